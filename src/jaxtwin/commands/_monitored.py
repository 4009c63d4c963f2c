"""The monitor of a live rig, as `observe`, `record`, `drive` and `control` have it."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple, final

import typer

from ._alarm_command import AlarmCommand

if TYPE_CHECKING:
    from ..live import Finding, RigConnection
    from ..monitoring import LiveMonitor
    from ..physics import Twin

MonitorOption = Annotated[
    bool,
    typer.Option(
        "--monitor", help="Raise what changes in the rig as alarms, as observe and monitor find it."
    ),
]
CalibrationOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="What is healthy, as MonitorCalibration.save and 'monitor --save' write it.",
    ),
]
SampleTimeOption = Annotated[
    float, typer.Option(min=0.01, metavar="S", help="The time between two readings.")
]


@final
class MonitorOptions(NamedTuple):
    """The files from which a monitor is made, and the time between two readings, s."""

    noise: Path | None
    calibration: Path | None
    sample_time: float

    @classmethod
    def of(
        cls,
        wanted: bool,
        noise: Path | None,
        calibration: Path | None,
        sample_time: float,
        rig: str,
        *,
        is_driven: bool = True,
    ) -> "MonitorOptions | None":
        """The options of a command; None if it has no monitor. A rig that is driven has one in any
        case if its alarms switch the cells off.

        **Raises:** `typer.BadParameter` for a file that only a monitor reads; `RigError`.
        """
        from ..rig import load_rig

        limits = load_rig(rig).limits if is_driven else None
        if wanted or (limits is not None and limits.stop_on_alarm):
            return cls(noise, calibration, sample_time)
        if noise is not None or calibration is not None:
            raise typer.BadParameter("--noise and --calibration are for the monitor; add --monitor")
        return None

    def monitor(self, twin: "Twin", on_finding: "Callable[[Finding], None]") -> "LiveMonitor":
        """Makes a monitor. This compiles for some seconds, which a rig should not wait for.

        **Raises:** `JaxtwinError` for files that cannot be read or are those of another rig.
        """
        from ..monitoring import LiveMonitor, MonitorCalibration
        from ..observers import ProcessNoise, live_observer

        levels = None if self.noise is None else ProcessNoise.load(self.noise)
        healthy = None if self.calibration is None else MonitorCalibration.load(self.calibration)
        observer = live_observer(twin, levels, self.sample_time)
        return LiveMonitor(observer, on_finding, calibration=healthy, sample_time=self.sample_time)


def ring_and_note(connection: "RigConnection", command: AlarmCommand, finding: "Finding") -> None:
    """Raises a finding on all links that alarms have: an event in the recording and on MQTT, and
    for an alarm the log, the user's command and the exit code."""
    from ..live import Event

    kind = "alarm" if finding.is_alarm else "notice"
    detail = f"{finding.kind}: {finding.detail} ({finding.severity})"
    connection.note(Event("", connection.clock.now(), kind, detail))
    if finding.is_alarm:
        command.ring(finding)
