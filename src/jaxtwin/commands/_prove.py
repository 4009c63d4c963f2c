"""`jaxtwin prove`: does each interlock switch the heater off?"""

from collections.abc import Mapping
from functools import partial
from math import isnan
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ._exit_codes import FOUND_ERROR
from ._live_run import Run, run_on_live_rig
from ._options import (
    AlarmOption,
    AmbientOption,
    BaudOption,
    DatabaseOption,
    LinkOption,
    OperatorOption,
    ParameterFileOption,
    ResetOption,
    RigArgument,
    SetOption,
    SilenceOption,
)
from ._output import say

if TYPE_CHECKING:
    from ..live import Proof, RigConnection
    from ..physics import Twin


def prove(
    rig: RigArgument,
    link: LinkOption,
    duty: Annotated[
        float, typer.Option(metavar="D", help="Of each cell while it is heated, above 0 to 1.")
    ] = 0.3,
    out: DatabaseOption = None,
    silence: SilenceOption = 3.0,
    ambient: AmbientOption = None,
    reset: ResetOption = False,
    alarm: AlarmOption = None,
    operator: OperatorOption = None,
    parameter_file: ParameterFileOption = None,
    set_name: SetOption = None,
    baud: BaudOption = 115_200,
) -> None:
    """Prove that each interlock switches a live rig off: heat it for seconds, provoke them in turn.

    After each stop the device must report that the cells are off, a trip, and that the relay of the
    rig file is open; it must stay so, and refuse a duty until a reset. It is left tripped.

    The exit code is 0 if all steps were proven, 1 if one was not, 3 if the rig does not start or a
    signal such as SIGTERM ended it, 5 if the device reported heat after a stop, 6 if the readings
    after the last step show that the rig heats (cut the power), 130 after Ctrl-C.
    """
    proofs: list[Proof] = []

    def prepare(twin: "Twin", *_: object) -> tuple[Run, Mapping[str, Any]]:
        from ..live import interlocks_of

        # This compiles before the rig is connected, because nothing would read what it sends.
        interlocks_of(twin, silence=silence, ambient=ambient)
        given = {"duty": duty, "silence": silence, "ambient": ambient}
        return partial(_prove, twin=twin, proofs=proofs, **given), {}

    try:
        run_on_live_rig(
            prepare,
            doing="proving",
            duration=None,
            rig=rig,
            link=link,
            out=out,
            reset=reset,
            alarm=alarm,
            operator=operator,
            parameter_file=parameter_file,
            set_name=set_name,
            baud=baud,
        )
    finally:
        for proof in proofs:
            say(_row(proof))
    if any(proof.wrong for proof in proofs):
        raise typer.Exit(FOUND_ERROR)


def _prove(
    connection: "RigConnection", *, proofs: "list[Proof]", **options: Any
) -> Literal["completed", "stopped"]:
    """Collects the proofs.

    **Raises:** `SafetyStop` if the device reported heat after a stop.
    """
    from ..errors import SafetyStop
    from ..live import prove as run

    for proof in run(connection, **options):
        proofs.append(proof)
        if proof.kind in ("still-on", "heats"):
            raise SafetyStop(proof.wrong, proof.kind)
    return "completed"


def _row(proof: "Proof") -> str:
    verdict = "WRONG" if proof.wrong else "ok   "
    off = "" if isnan(proof.off_after) else f"off after {proof.off_after:.2f} s"
    row = f"{verdict} {proof.step:<35} {proof.kind or 'none':<17} {off}".rstrip()
    return f"{row}\n      {proof.wrong}" if proof.wrong else row
