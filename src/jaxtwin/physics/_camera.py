"""The infrared camera: how pixels of frames become channels, and its recalibrations."""

from typing import final

import numpy as np
from jaxtyping import Float, Shaped

from .._arguments import of_kind
from ..errors import RigError
from ..rig import Camera, CommonError, Rig


def frame_to_channels(
    rig: Rig, frames: Shaped[np.ndarray, "*frames height width"]
) -> Float[np.ndarray, "*frames channels"]:
    """Computes the readings of the channels in camera frames, Fig. 5d of the paper.

    A channel is the mean of the pixels under its rectangle of the plate, each weighted by the area
    inside the rectangle, so that the edge of a zone may run through a pixel. A channel that is
    given by nodes is the plain mean over these elements, of which each is the mean of its pixels.

    **Arguments:**

    - `rig`: the rig, whose camera states which pixels show the plate.
    - `frames`: a frame `(height, width)` or many frames `(..., height, width)`, in any unit of
      temperature; row 0 is the top.

    **Returns:** `(..., channels)` in the order of the rig, in the unit of the frames.

    **Raises:** `RigError` if the frames do not have the camera's resolution, or the rig has no
    camera.
    """
    of_kind("frame_to_channels: rig", rig, Rig, "a Rig, as load_rig reads it", RigError)
    _, frames = checked_frames(rig, frames)
    return np.einsum("...hw,chw->...c", frames, pixel_weights(rig))


def checked_frames(
    rig: Rig, frames: Shaped[np.ndarray, "*frames height width"]
) -> tuple[Camera, Float[np.ndarray, "*frames height width"]]:
    """The camera of a rig and its frames.

    **Raises:** `RigError` if the frames do not have the camera's resolution, or the rig has no
    camera.
    """
    camera = _camera(rig)
    frames = np.asarray(frames)
    if frames.dtype.kind not in "iuf" or frames.ndim < 2:
        raise RigError(
            f"frames: expected numbers of shape (..., height, width), got {frames.dtype} values "
            f"of shape {frames.shape}"
        )
    if frames.shape[-2:] != (camera.height, camera.width):
        raise RigError(
            f"{rig.source}: camera.resolution: expected frames of {camera.width} x "
            f"{camera.height} pixels, got {frames.shape[-1]} x {frames.shape[-2]}"
        )
    return camera, np.asarray(frames, float)


def pixel_weights(rig: Rig) -> Float[np.ndarray, "channels height width"]:
    """The weight of each pixel in each channel; every channel sums to 1.

    **Raises:** `RigError` if the rig has no camera.
    """
    camera, plate = _camera(rig), rig.plate
    x = _pixel_edges(camera.width, camera.view_x, plate.width)
    y = _pixel_edges(camera.height, camera.view_y, plate.height)
    weights = np.zeros((len(rig.channels), camera.height, camera.width))
    for number, channel in enumerate(rig.channels):
        for x0, x1, y0, y1 in channel.sensor.outline(plate):
            area = np.outer(_covered(y, y0, y1), _covered(x, x0, x1))
            weights[number] += area / area.sum()
    return weights / weights.sum(axis=(1, 2), keepdims=True)


def _camera(rig: Rig) -> Camera:
    if rig.camera is None:
        raise RigError(f"{rig.source}: camera: expected a rig with a camera, got one without")
    return rig.camera


def _pixel_edges(pixels: int, view: tuple[float, float], size: float) -> np.ndarray:
    """Edges of the pixels of one axis in plate coordinates, m."""
    first, last = view
    return (np.arange(pixels + 1) - first) / (last - first) * size


def _covered(edges: np.ndarray, low: float, high: float) -> np.ndarray:
    """Length of each interval between neighbouring edges that lies between low and high."""
    return np.clip(np.minimum(edges[1:], high) - np.maximum(edges[:-1], low), 0, None)


# A camera's recalibrations: a shutter that closes, and an offset that jumps and fades.

# The time for which a recalibration freezes the image, s.
SHUTTER_SECONDS = 1.0

# Size (K) and duration (s) of a jump of the camera's offset, if the rig file states none.
JUMP_KELVIN, JUMP_DECAY = 0.8, 25.0


@final
class Recalibrations:
    r"""The recalibrations of a camera: the times at which its shutter is closed, and its offset.

    At a recalibration the offset jumps to $\sum_j b_j$ and fades as $\sum_j b_j e^{-t / \tau_j}$.
    The time constants are those of `[camera.common_error]`, and each $b_j$ is drawn from the prior
    that a match has for it: normal, with the standard deviation `jump`.

    The virtual rig and a simulated closed loop with the same seed see the same jumps.

    **Arguments:**

    - `interval`: the time between two recalibrations, s; 0: never.
    - `seed`: the seed of the jumps.
    - `common_error`: the common error in the rig file; None for `JUMP_KELVIN` and `JUMP_DECAY`.
    """

    def __init__(self, interval: float, seed: int, common_error: CommonError | None):
        self._interval = interval
        self._random = np.random.default_rng([seed, 1])
        self._size, relaxation = JUMP_KELVIN, (JUMP_DECAY,)
        if common_error is not None:
            self._size, relaxation = common_error.jump, common_error.relaxation
        self._relaxation = np.array(relaxation)
        self._jump = np.zeros(len(relaxation))
        self._at = 0.0

    def advance(self, time: float) -> None:
        """Advances to a time, s."""
        while self._interval and time >= self._at + self._interval:
            self._at += self._interval
            self._jump = self._random.normal(0, self._size, len(self._relaxation))

    def is_closed(self, time: float) -> bool:
        """Whether the shutter is closed."""
        return self._at > 0 and time - self._at < SHUTTER_SECONDS

    def offset(self, time: float) -> float:
        """Offset of all pixels, K."""
        return float(self._jump @ np.exp(-(time - self._at) / self._relaxation))
