"""What a twin does not know of its rig: the random heat, drifts and errors of readings that an
observer assumes."""

import dataclasses
import math
import os
import tomllib
from pathlib import Path
from typing import Any, TypeGuard, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from .._arguments import path_of
from .._whole_file import write_whole_file
from ..errors import ObserverError

Level = Float[ArrayLike, ""]

# The levels that are estimated, with the standard deviation of the prior of their logarithm, or of
# themselves if they are `SIGNED_LEVELS`. How far parameters drift is not: recordings that were
# matched together say nothing of later weeks. How far the values of the fit may be from those of
# the rig is what the fit says.
SPREADS = {
    "reading": 0.5,
    "reading_time": 1.0,
    "heat": 1.0,
    "command_time": 1.0,
    "disturbance": 1.0,
    "disturbance_time": 0.7,
    "twin_time": 0.7,
    "common": 0.7,
    "common_time": 0.7,
    "jump": 0.7,
    "jump_mean": 0.5,
    "channel": 0.7,
    "channel_time": 0.7,
}

# The levels that may be below 0.
SIGNED_LEVELS = ("jump_mean",)

ABOVE_ZERO = "a number above 0"

# A level is found if recordings leave less than this part of the variance of its prior.
MAX_VARIANCE_FRACTION = 0.5

UNITS = {
    "reading": "K",
    "reading_time": "s",
    "heat": "W s^0.5",
    "command_time": "s",
    "disturbance": "W",
    "disturbance_time": "s",
    "room": "K s^-0.5",
    "twin": "1",
    "twin_time": "s",
    "slow": "1",
    "slow_time": "s",
    "common": "K",
    "common_time": "s",
    "jump": "K",
    "jump_mean": "K",
    "channel": "K",
    "channel_time": "s",
    "ambient": "K",
}


