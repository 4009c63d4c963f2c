"""What one step of the conformance test found."""

from typing import NamedTuple


class Finding(NamedTuple):
    """The test of one step of the script, and the error that it found (`""` for none)."""

    step: str
    wrong: str


def found(step: str, ok: bool, wrong: str) -> Finding:
    """The finding of a step that is `wrong` if it is not `ok`."""
    return Finding(step, "" if ok else wrong)
