"""What one step of the conformance test found."""

from typing import NamedTuple


class StepResult(NamedTuple):
    """The test of one step of the script, and the error that it found (`""` for none)."""

    step: str
    wrong: str


def found(step: str, ok: bool, wrong: str) -> StepResult:
    """The result of a step that is `wrong` if it is not `ok`."""
    return StepResult(step, "" if ok else wrong)
