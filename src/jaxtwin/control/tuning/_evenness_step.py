r"""The change of duty and places that makes a linearised plate most even, within a trust region.

With the temperatures $T$ of the elements, their derivatives $T_z$ and the error $e$ of the mean,

$$\min_d \; J(T + T_z d) + w \lvert e + e_z d \rvert, \quad
\underline d \le d \le \overline d, \quad R d \le r$$

where $J$ is the range, in a linear program, or the standard deviation, in one of least squares (of
which the error of the mean is then a square).
"""

from abc import abstractmethod
from typing import ClassVar, NamedTuple, final

import equinox as eqx
import numpy as np
from jaxtyping import Float
from scipy.optimize import linprog, minimize

# The weight of an error of the mean relative to that of the evenness. A far smaller one would do:
# the range changes by a fraction of a kelvin with each kelvin of the mean.
OF_MEAN = 10.0

# The same where both are squares: the error that is left is a thousandth of the standard deviation.
OF_SQUARES = 30.0


class LinearPlate(NamedTuple):
    """The linearised steady state of a plate.

    - `elements`: the temperatures of the elements, degC, with their derivatives `elements_by`.
    - `error`: the error of the mean, K, with its derivatives `error_by`.
    """

    elements: Float[np.ndarray, " elements"]
    elements_by: Float[np.ndarray, "elements unknowns"]
    error: float
    error_by: Float[np.ndarray, " unknowns"]


class Region(NamedTuple):
    """The changes among which one is searched: `lowest` to `highest`, with `rows @ change <=
    room`."""

    lowest: Float[np.ndarray, " unknowns"]
    highest: Float[np.ndarray, " unknowns"]
    rows: Float[np.ndarray, "rows unknowns"]
    room: Float[np.ndarray, " rows"]


class AbstractUnevenness(eqx.Module):
    """A measure of how uneven a plate is, which is to become small."""

    name: ClassVar[str]

    @abstractmethod
    def value(self, elements: Float[np.ndarray, " elements"]) -> float:
        """Computes the measure, K."""

    @abstractmethod
    def cost(self, plate: LinearPlate) -> float:
        """Computes the measure with the error of the mean in it, K."""

    @abstractmethod
    def step(self, plate: LinearPlate, region: Region) -> Float[np.ndarray, " unknowns"] | None:
        """Finds the change with the least cost; None if no change is allowed."""


@final
class PlateRange(AbstractUnevenness):
    """The difference between the hottest and the coldest element."""

    name: ClassVar[str] = "range"

    def value(self, elements: Float[np.ndarray, " elements"]) -> float:
        return float(np.ptp(elements))

    def cost(self, plate: LinearPlate) -> float:
        return self.value(plate.elements) + OF_MEAN * abs(plate.error)

    def step(self, plate: LinearPlate, region: Region) -> Float[np.ndarray, " unknowns"] | None:
        # Beside the change: the hottest and the coldest temperature, and the size of the error.
        unknowns, ones = len(region.lowest), np.ones((len(plate.elements), 1))
        nothing, no_rows = np.zeros_like(ones), np.zeros((len(region.rows), 3))
        rows = np.vstack(
            [
                np.hstack([plate.elements_by, -ones, nothing, nothing]),
                np.hstack([-plate.elements_by, nothing, ones, nothing]),
                np.concatenate([plate.error_by, [0.0, 0.0, -1.0]])[None],
                np.concatenate([-plate.error_by, [0.0, 0.0, -1.0]])[None],
                np.hstack([region.rows, no_rows]),
            ]
        )
        optimum = linprog(
            np.concatenate([np.zeros(unknowns), [1.0, -1.0, OF_MEAN]]),
            A_ub=rows,
            b_ub=np.concatenate(
                [-plate.elements, plate.elements, [-plate.error, plate.error], region.room]
            ),
            bounds=[
                *zip(region.lowest, region.highest, strict=True),
                (None, None),
                (None, None),
                (0, None),
            ],
        )
        return None if optimum.x is None else optimum.x[:unknowns]


@final
class PlateDeviation(AbstractUnevenness):
    """The standard deviation of the elements, weighted by their areas.

    **Arguments:**

    - `shares`: the share of each element in the area of the plate.
    """

    name: ClassVar[str] = "standard deviation"
    shares: Float[np.ndarray, " elements"]

    def value(self, elements: Float[np.ndarray, " elements"]) -> float:
        return float(np.sqrt(self.shares @ (elements - self.shares @ elements) ** 2))

    def cost(self, plate: LinearPlate) -> float:
        return float(np.hypot(self.value(plate.elements), OF_SQUARES * plate.error))

    def step(self, plate: LinearPlate, region: Region) -> Float[np.ndarray, " unknowns"] | None:
        roots = np.sqrt(self.shares)
        matrix = np.vstack(
            [
                roots[:, None] * (plate.elements_by - self.shares @ plate.elements_by),
                OF_SQUARES * plate.error_by,
            ]
        )
        now = np.append(
            roots * (plate.elements - self.shares @ plate.elements), OF_SQUARES * plate.error
        )
        # In units of the region, so that metres and duty cycles are alike.
        width = np.maximum(region.highest, -region.lowest)
        width = np.where(width > 0, width, 1.0)
        matrix, rows = matrix * width, region.rows * width
        optimum = minimize(
            lambda change: 0.5 * float(((now + matrix @ change) ** 2).sum()),
            np.zeros(len(width)),
            jac=lambda change: matrix.T @ (now + matrix @ change),
            method="SLSQP",
            bounds=[*zip(region.lowest / width, region.highest / width, strict=True)],
            constraints={
                "type": "ineq",
                "fun": lambda change: region.room - rows @ change,
                "jac": lambda _: -rows,
            }
            if len(rows)
            else (),
            options={"maxiter": 200, "ftol": 1e-12},
        )
        return optimum.x * width if np.isfinite(optimum.x).all() else None
