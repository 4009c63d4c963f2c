"""The infrared camera: how pixels of frames become channels."""

import numpy as np
from jaxtyping import Float, Shaped

from .._arguments import of_kind
from ..errors import RigError
from ..rig import Camera, Rig


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
