"""The parameters that a match may change, as the optimiser's vector: positions, scales, bounds."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..physics import Twin
from ..rig import Parameter

Vector = Float[np.ndarray | Array, "*descents unknowns"]

# A start at a bound is moved inside by this part of the range, because the derivative of the
# transform is 0 at a bound.
WALL = 1e-6

# An entry that is nearer to a bound is at it.
BOUND_TOLERANCE = 1e-9


@final
class SearchSpace(eqx.Module):
    """Bounds of the optimiser's vector, and the distances that its entries are expected to move.

    - `lower`, `upper`: bounds, infinite if there are none.
    - `scale`: the reciprocal of the distance that each entry is expected to move; None if that is
      not known.
    - `difference_steps`: the steps of central differences, for `BoundedLevenbergMarquardt`; None
      for exact derivatives. Differences take less time to compile.
    """

    lower: Vector
    upper: Vector
    scale: Vector | None = None
    difference_steps: Vector | None = None

    def clip(self, vector: Float[Array, " unknowns"]) -> Float[Array, " unknowns"]:
        """The nearest vector inside the bounds."""
        return jnp.clip(vector, self.lower, self.upper)

    def to_unbounded(
        self, vector: Float[np.ndarray, " unknowns"]
    ) -> Float[np.ndarray, " unknowns"]:
        r"""Transforms a vector to the variables of an optimiser without bounds.

        An entry between two bounds becomes the angle $z$ of MINUIT (James and Roos, Computer
        Physics Communications 10 (1975) 343-367),

        $$u = l + \frac{h - l}{2} (1 + \sin z),$$

        which can reach its bounds, unlike a logistic curve. Any other entry is only scaled, and
        clipped at its bound.
        """
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        walled = np.isfinite(lower) & np.isfinite(upper)
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.clip((vector - lower) / (upper - lower), WALL, 1 - WALL)
        angle = np.arcsin(2 * np.where(walled, share, 0.5) - 1)
        return np.where(walled, angle, vector * self._plain_scale())

    def from_unbounded(self, variables: Float[Array, " unknowns"]) -> Float[Array, " unknowns"]:
        """The vector that belongs to such variables."""
        lower, upper = jnp.asarray(self.lower), jnp.asarray(self.upper)
        walled = jnp.isfinite(lower) & jnp.isfinite(upper)
        low, high = jnp.where(walled, lower, 0.0), jnp.where(walled, upper, 1.0)
        inside = low + (high - low) * 0.5 * (1 + jnp.sin(variables))
        return self.clip(jnp.where(walled, inside, variables / self._plain_scale()))

    def _plain_scale(self) -> Vector:
        return np.ones(np.shape(self.lower)) if self.scale is None else self.scale


@final
@dataclass(frozen=True)
class Unknowns:
    """The optimiser's vector: shared parameters, then the values of each group of recordings, then
    those of each recording.

    Positive parameters enter by their logarithm: their relative change matters, and no step can
    make them negative. The others, such as temperatures, enter as they are.

    **Arguments:**

    - `shared`: parameters with one value for all recordings.
    - `per_group`: parameters with a value for each group.
    - `per_recording`: parameters with a value for each recording.
    - `group_numbers`: the number of each recording's group, counted from 0.
    """

    shared: tuple[Parameter, ...]
    per_group: tuple[Parameter, ...]
    per_recording: tuple[Parameter, ...]
    group_numbers: tuple[int, ...]

    @classmethod
    def of(cls, rows: Sequence[Parameter], group_numbers: Sequence[int]) -> "Unknowns":
        """Sorts parameters by their scope. If there is a single group, the parameters of groups are
        shared."""
        single = max(group_numbers) == 0
        return cls(
            shared=tuple(r for r in rows if r.scope == "shared" or (single and r.scope == "group")),
            per_group=tuple(r for r in rows if r.scope == "group" and not single),
            per_recording=tuple(r for r in rows if r.scope == "recording"),
            group_numbers=tuple(group_numbers),
        )

    @property
    def recordings(self) -> int:
        """The number of recordings."""
        return len(self.group_numbers)

    @property
    def entry_parameters(self) -> tuple[Parameter, ...]:
        """The parameter of each entry of the vector."""
        groups = max(self.group_numbers) + 1
        return self.shared + self.per_group * groups + self.per_recording * self.recordings

    @property
    def size(self) -> int:
        """The length of the vector."""
        return len(self.entry_parameters)

    def start(self) -> Float[np.ndarray, " unknowns"]:
        """The parameters' values as a vector."""
        return np.array([row.to_entry(row.value) for row in self.entry_parameters])

    def lower(self) -> Float[np.ndarray, " unknowns"]:
        """Lower bounds of the vector."""
        return np.array([row.to_entry(row.lower) for row in self.entry_parameters])

    def upper(self) -> Float[np.ndarray, " unknowns"]:
        """Upper bounds of the vector."""
        return np.array([row.to_entry(row.upper) for row in self.entry_parameters])

    def are_inside(self, vector: Float[np.ndarray, " unknowns"]) -> Bool[np.ndarray, " unknowns"]:
        """Which entries of the vector are not at a bound."""
        return (vector > self.lower() + BOUND_TOLERANCE) & (vector < self.upper() - BOUND_TOLERANCE)

    def prior_means(self) -> Float[np.ndarray, " unknowns"]:
        """The prior mean of each entry; 0 for an entry without a prior."""
        expected = [(row, row.prior_value) for row in self.entry_parameters]
        return np.array([0.0 if value is None else row.to_entry(value) for row, value in expected])

    def prior_weights(self) -> Float[np.ndarray, " unknowns"]:
        """The reciprocal of the prior standard deviation of each entry by itself; 0 for an entry
        without a prior."""
        return np.array(
            [
                0.0 if row.standard_deviation is None else 1 / row.standard_deviation
                for row in self.entry_parameters
            ]
        )

    def group_entries(self) -> Int[np.ndarray, "groups entries"]:
        """The positions of each group's values in the vector."""
        groups, size = max(self.group_numbers) + 1, len(self.per_group)
        return len(self.shared) + size * np.arange(groups)[:, None] + np.arange(size)

    def rows_of_groups(self) -> tuple[tuple[Parameter, ...], Int[np.ndarray, "rows groups"]]:
        """The parameters of scope group and the positions of their values; with a single group
        these are among the shared ones."""
        if self.per_group:
            return self.per_group, self.group_entries().T
        places = [number for number, row in enumerate(self.shared) if row.scope == "group"]
        return tuple(self.shared[n] for n in places), np.array(places, int).reshape(-1, 1)

    def default_scales(self) -> Float[np.ndarray, " unknowns"]:
        """A default for the prior standard deviation of an entry: a factor of e, a tenth of its
        range, or its size plus one."""
        with np.errstate(invalid="ignore"):
            ranges = self.upper() - self.lower()
        plain = 0.1 * np.where(np.isfinite(ranges), ranges, np.abs(self.start()) + 1)
        return np.where([row.is_logarithmic for row in self.entry_parameters], 1.0, plain)

    def scales(self) -> Float[np.ndarray, " unknowns"]:
        """The distance that each entry is expected to move: its prior standard deviation, or its
        default scale."""
        weights = self.prior_weights()
        return np.where(weights > 0, 1 / np.where(weights > 0, weights, 1), self.default_scales())

    def search_space(self) -> SearchSpace:
        """Bounds of the vector, and the reciprocals of its scales if there are priors."""
        weights = self.prior_weights()
        scale = np.where(weights > 0, weights, 1 / self.default_scales())
        return SearchSpace(self.lower(), self.upper(), scale if weights.any() else None)

    def value_derivatives(
        self, vector: Float[np.ndarray, " unknowns"]
    ) -> Float[np.ndarray, " unknowns"]:
        """Derivatives of the parameters' values with respect to the vector's entries."""
        pairs = zip(self.entry_parameters, vector, strict=True)
        return np.array([np.exp(entry) if row.is_logarithmic else 1.0 for row, entry in pairs])

    def labels(self, recordings: Sequence[str], group_names: Sequence[str]) -> tuple[str, ...]:
        """Names of the entries; the value of a group or recording is `name[group]` or
        `name[recording]`."""
        own = [f"{row.name}[{group}]" for group in group_names for row in self.per_group]
        own += [
            f"{row.name}[{recording}]" for recording in recordings for row in self.per_recording
        ]
        return (*(row.name for row in self.shared), *own)

    @property
    def layout(self) -> "VectorLayout":
        """The order of the entries, for compiled code."""
        return VectorLayout(
            shared=tuple((row.name, row.is_logarithmic) for row in self.shared),
            per_group=tuple((row.name, row.is_logarithmic) for row in self.per_group),
            per_recording=tuple((row.name, row.is_logarithmic) for row in self.per_recording),
            group_numbers=self.group_numbers,
        )

    def to_values(
        self, vector: Float[np.ndarray, "*draws unknowns"]
    ) -> Float[np.ndarray, "*draws unknowns"]:
        """The entries in their parameters' units."""
        result = np.array(vector)
        logarithmic = np.array([row.is_logarithmic for row in self.entry_parameters], dtype=bool)
        result[..., logarithmic] = np.exp(result[..., logarithmic])
        # Rounding of the logarithm must not move a value at a bound beyond it.
        lower, upper = np.array([(row.lower, row.upper) for row in self.entry_parameters]).T
        return np.clip(result, lower, upper)

    def recording_values(
        self, vector: Float[np.ndarray, "*draws unknowns"]
    ) -> list[dict[str, Float[np.ndarray, "*draws"]]]:
        """Name -> value in the parameter's unit, for each recording."""
        result, names = (
            self.to_values(vector),
            [row.name for row in self.shared + self.per_group + self.per_recording],
        )
        return [
            {name: result[..., entry] for name, entry in zip(names, places, strict=True)}
            for places in self.layout.entry_indices()
        ]


