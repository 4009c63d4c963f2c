"""The parameters that a match may change, and their positions in the optimiser's vector."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._arguments import mapping_of, names_of
from .._errors import MatchError, ParameterError
from .._name_suggestions import did_you_mean
from ..physics import Twin
from ..rig import Parameter
from ._search_space import SearchSpace

NARROWEST = 1e-100
"""The smallest spread of a prior, and the reciprocal of the largest: their squares must be finite
and positive."""


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
    def layout(self) -> "Layout":
        """The order of the entries, for compiled code."""
        return Layout(
            shared=tuple((row.name, row.is_logarithmic) for row in self.shared),
            per_group=tuple((row.name, row.is_logarithmic) for row in self.per_group),
            per_recording=tuple((row.name, row.is_logarithmic) for row in self.per_recording),
            group_numbers=self.group_numbers,
        )

    def to_values(
        self, vector: Float[np.ndarray, "*draws unknowns"]
    ) -> Float[np.ndarray, "*draws unknowns"]:
        """The entries in their parameters' units."""
        found = np.array(vector)
        logarithmic = np.array([row.is_logarithmic for row in self.entry_parameters], dtype=bool)
        found[..., logarithmic] = np.exp(found[..., logarithmic])
        # Rounding of the logarithm must not move a value at a bound beyond it.
        lower, upper = np.array([(row.lower, row.upper) for row in self.entry_parameters]).T
        return np.clip(found, lower, upper)

    def recording_values(
        self, vector: Float[np.ndarray, "*draws unknowns"]
    ) -> list[dict[str, Float[np.ndarray, "*draws"]]]:
        """Name -> value in the parameter's unit, for each recording."""
        found, names = (
            self.to_values(vector),
            [row.name for row in self.shared + self.per_group + self.per_recording],
        )
        return [
            {name: found[..., entry] for name, entry in zip(names, places, strict=True)}
            for places in self.layout.entry_indices()
        ]


@final
@dataclass(frozen=True)
class Layout:
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


@final
@dataclass(frozen=True)
class ParameterChoice:
    """The arguments of `match` that change the rig's parameter table, not checked yet.

    - `free`: the free parameters, in place of those that the table marks as free.
    - `fixed`: parameters to hold.
    - `shared`, `per_recording`: parameters that are free in addition, with one value for all
      recordings or a value for each, whatever their scope in the table.
    - `bounds`: bounds that replace those of the table, name -> (lower, upper) in the parameter's
      unit.
    """

    free: Iterable[str] | None = None
    fixed: Iterable[str] = ()
    shared: Iterable[str] = ()
    per_recording: Iterable[str] = ()
    bounds: Mapping[str, tuple[float, float]] | None = None


AS_IN_THE_TABLE = ParameterChoice()


