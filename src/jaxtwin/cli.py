"""The command line: `jaxtwin --help`.

Exit codes: 0 on success, and those of `commands/_exit_codes.py`. Errors of the package become one
line on standard error.
"""

import atexit
import gc
import inspect
import io
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer

from . import __version__
from .commands import (
    _backup,
    _conform,
    _control,
    _data,
    _dc_sweep,
    _demo,
    _design,
    _diagnose,
    _diff,
    _doctor,
    _drive,
    _estimate_noise,
    _export,
    _fleet,
    _health,
    _identify,
    _import_recording,
    _match,
    _monitor,
    _netlist,
    _new_rig,
    _observe,
    _prove,
    _record,
    _refit,
    _report,
    _retune,
    _rigs,
    _sensitivity,
    _serve,
    _simulate,
    _sweep,
    _twins,
    _validate,
    _virtual_rig,
    _warm_up,
    _watch,
)
from .commands._exit_codes import ALARMED, HEATS, STOPPED, TRIPPED, USAGE_ERROR
from .commands._output import printable
from .commands._signals import lasting_interrupt
from .commands._unblocked_output import unblocked_output
from .errors import JaxtwinError, SafetyStop

# Releases of typer contain click under different names.
UsageProblem: Any = typer.BadParameter.__mro__[1]

START = "Start here"
RIGS = "Rigs"
TWINS = "Twins"
LIVE = "A live rig"
MACHINE = "This machine"

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Each command has an example: [bold]jaxtwin match --help[/]",
)
data = typer.Typer(help="List or fetch recordings.")
twins = typer.Typer(help="Look at a store of twins, or change its champion.")


def _example(*lines: str) -> str:
    return "\n\n".join(["[dim]Example:[/]", *(f"[bold]  {line}[/]" for line in lines)])


def _text_of(function) -> str:
    # Each paragraph becomes one line, which the terminal wraps; typer would keep the line breaks of
    # the docstring.
    paragraphs = inspect.cleandoc(function.__doc__ or "").split("\n\n")
    return "\n\n".join(" ".join(paragraph.splitlines()) for paragraph in paragraphs)


def _add(name: str, panel: str, function, *example: str) -> None:
    text = _text_of(function)
    app.command(name, help=text, rich_help_panel=panel, epilog=_example(*example))(function)


