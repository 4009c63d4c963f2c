"""`jaxtwin refit`: the champion of a store refitted to new recordings, one after the other."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import JaxtwinError
from ._exit_codes import ALARMED, NOT_CONVERGED, REJECTED
from ._options import JsonOption, NoiseOption
from ._output import check_json, say, write_json
from ._show_progress import show_progress
from ._sources import open_store, say_notes

if TYPE_CHECKING:
    from ..refitting import Refit
    from ..twin_store import TwinStore

ENDINGS = (".mat", ".csv", ".nc", ".db")


def refit(
    store: Annotated[
        Path, typer.Argument(metavar="STORE", help="A store of twins with a champion, .db.")
    ],
    recordings: Annotated[
        Path,
        typer.Option(
            "--recordings", metavar="DIR", help="The folder of recordings; new ones are taken."
        ),
    ],
    forgetting: Annotated[
        float, typer.Option(min=0, help="The step between sessions, in the spread that they show.")
    ] = 1.0,
    changes: Annotated[
        int, typer.Option(min=0, help="Values that may have changed at once; after work, more.")
    ] = 1,
    window: Annotated[
        float | None, typer.Option(metavar="S", help="Only the end of each recording.")
    ] = None,
    noise: NoiseOption = None,
    calibration: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="What is healthy, as 'monitor --save' wrote it."),
    ] = None,
    controller: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The controller that runs on the twin, .toml."),
    ] = None,
    reference: Annotated[
        float | None,
        typer.Option(metavar="DEGC", help="Where its loop is judged; default: the mean reading."),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Refit the champion of a store to each new recording of a folder, in the order of their names.

    A gate promotes the new twin, keeps the last one, rejects the recording, or adds the new twin as
    challenger and asks. The store remembers which recordings it has judged.

    The exit code is 0 if all were promoted or left the twin unchanged, 3 if one was rejected or
    asks, 4 if a match did not converge, and 5 if a recording is an alarm, such as a frozen channel.
    """
    from ..control import read_controller
    from ..io import gap_sentences, read_recording
    from ..monitoring import MonitorCalibration
    from ..observers import ProcessNoise
    from ..refitting import keep_refit
    from ..refitting import refit as refitted

    check_json(json)
    if not recordings.is_dir():
        raise typer.BadParameter(f"--recordings {recordings}: expected a folder")
    twins = open_store(store)
    results: list[dict[str, Any]] = []
    code = 0
    with show_progress() as progress:
        progress.step("reading")
        champion = twins.version("champion")
        last = champion.fit()
        rig = last.twin.rig
        known = None if calibration is None else MonitorCalibration.load(calibration)
        levels = None if noise is None else ProcessNoise.load(noise)
        loop = None if controller is None else read_controller(controller, rig)
        judged = _judged(twins)
        for file in _files(recordings, store):
            name = file.name
            try:
                recording = read_recording(file, rig=rig)
                if recording.fingerprint[:12] in judged:
                    continue
                say_notes(file, recording)
                progress.step(f"refitting to {name}")
                result = refitted(
                    last,
                    recording,
                    window=window,
                    forgetting=forgetting,
                    changes=changes,
                    noise=champion.noise if levels is None else levels,
                    calibration=known,
                    controller=loop,
                    reference=reference,
                )
            except JaxtwinError as problem:
                # One recording that cannot be read or matched does not keep the others out.
                say(f"{name}: rejected: {problem}", json)
                results.append({"file": name, "decision": "rejected", "reason": str(problem)})
                code = max(code, REJECTED)
                continue
            champion = keep_refit(twins, champion, recording, result)
            if result.decision == "promoted":
                last = champion.fit()
            for sentence in gap_sentences(recording):
                say(sentence, json)
            say(f"{name}: {result.summary()}", json)
            results.append({"file": name, "champion": champion.number, **result.to_dict()})
            code = max(code, _code(result))
    if not results:
        say(f"{recordings}: no new recording; the champion is version {champion.number}", json)
    write_json(json, {"champion": champion.number, "recordings": results})
    if code:
        raise typer.Exit(code)


def _code(result: "Refit") -> int:
    if result.is_alarm:
        return ALARMED
    if not result.converged:
        return NOT_CONVERGED
    return 0 if result.decision in ("promoted", "unchanged") else REJECTED


def _judged(twins: "TwinStore") -> set[str]:
    """The beginnings of the fingerprints of all recordings that a version was matched to, or that
    one has judged."""
    from ..refitting import TAG

    judged: set[str] = set()
    for version in twins.versions:
        judged |= {digest[:12] for digest in version.recordings.values()}
        judged |= {key.removeprefix(f"{TAG} ") for key in version.tags if key.startswith(f"{TAG} ")}
    return judged


def _files(folder: Path, store: Path) -> list[Path]:
    """The recordings of a folder, in the order of their names."""
    return sorted(
        file
        for file in folder.iterdir()
        if file.suffix.lower() in ENDINGS and file.resolve() != store.resolve()
    )
