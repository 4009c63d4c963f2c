"""The residuals of a twin on recordings, as one function of the unknowns."""

from collections.abc import Sequence
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..io import Experiment
from ..physics import System, Twin
from ..simulation import Schedule, build_schedule, reference_temperature, solve_schedule
from ._unknowns import Layout


@final
class Recordings(eqx.Module):
    """Recordings with the same schedule of steps, stacked so that they are solved at once.

    - `schedule`: every array with a leading recordings axis.
    - `columns`: which of the rig's channels each recording holds.
    - `temperatures`: recorded, `(recordings, times, channels)`, degC.
    - `positions`: their places among all recordings.
    """

    schedule: Schedule
    columns: Int[np.ndarray | Array, "recordings channels"]
    temperatures: Float[np.ndarray | Array, "recordings times channels"]
    positions: tuple[int, ...] = eqx.field(static=True)


@final
class Problem(eqx.Module):
    """Everything that the residuals depend on beside the unknowns.

    - `twin`: values of the parameters that are held.
    - `groups`: the recordings.
    - `layout`: of the vector of unknowns.
    """

    twin: Twin
    groups: tuple[Recordings, ...]
    layout: Layout = eqx.field(static=True)


def build_problem(twin: Twin, experiments: Sequence[Experiment], layout: Layout) -> Problem:
    """Groups recordings by the shape of their schedules, so that compiled code is shared."""
    groups: dict[tuple, list[int]] = {}
    schedules = [build_schedule(experiment) for experiment in experiments]
    for position, (schedule, experiment) in enumerate(zip(schedules, experiments, strict=True)):
        shapes = tuple(np.shape(leaf) for leaf in jax.tree.leaves(schedule))
        key = (shapes, schedule.ambient is None, len(experiment.channels))
        groups.setdefault(key, []).append(position)
    stacked = []
    for positions in groups.values():
        members = [experiments[position] for position in positions]
        columns = [[twin.channels.index(name) for name in e.channels] for e in members]
        stacked.append(
            Recordings(
                schedule=jax.tree.map(
                    lambda *leaves: np.stack(leaves), *(schedules[p] for p in positions)
                ),
                columns=np.array(columns, dtype=np.int32),
                temperatures=np.stack([np.asarray(e.temperatures) for e in members]),
                positions=tuple(positions),
            )
        )
    return Problem(twin=twin, groups=tuple(stacked), layout=layout)


def residuals(
    vector: Float[Array, " unknowns"], problem: Problem
) -> tuple[list[Float[Array, "recordings times channels"]], None]:
    """Simulated minus recorded temperatures, K: the residuals of eq. (11) of the paper.

    **Returns:** one array for each group of recordings, and nothing else (optimistix's form).
    """
    values = problem.layout.values(vector)
    differences = []
    for group in problem.groups:
        own = [values[position] for position in group.positions]
        batched = jax.tree.map(lambda *leaves: jnp.stack(leaves), *own)

        def simulated(
            values: dict[str, Float[Array, ""]],
            schedule: Schedule,
            columns: Int[Array | np.ndarray, " columns"],
        ) -> Float[Array, "times channels"]:
            system = problem.twin.with_parameters(values).system(lumped=True)
            return channel_temperatures(system, schedule, columns) - 273.15

        readings = jax.vmap(simulated)(batched, group.schedule, group.columns)
        differences.append(readings - group.temperatures)
    return differences, None


def channel_temperatures(
    system: System, schedule: Schedule, columns: Int[Array | np.ndarray, " columns"]
) -> Float[Array, "times channels"]:
    """Readings of some channels from the rig's own start, K."""
    weights = jnp.asarray(system.wiring.channel_weights)[columns]
    reference = reference_temperature(system, schedule)
    deviation = solve_schedule(system, schedule, system.initial_temperature, weights)
    ambient = 0.0
    if schedule.ambient_at is not None:
        ambient = (jnp.asarray(schedule.ambient_at) - reference)[:, None]
    return reference + ambient + system.gain[columns] * (deviation - ambient)
