"""Opens the inputs of commands: a twin with its values, and recordings."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from ._output import printable

if TYPE_CHECKING:
    from ..io import Experiment
    from ..live import Draws
    from ..matching import Fit
    from ..physics import Twin
    from ..rig import Rig
    from ..twin_store import TwinStore

# The number of glitches of a recording that are named.
SHOWN_GLITCHES = 3


def open_twin(
    rig: "Rig", set_name: str | None, parameter_file: Path | None, recording: str | None = None
) -> "Twin":
    """The twin of a rig, with the values of a parameter set, and of a parameter file that overrides
    them.

    **Arguments:**

    - `rig`: the rig.
    - `set_name`: a parameter set of the rig, or None.
    - `parameter_file`: a parameter file, or None.
    - `recording`: the recording whose own values are used, if the file has some.

    **Raises:** `ParameterError` for an unknown set or a file that does not fit the rig.
    """
    from .._name_suggestions import did_you_mean
    from ..errors import ParameterError
    from ..physics import Twin
    from ..rig import read_parameters

    values: dict[str, float] = {}
    if set_name is not None:
        if set_name not in rig.parameter_sets:
            known = ", ".join(rig.parameter_sets) or "none"
            raise ParameterError(
                f"{rig.source}: parameter set: expected one of {known}, got {set_name!r}"
                f"{did_you_mean([set_name], rig.parameter_sets)}"
            )
        values |= rig.parameter_sets[set_name]
    if parameter_file is not None:
        values |= read_parameters(parameter_file, rig, recording)
    return Twin(rig, values)


def label_of(parameter_file: Path | None) -> str:
    """What a twin with the values of a parameter file, or of the rig file, is called."""
    return f"values of {parameter_file.name}" if parameter_file else "values of the rig file"


def open_fit(rig: "Rig", parameter_file: Path | None) -> "Fit | None":
    """The fit in a parameter file; None if the file holds only values, or there is no file.

    **Raises:** `ParameterError` for a file that cannot be read or a fit of another rig.
    """
    from ..errors import ParameterError
    from ..rig import read_toml

    if parameter_file is None:
        return None
    data, _ = read_toml(parameter_file, ParameterError)
    if not isinstance(data.get("fit"), dict):
        return None
    from ..matching import Fit

    return Fit.load(parameter_file, rig=rig)


def open_draws(rig: "Rig", parameter_file: Path | None) -> "Draws | None":
    """Draws of what the fit in a parameter file does not know, for the interlocks of a rig; None if
    there is no fit.

    **Raises:** `ParameterError` for a file that cannot be read or a fit of another rig.
    """
    fit = open_fit(rig, parameter_file)
    return None if fit is None else draws_of(fit)


def draws_of(fit: "Fit") -> "Draws":
    """Draws of what a fit does not know, for the interlocks of a rig."""
    from ..live import DRAWS
    from ..matching import posterior_draws

    return posterior_draws(fit, DRAWS)


def open_twins(
    rig: "Rig",
    set_name: str | None,
    parameter_file: Path | None,
    experiments: "Sequence[Experiment]",
) -> "Fit | list[Twin]":
    """The fit in a parameter file, which has a twin for each experiment; otherwise a list of twins
    with the values that the file has for the recording of that name.

    **Raises:** the errors of `open_twin` and `open_fit`.
    """
    fit = open_fit(rig, parameter_file)
    if fit is not None:
        return fit
    return [
        open_twin(rig, set_name, parameter_file, experiment.name or None)
        for experiment in experiments
    ]


def open_recordings(rig: "Rig", names: Sequence[str]) -> "list[Experiment]":
    """Reads recordings of a rig, and says what was done to them.

    **Arguments:**

    - `rig`: the rig, whose driver determines the meaning of PWM counts.
    - `names`: files, or names that `jaxtwin data list` lists.

    **Raises:** `RecordingError` for the first recording that is not found or cannot be read.
    """
    from ..io import read_recording

    experiments = []
    for name in names:
        file = find_recording(name)
        experiments.append(read_recording(file, rig=rig))
        say_notes(file, experiments[-1])
    return experiments


def say_notes(file: Path, experiment: "Experiment") -> None:
    """Prints on standard error what was done to a recording that its numbers do not show, such as
    readings that are codes and count as missing; and its glitches, which count."""
    notes = [*experiment.notes]
    if glitches := experiment.glitches:
        more = f", and {len(glitches) - SHOWN_GLITCHES} more" * (len(glitches) > SHOWN_GLITCHES)
        shown = "; ".join(str(glitch) for glitch in glitches[:SHOWN_GLITCHES])
        notes.append(f"{shown}{more}; it counts unless it is left out (import --mask-glitches)")
    for note in notes:
        print(printable(f"{file.name}: {note}"), file=sys.stderr)


def open_continuous(rig: "Rig", names: Sequence[str]) -> "tuple[list[Experiment], list[str]]":
    """Reads recordings that an observer follows, each from its start: divided at gaps over which
    the duty cannot be held.

    **Returns:** the recordings, and what is assumed of their gaps, in sentences.

    **Raises:** the errors of `open_recordings`; `RecordingError` for a single sample between such
    gaps.
    """
    from ..io import gap_sentences, separate_recordings

    given = open_recordings(rig, names)
    parts = [part for experiment in given for part in separate_recordings(experiment)]
    return parts, [sentence for experiment in given for sentence in gap_sentences(experiment)]


def find_recording(name: str) -> Path:
    """The path of a file, of a synthetic recording given by its name, or of a published one.

    **Raises:** `RecordingError` if it is none of these.
    """
    from ..data import synthetic_recordings
    from ..errors import RecordingError
    from ..io import SINGLE_CELL, TWO_CELL, find_recordings

    path = Path(name)
    if path.is_file():
        return path
    known = {file.stem: file for file in synthetic_recordings()}
    if name in known:
        return known[name]
    published = {
        Path(published_file.name).stem: published_file.name
        for published_file in TWO_CELL + SINGLE_CELL
    }
    if path.parent == Path() and path.stem in published and path.suffix in ("", ".mat"):
        return find_recordings(names=[published[path.stem]])[0]
    raise RecordingError(
        f"{name}: expected a file or a known recording, got neither; 'jaxtwin data list' lists the "
        "known ones"
    )


def open_store(path: Path) -> "TwinStore":
    """A store of twins that is there.

    **Raises:** `typer.BadParameter` for a file that is not; `StoreError` for one that is no store.
    """
    from ..twin_store import TwinStore

    if not path.is_file():
        raise typer.BadParameter(
            f"{path}: there is no such store; 'jaxtwin twins add' makes one from a fit"
        )
    return TwinStore(path)
