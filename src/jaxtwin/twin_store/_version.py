"""What a store knows of a version of a twin, and of a move of an alias."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, final

from ..io import Experiment
from ..matching import Fit, fit_of_text
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
