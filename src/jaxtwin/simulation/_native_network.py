"""A network as the tables and numbers that `rodas5p.c` takes.

The tables (which nodes are connected, in which order they are eliminated) are the same for all
draws of a twin and made once. The numbers of a draw are one column of an array.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._celsius import ZERO_CELSIUS
from .._compilation import persistent_jit
from .._sparse import SparseLU
from ..physics import STEFAN_BOLTZMANN, System, Twin, Wiring
from ._initial import CheckedInitial, initial_temperatures, keeps_symmetry
from ._native_inputs import InputLayout, NativeInputs
from ._rosenbrock_step import CORRECTION, DENSE, GAMMA, NODES, SLOPE_TABLE, STATE_TABLE, TIME
from ._scalar_network import network_pattern
from ._time_grid import InputSummary, reference_temperature


@final
class Elimination:
    """A sparsity pattern and its factors by rows, with the nodes in the order of elimination.

    - `order` (nodes,): the node that is eliminated first, second, and so on.
    - `row`, `column`: where each row of the matrix begins, and the column of each entry.
    - `factor_row`, `factor_column`, `diagonal`: the same for the factors $L$ and $U$ together, and
      the place of the diagonal of each row.
    - `place` (nodes, nodes): the place of each entry among the factors, -1 for none.
    - `changed`: the places that elimination changes, in its order.
    """

    def __init__(self, pattern: Bool[np.ndarray, "nodes nodes"]):
        steps = SparseLU(pattern).elimination
        self.order = np.array([pivot for pivot, *_ in steps], np.int32)
        filled = np.array(pattern, bool) | np.eye(len(pattern), dtype=bool)
        ordered = filled[np.ix_(self.order, self.order)]
        for pivot, rows, columns in steps:
            filled[np.ix_(rows, columns)] = True
            filled[pivot, pivot] = True
        factors = filled[np.ix_(self.order, self.order)]
        self.row, self.column = _by_rows(ordered)
        self.factor_row, self.factor_column = _by_rows(factors)
        self.place = np.full(factors.shape, -1, np.int32)
        self.place[factors] = np.arange(np.count_nonzero(factors))
        self.diagonal = np.diag(self.place).astype(np.int32)
        self.changed = np.array(
            [
                self.place[i, j]
                for i in range(len(factors))
                for k in np.flatnonzero(factors[i, :i])
                for j in k + 1 + np.flatnonzero(factors[k, k + 1 :])
            ],
            np.int32,
        )


def _by_rows(
    pattern: Bool[np.ndarray, "rows columns"],
) -> tuple[Int[np.ndarray, " begins"], Int[np.ndarray, " entries"]]:
    """Where each row of a pattern begins, and the column of each entry."""
    begins = np.append(0, np.cumsum(pattern.sum(axis=1)))
    return begins.astype(np.int32), np.nonzero(pattern)[1].astype(np.int32)


# The number of numbers of a draw before those of its network.
COMMON = 5

# The current limit of a driver without one, A.
NO_LIMIT = 1e300


@final
class NativeNetwork:
    """The tables of a network, which are equal for all draws of a twin.

    - `header`: `network.h`, with the patterns of the network and the coefficients of the method.
    """

    def __init__(self, wiring: Wiring) -> None:
        self.elimination = Elimination(network_pattern(wiring))
        self.position = np.argsort(self.elimination.order).astype(np.int32)
        self.inputs = NativeInputs(wiring, self._layout(wiring))
        self.header = self._header(wiring)

    def _layout(self, wiring: Wiring) -> InputLayout:
        """The places of numbers in `_numbers`."""
        table, at = self.elimination, self.position
        nodes, cells = len(table.order), len(wiring.cold)
        bodies = len(wiring.netlist.reservoirs)
        rows = np.repeat(table.order, np.diff(table.row))
        entry = np.full((nodes, nodes), -1)
        entry[rows, table.order[table.column]] = COMMON + np.arange(len(table.column))
        to_ambient = COMMON + len(table.column) + nodes
        held = to_ambient + nodes
        to_held = held + bodies
        supply_voltage = to_held + (bodies + 1) * nodes + 2 * cells
        return InputLayout(
            entry,
            to_ambient + at,
            held + np.arange(bodies),
            to_held + nodes * np.arange(bodies)[:, None] + at,
            supply_voltage + np.arange(cells),
        )

    def _header(self, wiring: Wiring) -> str:
        table, at = self.elimination, self.position
        cold, hot = at[wiring.cold], at[wiring.hot]
        cells = len(cold)
        losses, far = self._losses(wiring)
        cell_factors = [
            table.place[a, b]
            for k in range(cells)
            for a in (cold[k], hot[k])
            for b in (cold[k], hot[k])
        ]
        rows = np.repeat(np.arange(len(table.order)), np.diff(table.row))
        sizes: dict[str, float] = {
            "NODES": len(table.order),
            "ENTRIES": len(table.column),
            "FACTORS": len(table.factor_column),
            "CELLS": cells,
            "LOSSES": len(losses),
            "HAS_FAR_ENDS": wiring.loss_paths is not None and not wiring.loss_paths.is_of_plate,
            "BODIES": len(wiring.netlist.reservoirs),
            "EFFECTS": len(self.inputs.effect_term) - 1,
            "TERMS": len(self.inputs.cell),
            "ON_OFF": wiring.averaging == "on-off",
            "BRAKE": wiring.off_phase == "brake",
            "HAS_DRIVE_LAW": wiring.drive_exponents is not None,
            "HAS_LAG": wiring.lag is not None,
            "HAS_DRIFT": wiring.ambient_drift is not None,
            "METHOD_GAMMA": GAMMA,
        }
        integers = {
            "network_row": table.row,
            "network_column": table.column,
            "network_factor_of": table.place[rows, table.column],
            "network_diagonal": table.diagonal,
            "network_cold": cold,
            "network_hot": hot,
            "network_cell_factors": cell_factors,
            "network_is_heater": wiring.heaters or [False] * cells,
            "network_has_own_supply": wiring.own_supply or [False] * cells,
            "network_loss_node": losses,
            "network_loss_far": far,
            "network_loss_factors": [
                table.place[a, b] if b >= 0 else -1
                for near, end in zip(losses, far, strict=True)
                for a, b in ((near, end), (end, near))
            ],
            "network_effect_term": self.inputs.effect_term,
            "network_effect_number": self.inputs.effect_number,
            "network_changed_number": self.inputs.changed_number,
            "network_changed_sign": self.inputs.changed_sign,
        }
        numbers = {
            "method_node": NODES,
            "method_time": TIME,
            "method_state": STATE_TABLE,
            "method_slope": SLOPE_TABLE,
            "method_dense": DENSE,
            "method_correction": CORRECTION,
        }
        lines = [f"#define {name} {number + 0!r}" for name, number in sizes.items()]
        lines += [
            f"#define NETWORK_FACTORISE {' '.join(_factorise_statements(table))}",
            f"#define NETWORK_SOLVE {' '.join(_solve_statements(table))}",
        ]
        for kind, tables in (("int", integers), ("double", numbers)):
            lines += [_table(kind, name, np.asarray(values)) for name, values in tables.items()]
        return "\n".join(lines) + "\n"

    def _losses(self, wiring: Wiring) -> tuple[Int[np.ndarray, " even"], Int[np.ndarray, " even"]]:
        """The nodes at which paths of nonlinear heat begin, and where they end as in `LossPaths`.
        The program takes two at a time; the last one is repeated, with a factor of 0."""
        paths, at = wiring.loss_paths, self.position
        if paths is None:
            return at[:0], at[:0]
        near, far = at[paths.near], np.where(paths.far >= 0, at[paths.far], paths.far)
        filling = (0, len(near) % 2)
        return np.pad(near, filling, mode="edge"), np.pad(far, filling, mode="edge")


@final
class Outputs:
    """The sums of node temperatures that are computed of each draw: the readings of channels, then
    the temperatures of the plate's elements, if they are wanted.

    **Arguments:**

    - `wiring`: that of the systems.
    - `columns`: the positions of the requested channels among those of the rig.
    - `with_plate`: whether the elements are wanted.

    `readers` are the nodes that each channel may read, `others` the elements. `row` (outputs + 1,)
    is where the weights of each output begin, and `nodes` the node of each weight.
    """

    def __init__(self, wiring: Wiring, columns: Sequence[int], with_plate: bool) -> None:
        self.columns = np.array(columns, np.int32)
        # Where a camera's place is a parameter, a zone may read any element of the plate.
        reads = np.asarray(wiring.channel_weights)[self.columns] != 0
        if wiring.zones is not None:
            reads[:, : wiring.elements] = True
        self.readers = [np.flatnonzero(row).astype(np.int32) for row in reads]
        # All elements are read, also where one node of the lumped network stands for two.
        self.others = np.asarray(wiring.rig_elements if with_plate else [], np.int32)
        self.count = len(self.columns) + len(self.others)
        lengths = [len(nodes) for nodes in self.readers] + [1] * len(self.others)
        self.row = np.cumsum([0, *lengths]).astype(np.int32)
        self.nodes = np.concatenate([*self.readers, self.others])

    def select(
        self, numbers: Float[np.ndarray, "numbers draws"], columns: Sequence[int]
    ) -> Float[np.ndarray, "fewer draws"]:
        """The numbers of draws for fewer channels, these positions among the `columns`."""
        count = len(self.columns)
        if tuple(columns) == tuple(self.columns.tolist()):
            return numbers
        tables = len(numbers) - len(self.nodes) - 3 * count
        at = np.asarray(columns, int)
        kept = [np.arange(tables), *(tables + part * count + at for part in range(3))]
        weights = len(numbers) - len(self.nodes)
        kept += [weights + np.arange(*self.row[begin : begin + 2]) for begin in at]
        kept.append(weights + np.arange(self.row[count], self.row[-1]))
        return numbers[np.concatenate(kept)]


@lru_cache(maxsize=32)
def native_network(wiring: Wiring) -> NativeNetwork:
    """The tables of a network, made once."""
    return NativeNetwork(wiring)


@persistent_jit
def pack_draws(
    twin: Twin,
    draws: Mapping[str, Float[Array | np.ndarray, " draws"]],
    inputs: InputSummary,
    initial: CheckedInitial,
    with_plate: bool,
) -> Float[Array, "numbers draws"]:
    """Computes the numbers of draws for `rodas5p.c`, in the order of its `struct numbers`, for all
    channels: recordings of other channels use the same program.

    **Arguments:** `twin` to `initial` are as in `prepare_chunk`, `with_plate` as in `Outputs`.
    """

    def pack(values: Mapping[str, Float[Array | np.ndarray, ""]]) -> Float[Array, " numbers"]:
        system = twin.with_values(values).system(lumped=keeps_symmetry(initial))
        network = native_network(system.wiring)
        outputs = Outputs(system.wiring, range(len(system.wiring.channels)), with_plate)
        reference = reference_temperature(system, inputs)
        start = initial_temperatures(system, initial, inputs.first, reference)
        drift = system.ambient_drift if inputs.ambient is None else None
        return _numbers(network, outputs, system, reference, start - reference, drift)

    return jax.vmap(pack, out_axes=1)(draws)


def _numbers(
    network: NativeNetwork,
    outputs: Outputs,
    system: System,
    reference: Float[Array, ""],
    start: Float[Array, " nodes"],
    drift: Float[Array, ""] | None,
) -> Float[Array, " numbers"]:
    wiring, module, bridge, loss = system.wiring, system.module, system.bridge, system.loss
    table, columns = network.elimination, outputs.columns
    order, cells = table.order, len(wiring.cold)
    rows = np.repeat(np.arange(len(order)), np.diff(table.row))
    held = system.reservoirs
    limit = NO_LIMIT if bridge.current_limit is None else bridge.current_limit
    share = 1.0 if bridge.supply_share is None else bridge.supply_share
    gain = system.gain[columns]
    on_plate = jnp.broadcast_to(system.on_plate, system.gain.shape)[columns]
    offset = 0.0 if system.offset is None else system.offset[columns]
    weights = jnp.asarray(system.channel_weights)[columns]
    lists: list[Any] = [
        [system.is_valid, reference],
        [0.0 if value is None else value for value in (system.lag, system.delay, drift)],
        system.conductance[order[rows], order[table.column]],
        system.capacitance[order],
        system.ambient_conductance[order],
        *(
            []
            if held is None
            else [held.temperature - reference, held.conductance[:, order].ravel()]
        ),
        start[order],
        *(
            jnp.broadcast_to(jnp.asarray(value), (cells,))
            for value in (
                module.seebeck_coefficient,
                module.electrical_resistance,
                bridge.supply_voltage * jnp.asarray(share),
                bridge.supply_resistance,
                bridge.on_resistance,
                limit,
                bridge.own_voltage * jnp.asarray(share),
                *([] if bridge.drive_exponent is None else [bridge.drive_exponent]),
            )
        ),
        *(
            []
            if loss is None
            else [
                _even(value)
                for value in (
                    loss.film,
                    jnp.broadcast_to(loss.exponent, loss.film.shape),
                    STEFAN_BOLTZMANN * loss.radiating,
                    *([] if loss.linear is None else [loss.linear]),
                )
            ]
        ),
        network.inputs.of_draw(system),
        gain,
        jnp.broadcast_to(reference - ZERO_CELSIUS + offset, gain.shape),
        1 - gain * on_plate,
        *(weights[row, read] for row, read in enumerate(outputs.readers)),
        jnp.ones(len(outputs.others)),
    ]
    dtype = reference.dtype
    return jnp.concatenate([jnp.atleast_1d(jnp.asarray(row, dtype)) for row in _flat(lists)])


def _even(numbers: Float[Array, " elements"]) -> Float[Array, " even"]:
    """The numbers of the losses, filled up to an even number."""
    return jnp.pad(numbers, (0, numbers.size % 2))


def _flat(lists: Sequence[Any]) -> list[Any]:
    return [row for part in lists for row in (part if isinstance(part, list) else [part])]


def _factorise_statements(table: Elimination) -> list[str]:
    """The elimination as straight code in C. A compiler takes ten times as long to unroll the loops
    of a network of sixty nodes."""
    changed, lines = iter(table.changed.tolist()), []
    row, diagonal, column = table.factor_row, table.diagonal, table.factor_column
    for i, pivot in enumerate(diagonal):
        for p in range(row[i], pivot):
            k = column[p]
            lines.append(f"f[{p}] *= f[{diagonal[k]}];")
            lines += [
                f"f[{next(changed)}] -= f[{p}] * f[{q}];"
                for q in range(diagonal[k] + 1, row[k + 1])
            ]
        lines.append(f"f[{pivot}] = 1 / f[{pivot}];")
    return lines


def _solve_statements(table: Elimination) -> list[str]:
    """The substitutions forwards and backwards as straight code in C."""
    row, diagonal, column = table.factor_row, table.diagonal, table.factor_column

    def less(places: range) -> str:
        return "".join(f" - f[{p}] * x[{column[p]}]" for p in places)

    nodes = range(len(diagonal))
    forwards = [f"x[{i}] = b[{i}]{less(range(row[i], diagonal[i]))};" for i in nodes]
    backwards = [
        f"x[{i}] = (x[{i}]{less(range(diagonal[i] + 1, row[i + 1]))}) * f[{diagonal[i]}];"
        for i in reversed(nodes)
    ]
    return forwards + backwards


def _table(kind: str, name: str, values: np.ndarray) -> str:
    """A constant table of one or two dimensions in C."""
    sizes = "".join(f"[{max(size, 1)}]" for size in values.shape)
    inner = ", ".join(
        "{" + ", ".join(repr(number) for number in row) + "}" if values.ndim == 2 else repr(row)
        for row in (values.astype(int) if kind == "int" else values).tolist()
    )
    return f"static const {kind} {name}{sizes} = {{{inner or 0}}};"