@final
@dataclass(frozen=True)
class VectorLayout:
    """The layout of the vector for compiled code: the order of the unknowns, without values and
    bounds.

    **Arguments:**

    - `shared`, `per_group`, `per_recording`: pairs (name, whether it enters by its logarithm).
    - `group_numbers`: the number of each recording's group.
    """

    shared: tuple[tuple[str, bool], ...]
    per_group: tuple[tuple[str, bool], ...]
    per_recording: tuple[tuple[str, bool], ...]
    group_numbers: tuple[int, ...]

    @property
    def names(self) -> tuple[tuple[str, bool], ...]:
        """Names of the entries on which a recording depends."""
        return self.shared + self.per_group + self.per_recording

    def entry_indices(self) -> Int[np.ndarray, "recordings entries"]:
        """The positions of the entries on which each recording depends."""
        shared, grouped, own = map(len, (self.shared, self.per_group, self.per_recording))
        recordings, group = len(self.group_numbers), np.array(self.group_numbers)[:, None]
        of_group = shared + grouped * group + np.arange(grouped)
        behind = shared + grouped * (max(self.group_numbers) + 1)
        of_recording = behind + own * np.arange(recordings)[:, None] + np.arange(own)
        first = np.broadcast_to(np.arange(shared), (recordings, shared))
        return np.concatenate([first, of_group, of_recording], axis=1)

    def local_values(self, local: Float[Array, " entries"]) -> dict[str, Float[Array, ""]]:
        """Name -> value in the parameter's unit, from the entries on which a recording depends."""
        entries = self.names
        logarithmic = np.array([is_logarithm for _, is_logarithm in entries], dtype=bool)
        # All at once: separate operations would be compiled one by one.
        powers = jnp.exp(jnp.where(logarithmic, local, 0.0))
        values = jnp.where(logarithmic, powers, local)
        return {name: values[number] for number, (name, _) in enumerate(entries)}

    def network_entries(self, twin: Twin) -> list[int]:
        """The entries of a recording that act on the network, not only on gains."""
        outer = twin.wiring.gain_names
        return [number for number, (name, _) in enumerate(self.names) if name not in outer]
