r"""A twin's equations written again in numpy, with an analytic Jacobian: for solvers outside JAX.

$C \dot x = -G x - l(x) + q(x, u)$ with $x$ the deviation from ambient, $q$ the heat flows of the
cells, eqs. (7)-(9) of the paper, and $l$ what a film that grows with the rise and radiation take
beyond $G$. Where the driver lags behind its command $c$, the duty cycles are states as well:
$\tau \dot u = c - u$. Only numbers are taken from the twin.
A command is the duty of each cell and, behind them, the room's deviation from the ambient
temperature of the rig, K.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import jax
import numpy as np
from jaxtyping import Float

import jaxtwin as jt
from jaxtwin.rig import FILM_REFERENCE

STEFAN_BOLTZMANN = 5.670374419e-8
CALM = 1.0
"""Rise below which the film stops falling, K."""


@dataclass(frozen=True)
class Equations:
    """One draw's network: numbers of `twin.system()` as plain numpy arrays, SI units.

    The vector of states holds the nodes' deviations from ambient, K, and behind them, where the
    driver lags, the duty cycle of each cell. `film`, `exponent` and `radiating` are zeros where
    losses are linear.
    """

    capacitance: np.ndarray
    conductance: np.ndarray
    cold: np.ndarray
    hot: np.ndarray
    seebeck: np.ndarray
    resistance: np.ndarray
    supply_voltage: float
    supply_resistance: float
    on_resistance: float
    averaging: str
    off_phase: str
    film: np.ndarray
    exponent: np.ndarray
    radiating: np.ndarray
    lag: float
    delay: float
    ambient: float
    start: np.ndarray
    weights: np.ndarray
    gain: np.ndarray

    @property
    def nodes(self) -> int:
        """How many of the states are temperatures."""
        return len(self.capacitance)

    @cached_property
    def linear_losses(self) -> bool:
        """Whether the losses are those of the network's links."""
        return not (self.exponent.any() or self.radiating.any())

    @property
    def initial(self) -> Float[np.ndarray, " states"]:
        """States at the start: the rig's own, and a driver that has not been told anything."""
        return np.concatenate([self.start, np.zeros(len(self.cold) if self.lag else 0)])

    def readings(
        self, states: Float[np.ndarray, "times states"], room: Float[np.ndarray, " times"]
    ) -> Float[np.ndarray, "times channels"]:
        """What the channels read, degC, in a room that deviates from the ambient temperature."""
        rises = states[:, : self.nodes] - room[:, None]
        return self.gain * (rises @ self.weights.T) + self.ambient - 273.15 + room[:, None]

    def rate(
        self, state: Float[np.ndarray, " states"], command: Float[np.ndarray, " cells_and_room"]
    ) -> Float[np.ndarray, " states"]:
        """The states' rate of change, 1/s."""
        x, room = state[: self.nodes], command[-1]
        command = command[:-1]
        duty = state[self.nodes :] if self.lag else command
        heat = self.conductance.sum(axis=1) * room - self.conductance @ x
        if not self.linear_losses:
            heat[: len(self.film)] -= self._loss(x[: len(self.film)] - room, self.ambient + room)
        for share, cold, hot in self._cell_heat(x, duty):
            heat[self.cold] -= share * cold
            heat[self.hot] += share * hot
        heat /= self.capacitance
        return np.concatenate([heat, (command - duty) / self.lag]) if self.lag else heat

    def jacobian(
        self, state: Float[np.ndarray, " states"], command: Float[np.ndarray, " cells_and_room"]
    ) -> Float[np.ndarray, "states states"]:
        """Derivative of `rate` with respect to the states, 1/s."""
        n, c, h = self.nodes, self.cold, self.hot
        x, room = state[:n], command[-1]
        duty = state[n:] if self.lag else command[:-1]
        J = np.zeros((len(state), len(state)))
        J[:n, :n] = -self.conductance
        if not self.linear_losses:
            plate = np.arange(len(self.film))
            J[plate, plate] -= self._loss_slope(x[: len(self.film)] - room, self.ambient + room)
        T_c, T_h = x[c] + self.ambient, x[h] + self.ambient
        for share, current, loop in self._phases(T_h - T_c, duty):
            peltier = share * self.seebeck * current
            # dI/dT_h = -dI/dT_c
            d = 0.0 if loop is None else -self.seebeck / loop
            cold = share * (self.seebeck * T_c - self.resistance * current) * d
            hot = share * (self.seebeck * T_h + self.resistance * current) * d
            J[c, c] -= peltier - cold
            J[c, h] -= cold
            J[h, h] += peltier + hot
            J[h, c] -= hot
        if self.lag:
            (_, cold_on, hot_on), (_, cold_off, hot_off) = self._cell_heat(x, duty)
            cells = np.arange(len(c))
            J[c, n + cells] = -np.sign(duty) * (cold_on - cold_off)
            J[h, n + cells] = np.sign(duty) * (hot_on - hot_off)
            J[n + cells, n + cells] = -1 / self.lag
        J[:n] /= self.capacitance[:, None]
        return J

    def _loss(self, rise: np.ndarray, ambient: float) -> np.ndarray:
        power = ((rise**2 + CALM**2) / (FILM_REFERENCE**2 + CALM**2)) ** (self.exponent / 2)
        radiated = (ambient + rise) ** 4 - ambient**4
        return self.film * (power - 1) * rise + STEFAN_BOLTZMANN * self.radiating * radiated

    def _loss_slope(self, rise: np.ndarray, ambient: float) -> np.ndarray:
        square = rise**2 + CALM**2
        power = (square / (FILM_REFERENCE**2 + CALM**2)) ** (self.exponent / 2)
        film = self.film * (power - 1 + power * self.exponent * rise**2 / square)
        return film + 4 * STEFAN_BOLTZMANN * self.radiating * (ambient + rise) ** 3

    def _cell_heat(self, x: np.ndarray, duty: np.ndarray):
        """The parts of a PWM period: share, heat out of the cold and into the hot sides."""
        T_c, T_h = x[self.cold] + self.ambient, x[self.hot] + self.ambient
        heat = []
        for share, current, _ in self._phases(T_h - T_c, duty):
            peltier, joule = self.seebeck * current, 0.5 * self.resistance * current * current
            heat.append((share, peltier * T_c - joule, peltier * T_h + joule))
        return heat

    def _phases(self, difference: np.ndarray, duty: np.ndarray):
        """The parts of a PWM period: share, current, resistance of the loop (None where open)."""
        emf = self.seebeck * difference
        loop = self.resistance + self.on_resistance
        share = np.abs(duty)
        if self.averaging == "voltage":
            whole = loop + share * self.supply_resistance
            return [(1.0, (-duty * self.supply_voltage - emf) / whole, whole)]
        on = loop + self.supply_resistance
        phases = [(share, (-np.sign(duty) * self.supply_voltage - emf) / on, on)]
        off = (-emf / loop, loop) if self.off_phase == "brake" else (0 * emf, None)
        return [*phases, (1 - share, *off)]


