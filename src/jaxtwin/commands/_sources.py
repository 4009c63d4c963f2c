"""What commands start from: a twin with its values, and recordings."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..io import Experiment
    from ..physics import Twin
    from ..rig import Rig


def open_twin(
    rig: "Rig", set_name: str | None, parameters: Path | None, recording: str | None = None
) -> "Twin":
    """The twin of a rig, with the values of a parameter set and, over them, of a parameter file.

    **Arguments:**

    - `rig`: of which one.
    - `set_name`: a parameter set of the rig, or None.
    - `parameters`: a parameter file, or None.
    - `recording`: whose own values to take where the file has some.

    **Raises:** `ParameterError` for an unknown set or a file that does not fit the rig.
    """
    from .._errors import ParameterError
    from ..physics import Twin
    from ..rig import read_parameters

    values: dict[str, float] = {}
    if set_name is not None:
        if set_name not in rig.parameter_sets:
            allowed = ", ".join(rig.parameter_sets) or "none"
            raise ParameterError(
                f"{rig.source}: found no parameter set {set_name!r}, there are: {allowed}"
            )
        values |= rig.parameter_sets[set_name]
    if parameters is not None:
        values |= read_parameters(parameters, rig, recording)
    return Twin(rig, values)


def open_twins(
    rig: "Rig", set_name: str | None, parameters: Path | None, experiments: "Sequence[Experiment]"
) -> "list[Twin]":
    """The twin of each experiment, with its own values where the parameter file has some.

    Of a recording whose name the file does not have they are estimated from its first minute, as
    `jaxtwin.validate` does; a drive without recorded temperatures gets the file's shared values.

    **Raises:** as `open_twin`; `MatchError` where a recording is too short for that.
    """
    from ..matching import estimate_initial_conditions
    from ..rig._parameter_file import recording_parameters

    known = {} if parameters is None else recording_parameters(parameters)
    own = list(dict.fromkeys(name for names in known.values() for name in names))
    twins = []
    for one in experiments:
        twin = open_twin(rig, set_name, parameters, one.name or None)
        if own and one.name not in known and one.temperatures is not None:
            twin = estimate_initial_conditions(twin, one, own=own).twin
        twins.append(twin)
    return twins


def open_recordings(rig: "Rig", names: Sequence[str]) -> "list[Experiment]":
    """Reads recordings of a rig.

    **Arguments:**

    - `rig`: its driver says how PWM counts are meant.
    - `names`: files, or what `jaxtwin data list` lists.

    **Raises:** `RecordingError` for the first that is not found or cannot be read.
    """
    from ..io import read_recording

    driver = rig.driver
    return [
        read_recording(find_recording(name), counts=driver.counts, polarity=driver.polarity)
        for name in names
    ]


def find_recording(name: str) -> Path:
    """A file, a synthetic recording by its name, or a published one wherever it lies.

    **Raises:** `RecordingError` where it is none of them.
    """
    from .._errors import RecordingError
    from ..data import synthetic_recordings
    from ..io import SINGLE_CELL, TWO_CELL, find_recordings

    path = Path(name)
    if path.is_file():
        return path
    known = {file.stem: file for file in synthetic_recordings()}
    if name in known:
        return known[name]
    published = {Path(one.name).stem: one.name for one in TWO_CELL + SINGLE_CELL}
    if path.parent == Path() and path.stem in published and path.suffix in ("", ".mat"):
        return find_recordings(names=[published[path.stem]])[0]
    raise RecordingError(
        f"{name}: no such file, and no known recording ('jaxtwin data list' lists them)"
    )
