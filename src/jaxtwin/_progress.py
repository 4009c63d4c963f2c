"""The interface by which a long piece of work reports its progress."""

from typing import Protocol, final, runtime_checkable


@runtime_checkable
class Progress(Protocol):
    """Shows the progress of a piece of work that consists of steps."""

    def step(self, text: str) -> None:
        """Ends the step under way, if there is one, and begins the next."""
        ...

    def update(self, text: str) -> None:
        """Reports the progress of the step under way."""
        ...


@final
class NullProgress:
    """Shows nothing."""

    def step(self, text: str) -> None:
        """Does nothing."""

    def update(self, text: str) -> None:
        """Does nothing."""
