"""`jaxtwin sensitivity`: which parameters matter."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ._options import (
    JsonOption,
    ParametersOption,
    RecordingsArgument,
    RigArgument,
    SeedOption,
    SetOption,
)
from ._output import aligned, check_json, check_output, say, write_json
from ._show_progress import show_progress
from ._sources import open_recordings, open_twins

if TYPE_CHECKING:
    from ..sensitivity_analysis import Sensitivity


def sensitivity(
    rig: RigArgument,
    recordings: RecordingsArgument,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="Draws, costs, indices: .nc.")],
    draws: Annotated[int, typer.Option(min=3, help="How many; the paper takes 50.")] = 50,
    spread: Annotated[
        float, typer.Option(help="Standard deviation as a part of each value.")
    ] = 0.25,
    seed: SeedOption = 0,
    parameters: ParametersOption = None,
    set_name: SetOption = None,
    json: JsonOption = None,
) -> None:
    """Draw parameters around their values and correlate them with each channel's cost."""
    check_output(out, ".nc")
    check_json(json)
    with show_progress() as progress:
        progress.step("reading")
        from .. import sensitivity as analysis  # which takes a second
        from ..rig import load_rig

        loaded = load_rig(rig)
        experiments = open_recordings(loaded, recordings)
        twins = open_twins(loaded, set_name, parameters, experiments)
        done, total = 0, draws * len(experiments)

        def report(finished: int) -> None:
            nonlocal done
            done += finished
            progress.update(f"{done} of {total} simulations")

        progress.step(f"{draws} draws on {len(experiments)} recordings")
        result = analysis(
            twins, experiments, draws=draws, spread=spread, seed=seed, on_progress=report
        )
        progress.step(f"writing {out}")
        result.save(out)
    say(_table(result), json)
    write_json(json, result.to_dict())


def _table(result: "Sensitivity") -> str:
    table = result.to_dataframe().loc["mean"]
    rows = [("parameter", "correlation", "95 % interval", "rank correlation", "95 % interval")]
    for name in result.ranking():
        row = table.loc[name]
        rows.append(
            (
                name,
                f"{row.correlation:+.3f}",
                f"{row.lower:+.3f} ... {row.upper:+.3f}",
                f"{row.rank_correlation:+.3f}",
                f"{row.rank_lower:+.3f} ... {row.rank_upper:+.3f}",
            )
        )
    failed = int(result.failed.sum())
    tail = f"\n{failed} of {len(result.failed)} draws failed and do not count" if failed else ""
    return f"correlation with the mean cost of all channels\n{aligned(rows)}{tail}"
