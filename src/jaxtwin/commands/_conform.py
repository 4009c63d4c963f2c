"""`jaxtwin conform`: does a device keep the protocol?"""

import typer

from ._exit_codes import FOUND_ERROR
from ._options import BaudOption, LinkOption, RigArgument
from ._output import say


def conform(rig: RigArgument, link: LinkOption, baud: BaudOption = 115_200) -> None:
    """Test a device's firmware by greetings, commands and faults; this drives the cells briefly.

    The exit code is 0 if the device passes, 1 if it does not.
    """
    from ..errors import LinkError
    from ..live import SystemClock, opener
    from ..live import conform as steps
    from ..rig import load_rig

    if len(link) != 1:
        raise typer.BadParameter("give one --link: devices are tried one by one")
    loaded = load_rig(rig)
    try:
        transport = opener(link[0], loaded, baud=baud)()
    except OSError as error:
        raise LinkError(f"{link[0]}: {error}") from None
    wrong = 0
    try:
        for finding in steps(loaded, transport, SystemClock()):
            wrong += bool(finding.wrong)
            say(f"{'WRONG' if finding.wrong else 'ok   '} {finding.step}")
            if finding.wrong:
                say(f"      {finding.wrong}")
    except OSError as error:
        raise LinkError(f"{link[0]}: the device hung up: {error}") from None
    finally:
        transport.close()
    if wrong:
        raise typer.Exit(FOUND_ERROR)
