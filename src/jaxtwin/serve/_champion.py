"""The champion of a store as the twin beside a rig, also after another one was promoted."""

from collections.abc import Callable
from typing import Any, final

from ..twin_store import TwinStore, TwinVersion
from ._twin_beside import TwinBeside

LOOK_SECONDS = 5.0
"""The time between two looks at the store, s, which another process may change."""


@final
class Champion:
    """Follows the champion of a store.

    **Arguments:**

    - `store`: the store, whose champion is a twin of the rig.
    - `made`: makes the twin beside the rig from a version.
    """

    def __init__(self, store: TwinStore, made: Callable[[TwinVersion], TwinBeside]):
        self.store = store
        self.number = store.version("champion").number
        """The version that is followed."""
        self._made = made
        self._looked = 0

    def next(self, now: int) -> TwinBeside | None:
        """Returns the twin of a new champion; None if there is no other.

        **Arguments:**

        - `now`: host time, ns.

        **Raises:** `StoreError` if the store cannot be read, and the errors of making the twin.
        """
        if now - self._looked < LOOK_SECONDS * 1e9:
            return None
        self._looked = now
        if self.store.aliases.get("champion", self.number) == self.number:
            return None
        version = self.store.version("champion")
        beside = self._made(version)
        self.number = version.number
        return beside

    def look_at_once(self) -> None:
        """Makes `next` look at the store, whenever it looked last."""
        self._looked = 0

    def content(self) -> dict[str, Any]:
        """The versions of the store, the newest first, for a page."""
        return {
            "store": self.store.path.name,
            "followed": self.number,
            "versions": [
                {
                    "number": one.number,
                    "made": one.made,
                    "parent": one.parent,
                    "reason": one.reason,
                    "aliases": list(one.aliases),
                }
                for one in reversed(self.store.versions[-20:])
            ],
        }
