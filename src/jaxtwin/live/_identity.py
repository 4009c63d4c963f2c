"""Which bench a rig file describes, as its devices must introduce it; frames -> channels."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float, UInt16

from ..physics import pixel_weights
from ..rig import Rig
from ._messages import VERSION, Hello, wire_name

CENTIKELVIN = 0.01
ZERO_CELSIUS = 273.15


@final
@dataclass(frozen=True, eq=False)
class Identity:
    """A rig as the protocol sees it.

    **Arguments:**

    - `rig`, `cells`, `channels`: names, as they stand in messages.
    - `camera`: width and height of its frames, pixels; `None` where sensors read the channels.
    - `counts`: PWM counts of full duty.
    - `weights`: share of each pixel in each channel, `(channels, pixels)`; rows sum to 1. Without
      a camera there are no pixels.
    """

    rig: str
    cells: tuple[str, ...]
    channels: tuple[str, ...]
    camera: tuple[int, int] | None
    counts: int
    weights: Float[np.ndarray, "channels pixels"]

    @classmethod
    def of(cls, rig: Rig) -> "Identity":
        """That of a rig."""
        camera, channels = rig.camera, len(rig.channels)
        return cls(
            rig=wire_name(rig.name),
            cells=tuple(wire_name(cell.name) for cell in rig.cells),
            channels=tuple(wire_name(channel.name) for channel in rig.channels),
            camera=camera and (camera.width, camera.height),
            counts=rig.driver.counts,
            weights=np.zeros((channels, 0))
            if camera is None
            else pixel_weights(rig).reshape(channels, -1),
        )

    def refusal(self, hello: Hello) -> str | None:
        """Why a device does not belong to this rig, or `None` where it does."""
        if hello.version != VERSION:
            return f"speaks version {hello.version} of the protocol; allowed is {VERSION}"
        pairs = (
            ("rig", hello.rig, self.rig),
            ("cells", hello.cells or self.cells, self.cells),
            ("channels", hello.channels or self.channels, self.channels),
            ("camera", hello.camera or self.camera, self.camera),
            ("counts", hello.counts if hello.cells else self.counts, self.counts),
        )
        for field, found, allowed in pairs:
            if found != allowed:
                return f"greets with {field} {found}; the rig file says {allowed}"
        return None

    def temperatures(
        self, pixels: UInt16[np.ndarray, "height width"]
    ) -> Float[np.ndarray, " channels"]:
        """Channels of a frame in centikelvin, degC: means by area over each channel's pixels."""
        return self.weights @ pixels.ravel() * CENTIKELVIN - ZERO_CELSIUS
