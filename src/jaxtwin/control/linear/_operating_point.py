"""Computes steady states: the temperatures for a duty cycle, and the duty cycle for
temperatures."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..._arguments import finite_number
from ..._celsius import ZERO_CELSIUS
from ..._lapack import solve
from ..._result import AbstractResult, dataset, table
from ...errors import ControlError
from ...physics import System, Twin

if TYPE_CHECKING:
    import pandas
    import xarray

# Steps of the search for a duty cycle. It usually needs a handful; on the way from full cooling to
# full heating each is limited to `MAX_STEP`.
NEWTON_STEPS = 40

MAX_STEP = 0.25

# The distance from a duty of 0 at which its two slopes are computed.
KINK_DISTANCE = 1e-9


@final
class OperatingPoint(eqx.Module, AbstractResult):
    """A steady state of a rig.

    - `duty`: the duty of the cells, -1 to 1.
    - `nodes`: temperatures of the nodes, degC, in the order of `twin.netlist.nodes`.
    - `outputs`: readings of the channels, degC.
    - `ambient`: temperature of the surroundings, degC.
    - `cell_names`, `node_names`, `channel_names`: the names of the above; empty for numbers.
    - `elements`: the number of elements of the plate, which are the first nodes.
    - `rig`: the name of the rig; empty for that of no rig file.
    """

    duty: Float[Array | np.ndarray, " inputs"]
    nodes: Float[Array | np.ndarray, " nodes"]
    outputs: Float[Array | np.ndarray, " outputs"]
    ambient: Float[Array | np.ndarray, ""]
    cell_names: tuple[str, ...] = eqx.field(static=True, default=())
    node_names: tuple[str, ...] = eqx.field(static=True, default=())
    channel_names: tuple[str, ...] = eqx.field(static=True, default=())
    rig: str = eqx.field(static=True, default="")
    elements: int = eqx.field(static=True, default=0)

    def __repr__(self) -> str:
        # Also where its numbers are traced.
        duty = self.duty if isinstance(self.duty, np.ndarray) else np.shape(self.duty)
        return f"OperatingPoint(rig={self.rig!r}, duty={duty}, {len(self.channel_names)} channels)"

    @property
    def range(self) -> float:
        """The difference between the hottest and the coldest element of the plate, K.

        **Raises:** `ControlError` for a rig without a plate.
        """
        if not self.elements:
            raise ControlError("range: expected an operating point of a rig with a plate")
        return float(np.ptp(np.asarray(self.nodes)[: self.elements]))

    def to_xarray(self) -> "xarray.Dataset":
        """Returns a labelled dataset, with units in the attributes: duty (cell), state (node),
        temperature (channel) and ambient, named as in `Run.to_xarray`."""
        cells, nodes, channels = self._labels()
        return dataset(
            {
                "duty": ("cell", self.duty, "1"),
                "state": ("node", self.nodes, "degC"),
                "temperature": ("channel", self.outputs, "degC"),
                "ambient": ("", self.ambient, "degC"),
            },
            {},
            cell=cells,
            node=nodes,
            channel=channels,
        )

    def to_dataframe(self) -> "pandas.DataFrame":
        """Returns a table with a row for the duty of each cell, the temperature of each node, the
        reading of each channel and the ambient temperature. Its index is quantity and name; its
        columns are value and unit."""
        rows = []
        for name, values in self.to_xarray().data_vars.items():
            quantity = {"state": "node", "temperature": "channel"}.get(str(name), name)
            names = values[values.dims[0]].values if values.dims else [""]
            numbers = zip(names, np.atleast_1d(values).tolist(), strict=True)
            rows += [(quantity, *number, values.attrs["units"]) for number in numbers]
        return table(rows, "quantity", "name", columns=["quantity", "name", "value", "unit"])

    def _labels(self) -> tuple[list[str], list[str], list[str]]:
        """Returns the names of cells, nodes and channels. Names that were not given are u1, u2, and
        so on for cells, x1 for nodes, y1 for channels."""
        cells, nodes, channels = (
            list(names) or [f"{letter}{number + 1}" for number in range(len(values))]
            for letter, names, values in (
                ("u", self.cell_names, self.duty),
                ("x", self.node_names, self.nodes),
                ("y", self.channel_names, self.outputs),
            )
        )
        return cells, nodes, channels

    def _overview(self) -> "pandas.DataFrame":
        return self.to_dataframe().drop(index="node", level="quantity")


@final
class Target(eqx.Module):
    """Temperatures for which a duty cycle is searched.

    The search minimises the distance of `channels @ readings` from `temperatures` over `duty =
    directions @ unknowns`, in which a heater that would cool is off: no duty is below its
    `lowest_duty`.
    """

    channels: Float[np.ndarray, "targets channels"]
    temperatures: Float[np.ndarray, " targets"]
    directions: Float[np.ndarray, "cells unknowns"]
    lowest_duty: Float[np.ndarray, " cells"]


def target_of(twin: Twin, temperatures: Mapping[str, float] | float | int) -> Target:
    """The temperatures given to `linearize`, checked.

    **Raises:** `ControlError` for unknown channels, values that are not numbers, or fewer channels
    than cells.
    """
    where = "linearize: temperatures"
    cells, names = len(twin.netlist.cells), twin.channels
    lowest = twin.wiring.lowest_duty
    if not isinstance(temperatures, Mapping):
        mean = finite_number(where, temperatures, ControlError)
        everything = np.full((1, len(names)), 1 / len(names))
        return Target(everything, np.array([mean]), np.ones((cells, 1)), lowest)
    for name in temperatures:
        if name not in names:
            raise ControlError(
                f"{where}: expected channels of {twin.rig.name} ({', '.join(names)}), got {name!r}"
            )
    if len(temperatures) != 1 and len(temperatures) < cells:
        raise ControlError(
            f"{where}: expected a single channel (all cells then get the same duty) or at least "
            f"as many as the {cells} cells of {twin.rig.name}, got {len(temperatures)}"
        )
    numbers = [finite_number(f"{where}: {n}", v, ControlError) for n, v in temperatures.items()]
    rows = np.eye(len(names))[[names.index(name) for name in temperatures]]
    directions = np.ones((cells, 1)) if len(numbers) == 1 else np.eye(cells)
    return Target(rows, np.array(numbers), directions, lowest)


def slopes(
    system: System,
    deviation: Float[Array, " nodes"],
    duty: Float[Array, " cells"],
    reference: Float[Array, ""],
) -> tuple[Float[Array, "nodes nodes"], Float[Array, "nodes cells"]]:
    """The derivatives of the heat into the nodes with respect to their temperatures, W/K, and to
    the duty, W.

    At a duty of 0, where the slopes of heating and of cooling differ, the derivative with respect
    to the duty is the mean of the two.
    """
    at_zero = jnp.where(duty == 0, jnp.asarray(KINK_DISTANCE, duty.dtype), 0.0)
    by_duty = jax.jacfwd(lambda duty: system.heat_into_nodes(deviation, duty, reference))
    return (
        jax.jacfwd(lambda nodes: system.heat_into_nodes(nodes, duty, reference))(deviation),
        (by_duty(duty + at_zero) + by_duty(duty - at_zero)) / 2,
    )


def duty_for(
    system: System, target: Target, reference: Float[Array, ""]
) -> tuple[Float[Array, " cells"], Float[Array, " targets"], Float[Array, " nodes"]]:
    """Finds the duty cycle for temperatures by the Gauss-Newton method, the temperatures that it
    reaches, degC, and the deviation of the nodes at rest.

    Its derivatives with respect to the parameters are exact if the target can be reached.
    """
    directions = jnp.asarray(target.directions, reference.dtype)
    # One unknown is the duty of all cells and heaters, otherwise each is that of one.
    lowest_duty = jnp.asarray(target.lowest_duty, reference.dtype)
    lowest = lowest_duty if directions.shape[1] > 1 else lowest_duty.min()
    channels = jnp.asarray(target.channels, reference.dtype)
    aim = jnp.asarray(target.temperatures, reference.dtype) + ZERO_CELSIUS - reference

    def duty_of(unknowns: Array) -> Array:
        wanted = directions @ unknowns
        # Not `maximum`, whose derivative at the limit is a half.
        return jnp.where(wanted >= lowest_duty, wanted, lowest_duty)

    def readings(unknowns: Array) -> tuple[Array, Array]:
        duty = duty_of(unknowns)
        nodes = system.steady_state(duty, reference)
        return channels @ system.channel_temperatures(nodes), nodes

    def change(unknowns: Array) -> Array:
        reached, nodes = readings(unknowns)
        at = jax.lax.stop_gradient((system, nodes, duty_of(unknowns), reference))
        by_nodes, by_duty = slopes(*at)
        free = jax.lax.stop_gradient(directions @ unknowns >= lowest_duty)
        by_unknowns = by_duty @ jnp.where(free[:, None], directions, 0.0)
        gain = channels @ at[0].channel_temperatures(solve(-by_nodes, by_unknowns).T).T
        return solve(gain.T @ gain, gain.T @ (aim - reached))

    def newton(_: Int[Array, ""], unknowns: Array) -> Array:
        step = jnp.clip(change(unknowns), -MAX_STEP, MAX_STEP)
        return jnp.clip(unknowns + step, lowest, 1.0)

    start = jnp.zeros(directions.shape[1], reference.dtype)
    result = jax.lax.stop_gradient(jax.lax.fori_loop(0, NEWTON_STEPS, newton, start))
    # A last step, through which the derivatives pass.
    result = jnp.clip(result + change(result), lowest, 1.0)
    reached, nodes = readings(result)
    return duty_of(result), reached + reference - ZERO_CELSIUS, nodes
