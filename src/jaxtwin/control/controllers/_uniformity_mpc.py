r"""The model predictive controller that holds the mean of a plate as evenly as it can.

The temperatures that are to be even are those of the plate's elements, which no channel reads
alone. What the model misses of the channels is explained by unknown heat, which is equally likely
at each element: with $T_c = R_c q$ and $T_e = R_e q$, the rises of the channels and of the elements
by heat $q$, the errors $e_c$ of the channels change the elements by

$$e_e = R_e R_c^T (R_c R_c^T + \rho I)^{-1} e_c$$
"""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..._arguments import of_kind, whole_number
from ...errors import ControlError
from ..linear._state_space import StateSpace, check_at_rest
from ._mpc import MPC, design_mpc
from ._mpc_programs import AbstractEvennessCost, RangeCost
from ._predictive_controller import DEFAULT_EXCESS

# $\rho$, as a share of the mean variance of the channels' errors: the part that is noise.
NOISE_SHARE = 0.01


def design_uniformity_mpc(
    model: StateSpace,
    *,
    evenness: AbstractEvennessCost | None = None,
    sample_time_s: float | int = 5.0,
    order: int = 6,
    horizon: int = 30,
    control_horizon: int = 10,
    excess_deviation: float | int = DEFAULT_EXCESS,
    reading_noise: float | int = 0.5,
    **settings: Any,
) -> MPC:
    """Designs an `MPC` that holds the mean of the channels at its reference, as evenly as the cells
    can: at rest by the most even duty, and on the way with no larger range than at rest.

    ```python
    model = jt.linearize(twin, temperatures=40)
    even = jaxtwin.control.design_uniformity_mpc(model, limits=(0, 1))
    jt.simulate_closed_loop(twin, even, 40, duration=900)
    ```

    **Arguments:**

    - `model`: a linear model of a rig, from `linearize`. Of a rig with a plate the temperatures of
      all elements are to be even, of another rig those of the channels.
    - `evenness`: what makes them uneven; None for a `RangeCost`.
    - `sample_time_s`: the sample time, s. `order`: the number of states of the reduced model.
    - `horizon`, `control_horizon`, `excess_deviation`, `reading_noise`: as in `design_mpc`.
    - `settings`: the further arguments of `design_mpc`.

    **Raises:** `ControlError` if the model is not one in continuous time at rest, or for a setting
    that `design_mpc` refuses.
    """
    where = "design_uniformity_mpc"
    expected = "a model in continuous time, such as linearize(twin, temperatures=40)"
    of_kind(f"{where}: model", model, StateSpace, expected, ControlError)
    if model.is_discrete:
        raise ControlError(f"{where}: model: expected {expected}, got {model!r}")
    check_at_rest(f"{where}: model", model)
    channels = model.output_names
    elements = model.state_names[: model.operating_point.elements]
    limited = [name for name in settings.get("temperature_limits") or {} if name in channels]
    read = list(dict.fromkeys([*limited, *channels]))
    full = _from_room_to_point(model).with_states_as_outputs(elements)
    most = min(whole_number(f"{where}: order", order, 1, ControlError), _largest_order(full))
    return design_mpc(
        full.reduce(most).discretise(sample_time_s),
        measured=[channels],
        horizon=horizon,
        control_horizon=control_horizon,
        excess_deviation=excess_deviation,
        reading_noise=reading_noise,
        evenness=RangeCost() if evenness is None else evenness,
        points=elements or channels,
        point_errors=_element_errors(model, read) if elements else None,
        **settings,
    )


def _from_room_to_point(model: StateSpace) -> StateSpace:
    """The model with the gain of the whole way from the room to the operating point. Cells give
    less heat per unit of duty the warmer the plate is, and a plan on the way needs the mean."""
    point = model.operating_point
    duty, rises = np.asarray(point.duty), np.asarray(point.nodes) - float(point.ambient)
    C = np.asarray(model.C)
    by_cells = C @ np.linalg.solve(-np.asarray(model.A), np.asarray(model.B)) * duty
    share, *_ = np.linalg.lstsq(by_cells, C @ rises, rcond=None)
    return eqx.tree_at(lambda m: m.B, model, np.asarray(model.B) * share)


def _largest_order(model: StateSpace) -> int:
    return len(model.hankel_singular_values)


def _element_errors(
    model: StateSpace, channels: list[str]
) -> Float[np.ndarray, "elements channels"]:
    """What an error of 1 K of the model at each channel changes at each element."""
    elements = model.operating_point.elements
    rows = [model.output_names.index(name) for name in channels]
    rises = np.linalg.solve(-np.asarray(model.A), np.eye(len(model.A))[:, :elements])
    of_elements, of_channels = rises[:elements], np.asarray(model.C)[rows] @ rises
    together = of_channels @ of_channels.T
    noise = NOISE_SHARE * np.trace(together) / len(together) * np.eye(len(together))
    return np.linalg.solve(together + noise, of_channels @ of_elements.T).T
