r"""The values of a group of recordings: of a matched group, or of another one.

The value of group $g$ is $u_g = \phi + b_g$, with $\phi \sim N(m, s^2)$ shared by all groups and
$b_g \sim N(0, \tau^2)$. This is a normal hierarchical model with standard deviations $s$ and $\tau$
from the rig file. The match integrates $\phi$ out. Its posterior follows from the values of the $G$
groups (Gelman and others, Bayesian Data Analysis, section 5.4):

$$\phi \mid u \sim N\Big(m + w \sum_g (u_g - m), \; w \tau^2\Big), \qquad
w = \frac{s^2}{\tau^2 + G s^2}$$

The value of a new group is $\phi$ with the additional variance $\tau^2$.
"""

from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from ..rig import Parameter
from ._unknowns import Unknowns


@final
class GroupValues(NamedTuple):
    """Expected values of a group, and their uncertainty, on the scale of the optimiser's vector.

    - `rows`: the parameters. `mean`: their expected values.
    - `lift`: the derivatives of these values with respect to the entries of the match's vector.
    - `variance`: the variance of each value given the vector; `shared_variance`: the variance of
      the part that all groups share.
    """

    rows: tuple[Parameter, ...]
    mean: Float[np.ndarray, " rows"]
    lift: Float[np.ndarray, "rows unknowns"]
    variance: Float[np.ndarray, " rows"]
    shared_variance: Float[np.ndarray, " rows"]

    @property
    def values(self) -> dict[str, float]:
        """Name -> mean in the parameter's unit, inside its bounds."""
        pairs = zip(self.rows, self.mean.tolist(), strict=True)
        return {
            row.name: float(np.clip(row.from_entry(entry), row.lower, row.upper))
            for row, entry in pairs
        }

    def covariance(
        self, of_vector: Float[np.ndarray, "unknowns unknowns"]
    ) -> Float[np.ndarray, "rows rows"]:
        """The covariance of the values, given that of the match's vector. A value that was held at
        a bound has none."""
        propagated = self.lift @ np.nan_to_num(of_vector) @ self.lift.T
        return propagated + np.diag(self.variance)


def new_group_values(unknowns: Unknowns, vector: Float[np.ndarray, " unknowns"]) -> GroupValues:
    """The values expected of a group that was not matched, for the parameters that differ between
    groups."""
    rows, places = unknowns.rows_of_groups()
    standard_deviations = np.array(
        [(row.prior_spread, row.group_spread) for row in rows], float
    ).reshape(-1, 2)
    shared, between = np.square(standard_deviations.T)
    count = places.shape[1]
    weight = shared / (between + count * shared)
    lift = np.zeros((len(rows), unknowns.size))
    lift[np.arange(len(rows))[:, None], places] = weight[:, None]
    means = unknowns.prior_means()
    return GroupValues(
        rows=rows,
        mean=means[places[:, 0]] + lift @ (vector - means),
        lift=lift,
        variance=weight * between + between,
        shared_variance=weight * between,
    )


def group_and_shared_values(
    unknowns: Unknowns, vector: Float[np.ndarray, " unknowns"], group: int | None
) -> GroupValues:
    """The values that all recordings share, followed by those of a group.

    **Arguments:**

    - `group`: the number of the group, None for a group that was not matched.
    """
    rows, places = unknowns.rows_of_groups()
    shared = [number for number, row in enumerate(unknowns.shared) if row.scope != "group"]
    of_group = new_group_values(unknowns, vector)
    if group is not None:
        lift, none = np.eye(unknowns.size)[places[:, group]], np.zeros(len(rows))
        of_group = GroupValues(rows, vector[places[:, group]], lift, none, none)
    none = np.zeros(len(shared))
    return GroupValues(
        rows=(*(unknowns.shared[number] for number in shared), *rows),
        mean=np.concatenate([vector[shared], of_group.mean]),
        lift=np.concatenate([np.eye(unknowns.size)[shared], of_group.lift]),
        variance=np.concatenate([none, of_group.variance]),
        shared_variance=np.concatenate([none, of_group.shared_variance]),
    )
