"""The problem of a `MovingHorizonEstimator`, for do-mpc with IPOPT.

The equations are those of `_equations`, in CasADi, with the duty that lags behind its command and
the heats that the twin does not explain as states. Heats are forgotten exponentially and driven by
process noise, which do-mpc holds over a sample. Its arrival cost has the weights of the start at
every sample: it has no Riccati equation.
"""

import warnings
from typing import Any, final

import casadi as ca
import numpy as np
from jaxtyping import Float

import jaxtwin as jt
from jaxtwin.observers import ProcessNoise
from jaxtwin.observers._start import GIVEN_SPREAD

from ._casadi import numbers_of, rate_of
from ._do_mpc import SILENT
from ._equations import equations

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # about parts of do-mpc that are not installed
    import do_mpc

EXACT = 1e-4
"""The spread of what is taken as known, in its unit."""


@final
class DoMPCEstimator:
    """do-mpc's moving-horizon estimation on the equations of a twin that reads all channels.

    **Arguments:**

    - `noise`: of which `reading`, `disturbance` and `disturbance_time` count.
    - `sample_time`: s. `horizon`: in samples.
    - `lowest`: the lowest heat, W.
    """

    def __init__(
        self,
        twin: jt.Twin,
        noise: ProcessNoise,
        sample_time: float,
        horizon: int,
        lowest: float,
        degree: int = 2,
    ):
        network = equations(twin)
        self.network, cells = network, len(network.cold)
        level, time, reading = (
            float(np.asarray(value))
            for value in (noise.disturbance, noise.disturbance_time, noise.reading)
        )
        model = do_mpc.model.Model("continuous", "SX")
        x = model.set_variable("_x", "x", shape=(network.nodes, 1))
        reached = model.set_variable("_x", "reached", shape=(cells, 1))
        heat = model.set_variable("_x", "heat", shape=(cells, 1))
        u = model.set_variable("_u", "u", shape=(cells, 1))
        entering = ca.SX.zeros(network.nodes)
        for cell, node in enumerate(network.cold):
            entering[int(node)] = heat[cell] / network.capacitance[node]
        numbers = ca.SX(ca.DM(numbers_of(network)))
        model.set_rhs("x", rate_of(network, x, numbers, reached) + entering)
        model.set_rhs("reached", (u - reached) / network.lag)
        model.set_rhs("heat", -heat / time, process_noise=True)
        weights = ca.DM(network.gain[:, None] * network.weights)
        model.set_meas("readings", weights @ x + (network.ambient - 273.15), meas_noise=True)
        model.set_meas("duty", u, meas_noise=False)
        model.setup()
        self.mhe = do_mpc.estimator.MHE(model)
        settings: Any = self.mhe.settings
        settings.n_horizon, settings.t_step = horizon, sample_time
        settings.collocation_deg = degree
        settings.store_full_solution = False
        settings.meas_from_data = True
        settings.nlpsol_opts = SILENT
        spreads = [GIVEN_SPREAD] * network.nodes + [EXACT] * cells + [level] * cells
        gained = level**2 * -np.expm1(-2 * sample_time / time)
        per_rate = (time * -np.expm1(-sample_time / time)) ** 2
        self.mhe.set_default_objective(
            P_x=np.diag(np.array(spreads) ** -2.0),
            P_v=np.eye(len(network.gain)) / reading**2,
            P_w=np.eye(cells) * per_rate / gained,
        )
        self.mhe.bounds["lower", "_x", "heat"] = lowest
        self.mhe.setup()

    def start(self, nodes: Float[np.ndarray, " nodes"]) -> None:
        """Starts with idle cells at temperatures of the nodes, degC."""
        cells = len(self.network.cold)
        state = np.concatenate([nodes + 273.15 - self.network.ambient, np.zeros(2 * cells)])
        self.mhe.x0, self.mhe.u0 = state[:, None], np.zeros((cells, 1))
        self.mhe.set_initial_guess()

    def step(
        self, readings: Float[np.ndarray, " channels"], duty: Float[np.ndarray, " cells"]
    ) -> tuple[Float[np.ndarray, " nodes"], Float[np.ndarray, " cells"]]:
        """The temperatures of the nodes, degC, and the heats, W, after a sample."""
        found = np.asarray(self.mhe.make_step(np.concatenate([readings, duty])[:, None]))[:, 0]
        nodes, cells = self.network.nodes, len(self.network.cold)
        return found[:nodes] + self.network.ambient - 273.15, found[-cells:]