def choose_unknowns(
    twin: Twin, group_numbers: Sequence[int], choice: ParameterChoice = AS_IN_THE_TABLE
) -> Unknowns:
    """Chooses the unknowns of a match: the rig's parameter table, changed by a choice.

    **Arguments:**

    - `twin`: its values are the start of the match.
    - `group_numbers`: the number of each recording's group, counted from 0.
    - `choice`: the changes of the table.

    **Raises:** `ParameterError` for unknown names and for a parameter with several values;
    `MatchError` if a name has contradictory roles, or has bounds without being free; if bounds
    exclude the value or the prior's centre, or change the meaning of the prior's spread; if that
    spread is too small or too large; or if nothing is left free.
    """
    table = twin.rig.parameters
    twin.numbers_si  # noqa: B018 - refuses a parameter with several values
    if isinstance(choice.free, Mapping):
        raise MatchError(
            f"free: expected one name or several, got values beside them; free them by name and "
            f"give bounds as bounds={dict(choice.free)!r}"
        )
    free = None if choice.free is None else set(names_of("free", choice.free, MatchError))
    fixed = set(names_of("fixed", choice.fixed, MatchError))
    shared = set(names_of("shared", choice.shared, MatchError))
    per_recording = set(names_of("per_recording", choice.per_recording, MatchError))
    bounds = {} if choice.bounds is None else choice.bounds
    mapping_of("bounds", bounds, "name -> (lower, upper)", MatchError)
    keywords = {
        "free": free or set(),
        "fixed": fixed,
        "shared": shared,
        "per_recording": per_recording,
        "bounds": set(bounds),
    }
    for keyword, names in keywords.items():
        unknown = sorted(names - set(table))
        if unknown:
            raise ParameterError(
                f"{twin.rig.name}: {keyword}: expected some of the parameters {', '.join(table)}, "
                f"got {', '.join(unknown)}{did_you_mean(unknown, table)}"
            )
    opposites = (
        ("free", "fixed"),
        ("shared", "fixed"),
        ("per_recording", "fixed"),
        ("shared", "per_recording"),
    )
    for keyword, other in opposites:
        both = sorted(keywords[keyword] & keywords[other])
        if both:
            raise MatchError(
                f"{', '.join(both)}: expected in either {keyword} or {other}, got in both"
            )
    chosen = {
        name: row
        for name, row in table.items()
        if name not in fixed
        and (name in shared | per_recording or (row.free if free is None else name in free))
    }
    if not chosen:
        raise MatchError(
            f"{twin.rig.name}: no free parameter; set free = true in the rig file's table or pass "
            "free=[...]"
        )
    held = sorted(set(bounds) - set(chosen))
    if held:
        raise MatchError(
            f"bounds: expected some of the free parameters {', '.join(chosen)}, got "
            f"{', '.join(held)}; free it or leave its bounds out"
        )
    rows = []
    for name, row in chosen.items():
        scope = "recording" if name in per_recording else "shared" if name in shared else row.scope
        limits = bounds.get(name, (row.lower, row.upper))
        bounded = _bounded(row, float(twin.values[name]), limits)
        rows.append(replace(bounded, free=True, scope=scope))
    return Unknowns.of(rows, group_numbers)


def _bounded(row: Parameter, value: float, bounds: tuple[float, float]) -> Parameter:
    """A parameter with a start value and bounds that do not change the meaning of its prior."""
    lower, upper = _pair(row.name, bounds)
    given = f"{lower:g} to {upper:g} {row.unit}".rstrip()
    if not lower <= value <= upper or lower == upper:
        raise MatchError(
            f"{row.name}: expected a start within its bounds, {lower:g} to {upper:g}, got "
            f"{value:g} {row.unit}; move the start or the bounds"
        )
    if row.prior_value is not None and not lower <= row.prior_value <= upper:
        raise MatchError(
            f"{row.name}: expected bounds that contain the centre of the prior, "
            f"{row.prior_value:g}, got {given}"
        )
    if row.prior_spread is not None and not NARROWEST <= row.prior_spread <= 1 / NARROWEST:
        raise MatchError(
            f"{row.name}: expected a prior spread of {NARROWEST:g} to {1 / NARROWEST:g}, got "
            f"{row.prior_spread:g}; hold a parameter that is known, and leave the prior out where "
            "nothing is known"
        )
    bounded = replace(row, value=value, lower=lower, upper=upper)
    if row.prior_spread is not None and bounded.is_logarithmic != row.is_logarithmic:
        kept = "above 0" if row.is_logarithmic else "with a lower one of 0 or less"
        kind = "relative" if row.is_logarithmic else f"in {row.unit or 'its unit'}"
        raise MatchError(
            f"{row.name}: expected bounds {kept}, because the prior's spread is {kind}, got {given}"
        )
    return bounded


def _pair(name: str, bounds: object) -> tuple[float, float]:
    """Two numbers in order; they may be infinite."""
    try:
        pair = np.asarray(bounds)
    except ValueError:  # of different lengths
        pair = np.array(None)
    if pair.dtype.kind not in "iuf" or pair.shape != (2,) or not pair[0] < pair[1]:
        raise MatchError(
            f"{name}: bounds: expected (lower, upper), numbers in that order, got {bounds!r}"
        )
    return float(pair[0]), float(pair[1])
