r"""The residuals of a twin on recordings, as one function of the unknowns, and their derivatives.

Simulated less recorded temperatures $D$ of a recording have two parts with noise of their own: what
all channels share, which is the camera's or the room's, and what a channel has alone.

$$m_t = \sum_c w_{tc} D_{tc} \Big/ \sum_c w_{tc}, \qquad
\lVert r \rVert^2 = \sum_{tc} \frac{w_{tc} (D_{tc} - m_t)^2}{\sigma_i^2}
+ \sum_t \frac{w_t (m_t - c_t)^2}{\sigma_m^2} + \sum_j \frac{b_j^2}{s_j^2}
+ \sum_p \frac{(u_p - \bar u_p)^2}{s_p^2}$$

$c = \Phi b$ is the camera's common error, whose sizes $b$ are solved for in closed form, and the
last sum is what is known of the parameters beforehand.
Without any of that, and with equal weights, it is eq. (11) of the paper.
"""

from collections.abc import Sequence
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..io import Experiment
from ..physics import System, Twin
from ..simulation import (
    Schedule,
    ambient_of_samples,
    padded,
    padded_schedule,
    reference_temperature,
    solve_schedule,
)
from ._unknowns import Layout, Unknowns
from ._weights import Weights, stacked


@final
class Recordings(eqx.Module):
    """Recordings of equal shapes, stacked so that they are solved at once.

    Their samples are filled up to a few sizes, as their schedules are, with some that count for
    nothing, so that recordings of another length run through the same programs.

    - `schedule`: every array with a leading recordings axis.
    - `columns`: which of the rig's channels each recording holds.
    - `temperatures`: recorded, `(recordings, times, channels)`, degC; any finite number where a
      sample is missing or fills up their number, which weighs nothing.
    - `sampled`: where there is a sample.
    - `lengths`: how many times each recording has, without those that fill up.
    - `weights`: of the samples, and the camera's shapes; 0 for those that fill up.
    - `positions`: their places among all recordings.
    """

    schedule: Schedule
    columns: Int[np.ndarray | Array, "recordings channels"]
    temperatures: Float[np.ndarray | Array, "recordings times channels"]
    sampled: Bool[np.ndarray | Array, "recordings times channels"]
    lengths: Int[np.ndarray | Array, " recordings"]
    weights: Weights
    positions: tuple[int, ...] = eqx.field(static=True)


@final
class Ties(eqx.Module):
    """What is known beforehand of combinations of unknowns, such as the difference of two of them.

    - `rows`, `values`: `rows @ vector - values` is expected to be 0 with a variance of 1.
    """

    rows: Float[np.ndarray | Array, "ties unknowns"]
    values: Float[np.ndarray | Array, " ties"]

    @classmethod
    def none(cls, unknowns: int) -> "Ties":
        """Nothing is known of any combination."""
        return cls(np.zeros((0, unknowns)), np.zeros(0))


@final
class Objective(eqx.Module):
    """Everything that the residuals depend on beside the unknowns.

    - `twin`: values of the parameters that are held.
    - `groups`: the recordings.
    - `centre`, `precision`: of what is known of the unknowns beforehand: expected entries of the
      vector, and one over their standard deviations, 0 where nothing is known.
    - `ties`: what is known beforehand of combinations of unknowns.
    - `layout`: of the vector of unknowns.
    """

    twin: Twin
    groups: tuple[Recordings, ...]
    centre: Float[np.ndarray | Array, " unknowns"]
    precision: Float[np.ndarray | Array, " unknowns"]
    ties: Ties
    layout: Layout = eqx.field(static=True)