def equations(twin: jt.Twin) -> Equations:
    """The equations of one twin."""
    with jax.enable_x64(True):
        system = jax.tree.map(np.asarray, twin.system())
    module, bridge, loss = system.module, system.bridge, system.loss
    none = np.zeros(system.wiring.elements)
    return Equations(
        capacitance=system.capacitance,
        conductance=system.conductance,
        cold=system.wiring.cold,
        hot=system.wiring.hot,
        seebeck=module.seebeck_coefficient,
        resistance=module.electrical_resistance,
        supply_voltage=float(bridge.supply_voltage),
        supply_resistance=float(bridge.supply_resistance),
        on_resistance=float(bridge.on_resistance),
        averaging=bridge.averaging,
        off_phase=bridge.off_phase,
        film=none if loss is None else loss.film,
        exponent=none if loss is None else loss.exponent + none,
        radiating=none if loss is None else loss.radiating,
        lag=0.0 if system.lag is None else float(system.lag),
        delay=0.0 if system.delay is None else float(system.delay),
        ambient=float(system.ambient_temperature),
        start=system.initial_temperature - system.ambient_temperature,
        weights=np.asarray(system.channel_weights),
        gain=system.gain,
    )


Stretch = tuple[float, float, Float[np.ndarray, " cells_and_room"]]
"""Start, end and what is commanded in between."""


def stretches(experiment: jt.Experiment, network: Equations) -> Sequence[Stretch]:
    """What the cells are commanded as it reaches them, and the room, between two changes each; no
    step of a solver should straddle one."""
    time, delay = experiment.time, network.delay
    duty = np.vstack([np.zeros(experiment.n_cells), experiment.duty])
    room = rooms(experiment, network)
    changes = 1 + np.flatnonzero(np.any(np.diff(experiment.duty, axis=0) != 0, axis=1))
    warmer = 1 + np.flatnonzero(np.diff(room) != 0)
    begins = np.unique([time[0], time[0] + delay, *(time[changes] + delay), *time[warmer]])
    begins = begins[begins < time[-1]]

    def held(begin: float) -> Float[np.ndarray, " cells_and_room"]:
        commanded = np.searchsorted(time, begin - delay + 1e-9, side="right")
        return np.append(duty[commanded], room[np.searchsorted(time, begin, side="right") - 1])

    ends = [*begins.tolist(), float(time[-1])]
    return [(start, end, held(start)) for start, end in pairwise(ends)]


def rooms(experiment: jt.Experiment, network: Equations) -> Float[np.ndarray, " times"]:
    """The room at each sample, as a deviation from the ambient temperature of the rig, K."""
    if experiment.ambient is None:
        return np.zeros(len(experiment.time))
    return experiment.ambient + 273.15 - network.ambient
