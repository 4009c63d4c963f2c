"""What a twin does not know of its rig: the random heat, drifts and errors of readings that an
observer assumes."""

import dataclasses
import math
import os
import tomllib
from pathlib import Path
from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from .._arguments import path_of
from .._errors import ObserverError
from .._whole_file import write_whole_file

Level = Float[ArrayLike, ""]


@final
class ProcessNoise(eqx.Module):
    """The noise that an observer assumes: of the rig, beyond its twin, and of its readings.

    `jaxtwin.estimate_noise` finds the levels from recordings. All are standard deviations.

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
    - `jump`: the jump of that error at a correction of the camera, K; without effect for a rig
      without a camera that corrects itself.
    - `channel`: the error of each channel by itself, K, which is forgotten within `channel_time`,
      s; without effect if there is a single channel.
    - `ambient`: white noise of a measured ambient temperature, K.

    `names` are the parameters that drift slowly beside the equations of the twin.
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
    slow_time: Level = 3600.0
    common: Level = 0.2
    common_time: Level = 60.0
    jump: Level = 1.0
    channel: Level = 0.1
    channel_time: Level = 300.0
    ambient: Level = 0.2
    names: tuple[str, ...] = eqx.field(static=True, default=())

    def check(self) -> None:
        """Checks the levels.

        **Raises:** `ObserverError` for a level that is not a number above 0.
        """
        for name, level in self.levels().items():
            if not (math.isfinite(level) and level > 0):
                raise ObserverError(f"noise: {name}: expected a number above 0, got {level:g}")

    def as_arrays(self) -> "ProcessNoise":
        """The same levels as arrays, which need no new compilation when they change."""
        arrays = {name: jnp.asarray(level) for name, level in self.levels().items()}
        return ProcessNoise(**arrays, names=self.names)

    def levels(self) -> dict[str, float]:
        """Name -> level."""
        return {
            field.name: float(np.asarray(getattr(self, field.name)))
            for field in dataclasses.fields(self)
            if field.name != "names"
        }

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes the levels to a TOML file, which `load` reads.

        **Returns:** the file.
        """
        lines = [f"{name} = {level!r}" for name, level in self.levels().items()]
        names = ", ".join(f'"{name}"' for name in self.names)
        text = "\n".join([f"names = [{names}]", *lines, ""])
        write_whole_file(path, text.encode(), ObserverError)
        return Path(path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "ProcessNoise":
        """Reads the levels that `save` wrote; one that the file does not state keeps its default.

        **Raises:** `ObserverError` that names the file and the entry that is wrong.
        """
        source = path_of("ProcessNoise.load: path", path, ObserverError)
        try:
            entries = tomllib.loads(source.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ObserverError(f"{source}: expected levels of noise as TOML: {error}") from error
        known = cls().levels()
        for name, entry in entries.items():
            if name == "names":
                good = isinstance(entry, list) and all(isinstance(one, str) for one in entry)
                allowed = "a list of parameters"
            else:
                good = name in known and isinstance(entry, int | float) and 0 < entry < math.inf
                good = good and not isinstance(entry, bool)
                allowed = "a number above 0" if name in known else "levels of noise"
            if not good:
                raise ObserverError(f"{source}: {name}: expected {allowed}, got {entry!r}")
        names = tuple(entries.pop("names", ()))
        return cls(**{name: float(level) for name, level in entries.items()}, names=names)
