"""The most even steady state that the cells can hold at a mean temperature, found by steps within
trust regions."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar, NamedTuple, final

import equinox as eqx
import numpy as np
from jaxtyping import Float
from scipy.optimize import linprog, minimize

from ..._arguments import finite_number
from ..._progress import announced
from ...errors import ControlError
from ...matching import Fit, nominal_twin
from ...physics import Twin
from ...rig import check_has_plate
from ..controllers._duty_limits import bounds_of, checked_limits, limits_of_rig
from ..linear._linearize import linearize
from ..linear._operating_point import OperatingPoint
from ..linear._state_space import StateSpace

# The change of duty and places that makes a linearised plate most even, within a trust region.
#
# With the temperatures $T$ of the elements, their derivatives $T_z$ and the error $e$ of the mean,
#
# $$\min_d \; J(T + T_z d) + w \lvert e + e_z d \rvert, \quad
# \underline d \le d \le \overline d, \quad R d \le r$$
#
# where $J$ is the range, in a linear program, or the standard deviation, in one of least squares
# (of which the error of the mean is then a square).

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


# The largest change of the duty of a cell in a step.
FIRST_REACH = 0.25

MIN_STEP = 1e-6

STEPS = 60

# A mean counts as reached within this distance, K.
MEAN_TOLERANCE = 0.01


@announced("most even point")
def most_even_point(
    twin: Twin | Fit,
    temperature: float | int,
    *,
    limits: Sequence[float | int] = (-1.0, 1.0),
    ambient: float | int | None = None,
) -> OperatingPoint:
    """Finds the steady state at which the plate is most even.

    ```python
    best = jaxtwin.control.most_even_point(twin, 40)
    best.duty, best.outputs  # -1 to 1, degC
    ```

    No controller holds the mean with less difference between the hottest and the coldest element
    of the plate, because cells that stand at fixed places leave a pattern that no duty removes. The
    outputs of this point are the references with which a controller of several outputs makes the
    plate as even as it can be.

    The search solves a sequence of linear programs with the exact derivatives of the steady state,
    starting at equal duty cycles.

    **Arguments:**

    - `twin`: the twin; or a fit (`Fit.mean_twin`).
    - `temperature`: the mean of all channels, degC.
    - `limits`: lowest and highest duty.
    - `ambient`: temperature of the surroundings, degC; None: that of the rig.

    **Raises:** `ControlError` if no duty within the limits reaches the temperature.
    """
    where = "most_even_point"
    plant = nominal_twin(f"{where}: twin", twin, ControlError)
    check_has_plate(where, plant.rig, ControlError)
    mean = finite_number(f"{where}: temperature", temperature, ControlError)
    cells = len(plant.rig.driven)
    given = limits_of_rig(where, checked_limits(where, limits), plant.rig)
    low, high = (np.broadcast_to(bound, (cells,)) for bound in bounds_of(given))
    elements = plant.wiring.elements

    def plate_at(duty: Float[np.ndarray, " cells"]) -> _Plate:
        return _plate(linearize(plant, duty=duty, ambient=ambient), elements, mean)

    start = linearize(plant, temperatures=mean, ambient=ambient).operating_point
    at = plate_at(np.clip(np.asarray(start.duty), low, high))
    reach = FIRST_REACH
    for _ in range(STEPS):
        step = _step(at, np.maximum(low - at.duty, -reach), np.minimum(high - at.duty, reach))
        if np.abs(step).max() < MIN_STEP:
            break
        result = plate_at(at.duty + step)
        if result.cost < at.cost:
            at, reach = result, min(2 * reach, FIRST_REACH)
        else:
            reach = 0.4 * min(reach, float(np.abs(step).max()))
    error = at.linear.error
    if abs(error) > MEAN_TOLERANCE:
        raise ControlError(
            f"{where}: temperature: expected a mean that duty cycles from {low.min():g} to "
            f"{high.max():g} reach, got {mean:g} degC; the nearest found was "
            f"{mean + error:.4g} degC"
        )
    return at.point


@final
class _Plate(NamedTuple):
    """A steady state with its derivatives by the duty."""

    point: OperatingPoint
    linear: LinearPlate

    @property
    def duty(self) -> Float[np.ndarray, " cells"]:
        return np.asarray(self.point.duty)

    @property
    def cost(self) -> float:
        return PlateRange().cost(self.linear)


def _plate(model: StateSpace, elements: int, mean: float) -> _Plate:
    A, B, C = (np.asarray(matrix) for matrix in (model.A, model.B, model.C))
    nodes_by_duty = np.linalg.solve(-A, B)
    point = model.operating_point
    return _Plate(
        point,
        LinearPlate(
            np.asarray(point.nodes)[:elements],
            nodes_by_duty[:elements],
            float(np.asarray(point.outputs).mean()) - mean,
            (C @ nodes_by_duty).mean(axis=0),
        ),
    )


def _step(
    at: _Plate, low: Float[np.ndarray, " cells"], high: Float[np.ndarray, " cells"]
) -> Float[np.ndarray, " cells"]:
    region = Region(low, high, np.zeros((0, len(low))), np.zeros(0))
    step = PlateRange().step(at.linear, region)
    assert step is not None  # no change is allowed
    return step