_add("demo", START, _demo.demo, "jaxtwin demo --out report", "jaxtwin demo --live")
_add("rigs", RIGS, _rigs.rigs, "jaxtwin rigs")
_add("check", RIGS, _rigs.check, "jaxtwin check my-rig.toml")
_add(
    "new-rig",
    RIGS,
    _new_rig.new_rig,
    "jaxtwin new-rig bench.toml",
    'jaxtwin new-rig bench.toml --width "8 cm" --height "4 cm" --thickness "2 mm" '
    '--material aluminium --module TEC1-12706 --at "2 cm, 2 cm" --at "6 cm, 2 cm" --zones 3x2',
)
_add("schema", RIGS, _rigs.schema, "jaxtwin schema --out rig.schema.json")
_add(
    "netlist",
    RIGS,
    _netlist.netlist,
    "jaxtwin netlist paper-2024 --out netlist.png --spice paper-2024.cir",
)
_add("dc-sweep", RIGS, _dc_sweep.dc_sweep, "jaxtwin dc-sweep TEC1-12706 --out sweep")
_add(
    "import",
    TWINS,
    _import_recording.import_recording,
    "jaxtwin import box.csv --rig box.toml --column t2=T1 --column heater_on=duty_P1 "
    "--ignore '*' --out monday.csv",
)
_add(
    "simulate",
    TWINS,
    _simulate.simulate,
    "jaxtwin simulate paper-2024 --duty 0:0.5,500:0.78 --duration 1000 --out run.nc",
    "jaxtwin simulate paper-2024 --recording synthetic-A --parameters fit.toml --out run.csv",
)
_add(
    "identify",
    TWINS,
    _identify.identify,
    "jaxtwin identify log.csv --out oven.toml --fit fit.toml",
)
_add(
    "match",
    TWINS,
    _match.match,
    "jaxtwin match paper-2024 synthetic-A synthetic-B synthetic-C --set initial "
    "--per-recording T_amb --per-recording T_start --out fit.toml",
)
_add(
    "validate",
    TWINS,
    _validate.validate,
    "jaxtwin validate dual-cell monday.csv --parameters fit.toml --out validation",
    "jaxtwin validate dual-cell monday.csv tuesday.csv --split 500 --json split.json",
    "jaxtwin validate dual-cell monday.csv tuesday.csv --leave-one-out",
)
_add(
    "estimate-noise",
    TWINS,
    _estimate_noise.estimate_noise,
    "jaxtwin estimate-noise fit.toml monday.csv tuesday.csv --name R_E --out noise.toml",
)
_add(
    "report",
    TWINS,
    _report.report,
    "jaxtwin report fit.toml synthetic-A synthetic-B synthetic-C --out report --draws 10000",
)
_add(
    "monitor",
    TWINS,
    _monitor.monitor,
    "jaxtwin monitor fit.toml friday.csv --healthy monday.csv --healthy tuesday.csv "
    "--save healthy.toml",
    "jaxtwin monitor fit.toml friday.csv --calibration healthy.toml --json - --out pictures",
)
_add(
    "diagnose",
    TWINS,
    _diagnose.diagnose,
    "jaxtwin diagnose fit.toml friday.csv --noise noise.toml --healthy monday.csv --json -",
    "jaxtwin diagnose fit.toml friday.csv --fault 'loosen P1' --fault 'fail P1' --out pictures",
)
_add(
    "refit",
    TWINS,
    _refit.refit,
    "jaxtwin refit twins.db --recordings sessions",
    "jaxtwin refit twins.db --recordings sessions --controller pid.toml --json refit.json",
)
_add(
    "retune",
    TWINS,
    _retune.retune,
    "jaxtwin retune twins.db --controller pid.toml",
    "jaxtwin retune twins.db --json retune.json",
)
_add(
    "health",
    TWINS,
    _health.health,
    "jaxtwin health twins.db --limit R_E=2.6 --within 60",
    "jaxtwin health monday.toml tuesday.toml friday.toml --times 0,1,4 --out health.png",
)
_add("diff", TWINS, _diff.diff, "jaxtwin diff monday.toml tuesday.toml")
_add(
    "sensitivity",
    TWINS,
    _sensitivity.sensitivity,
    "jaxtwin sensitivity paper-2024 synthetic-A --parameters fit.toml --draws 10000 --out sens.nc",
    "jaxtwin sensitivity paper-2024 synthetic-A --method sobol --inputs bounds --out sobol.nc",
)
_add(
    "sweep",
    TWINS,
    _sweep.sweep,
    "jaxtwin sweep paper-2024 synthetic-A --parameters fit.toml --draws 10000000 --out sweep",
    "jaxtwin sweep paper-2024 --duty 0:0.5,500:0.78 --draws 1000000 --out sweep",
)
_add(
    "design",
    TWINS,
    _design.design,
    "jaxtwin design dual-cell monday.csv tuesday.csv --parameters fit.toml --out plan.csv",
    "jaxtwin design single-cell --duration 600 --bounds -0.5:0.8 --interest R_Th --out plan.csv",
    "jaxtwin design dual-cell --purpose diagnosis --fault 'weaken supply' --fault 'age P1' "
    "--parameters fit.toml --out test.csv",
)
_add(
    "virtual-rig",
    LIVE,
    _virtual_rig.virtual_rig,
    "jaxtwin virtual-rig dual-cell --speed 20",
    "jaxtwin virtual-rig dual-cell --pty --faults drop=0.01,jumps=164",
)
_add(
    "record",
    LIVE,
    _record.record,
    "jaxtwin record dual-cell --link socket://127.0.0.1:7000 --out session.db",
    "jaxtwin record my-rig.toml --link /dev/ttyACM0 --link socket://camera:7001 --out session.db",
)
_add(
    "drive",
    LIVE,
    _drive.drive,
    "jaxtwin drive dual-cell --link socket://127.0.0.1:7000 --duty 0:0.5,500:0.78 --duration 1000",
    "jaxtwin drive dual-cell --link socket://127.0.0.1:7000 --plan plan.csv --out session.db",
)
_add(
    "control",
    LIVE,
    _control.control,
    "jaxtwin control dual-cell --link socket://127.0.0.1:7000 --controller pid.toml "
    "--reference 0:35,600:45 --duration 1200 --out session.db",
)
_add(
    "observe",
    LIVE,
    _observe.observe,
    "jaxtwin observe dual-cell --link socket://127.0.0.1:7000",
    "jaxtwin observe session.db --noise noise.toml --speed 10",
)
_add(
    "watch",
    LIVE,
    _watch.watch,
    "jaxtwin watch dual-cell --link socket://127.0.0.1:7000",
    "jaxtwin watch session.db --speed 10",
)
_add(
    "serve",
    LIVE,
    _serve.serve,
    "jaxtwin serve dual-cell --link socket://127.0.0.1:7000 --out session.db",
    "jaxtwin serve dual-cell --virtual --speed 10 --allow-control",
    "jaxtwin serve dual-cell --replay session.db --speed 10",
    "jaxtwin serve dual-cell --link /dev/ttyACM0 --store twins.db --controller pid.toml "
    "--allow-control --self-optimise propose",
)
_add(
    "fleet",
    LIVE,
    _fleet.fleet,
    "jaxtwin fleet fleet.toml",
    "jaxtwin fleet fleet.toml --virtual --faults oven-1:loosen=P1@600/4",
)
_add(
    "conform",
    LIVE,
    _conform.conform,
    "jaxtwin conform dual-cell --link /dev/ttyACM0",
)
_add(
    "prove",
    LIVE,
    _prove.prove,
    "jaxtwin prove my-rig.toml --link /dev/ttyACM0 --out proof.db",
)
_add("backup", LIVE, _backup.backup, "jaxtwin backup session.db copy.db")
_add("export", LIVE, _export.export, "jaxtwin export session.db run.nc --start 10 --end 1000")
app.add_typer(twins, name="twins", rich_help_panel=TWINS)
for _name, _function, _line in (
    ("list", _twins.list_versions, "jaxtwin twins list twins.db"),
    ("show", _twins.show, "jaxtwin twins show twins.db champion"),
    ("diff", _twins.diff, "jaxtwin twins diff twins.db previous champion"),
    ("add", _twins.add, "jaxtwin twins add twins.db fit.toml --noise noise.toml"),
    ("promote", _twins.promote, 'jaxtwin twins promote twins.db --reason "it was remounted"'),
    ("rollback", _twins.rollback, 'jaxtwin twins rollback twins.db --reason "the loop swings"'),
):
    twins.command(_name, help=_text_of(_function), epilog=_example(_line))(_function)
