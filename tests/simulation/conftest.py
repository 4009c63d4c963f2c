"""The authors' circuit as plain matrices for scipy, from their model file alone.

Nothing in `Circuit` comes from the package: nodes and links from `circuit_facts.json`, equations
of cells and driver as the model file connects them, values from the file and from Table 4 of the
paper.
"""

import json
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from small_rigs import make_rig as make_rig

from jaxtwin import Experiment, Twin, load_rig

FACTS = json.loads((Path(__file__).parents[1] / "physics" / "circuit_facts.json").read_text())

# Model file's name -> symbol of Table 4 (or of the rig where Table 4 has none).
SYMBOLS = {
    "R": "R_Tfx",
    "R1x": "R_Tfx1",
    "R2x": "R_Tfx2",
    "R1y": "R_Tcy1",
    "Ra": "R_Tez",
    "Ra1": "R_Tez1",
    "Ra2": "R_Tez2",
    "Ra3": "R_Tez3",
    "Rp": "R_Tey",
    "Rxp1": "R_Tex1",
    "Ryp1": "R_Tey1",
    "Ryp2": "R_Tey2",
    "Ryp3": "R_Tey3",
}

# The cells as the model file starts them: TEC1-12706 at 323 K.
STARTUP = {symbol: FACTS["formulas"][name] for name, symbol in SYMBOLS.items()} | {
    "alpha": 16.4 / 323,
    "R_E": 16.4 * (323 - 75) / (323 * 6.4),
    "R_Th": 75 / (16.4 * 6.4) * 2 * 323 / (323 - 75),
    "C_esp": 1262.0,
    "R_pc": 0.09,
    "R_ph": 0.6,
}

# Table 4 of the paper; what it leaves out keeps its start-up value. R_Tex3 and C_co are not in the
# circuit.
TABLE_4 = {
    "C_esp": (1200, 1959),
    "R_Th": (1.86, 9.75),
    "R_E": (1.96, 0.01),
    "R_Tfx": (0.49, 0.2),
    "R_Tez": (24.5, 18.54),
    "R_Tez1": (50, 95.5),
    "R_Tez2": (16.6, 0.52),
    "R_Tez3": (33.3, 0.82),
    "R_Tey": (197, 149.6),
    "R_Tex1": (196.91, 199.5),
    "R_Tey1": (788.3, 3.9),
    "R_Tey2": (262.7, 367.9),
    "R_Tey3": (545.5, 315.5),
    "R_ph": (0.6, 6.9e-5),
    "R_pc": (0.3, 1.1),
    "R_Tfx2": (0.42, 0.2),
}
VALUES = {
    "startup": STARTUP,
    "initial": STARTUP | {name: float(first) for name, (first, _) in TABLE_4.items()},
    "published": STARTUP | {name: float(final) for name, (_, final) in TABLE_4.items()},
}