def build_objective(
    twin: Twin,
    experiments: Sequence[Experiment],
    unknowns: Unknowns,
    weights: Sequence[Weights],
    ties: Ties | None = None,
) -> Objective:
    """Groups recordings by the shape of their schedules, so that compiled code is shared."""
    groups: dict[tuple, list[int]] = {}
    schedules = [padded_schedule(twin, experiment) for experiment in experiments]
    weights = [one.padded() for one in weights]
    for position, (schedule, experiment) in enumerate(zip(schedules, experiments, strict=True)):
        leaves = jax.tree.leaves((schedule, weights[position]))
        shapes = tuple(np.shape(leaf) for leaf in leaves)
        key = (shapes, schedule.ambient is None, len(experiment.channels))
        groups.setdefault(key, []).append(position)
    gathered = []
    for positions in groups.values():
        members = [experiments[position] for position in positions]
        columns = [[twin.channels.index(name) for name in e.channels] for e in members]
        gathered.append(
            Recordings(
                schedule=jax.tree.map(
                    lambda *leaves: np.stack(leaves), *(schedules[p] for p in positions)
                ),
                columns=np.array(columns, dtype=np.int32),
                # Nothing times NaN would be NaN.
                temperatures=np.stack(
                    [padded(np.nan_to_num(np.asarray(e.temperatures))) for e in members]
                ),
                sampled=np.stack([padded(e.sampled, False) for e in members]),
                lengths=np.array([len(e.time) for e in members]),
                weights=stacked([weights[p] for p in positions]),
                positions=tuple(positions),
            )
        )
    return Objective(
        twin=twin,
        groups=tuple(gathered),
        centre=unknowns.prior_means(),
        precision=unknowns.prior_weights(),
        ties=Ties.none(unknowns.size) if ties is None else ties,
        layout=unknowns.layout,
    )


def residuals(
    vector: Float[Array, " unknowns"], objective: Objective
) -> tuple[list[Any], Float[Array, ""]]:
    """The weighted residuals.

    **Returns:** for each group of recordings what a channel has alone, what all share and the
    sizes of the camera's shapes, then priors and ties; and the mean squared error of all samples
    that are not missing, K^2.
    """
    return weighted(differences(vector, objective), vector, objective)


def weighted(
    groups: Sequence[Float[Array, "_recordings _times _channels"]],
    vector: Float[Array, " unknowns"],
    objective: Objective,
) -> tuple[list[Any], Float[Array, ""]]:
    """The weighted residuals from the `differences`."""
    parts, squares, samples = [], jnp.zeros(()), jnp.zeros((), int)
    for group, difference in zip(objective.groups, groups, strict=True):

        def one(
            difference: Array, weights: Weights, sampled: Array | np.ndarray
        ) -> tuple[Any, Array]:
            channel, common_mode, sizes = weights.split(difference)
            error = difference - (jnp.asarray(weights.shapes) @ sizes)[:, None]
            return weights.weigh(channel, common_mode, sizes), jnp.sum(error**2, where=sampled)

        part, square = jax.vmap(one)(difference, group.weights, group.sampled)
        parts.append(part)
        squares += square.sum()
        samples += jnp.sum(group.sampled)
    parts.append((vector - objective.centre) * objective.precision)
    parts.append(jnp.asarray(objective.ties.rows) @ vector - objective.ties.values)
    return parts, squares / samples


def differences(
    vector: Float[Array, " unknowns"], objective: Objective
) -> list[Float[Array, "..."]]:
    """Simulated less recorded temperatures, `(recordings, times, channels)` for each group, K; 0
    for samples that fill up."""

    def one(local: Array, group: Recordings) -> Array:
        error = _reading(local, objective, group.schedule, group.columns) - group.temperatures
        return jnp.where(jnp.arange(len(error))[:, None] < group.lengths, error, 0.0)

    return [
        jax.vmap(one)(local, group)
        for group, local in zip(objective.groups, _local_vectors(vector, objective), strict=True)
    ]


def residual_jacobian(
    vector: Float[Array, " unknowns"], objective: Objective
) -> Float[Array, "residuals unknowns"]:
    """Derivatives of all residuals, in the order in which `ravel_pytree` lays them out.

    The same as `jax.jacfwd` of `residuals`, for less: a recording does not depend on the others'
    own values, and a channel's gain does not act on the plate.
    """
    return weighted_jacobian(derivatives(vector, objective), objective)


def derivatives(
    vector: Float[Array, " unknowns"], objective: Objective
) -> list[Float[Array, "_recordings _entries _times _channels"]]:
    """Derivatives of the `differences` in the entries that concern each recording."""
    return [
        jax.vmap(lambda one, g: _reading_jacobian(one, objective, g.schedule, g.columns))(
            local, group
        )
        for group, local in zip(objective.groups, _local_vectors(vector, objective), strict=True)
    ]


