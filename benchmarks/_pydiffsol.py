"""pydiffsol, a Rust library: equations in its own language, compiled as they are read, one draw at
a time.

At its best: single numbers in place of vectors and matrices, each link once, gains inside the
equations, and a solve for each stretch between two changes of the input, as no step should straddle
one. For rigs with the mean voltage and linear losses, such as the paper's.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pydiffsol
from jaxtyping import Float

from ._equations import Equations, equations, stretches
from ._task import Task


@dataclass(frozen=True)
class DiffsolSetting:
    """What a user of pydiffsol chooses: the method, the kind of matrix, and tolerances (K)."""

    solver: str
    matrix: str
    reltol: float
    abstol: float

    def __str__(self) -> str:
        tolerances = f"{self.reltol:.0e}, {self.abstol:.0e} K".replace("e-0", "e-")
        return f"{self.solver}, {self.matrix}, {tolerances}"


def diffsol(
    task: Task, count: int, setting: DiffsolSetting
) -> Callable[[], Float[np.ndarray, "draws times channels"]]:
    """Whole trajectories, degC."""
    draws = [equations(twin) for twin in task.twins(count)]
    one = draws[0]
    if one.lag or not one.linear_losses or one.averaging != "voltage":
        raise ValueError(f"{task.name}: expected the mean voltage, linear losses and no lag")
    ode = pydiffsol.Ode(
        _source(one),
        matrix_type=getattr(pydiffsol, setting.matrix),
        ode_solver=getattr(pydiffsol, setting.solver),
    )
    ode.rtol, ode.atol = setting.reltol, setting.abstol
    numbers = [_numbers(draw) for draw in draws]
    time = task.experiment.time
    parts = stretches(task.experiment, one)
    channels, nodes = len(one.gain), one.nodes
    out = np.empty((count, len(time), channels))

    def run() -> Float[np.ndarray, "draws times channels"]:
        for number, (draw, own) in enumerate(zip(draws, numbers, strict=True)):
            state = draw.start
            for begin, end, command in parts:
                inside = (time >= begin) & ((time < end) | (time == end) & (end == time[-1]))
                at = np.maximum(time[inside] - begin, 1e-9)
                at = at if at[-1] == end - begin else np.append(at, end - begin)
                found = ode.solve_dense(np.concatenate([own, state, command]), at)
                out[number, inside] = found.ys[:channels, : np.count_nonzero(inside)].T
                state = found.ys[channels : channels + nodes, -1]
        return out

    return run


def _links(one: Equations) -> list[tuple[int, int]]:
    return [(int(i), int(j)) for i, j in zip(*np.nonzero(np.triu(one.conductance, 1)), strict=True)]


def _numbers(one: Equations) -> Float[np.ndarray, " numbers"]:
    """The numbers of a draw, in the order of `_names`."""
    between = [-one.conductance[i, j] for i, j in _links(one)]
    ambient = one.conductance.sum(axis=1)
    drive = [one.supply_voltage, one.supply_resistance, one.on_resistance, one.ambient]
    cells = [one.seebeck, one.resistance]
    return np.concatenate([between, ambient, 1 / one.capacitance, *cells, drive, one.gain])


def _names(one: Equations) -> list[str]:
    counts = [("g", len(_links(one))), ("a", one.nodes), ("c", one.nodes)]
    counts += [("al", len(one.cold)), ("re", len(one.cold))]
    names = [f"{kind}{k}" for kind, count in counts for k in range(count)]
    names += ["vs", "rs", "ron", "amb", *(f"k{k}" for k in range(len(one.gain)))]
    return [
        *names,
        *(f"s{k}" for k in range(one.nodes)),
        *(f"d{k}" for k in range(len(one.cold))),
        "room",
    ]


def _source(one: Equations) -> str:
    """The equations in DiffSL."""
    heat: list[list[str]] = [[f"-a{i} * (x{i} - room)"] for i in range(one.nodes)]
    for k, (i, j) in enumerate(_links(one)):
        heat[i].append(f"g{k} * (x{j} - x{i})")
        heat[j].append(f"g{k} * (x{i} - x{j})")
    currents = []
    for k, (c, h) in enumerate(zip(one.cold, one.hot, strict=True)):
        emf = f"al{k} * (x{h} - x{c})"
        currents.append(f"i{k} {{ (-d{k} * vs - {emf}) / (re{k} + ron + abs(d{k}) * rs) }}")
        joule = f"0.5 * re{k} * i{k} * i{k}"
        heat[c].append(f"(-(al{k} * i{k} * (x{c} + amb)) + {joule})")
        heat[h].append(f"(al{k} * i{k} * (x{h} + amb) + {joule})")
    readings = [
        f"k{row} * ("
        + " + ".join(
            f"{weight!r} * (x{node} - room)" for node, weight in enumerate(weights) if weight
        )
        + ") + amb + room - 273.15"
        for row, weights in enumerate(one.weights.tolist())
    ]
    return "\n".join([
        "in_i { " + ", ".join(f"{name} = 1.0" for name in _names(one)) + " }",
        _vector("u_i", [f"x{i} = s{i}" for i in range(one.nodes)]),
        *currents,
        _vector("F_i", [f"c{i} * ({' + '.join(terms)})" for i, terms in enumerate(heat)]),
        _vector("out_i", [*readings, *(f"x{i}" for i in range(one.nodes))]),
    ])  # fmt: skip


def _vector(name: str, rows: Sequence[str]) -> str:
    return name + " {\n" + ",\n".join(f"  {row}" for row in rows) + "\n}"
