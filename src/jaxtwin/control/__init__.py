r"""Control: linear models of a twin, controllers, closed loops, and what tunes controllers.

`linear/` makes linear models of a twin. Near an operating point the temperatures of its nodes $x$,
the duty $u$ and the readings $y$ follow $\dot x = A x + B u$, $y = C x + D u$. `linearize` takes
the derivatives of the equations of `physics/_system.py` (`_linearize`), with the driver's delay and
lag apart (`_state_space`); its `discretise` makes $x_{k+1} = A x_k + B u_k$ of it, delay and lag
included (`_zero_order_hold`).

`controllers/` is what commands the cells. A controller is a PyTree of parameters with
`step(state, reference, measurement) -> duty, state` (`_controller`). The equations of a `PID` stand
in `_pid`, those of the others in a file each; `_riccati` in `linear/` designs the gains of an `LQI`
and of its Kalman filter, which may know what an observer finds (`_kalman`). An `MPC` minimises
quadratic programs at each sample (`_mpc_programs`), of its outputs, and of what makes many points
uneven (`_uniformity_mpc`). A `NonlinearMPC` plans on the twin itself
(`_multiple_shooting`). A class says the fields of its file and its law in C, which is in
`controllers/laws/`.

`loops/` closes the loop $u_k = K(r_k, y_k)$: around a nonlinear twin, in one compiled scan over
`Stepper` (`_closed_loop`), through a `Scenario` of references, disturbances and errors of the
readings; around a linear model, for stability and the sensitivity peak (`_sampled_loop`); and
around a rig (`_control`, behind the interlocks of `jaxtwin.live`).

`tuning/` finds parameters: by derivatives of whole loops (`_tune`), for several weights of two aims
(`_frontier`), by a relay's oscillation (`_ultimate_point`); the references of the most even plate
(`_most_even_point`), and the places of its cells (`_design_rig`).

A room imports only those before it.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(
    __name__,
    __file__,
    {
        "DiscreteModel": "StateSpace",
        "LinearModel": "StateSpace",
        "UniformityMPC": "design_uniformity_mpc",
    },
)
