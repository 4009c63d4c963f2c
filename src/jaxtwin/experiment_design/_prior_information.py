r"""The information on a rig before a recording, and after it.

The match of all recordings together with a new one has the covariance of `matching/_uncertainty.py`
with the sums over all recordings:

$$\operatorname{cov} = A^{-1} M A^{-1}, \qquad A = A_0 + J^T J, \qquad M = M_0 + J^T \Gamma J$$

$A_0$ and $M_0$ belong to the recordings of today and to the priors, $J$ and $\Gamma$ to the new
recording. Values that belong only to the new recording, such as the temperature of the room, are
unknowns too, with their priors.
"""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float, Int

from ..errors import MatchError
from ..matching import Fit
from ..matching._fit import solution_of
from ..matching._group_values import new_group_values
from ..matching._problem import choose_unknowns
from ..matching._uncertainty import inverse_of_normal
from ..matching._unknowns import Unknowns
from ..physics import Twin
from ..rig import Parameter

# The standard deviation of an unknown value, in the scale of the match.
UNKNOWN = 1e4

Square = Float[np.ndarray, "entries entries"]


@final
@dataclass(frozen=True, eq=False)
class PriorInformation:
    r"""The information before the new recording.

    - `twin`: the twin with the values that are expected in the new recording.
    - `unknowns`: the unknowns of a match of only the new recording.
    - `vector`: their values. `scale`: the distance that each is expected to move.
    - `normal`, `meat`: $A_0$ and $M_0$ of all entries: the entries of the match of today, followed
      by the additional entries of the new recording.
    - `places`: the position of each of the `unknowns` among these entries; -1 for values that are
      held at a bound.
    """

    twin: Twin
    unknowns: Unknowns
    vector: Float[np.ndarray, " unknowns"]
    scale: Float[np.ndarray, " unknowns"]
    normal: Square
    meat: Square
    places: Int[np.ndarray, " unknowns"]

    @classmethod
    def of_twin(cls, twin: Twin) -> "PriorInformation":
        """The information in the priors of the rig file."""
        unknowns = choose_unknowns(twin, (0,))
        prior = np.diag(unknowns.prior_weights() ** 2)
        places = np.arange(unknowns.size)
        return cls._make(twin, unknowns, prior, prior, places)

    @classmethod
    def of_fit(cls, fit: Fit, group: str | None) -> "PriorInformation":
        """The match of today.

        **Arguments:**

        - `group`: the group of the new recording; None for the only group, or for a new one.

        **Raises:** `MatchError` for a group that the match does not have.
        """
        problem = solution_of(fit).problem
        matched, names = problem.unknowns, problem.group_names
        if group is not None and group not in names:
            raise MatchError(
                f"design_experiment: group: expected one of {', '.join(names)}, or None for a new "
                f"one, got {group!r}"
            )
        unknowns = Unknowns(
            matched.shared, matched.per_group, matched.per_recording, group_numbers=(0,)
        )
        inside = np.isfinite(np.diag(fit.uncertainty.inverse_hessian))
        normal, _ = inverse_of_normal(fit.uncertainty.inverse_hessian[np.ix_(inside, inside)])
        meat = normal @ fit.uncertainty.vector_covariance[np.ix_(inside, inside)] @ normal
        position = np.where(inside, np.cumsum(inside) - 1, -1)
        shared = position[: len(matched.shared)]
        if not matched.per_group:
            of_group = np.zeros(0, int)
        elif group is not None:
            of_group = position[matched.group_entries()[names.index(group)]]
        else:
            normal, meat, of_group = _with_new_group(fit, normal, meat, inside)
        rows = matched.per_recording
        weights = [
            0.0 if row.standard_deviation is None else 1 / row.standard_deviation**2 for row in rows
        ]
        own = len(normal) + np.arange(len(rows))
        return cls._make(
            fit.twin_of_group(names[0] if len(names) == 1 else group or ""),
            unknowns,
            _with_block(normal, np.diag(weights)),
            _with_block(meat, np.diag(weights)),
            np.concatenate([shared, of_group, own]),
        )

    @classmethod
    def _make(
        cls,
        twin: Twin,
        unknowns: Unknowns,
        normal: Square,
        meat: Square,
        places: Int[np.ndarray, " unknowns"],
    ) -> "PriorInformation":
        rows = unknowns.entry_parameters
        vector = np.array([row.to_entry(float(twin.values[row.name])) for row in rows])
        scale = unknowns.scales()
        open_ = np.zeros(len(normal))
        open_[places[places >= 0]] = (UNKNOWN * scale[places >= 0]) ** -2.0
        return cls(
            twin, unknowns, vector, scale, normal + np.diag(open_), meat + np.diag(open_), places
        )

    @property
    def own_rows(self) -> tuple[Parameter, ...]:
        """The parameters of the rig itself that are not held at a bound."""
        rows = self.unknowns.shared + self.unknowns.per_group
        return tuple(row for row, place in zip(rows, self.places, strict=False) if place >= 0)

    def covariance(
        self,
        normal: Float[np.ndarray, "unknowns unknowns"] | None = None,
        meat: Float[np.ndarray, "unknowns unknowns"] | None = None,
    ) -> Float[np.ndarray, "unknowns unknowns"]:
        r"""The covariance of the `unknowns` with a new recording; NaN for values that are held.

        **Arguments:**

        - `normal`, `meat`: $J^T J$ and $J^T \Gamma J$ of the recording; None without one.
        """
        free = self.places >= 0
        at, of_new = np.ix_(self.places[free], self.places[free]), np.ix_(free, free)
        total, noise = self.normal.copy(), self.meat.copy()
        if normal is not None and meat is not None:
            total[at] += normal[of_new]
            noise[at] += meat[of_new]
        inverse, _ = inverse_of_normal(total)
        result = np.full((len(free), len(free)), np.nan)
        result[of_new] = (inverse @ noise @ inverse)[at]
        return result


def _with_new_group(
    fit: Fit, normal: Square, meat: Square, inside: np.ndarray
) -> tuple[Float[np.ndarray, "all all"], Float[np.ndarray, "all all"], Int[np.ndarray, " rows"]]:
    """The entries of the match and of a new group, whose values follow from those of the groups of
    the match."""
    solution = solution_of(fit)
    expected = new_group_values(solution.problem.unknowns, solution.vector)
    rows = len(expected.rows)
    difference = np.concatenate([-expected.lift[:, inside], np.eye(rows)], axis=1)
    prior = difference.T @ (difference / expected.variance[:, None])
    empty = np.zeros((rows, rows))
    places = len(normal) + np.arange(rows)
    return _with_block(normal, empty) + prior, _with_block(meat, empty) + prior, places


def _with_block(
    matrix: Square, block: Float[np.ndarray, "more more"]
) -> Float[np.ndarray, "all all"]:
    """The block-diagonal matrix of two blocks."""
    size = len(matrix)
    whole = np.zeros((size + len(block), size + len(block)))
    whole[:size, :size] = matrix
    whole[size:, size:] = block
    return whole
