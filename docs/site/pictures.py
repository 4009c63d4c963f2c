"""Pictures of several panels, which scroll on a phone instead of shrinking to its width."""

import re
import struct
from pathlib import Path

WIDE = 600
"""Pixels from which a picture shrunk to the width of a phone cannot be read."""

_PICTURE = re.compile(r'<img\b[^>]*\bsrc="([^":]+\.png)"[^>]*>')


def scrolling(page: str, folder: Path) -> str:
    """A page's HTML with wide pictures inside what style.css lets scroll. `folder` is where the
    page is."""

    def marked(picture: re.Match[str]) -> str:
        header = (folder / picture[1]).read_bytes()[:24]
        (width,) = struct.unpack(">I", header[16:20])
        return (
            f'<span class="panels" tabindex="0">{picture[0]}</span>'
            if width >= WIDE
            else picture[0]
        )

    return _PICTURE.sub(marked, page)
