"""The difference of two versions of a twin."""

import difflib
from dataclasses import dataclass
from typing import Any, final

from ..matching import FitDifference, compare_fits
from ._version import TwinVersion


@final
@dataclass(frozen=True)
class VersionDiff:
    """The difference of two versions of a twin.

    - `old`, `new`: the versions.
    - `parameters`: the differences of the fits, in standard errors.
    - `rig`: the lines of the rig file that differ, as `diff -u` writes them.
    - `only_old`, `only_new`: the recordings that only one of them was matched to.
    - `software`: name -> both versions, where they differ.
    """

    old: TwinVersion
    new: TwinVersion
    parameters: FitDifference
    rig: tuple[str, ...]
    only_old: tuple[str, ...]
    only_new: tuple[str, ...]
    software: dict[str, tuple[str, str]]

    def summary(self) -> str:
        """The difference as text."""
        lines = [f"version {self.old.number} to version {self.new.number}: {self.new.reason}"]
        lines.append(self.parameters.summary())
        for label, names in (("old", self.only_old), ("new", self.only_new)):
            lines += [f"recordings of the {label} version alone: {', '.join(names)}"] * bool(names)
        lines += [f"{name} {old}, now {new}" for name, (old, new) in self.software.items()]
        lines += self.rig
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """The difference as plain types for JSON."""
        return {
            "old": self.old.number,
            "new": self.new.number,
            "reason": self.new.reason,
            **self.parameters.to_dict(),
            "recordings_only_old": list(self.only_old),
            "recordings_only_new": list(self.only_new),
            "software": {name: list(pair) for name, pair in self.software.items()},
            "rig": list(self.rig),
        }


def diff_versions(old: TwinVersion, new: TwinVersion) -> VersionDiff:
    """The difference of two versions.

    **Raises:** `JaxtwinError` if one of the fits cannot be read.
    """
    rig = difflib.unified_diff(
        old.rig_text.splitlines(),
        new.rig_text.splitlines(),
        f"version {old.number}",
        f"version {new.number}",
        lineterm="",
    )
    before, after = set(old.recordings.values()), set(new.recordings.values())
    known = [*dict.fromkeys([*old.software, *new.software])]
    pairs = {
        name: (old.software.get(name, "none"), new.software.get(name, "none")) for name in known
    }
    return VersionDiff(
        old,
        new,
        compare_fits(old.fit(), new.fit()),
        tuple(rig),
        tuple(name for name, digest in old.recordings.items() if digest not in after),
        tuple(name for name, digest in new.recordings.items() if digest not in before),
        {name: pair for name, pair in pairs.items() if pair[0] != pair[1]},
    )
