"""The most even steady state that the cells can hold at a mean temperature."""

from collections.abc import Sequence
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from ..._arguments import finite_number
from ..._waiting import announced
from ...errors import ControlError
from ...matching import Fit, nominal_twin
from ...physics import Twin
from ...rig import check_has_plate
from ..controllers._duty_limits import bounds_of, checked_limits, limits_of_rig
from ..linear._linear_model import LinearModel
from ..linear._linearize import linearize
from ..linear._operating_point import OperatingPoint
from ._evenness_step import LinearPlate, PlateRange, Region

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


def _plate(model: LinearModel, elements: int, mean: float) -> _Plate:
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
