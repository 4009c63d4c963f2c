"""The reason why the cells must go off."""

from typing import NamedTuple


class Trip(NamedTuple):
    """The reason why an interlock stops a rig.

    - `kind`: the reason in a single word, for programs.
    - `detail`: the reason as a sentence, for people.
    """

    kind: str
    detail: str

    def __str__(self) -> str:
        return self.detail
