"""What a long piece of work tells about itself."""

from typing import Protocol, final, runtime_checkable


@runtime_checkable
class Progress(Protocol):
    """Someone who waits."""

    def step(self, text: str) -> None:
        """A new step begins, and the one before is done."""
        ...

    def news(self, text: str) -> None:
        """How far the step is."""
        ...


@final
class Silence:
    """Nobody waits."""

    def step(self, text: str) -> None:
        """Says nothing."""

    def news(self, text: str) -> None:
        """Says nothing."""