class Circuit:
    """C dT/dt = -G (T - T_ambient) + cells, with T in K; nodes V11 ... V38, then TC and TH of each
    cell.

    The driver puts -12 V times the duty on a cell behind 0.1 ohm (positive duty heats the plate).
    """

    def __init__(self, values: Mapping[str, float]):
        plate = list(FACTS["capacitances"])
        self.nodes = [*plate, "P1.TC", "P1.TH", "P2.TC", "P2.TH"]
        place = {name: number for number, name in enumerate(self.nodes)}
        self.alpha, self.R_E = values["alpha"], values["R_E"]
        sides = [0.0135 * values["C_esp"]] * 4
        self.C = np.array([*FACTS["capacitances"].values(), *sides])
        self.G = np.zeros((28, 28))
        self.to_air = np.zeros(28)
        links = [(a, b, _now(resistance, values)) for a, b, resistance in FACTS["links"]]
        for cell, element in (("P1", "V23"), ("P2", "V26")):
            links.append((element, f"{cell}.TC", values["R_pc"]))
            links.append((f"{cell}.TC", f"{cell}.TH", values["R_Th"]))
            links.append((f"{cell}.TH", "ambient", values["R_ph"]))
        for first, second, resistance in links:
            inner = [place[end] for end in (first, second) if end != "ambient"]
            self.G[inner, inner] += 1 / resistance
            if len(inner) == 2:
                self.G[inner, inner[::-1]] -= 1 / resistance
            else:
                self.to_air[inner] += 1 / resistance
        self.cold, self.hot = np.array([24, 26]), np.array([25, 27])

    def cells(self, T: np.ndarray, duty: np.ndarray) -> tuple[np.ndarray, ...]:
        """q_c out of TC, q_h into TH (W), current (A) and voltage (V) of both cells."""
        cold, hot = T[..., self.cold], T[..., self.hot]
        current = (-12 * duty - self.alpha * (hot - cold)) / (self.R_E + 0.1)
        voltage = self.alpha * (hot - cold) + self.R_E * current
        q_c = self.alpha * current * cold - self.R_E * current**2 / 2
        q_h = self.alpha * current * hot + self.R_E * current**2 / 2
        return q_c, q_h, current, voltage

    def rate(self, T: np.ndarray, duty: np.ndarray, ambient: float) -> np.ndarray:
        """dT/dt of one state, K/s."""
        heat = -self.G @ T + self.to_air * ambient
        q_c, q_h, _, _ = self.cells(T, duty)
        heat[self.cold] -= q_c
        heat[self.hot] += q_h
        return heat / self.C

    def slope(self, T: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """Derivative of the rate by the state, by hand."""
        slope = -self.G.copy()
        _, _, current, _ = self.cells(T, duty)
        for cell, (c, h) in enumerate(zip(self.cold, self.hot, strict=True)):
            by_hot = -self.alpha / (self.R_E + 0.1)  # of the current; by the cold side the reverse
            out = self.alpha * T[c] - self.R_E * current[cell]
            into = self.alpha * T[h] + self.R_E * current[cell]
            slope[c, c] -= self.alpha * current[cell] - out * by_hot
            slope[c, h] -= out * by_hot
            slope[h, h] += self.alpha * current[cell] + into * by_hot
            slope[h, c] -= into * by_hot
        return slope / self.C[:, None]

    def start(self, celsius: float = 15.0) -> np.ndarray:
        """Plate at a temperature, cells at the model file's 298 K."""
        return np.array([celsius + 273.15] * 24 + [298.0] * 4)

    def solve(
        self,
        time: np.ndarray,
        duty: np.ndarray,
        *,
        start: np.ndarray | None = None,
        ambient: np.ndarray | float = 15.0,
    ) -> np.ndarray:
        """Node temperatures at the sample times, degC: Radau, anew from each input change on.

        Inputs are held from sample to sample; `ambient` in degC.
        """
        air = np.broadcast_to(np.asarray(ambient) + 273.15, time.shape)
        inputs = np.column_stack([duty, air])
        changes = 1 + np.flatnonzero(np.any(inputs[1:] != inputs[:-1], axis=1))
        marks = [0, *changes, len(time) - 1]
        states = [self.start() if start is None else start]
        for first, last in pairwise(marks):
            if first == last:
                continue
            held, outside = duty[first], float(air[first])
            part = solve_ivp(
                lambda t, T, held=held, outside=outside: self.rate(T, held, outside),
                (time[first], time[last]),
                states[-1],
                method="Radau",
                t_eval=time[first + 1 : last + 1],
                rtol=1e-10,
                atol=1e-10,
                jac=lambda t, T, held=held: self.slope(T, held),
            )
            assert part.success, part.message
            states.extend(part.y.T)
        return np.array(states) - 273.15


@pytest.fixture(scope="session")
def circuits() -> dict[str, Circuit]:
    """The authors' circuit with start-up values and both columns of Table 4."""
    return {name: Circuit(values) for name, values in VALUES.items()}


@pytest.fixture(scope="session")
def twins() -> dict[str, Twin]:
    """The package's twin of the same circuit, with the rig's own parameter sets."""
    rig = load_rig("paper-2024")
    return {name: Twin(rig, rig.parameter_sets[name]) for name in VALUES}


@pytest.fixture(scope="session")
def paper_steps() -> Experiment:
    """The step recordings' inputs: 128 of 255 counts until 500 s, then 200, every second."""
    time = np.arange(1001.0)
    return Experiment(time, np.where(time < 500, 128, 200)[:, None] / 255 * np.ones(2))


def _now(startup: float, values: Mapping[str, float]) -> float:
    """What a link of the model file becomes for other values: same symbol, same factor."""
    if startup == pytest.approx(2 * FACTS["formulas"]["Ra"], rel=1e-12):
        return 2 * values["R_Tez"]  # the two elements under a cell
    for name, symbol in SYMBOLS.items():
        if startup == pytest.approx(FACTS["formulas"][name], rel=1e-12):
            return values[symbol]
    raise AssertionError(f"no formula of the model file gives {startup} K/W")
