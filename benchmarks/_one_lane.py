"""The C program with vectors of one number, so that it takes one draw at a time."""

import tempfile
from functools import cache
from pathlib import Path


@cache
def one_lane_compiler() -> str:
    """A compiler whose vectors hold one number, so that the program takes one draw at a time."""
    script = Path(tempfile.mkdtemp()) / "cc-one-lane"
    script.write_text('#!/bin/sh\nexec cc -DLANES=1 "$@"\n')
    script.chmod(0o700)
    return str(script)
