"""What inputs besides the duty change in a network, as tables for `rodas5p.c`.

Each change is a sum of products of two factors: one with the parameters, which is a number of each
draw, and one with the inputs, which all draws share in a step.
"""

from typing import NamedTuple, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..physics import Expressions, System, Wiring
from ..rig import Value


class InputLayout(NamedTuple):
    """Where the numbers of a draw that inputs may change begin, see `struct numbers`.

    - `entry` (nodes, nodes): the numbers of the entries of the conductance matrix.
    - `to_ambient` (nodes,), `held` (bodies,), `to_held` (bodies, nodes), `supply_voltage` (cells,).

    Nodes are in the order of the wiring.
    """

    entry: Int[np.ndarray, "nodes nodes"]
    to_ambient: Int[np.ndarray, " nodes"]
    held: Int[np.ndarray, " bodies"]
    to_held: Int[np.ndarray, "bodies nodes"]
    supply_voltage: Int[np.ndarray, " cells"]


@final
class NativeInputs:
    """The effects of a rig's inputs: the changes of links, of bodies of a given temperature, and of
    the voltage at each cell, as far as they depend on inputs.

    - `effect_term` (effects + 1,): where the terms of each effect begin.
    - `effect_number` (effects + 1,), `changed_number`, `changed_sign`: where the numbers that each
      effect changes begin, which they are, and with which sign.
    - `cell`: of each term, the cell whose share of the supply's voltage is a factor; -1 for none.
    """

    def __init__(self, wiring: Wiring, layout: InputLayout):
        effects = wiring.input_wiring
        self.inputs = wiring.inputs
        of_draws: list[Value] = []
        of_steps: list[Value] = []
        cells: list[int] = []
        terms, numbers = [0], [0]
        self.changed_number: list[int] = []
        self.changed_sign: list[int] = []
        names = {name for rig_input in wiring.inputs for name in rig_input.names}

        def add(values: list[Value], changed: dict[int, int], cell: int = -1) -> None:
            for value in values:
                inputs = tuple(row for row in value.powers if row[0] in names)
                if inputs:
                    others = tuple(row for row in value.powers if row[0] not in names)
                    of_draws.append(Value(value.factor, others))
                    of_steps.append(Value(1.0, inputs))
                    cells.append(cell)
            if len(of_steps) > terms[-1]:
                self.changed_number += changed
                self.changed_sign += changed.values()
                terms.append(len(of_steps))
                numbers.append(len(self.changed_number))

        if effects is not None:
            for row, values in enumerate(_sums(effects.conductances)):
                add(values, _of_link(layout, effects.differences[row], effects.to_reservoir[row]))
            for body, values in enumerate(_sums(effects.reservoirs)):
                add(values, {int(layout.held[body]): 1})
            for values in _sums(effects.supply_voltage):
                for cell, number in enumerate(layout.supply_voltage.tolist()):
                    add(values, {number: 1}, cell)
        self.effect_term, self.effect_number, self.cell = terms, numbers, np.array(cells, int)
        self._of_draws = Expressions([[value] for value in of_draws])
        self._of_steps = Expressions([[value] for value in of_steps])

    def of_draw(self, system: System) -> Float[Array, " terms"]:
        """The factors of a draw."""
        if not len(self.cell) or system.input_values is None:
            return jnp.zeros(0)
        factors = self._of_draws(system.input_values)
        share = system.bridge.supply_share
        if share is None:
            return factors
        return jnp.where(self.cell >= 0, jnp.asarray(share)[self.cell], 1.0) * factors

    def of_steps(
        self, levels: Float[np.ndarray, "steps inputs"]
    ) -> Float[np.ndarray, "steps terms"]:
        """The factors of steps, as differences from those where no input is stated.

        **Arguments:**

        - `levels`: the inputs in each step, see `input_levels`.
        """
        if not len(self.cell):
            return np.zeros((len(levels), 0))
        shares = {
            name: np.asarray(number)
            for rig_input, level in zip(self.inputs, levels.T, strict=True)
            for name, number in rig_input.shares(level).items()
        }
        nominal = {name: n for rig_input in self.inputs for name, n in rig_input.nominal.items()}
        # A speed below 0 has no power: the draws then fail, without a warning for each.
        with np.errstate(invalid="ignore", divide="ignore"):
            now, before = self._of_steps.numbers(shares), self._of_steps.numbers(nominal)
        return (now - before[:, None]).T


def _sums(expressions: Expressions) -> list[list[Value]]:
    """The values of each sum."""
    return [
        [
            product * float(factor)
            for product, factor in zip(expressions.products, row, strict=True)
            if factor
        ]
        for row in expressions.factors
    ]


def _of_link(
    layout: InputLayout,
    differences: Float[np.ndarray, " nodes"],
    to_reservoir: Float[np.ndarray, " bodies"],
) -> dict[int, int]:
    """The numbers that the conductance of a link changes, each with its sign: those of its ends."""
    ends = np.flatnonzero(differences)
    changed = {int(layout.entry[i, j]): 1 if i == j else -1 for i in ends for j in ends}
    if len(ends) == 2:
        return changed
    bodies = np.flatnonzero(to_reservoir)
    if len(bodies):
        return changed | {int(layout.to_held[bodies[0], ends[0]]): 1}
    return changed | {int(layout.to_ambient[ends[0]]): 1}
