"""What a store knows of a version of a twin and a move of an alias, and how two versions differ."""

import difflib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, final

from ..io import Experiment
from ..matching import Fit, FitDifference, compare_fits, fit_of_text
from ..observers import ProcessNoise


@final
@dataclass(frozen=True)
class TwinVersion:
    """A version of a twin in a store. It never changes, but for its aliases and tags.

    **Arguments:**

    - `store`: the file of the store. `number`: the version, counted from 1.
    - `made`: when it was added, UTC, ISO 8601.
    - `parent`: the version that it was refitted from; None for a first match.
    - `reason`: why it was made, a sentence.
    - `rig`: the name of its rig.
    - `recordings`: recording -> SHA-256 of its contents.
    - `software`: the versions of jaxtwin and jax that matched it, and of jaxtwin that stored it.
    - `aliases`, `tags`: those that it had when it was looked up.
    - `fit_text`, `rig_text`, `noise_text`: the saved fit, the rig file, and the noise of its
      observer, all as TOML.
    - `controller_text`: the file of the controller that belongs to the twin, TOML; None if none
      does. `trial`: what `jaxtwin.retune` found of it.
    """

    store: str
    number: int
    made: str
    parent: int | None
    reason: str
    rig: str
    recordings: Mapping[str, str]
    software: Mapping[str, str]
    aliases: tuple[str, ...]
    tags: Mapping[str, str]
    fit_text: str = field(repr=False)
    rig_text: str = field(repr=False)
    noise_text: str | None = field(repr=False)
    controller_text: str | None = field(default=None, repr=False)
    trial: Mapping[str, Any] = field(default_factory=dict, repr=False)

    @property
    def address(self) -> str:
        """The address of this version, which stands for the file of a fit."""
        return f"{self.store}@{self.number}"

    @property
    def noise(self) -> ProcessNoise | None:
        """The noise of its observer; None if it was added without."""
        if self.noise_text is None:
            return None
        return ProcessNoise.from_toml(self.noise_text, self.address)

    def fit(self, experiments: Experiment | Sequence[Experiment] | None = None) -> Fit:
        """Returns the fit.

        **Arguments:**

        - `experiments`: the matched recordings, as `Fit.load` takes them.

        **Raises:** the errors of `Fit.load`.
        """
        return fit_of_text(self.fit_text, self.address, None, experiments)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Writes the fit as a file, as `Fit.save` does.

        **Raises:** the errors of `Fit.save`.
        """
        self.fit().save(path)

    def to_dict(self) -> dict[str, Any]:
        """What is known of it as plain types for JSON, without the texts."""
        return {
            "version": self.number,
            "made": self.made,
            "parent": self.parent,
            "reason": self.reason,
            "rig": self.rig,
            "recordings": dict(self.recordings),
            "software": dict(self.software),
            "aliases": list(self.aliases),
            "tags": dict(self.tags),
            "has_noise": self.noise_text is not None,
            "controller": self.controller_text,
            "trial": dict(self.trial),
        }

    def summary(self) -> str:
        """What is known of it as text."""
        parent = "a first match" if self.parent is None else f"refitted from version {self.parent}"
        lines = [
            f"version {self.number} of {self.rig}, {parent}, {self.made}",
            f"  {self.reason}",
            f"  aliases: {', '.join(self.aliases) or 'none'}",
        ]
        lines += [f"  tag {key}: {value}" for key, value in self.tags.items()]
        lines += [f"  recording {name}: {digest[:12]}" for name, digest in self.recordings.items()]
        lines.append(
            f"  {', '.join(f'{name} {version}' for name, version in self.software.items())}"
        )
        lines.append(f"  noise: {'none' if self.noise_text is None else 'of its own'}")
        if self.controller_text is not None:
            scenarios = len(self.trial.get("scenarios", ()))
            tried = f", tried in {scenarios} scenarios" if scenarios else ""
            lines.append(f"  controller: of its own{tried}")
        return "\n".join(lines)


@final
@dataclass(frozen=True)
class AliasMove:
    """A move of an alias.

    - `made`: when, UTC, ISO 8601. `alias`: its name. `reason`: why, a sentence.
    - `before`, `after`: the versions; None where the alias was new or was deleted.
    """

    made: str
    alias: str
    before: int | None
    after: int | None
    reason: str

    def __str__(self) -> str:
        before, after = (
            "none" if version is None else f"version {version}"
            for version in (self.before, self.after)
        )
        return f"{self.made}  {self.alias}: {before} to {after}: {self.reason}"


# The difference of two versions of a twin.


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
