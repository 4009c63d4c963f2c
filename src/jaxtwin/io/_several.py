"""One experiment or several, as many functions take them."""

from collections.abc import Iterable
from typing import Any

from .._arguments import of_kind
from .._errors import JaxtwinError
from ._experiment import Experiment

EXPERIMENT = "an Experiment, as read_recording and Experiment.schedule make it"


def as_experiments(where: str, given: Any, error: type[JaxtwinError]) -> list[Experiment]:
    """A list of experiments.

    **Arguments:**

    - `where`: function and argument, for the message.
    - `given`: one experiment or several; none make an empty list.

    **Raises:** `error` where something else is among them.
    """
    several = isinstance(given, Iterable) and not isinstance(given, str | bytes)
    return [
        of_kind(where, one, Experiment, EXPERIMENT, error)
        for one in (given if several else [given])
    ]
