"""References of a closed loop: the desired value of each output at each sample."""

import math

import numpy as np
from jaxtyping import Array, Float, Int

from ..._arguments import finite_number
from ..._temperature_schedule import scheduled_temperatures
from ...errors import ControlError

# The largest number of references for which a loop is checked.
REPRESENTATIVES = 5


def reference_samples(
    where: str, references: object, times: Float[np.ndarray, " samples"], outputs: int
) -> Float[np.ndarray, "samples outputs"]:
    """The references at the samples, degC.

    **Arguments:**

    - `where`: the name of the argument, for error messages.
    - `references`: a number for all outputs; a text such as `"0:35,600:45"` or `"0:35/37"` (times
      in s, a value for all outputs or one for each, held until the next time), with
      `"0:16,ramp 600:40"` or `"0:16,curve 600:40"` for a change that ends at that time; or an array
      `(outputs,)` or `(samples, outputs)`, for a single output also `(samples,)`.
    - `times`: times of the samples, s.

    **Raises:** `ControlError` that quotes the invalid part.
    """
    if isinstance(references, str):
        return scheduled_temperatures(where, references, times, outputs, ControlError)
    try:
        values = np.asarray(references, float)
        if outputs == 1 and values.shape == times.shape:
            values = values[:, None]
        shaped = np.broadcast_to(values, (len(times), outputs))
    except (TypeError, ValueError):
        raise ControlError(
            f"{where}: expected a number, text such as '0:35,600:45', or an array of shape "
            f"({outputs},) or ({len(times)}, {outputs}), in degC, got "
            f"{_described(references)}"
        ) from None
    if not np.isfinite(shaped).all():
        raise ControlError(f"{where}: expected finite numbers, in degC, got {references!r}")
    return shaped.copy()


def references_ahead(
    references: Float[Array | np.ndarray, "samples outputs"], preview: int
) -> Float[Array | np.ndarray, "samples *preview outputs"]:
    """The references that a controller gets at each sample: those of the sample, or with a preview
    those of as many samples from it on. After the last sample its references go on."""
    if not preview:
        return references
    last = len(references) - 1
    return references[np.minimum(np.arange(last + 1)[:, None] + np.arange(preview), last)]


def representative_samples(
    references: Float[np.ndarray, "samples outputs"],
) -> Int[np.ndarray, " few"]:
    """The first samples of the lowest reference, of the highest, and of some between them, each
    different."""
    distinct, samples = np.unique(references, axis=0, return_index=True)
    return samples[
        np.unique(np.linspace(0, len(distinct) - 1, REPRESENTATIVES).round().astype(int))
    ]


def sample_times(
    where: str, duration: object, sample_time_s: float
) -> Float[np.ndarray, " samples"]:
    """Times of the samples from 0 to the duration, s.

    **Raises:** `ControlError` if the duration is not a multiple of the sample time.
    """
    duration = finite_number(f"{where}: duration", duration, ControlError)
    count = round(duration / sample_time_s)
    if count < 1 or not math.isclose(count * sample_time_s, duration, rel_tol=1e-9):
        raise ControlError(
            f"{where}: duration: expected a multiple of the controller's sample time "
            f"{sample_time_s:.10g} s, got {duration:.10g} s"
        )
    return sample_time_s * np.arange(count + 1)


def _described(value: object) -> str:
    shape = getattr(value, "shape", None)
    return repr(value) if shape is None else f"an array of shape {shape}"
