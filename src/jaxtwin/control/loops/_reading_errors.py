"""Errors of the readings that a controller gets: noise, recalibrations, lost messages."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..._arguments import finite_number, mapping_of
from ..._name_suggestions import unknown_name
from ...errors import ControlError
from ...physics import Faults, pixel_weights
from ...physics._recalibrations import SHUTTER_SECONDS, Recalibrations
from ...rig import Rig
from ._outages import is_within, longest_silence, periodic_spans

# The frame rate of the camera, as in the virtual rig.
FRAMES_PER_SECOND = 9.0


class ReadingErrors(NamedTuple):
    """Errors of the channels at each sample.

    - `error`: `(samples, channels)`, K; NaN after a channel has failed.
    - `arrives`: whether a new reading arrives, `(samples,)`.
    - `silence`: the longest time between two complete frames since the sample before, or until now
      if none has arrived, `(samples,)`, s.
    """

    error: Float[np.ndarray, "samples channels"]
    arrives: Bool[np.ndarray, " samples"]
    silence: Float[np.ndarray, " samples"]


def reading_errors(
    where: str,
    rig: Rig,
    times: Float[np.ndarray, " samples"],
    *,
    noise: bool,
    faults: Faults,
    failed_channels: Mapping[str, float],
    seed: int,
) -> ReadingErrors:
    """Makes the errors of a camera, or of point sensors, like those of the virtual rig.

    **Arguments:**

    - `times`: times of the controller's samples, s.
    - `noise`: whether readings have the noise that the rig file states.
    - `faults`: faults of a virtual rig, of which `drop`, `jumps` and `stall` are used.
    - `failed_channels`: channel -> time from which it gives no reading, s.

    **Raises:** `ControlError` for a channel that the rig does not have, and for faults that a
    simulated loop cannot have.
    """
    names = tuple(channel.name for channel in rig.channels)
    if faults.rig or faults.corrupt or faults.disconnect:
        raise ControlError(
            f"{where}: faults: expected drop, jumps and stall, which a simulated loop has, got "
            f"{faults}; the others are those of jaxtwin virtual-rig"
        )
    if faults.jumps and rig.camera is None:
        raise ControlError(
            f"{where}: faults: jumps: expected a rig with a camera, got {rig.name}, which has "
            "none; leave out jumps"
        )
    random = np.random.default_rng(seed)
    error = np.zeros((len(times), len(names)))
    if noise:
        error += random.normal(size=error.shape) @ _noise_factor(rig).T
    interval = times[1] - times[0] if len(times) > 1 else 1.0
    frames = 1 if rig.camera is None else max(1, int(interval * FRAMES_PER_SECOND))
    # The newest of several frames counts, so that a reading is missing only if all are lost.
    lost = random.random(len(times)) < faults.drop**frames
    recalibrations = Recalibrations(faults.jumps, seed, rig.common_error)
    for sample, time in enumerate(times.tolist()):
        recalibrations.advance(time)
        error[sample] += recalibrations.offset(time)
    mapping_of(f"{where}: failed_channels", failed_channels, "channel -> time", ControlError)
    for name, start in failed_channels.items():
        if name not in names:
            raise ControlError(f"{where}: failed_channels: {unknown_name('channel', name, names)}")
        begin = finite_number(f"{where}: failed_channels: {name}", start, ControlError)
        error[times >= begin, names.index(name)] = np.nan
    stalls = periodic_spans(*(faults.stall or (0.0, 0.0)), times[-1])
    closings = periodic_spans(faults.jumps, SHUTTER_SECONDS, times[-1])
    silent = np.concatenate([stalls, closings])
    # The frames between the sample before and a sample whose frames are all lost, and all after the
    # failure of a channel.
    period = 1 / FRAMES_PER_SECOND
    missed = np.column_stack([np.append(0.0, times[:-1]), times])[lost] + period
    failed = np.array([[float(start), np.inf] for start in failed_channels.values()])
    incomplete = np.concatenate([silent, missed, failed.reshape(-1, 2)])
    return ReadingErrors(
        error=error,
        arrives=~lost & ~is_within(times, silent),
        silence=longest_silence(times, incomplete, period),
    )


def _noise_factor(rig: Rig) -> Float[np.ndarray, "channels channels"]:
    """F with F F^T the covariance of the channels' noise, K^2; zones share noise by pixels."""
    if rig.camera is None:
        return rig.noise * np.eye(len(rig.channels))
    weights = pixel_weights(rig).reshape(len(rig.channels), -1)
    values, vectors = np.linalg.eigh(weights @ weights.T)
    return rig.noise * vectors * np.sqrt(np.maximum(values, 0.0))
