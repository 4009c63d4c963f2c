"""The problem of a `NonlinearMPC` without temperature limits, for do-mpc with IPOPT.

The equations are those of `_equations`, in CasADi, with the duty that lags behind its command as
states, and without the driver's delay. do-mpc integrates them by orthogonal collocation, one
element a sample, and hands them to IPOPT with exact first and second derivatives, as is its
default. (As a discrete model, whose intervals are steps of Runge and Kutta's method, the graph is
so large that a step took 5 s.)
"""

import warnings
from typing import Any, final

import casadi as ca
import numpy as np
from jaxtyping import Float

import jaxtwin as jt
from jaxtwin.control import NonlinearMPC

from ._casadi import numbers_of, rate_of
from ._equations import equations

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # about parts of do-mpc that are not installed
    import do_mpc

SILENT = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": 0}


@final
class DoMPC:
    """do-mpc on the equations of a twin whose outputs are two channels.

    **Arguments:**

    - `twin`, `controller`: the twin, and the controller whose problem is to be solved.
    - `outputs`: the channels that are its outputs.
    - `references`: their references, degC.
    - `degree`: the degree of the collocation.
    """

    def __init__(
        self,
        twin: jt.Twin,
        controller: NonlinearMPC,
        outputs: list[str],
        references: Float[np.ndarray, " outputs"],
        degree: int = 2,
    ):
        network = equations(twin)
        self.network = network
        rows = [twin.channels.index(name) for name in outputs]
        cells = len(network.cold)
        model = do_mpc.model.Model("continuous", "SX")
        x = model.set_variable("_x", "x", shape=(network.nodes, 1))
        reached = model.set_variable("_x", "reached", shape=(cells, 1))
        u = model.set_variable("_u", "u", shape=(cells, 1))
        numbers = ca.SX(ca.DM(numbers_of(network)))
        model.set_rhs("x", rate_of(network, x, numbers, reached))
        model.set_rhs("reached", (u - reached) / network.lag)
        model.setup()
        weights = network.gain[rows, None] * network.weights[rows]
        read = ca.DM(weights) @ x + (network.ambient - 273.15)
        error = (read - ca.DM(references)) / ca.DM(np.asarray(controller.output_deviation))
        self.mpc = do_mpc.controller.MPC(model)
        settings: Any = self.mpc.settings
        settings.n_horizon, settings.t_step = controller.horizon, controller.sample_time_s
        settings.collocation_deg = degree
        settings.store_full_solution = False
        settings.nlpsol_opts = SILENT
        self.mpc.set_objective(mterm=ca.sumsqr(error), lterm=ca.sumsqr(error))
        self.mpc.set_rterm(u=np.asarray(controller.duty_change_deviation) ** -2.0)
        self.mpc.bounds["lower", "_u", "u"] = controller.limits[0]
        self.mpc.bounds["upper", "_u", "u"] = controller.limits[1]
        self.mpc.setup()

    def start(
        self, state: Float[np.ndarray, "states 1"], duty: Float[np.ndarray, " cells"]
    ) -> None:
        """Takes over in a state under a duty, without a plan."""
        self.mpc.reset_history()
        self.mpc.x0, self.mpc.u0 = state, duty[:, None]
        self.mpc.set_initial_guess()

    def state(
        self, nodes: Float[np.ndarray, " nodes"], reached: Float[np.ndarray, " cells"]
    ) -> Float[np.ndarray, "states 1"]:
        """The state for temperatures of the nodes, degC, and the duty that reaches the cells."""
        return np.concatenate([nodes + 273.15 - self.network.ambient, reached])[:, None]

    def step(self, state: Float[np.ndarray, "states 1"]) -> Float[np.ndarray, " cells"]:
        """The duty of a sample."""
        return np.asarray(self.mpc.make_step(state))[:, 0]

    def plan(self) -> Float[np.ndarray, "samples cells"]:
        """The duty of the horizon, as it was last planned."""
        moves = [self.mpc.opt_x_num["_u", k, 0] for k in range(self.mpc.settings.n_horizon)]
        return np.array([np.asarray(move)[:, 0] for move in moves])
