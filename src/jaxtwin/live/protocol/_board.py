"""A board that answers when it is asked, and is no device of the protocol by itself."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar, TypeVar

from ..._kinds import add_kind
from ...errors import LinkError
from ...rig import Rig


class AbstractBoard(ABC):
    """A board with heaters and sensors, such as a Temperature Control Lab.

    A class of its own and `register_board` make every command and function that takes a link speak
    to a board: `mylab://PORT` opens the board whose `kind` is `"mylab"`. The host then does what a
    device of the protocol does by itself: see `BoardDevice`.

    All methods may raise `OSError` with a sentence that says what was expected of the board: the
    link is then closed, with the heaters off if the board still obeys, and opened again.
    """

    kind: ClassVar[str]
    """The scheme of its links."""

    rate: float = 1.0
    """The seconds of the board's time in a second; 1 except for a simulated board."""

    @classmethod
    @abstractmethod
    def open(cls, address: str, rig: Rig) -> "AbstractBoard":
        """Opens a board.

        **Arguments:**

        - `address`: the link without its scheme, such as `/dev/ttyACM0` of `tclab:///dev/ttyACM0`.
        - `rig`: the rig that is expected at the other end.
        """

    @abstractmethod
    def temperatures(self) -> Sequence[float]:
        """Reads the channels of the rig, in its order, degC; NaN for a sensor that has failed."""

    @abstractmethod
    def apply(self, duty: Sequence[float]) -> None:
        """Applies duty cycles to the cells and heaters of the rig, in its order, -1 to 1."""

    def ambient(self) -> float | None:
        """Reads the ambient temperature, degC; None if the board does not measure it."""
        return None

    @abstractmethod
    def close(self) -> None:
        """Ends the connection; the heaters are off already."""


Registered = TypeVar("Registered", bound=type[AbstractBoard])

# Scheme -> class of boards.
_KINDS: dict[str, type[AbstractBoard]] = {}


def register_board(board: Registered) -> Registered:
    """Makes links know a class of boards by its `kind`. Returns the class, so that it can be a
    decorator.

    **Raises:** `LinkError` for a class without a `kind`, or with the `kind` of another class.
    """
    add_kind(_KINDS, board, "register_board", "links, such as 'tclab'", LinkError)
    return board


def board_kinds() -> Mapping[str, type[AbstractBoard]]:
    """The registered kinds of boards, scheme -> class."""
    return _KINDS