app.add_typer(data, name="data", rich_help_panel=MACHINE)
data.command("list", epilog=_example("jaxtwin data list"))(_data.list_recordings)
data.command("fetch", epilog=_example("jaxtwin data fetch --to recordings"))(_data.fetch)
_add("doctor", MACHINE, _doctor.doctor, "jaxtwin doctor")
_add(
    "warm-up",
    MACHINE,
    _warm_up.warm_up,
    "jaxtwin warm-up paper-2024",
    "jaxtwin warm-up dual-cell monday.csv tuesday.csv",
)


def _show_version(wanted: bool) -> bool:
    if wanted:
        print(f"jaxtwin {__version__}")
        raise typer.Exit
    return wanted


@app.callback()
def _jaxtwin(
    version: Annotated[
        bool,
        typer.Option(
            "--version", is_eager=True, callback=_show_version, help="Show the version and exit."
        ),
    ] = False,
) -> None:
    """Digital twins of thermoelectric rigs: simulate, match, validate, analyse, record, control."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command line and exits.

    **Arguments:**

    - `arguments`: the arguments without the program's name; by default those of the process.
    """
    # JAX makes hundreds of thousands of objects that live as long as the process. Python searches
    # them for reference cycles while they are made, and again at its end, for up to a second.
    gc.set_threshold(20_000)
    atexit.register(gc.freeze)
    sys.exit(run(arguments))


def run(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line.

    **Arguments:**

    - `arguments`: the arguments without the program's name; by default those of the process.

    **Returns:** the exit code.
    """
    words = [_at_home(word) for word in (sys.argv[1:] if arguments is None else arguments)]
    if words in ([], ["data"], ["twins"]):
        words.append("--help")
    # A shell may close them (`>&-`), and Windows may have none.
    sys.stdout = sys.stdout or Path(os.devnull).open("w")  # noqa: SIM115 (until the process ends)
    sys.stderr = sys.stderr or Path(os.devnull).open("w")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        # A name that cannot be written in the encoding of a pipe must not end a command.
        if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
            stream.reconfigure(errors="backslashreplace")
    try:
        # Newer releases of typer return an exit code where older ones raise.
        with lasting_interrupt():
            code = app(words, prog_name="jaxtwin", standalone_mode=False)
            if code == STOPPED:
                raise KeyboardInterrupt
        sys.stdout.flush()
        if isinstance(code, int):
            return code
    except SafetyStop as error:
        codes = {"stopped": STOPPED, "still-on": ALARMED, "alarm": ALARMED, "heats": HEATS}
        return _fail(str(error), codes.get(error.kind, TRIPPED))
    except JaxtwinError as error:
        return _fail(str(error))
    except UsageProblem as error:
        command = context.command_path if (context := getattr(error, "ctx", None)) else "jaxtwin"
        message = error.format_message().removeprefix("Invalid value: ").rstrip(".")
        return _fail(f"{message} (see '{command} --help')")
    except (KeyboardInterrupt, typer.Abort):
        return _fail("stopped", STOPPED)
    except (SystemExit, OSError) as error:
        # typer turns a broken pipe into an exit.
        problem = error.__context__ if isinstance(error, SystemExit) else error
        if not isinstance(problem, OSError) or problem.filename is not None:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(problem, BrokenPipeError):
            return _fail(f"standard output: {problem.strerror}")
        # The reader closed the pipe, as `head` does, which is not an error.
    return 0


def _at_home(word: str) -> str:
    """Replaces `~` by the home folder, because shells do not replace it after `--out=`."""
    option, equals, value = word.partition("=") if word.startswith("--") else ("", "", word)
    if not value.startswith("~"):
        return word
    with suppress(RuntimeError):  # a user of that name is not known
        value = str(Path(value).expanduser())
    return f"{option}{equals}{value}"


def _fail(message: str, code: int = USAGE_ERROR) -> int:
    with unblocked_output():  # the exit code must come, whether or not anybody reads this
        print(f"jaxtwin: {printable(' '.join(message.split()))}", file=sys.stderr)
    return code


if __name__ == "__main__":
    main()