@final
class ProcessNoise(eqx.Module):
    """The noise that an observer assumes: of the rig, beyond its twin, and of its readings.

    `jaxtwin.estimate_noise` finds the levels from recordings. All are standard deviations, except
    `jump_mean`, a mean, and the correlation times `disturbance_time`, `twin_time`, `slow_time`,
    `common_time` and `channel_time`.

    **The rig**

    - `heat`: random heat into each side of the cells, white, W s^0.5; a heater has two sides, which
      are one node.
    - `command_time`: the error of the time at which a command takes effect, s. A change of the duty
      then leaves a heat of unknown size in the cells, the larger the larger the change.
    - `disturbance`: a heat into the node that each cell heats, W, which is forgotten within
      `disturbance_time`, s.
    - `room`: the random walk of the room temperature, K s^-0.5.
    - `twin`: the error of the twin's uncertain values, in standard deviations of the fit, which
      changes within `twin_time`, s, as the rig comes to other temperatures and duties.
    - `slow`: the error of the parameters that drift (`names`), relative, which changes within
      `slow_time`, s.

    **The readings**

    - `reading`: white noise of a reading, K.
    - `reading_time`: the error of the time of a reading, s: noise that grows with the slope.
    - `common`: the error that all channels share, K, forgotten within `common_time`, s.
    - `jump`: the jump of that error at a correction of the camera, K, of each part that fades by
      itself; without effect for a rig without a camera that corrects itself. `jump_mean`: its mean,
      of either sign, for a camera that corrects itself at equal intervals.
    - `channel`: the error of each channel by itself, K, which is forgotten within `channel_time`,
      s; without effect if there is a single channel.
    - `ambient`: white noise of a measured ambient temperature, K.

    `names` are the parameters that drift slowly beside the equations of the twin.
    `standard_errors` are those of the logarithms of the levels that were estimated, name -> error;
    `summary` prints them.
    """

    reading: Level = 0.1
    reading_time: Level = 0.03
    heat: Level = 0.3
    command_time: Level = 0.03
    disturbance: Level = 0.3
    disturbance_time: Level = 60.0
    room: Level = 0.003
    twin: Level = 1.0
    twin_time: Level = 3000.0
    slow: Level = 0.05
    slow_time: Level = 86_400.0
    common: Level = 0.2
    common_time: Level = 60.0
    jump: Level = 1.0
    jump_mean: Level = 0.0
    channel: Level = 0.1
    channel_time: Level = 300.0
    ambient: Level = 0.2
    names: tuple[str, ...] = eqx.field(static=True, default=())
    standard_errors: dict[str, float] = dataclasses.field(default_factory=dict)

    def check(self) -> None:
        """Checks the levels.

        **Raises:** `ObserverError` for a level that is not a number above 0, or not finite if it
        may be below 0.
        """
        for name, level in self.levels().items():
            if not _is_level(name, level):
                raise ObserverError(f"noise: {name}: expected {_expected(name)}, got {level:g}")

    def as_arrays(self) -> "ProcessNoise":
        """The same levels as arrays, which need no new compilation when they change."""
        arrays: dict[str, Any] = {name: jnp.asarray(lev) for name, lev in self.levels().items()}
        return ProcessNoise(**arrays, names=self.names)

    def levels(self) -> dict[str, float]:
        """Name -> level."""
        return {
            field.name: float(np.asarray(getattr(self, field.name)))
            for field in dataclasses.fields(self)
            if field.name not in ("names", "standard_errors")
        }

    def summary(self) -> str:
        """Returns a table of the levels with their standard errors and what the recordings say of
        each: `found`, or `assumed` if they say less than the prior."""
        lines = [f"{'level':18}{'value':>10}  {'unit':10}{'± %':>6}"]
        for name, level in self.levels().items():
            error = self.standard_errors.get(name)
            kind = "not estimated"
            if error is not None:
                share = 1 - (error / SPREADS[name]) ** 2
                if name in SIGNED_LEVELS:
                    error = error / abs(level) if level else None
                kind = (
                    "found"
                    if share > MAX_VARIANCE_FRACTION
                    else "assumed, the recordings do not show it"
                )
            percent = "" if error is None else f"{100 * error:.0f}"
            lines.append(f"{name:18}{level:10.3g}  {UNITS[name]:10}{percent:>6}  {kind}")
        if self.names:
            lines.append(f"drifting parameters: {', '.join(self.names)}")
        return "\n".join(lines)

    def to_toml(self) -> str:
        """The levels as TOML."""
        lines = [f"{name} = {level!r}" for name, level in self.levels().items()]
        names = ", ".join(f'"{name}"' for name in self.names)
        errors = [f"{name} = {error!r}" for name, error in self.standard_errors.items()]
        table = ["", "[standard_errors]", *errors] if errors else []
        return "\n".join([f"names = [{names}]", *lines, *table, ""])

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes the levels to a TOML file, which `load` reads.

        **Returns:** the file.
        """
        write_whole_file(path, self.to_toml().encode(), ObserverError)
        return Path(path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "ProcessNoise":
        """Reads the levels that `save` wrote; one that the file does not state keeps its default.

        **Raises:** `ObserverError` that names the file and the entry that is wrong.
        """
        source = path_of("ProcessNoise.load: path", path, ObserverError)
        try:
            text = source.read_text(encoding="utf-8-sig")
        except (OSError, ValueError) as error:
            raise ObserverError(f"{source}: expected levels of noise as TOML: {error}") from error
        return cls.from_toml(text, str(source))

    @classmethod
    def from_toml(cls, text: str, source: str) -> "ProcessNoise":
        """Reads the levels that `to_toml` gave; `source` is their name in messages.

        **Raises:** `ObserverError` that names the entry that is wrong.
        """
        try:
            entries = tomllib.loads(text)
        except ValueError as error:
            raise ObserverError(f"{source}: expected levels of noise as TOML: {error}") from error
        known = cls().levels()
        errors = entries.pop("standard_errors", {})
        if not isinstance(errors, dict):
            raise ObserverError(f"{source}: standard_errors: expected a table, got {errors!r}")
        for name, error in errors.items():
            where = f"standard_errors.{name}"
            if name not in SPREADS:
                raise ObserverError(f"{source}: {where}: expected levels of noise, got {error!r}")
            if not _is_number(error) or error <= 0:
                raise ObserverError(f"{source}: {where}: expected {ABOVE_ZERO}, got {error!r}")
        for name, entry in entries.items():
            if name in known:
                if not _is_number(entry) or not _is_level(name, entry):
                    raise ObserverError(
                        f"{source}: {name}: expected {_expected(name)}, got {entry!r}"
                    )
            elif name != "names":
                raise ObserverError(f"{source}: {name}: expected levels of noise, got {entry!r}")
            elif not (isinstance(entry, list) and all(isinstance(each, str) for each in entry)):
                raise ObserverError(
                    f"{source}: names: expected a list of parameters, got {entry!r}"
                )
        names = tuple(entries.pop("names", ()))
        levels = {name: float(level) for name, level in entries.items()}
        return cls(**levels, names=names, standard_errors=errors)


def _is_number(entry: object) -> TypeGuard[int | float]:
    return isinstance(entry, int | float) and not isinstance(entry, bool) and math.isfinite(entry)


def _is_level(name: str, level: int | float) -> bool:
    return math.isfinite(level) and (level > 0 or name in SIGNED_LEVELS)


def _expected(name: str) -> str:
    return "a finite number" if name in SIGNED_LEVELS else ABOVE_ZERO
