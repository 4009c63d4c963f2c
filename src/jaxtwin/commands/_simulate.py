"""`jaxtwin simulate`: one run of a rig."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._display import aligned
from ._options import JsonOption, ParameterFileOption, RigArgument, SetOption
from ._output import check_json, check_output, say, say_written, write_json
from ._show_progress import show_progress
from ._sources import open_fit, open_recordings, open_twin

if TYPE_CHECKING:
    from ..io import Experiment
    from ..matching import Fit
    from ..physics import Twin
    from ..rig import Rig
    from ..simulation import Run


def simulate(
    rig: RigArgument,
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="Where to: .nc (everything) or .csv.")
    ],
    recording: Annotated[
        str | None,
        typer.Option(metavar="RECORDING", help="Drive it as in a recording, and compare."),
    ] = None,
    duty: Annotated[
        str | None,
        typer.Option(
            metavar="SCHEDULE",
            help="Duty cycles from given times on, s: 0:0.5,500:0.78; for each cell: 0:0.5/0.3.",
        ),
    ] = None,
    duration: Annotated[float, typer.Option(metavar="S", help="Of the schedule.")] = 1000.0,
    parameter_file: ParameterFileOption = None,
    set_name: SetOption = None,
    json: JsonOption = None,
) -> None:
    """Simulate a rig, driven by a schedule or as in a recording."""
    from ..rig import load_rig

    if (recording is None) == (duty is None):
        raise typer.BadParameter("give either --recording or --duty")
    check_output(out, ".nc", ".csv")
    check_json(json)
    with show_progress() as progress:
        progress.step(f"reading {rig}")
        loaded = load_rig(rig)
        experiment = _experiment(loaded, recording, duty, duration)
        fit = open_fit(loaded, parameter_file)
        if fit is None:
            twin = open_twin(loaded, set_name, parameter_file, experiment.name or None)
        else:
            twin = fit.twin_for(experiment)
        progress.step(f"simulating {experiment.duration:g} s")
        began = time.perf_counter()
        run = twin.simulate(experiment)
        numbers = _numbers(run, time.perf_counter() - began)
        progress.step(f"writing {out}")
        run.save(out)
    table = _table(run, numbers)
    if fit is not None:
        numbers["own_values"], text = _own_values(fit, twin, experiment)
        table += f"\n{text}" * bool(text)
    say(table, json)
    say_written(out, json_path=json)
    write_json(json, numbers)


def _experiment(
    rig: "Rig", recording: str | None, duty: str | None, duration: float
) -> "Experiment":
    from ..io import Experiment

    if recording is not None:
        return open_recordings(rig, [recording])[0]
    return Experiment.schedule(duty or "", duration=duration, cells=len(rig.driven))


def _own_values(fit: "Fit", twin: "Twin", experiment: "Experiment") -> tuple[dict[str, float], str]:
    """The values of a run that belong to its recording, not to the rig, and their source."""
    names = next(iter(fit.recording_values.values()))
    values = {name: float(twin.values[name]) for name in names}
    if experiment.fingerprint in fit.fingerprints:
        matched = fit.recordings[fit.fingerprints.index(experiment.fingerprint)]
        source = f"as matched for {matched}"
    elif experiment.temperatures is None:
        source = f"means of {', '.join(fit.recordings)}"
    else:
        source = "estimated from the first minute of the recording, which was not matched"
    text = ", ".join(f"{name} = {value:.4g}" for name, value in values.items())
    return values, f"{text}: {source}" if values else ""


def _numbers(run: "Run", wall_time: float) -> dict[str, Any]:
    numbers: dict[str, Any] = {
        "rig": run.rig,
        "wall_time_s": wall_time,
        "final_degC": dict(zip(run.channels, run.temperatures[-1].tolist(), strict=True)),
    }
    if run.experiment.temperatures is not None:
        from .._statistics import mean_fit_percent

        numbers["rmse_K"] = run.rmse
        numbers["mean_fit_percent"] = mean_fit_percent(run.fit_percent.values())
        numbers["fit_percent"] = run.fit_percent
    numbers["beyond_limits"] = list(run.beyond_limits)
    return numbers


def _table(run: "Run", numbers: dict[str, Any]) -> str:
    from .._statistics import fit_text
    from ..io import gap_sentences

    fits = numbers.get("fit_percent")
    head = ["channel", f"degC at {run.time[-1]:g} s"] + (["fit, %"] if fits else [])
    rows = [head]
    for channel, final in numbers["final_degC"].items():
        rows.append([channel, f"{final:.2f}"] + ([fit_text(fits[channel])] if fits else []))
    text = aligned(rows)
    if fits:
        mean = fit_text(numbers["mean_fit_percent"], " %")
        text += f"\nmean fit {mean}, RMSE {numbers['rmse_K']:.2f} K"
    gaps = gap_sentences(run.experiment)
    return "\n".join([text, *gaps, *(f"warning: {beyond}" for beyond in run.beyond_limits)])