def weighted_jacobian(
    groups: Sequence[Float[Array, "_recordings _entries _times _channels"]], objective: Objective
) -> Float[Array, "residuals unknowns"]:
    """The residuals' Jacobian from the `derivatives`."""
    size, columns = np.shape(objective.centre)[0], []
    for group, slopes in zip(objective.groups, groups, strict=True):

        def one(slopes: Array, weights: Weights) -> tuple[Array, Array, Array]:
            return jax.vmap(lambda d: weights.weigh(*weights.split(d)))(slopes)

        places = objective.layout.entry_indices()[list(group.positions)]
        number = np.arange(len(places))[:, None]
        for part in jax.vmap(one)(slopes, group.weights):
            flat = part.reshape(*part.shape[:2], -1)
            whole = jnp.zeros((size, len(places), flat.shape[-1]), flat.dtype)
            columns.append(whole.at[places, number].set(flat).reshape(size, -1))
    columns.append(jnp.diag(jnp.asarray(objective.precision)))
    columns.append(jnp.asarray(objective.ties.rows).T)
    # Turned last, where it costs nothing: products of the columns do not care how they lie.
    return jnp.concatenate(columns, axis=1).T


def _local_vectors(
    vector: Float[Array, " unknowns"], objective: Objective
) -> list[Float[Array, "_recordings _entries"]]:
    places = objective.layout.entry_indices()
    return [vector[places[list(group.positions)]] for group in objective.groups]


def _reading(
    local: Float[Array, " entries"],
    objective: Objective,
    schedule: Schedule,
    columns: Int[Array | np.ndarray, " columns"],
) -> Float[Array, "times channels"]:
    """What the camera reads without its common error, degC."""
    system = objective.twin.with_parameters(objective.layout.local_values(local)).system(
        lumped=True
    )
    base, rise = channel_rises(system, schedule, columns)
    return base + system.gain[columns] * rise - 273.15


def _reading_jacobian(
    local: Float[Array, " entries"],
    objective: Objective,
    schedule: Schedule,
    columns: Int[Array | np.ndarray, " columns"],
) -> Float[Array, "entries times channels"]:
    layout = objective.layout
    inner = np.array(layout.network_entries(objective.twin), dtype=int)
    outer = np.setdiff1d(np.arange(local.size), inner)

    def twin(part: Array, entries: np.ndarray) -> Twin:
        values = layout.local_values(local.at[entries].set(part))
        return objective.twin.with_parameters(values)

    def plate(part: Array) -> tuple[Array, Array]:
        system = twin(part, inner).system(lumped=True)
        return channel_rises(system, schedule, columns)

    def gain(part: Array, entries: np.ndarray) -> Array:
        one = twin(part, entries)
        return one.wiring.gains(one.parameters_si)[columns]

    def forward(function: Any, part: Array) -> tuple[Any, Any]:
        basis = jnp.eye(part.size, dtype=part.dtype)
        push = jax.vmap(lambda d: jax.jvp(function, (part,), (d,)), out_axes=(None, 0))
        return push(basis)

    (_, rise), (d_base, d_rise) = forward(plate, local[inner])
    gains = gain(local[inner], inner)
    d_reading = d_base + gains * d_rise
    d_gain = forward(lambda part: gain(part, inner), local[inner])[1]
    d_reading = d_reading + rise * d_gain[:, None, :]
    whole = jnp.zeros((local.size, *rise.shape), rise.dtype).at[inner].set(d_reading)
    if outer.size:
        d_gain = forward(lambda part: gain(part, outer), local[outer])[1]
        whole = whole.at[outer].set(rise * d_gain[:, None, :])
    return whole


def channel_rises(
    system: System, schedule: Schedule, columns: Int[Array | np.ndarray, " columns"]
) -> tuple[Float[Array, "times #channels"], Float[Array, "times channels"]]:
    """From the rig's own start: the surroundings' temperature, K, and how far above it what each
    channel looks at is."""
    weights = jnp.asarray(system.wiring.channel_weights)[columns]
    reference = reference_temperature(system, schedule)
    rise = solve_schedule(system, schedule, system.initial_temperature, weights)
    ambient = jnp.asarray(ambient_of_samples(system, schedule), rise.dtype)
    ambient = jnp.broadcast_to(ambient, (rise.shape[0], 1))
    return reference + ambient, rise - ambient
