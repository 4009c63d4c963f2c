"""`jaxtwin record`: a live rig into a file."""

import contextlib
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from ._options import BaudOption, JsonOption, LinkOption, RigArgument
from ._output import check_json, check_output, say, write_json
from ._show_progress import show_progress
from ._signals import stop_signals


def record(
    rig: RigArgument,
    link: LinkOption,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="The recording, .db.")],
    append: Annotated[bool, typer.Option("--append", help="Go on with a recording.")] = False,
    frames: Annotated[bool, typer.Option("--frames", help="Keep camera frames too.")] = False,
    duration: Annotated[
        float | None, typer.Option(min=0, metavar="S", help="Until then, not until Ctrl-C.")
    ] = None,
    publish: Annotated[
        str | None, typer.Option(metavar="URL", help="mqtt://HOST/TOPIC: readings as JSON.")
    ] = None,
    baud: BaudOption = 115_200,
    json: JsonOption = None,
) -> None:
    """Record a live rig until Ctrl-C."""
    from ..io import Session
    from ..live import Recorder, connect, opener, report
    from ..rig import load_rig

    check_output(out, ".db")
    check_json(json)
    with stop_signals() as stop, show_progress() as progress, contextlib.ExitStack() as stack:
        loaded = load_rig(rig)
        for url in link:  # what cannot be a link is refused before there is a file
            opener(url, baud=baud)
        publisher = None
        if publish is not None:
            from ..live import Publisher

            names = [channel.name for channel in loaded.channels]
            publisher = Publisher(publish, names, [cell.name for cell in loaded.cells])
            stack.callback(publisher.close)
        recorder = stack.enter_context(Recorder(out, loaded, append=append, keep_frames=frames))
        bench = stack.enter_context(connect(loaded, *link, journal=recorder, baud=baud))
        progress.step(f"recording into {out} until Ctrl-C")
        begin = time.monotonic()
        while not stop.is_set() and (duration is None or time.monotonic() - begin < duration):
            records = bench.poll()
            if publisher is not None:
                publisher.publish(records)
            states = " and ".join(bench.states.values())
            progress.update(f"{recorder.written} records, link {states}")
    with Session(out) as session:
        content = report(session)
    say(_table(out, content), json)
    write_json(json, content)


def _table(file: Path, content: dict[str, Any]) -> str:
    lines = [f"{file}: {content['rig']}"]
    lines += [
        "  {stream} from {link}: {count}, every {period:.3g} s, longest step {longest:.3g} s, "
        "clock {drift:+.0f} ppm, late by {wait_99:.2g} s (99 %)".format(**stream)
        for stream in content["streams"]
    ]
    lines += [f"  lost: {count} of {stream}" for stream, count in content["lost"].items()]
    lines += [f"  {kind}: {count}" for kind, count in content["events"].items()]
    return "\n".join(lines)
