"""`jaxtwin warm-up`: compiles programs beforehand and keeps them."""

from typing import TYPE_CHECKING, Annotated

import typer

from ._options import JsonOption, RigArgument
from ._output import check_json, say, write_json
from ._show_progress import show_progress
from ._sources import open_recordings

if TYPE_CHECKING:
    from ..io import Experiment
    from ..physics import Twin

# The schedule of the run that replaces a missing recording: the two steps of the paper.
SCHEDULE = "0:0.5,500:0.78"

DURATION = 1000.0  # s

# The noise of the readings of this run, K: that of a camera.
NOISE = 0.1

# The number of iterations of the match, after which each of its programs has run.
ITERATIONS = 3


def warm_up(
    rig: RigArgument,
    recordings: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="RECORDING",
            help="Recordings of the length and number that are to be matched; by default a run of "
            "1000 s.",
        ),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Compile what simulate, match and validate run for a rig, and keep it."""
    from .._compilation import cache_state
    from ..errors import JaxtwinError

    check_json(json)
    before = cache_state()
    if before.folder is None:
        raise JaxtwinError(f"compiled programs are not kept: {before.reason}")
    with show_progress() as progress:
        progress.step(f"reading {rig}")
        from ..matching import match
        from ..physics import Twin
        from ..rig import load_rig
        from ..validation import validate

        twin = Twin(load_rig(rig))
        progress.step("simulating")
        experiments = (
            open_recordings(twin.rig, recordings) if recordings else [_made_recording(twin)]
        )
        twin.simulate(experiments[0])
        progress.step("matching")
        fit = match(twin, experiments, max_iterations=ITERATIONS)
        progress.step("validating")
        validate(fit, experiments[0])
    after = cache_state()
    new = after.files - before.files
    say(
        f"{twin.rig.name}: {new} new programs, {after.files} in all, {after.size / 2**20:.1f} MiB "
        f"in {after.folder}",
        json,
    )
    write_json(json, {"new": new, "programs": after.files, "bytes": after.size})


def _made_recording(twin: "Twin") -> "Experiment":
    """A run of the rig with noise, in place of a recording."""
    import numpy as np

    from ..io import Experiment

    run = twin.simulate(SCHEDULE, duration=DURATION)
    noise = NOISE * np.random.default_rng(0).standard_normal(run.temperatures.shape)
    return Experiment(
        run.time,
        run.experiment.duty,
        cells=run.experiment.cells,
        channels=run.channels,
        temperatures=np.asarray(run.temperatures) + noise,
    )
