"""A page with its loop and its web server, assembled."""

import contextlib
import socket
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, final

from .._celsius import ZERO_CELSIUS
from ..control import AbstractController
from ..live import (
    Alarms,
    EstimateJournal,
    Event,
    Finding,
    Publisher,
    RecordConsumer,
    Replay,
    RigConnection,
    StopRequest,
)
from ._access import Access
from ._app import web_app
from ._champion import Champion, TwinBeside
from ._desk import Desk
from ._frame_ring import FrameRing
from ._live_diagnosis import LiveDiagnosis, LiveRefit
from ._orders import MqttOrders
from ._page import Page
from ._recent_samples import RecentSamples
from ._rig_loop import RigLoop
from ._web_server import WebServer

if TYPE_CHECKING:  # a page whose controller is not tuned does not import it
    from ..control import ControllerDesign
    from ._self_optimiser import Policy


@final
class PageServer:
    """Serves the page of a rig while the block runs.

    **Arguments:**

    - `source`: the connection, started, or the replay.
    - `beside`: the twin that follows the rig.
    - `stop`: the event by which signals end the program.
    - `access`: who may ask for what.
    - `opened`: the open port.
    - `name`: the name of the source, for people.
    - `recording`: the file that is recorded into; None: none is.
    - `silence`: the time without data after which there is an alarm, s.
    - `champion`: the store whose champion is followed; None: there is no store.
    - `consumers`: makes those who get the records too, from the page and its desk.
    - `controller`: holds references on order; None: nobody does.
    - `policy`: whether that controller is tuned when the champion changes, for the `design` for
      which it was made: `propose` waits for a person, `apply` does not; None: it is not.
    - `about`: what a recording keeps of each run.
    - `raised`: called with each new finding.
    - `publisher`: sends readings, estimates and findings to a broker; None: nobody does.
    - `takes_mqtt_orders`: whether orders to the store are taken from that broker (`MqttOrders`).
    """

    def __init__(
        self,
        source: RigConnection | Replay,
        beside: TwinBeside,
        stop: StopRequest,
        access: Access,
        opened: socket.socket,
        *,
        name: str,
        recording: Path | None = None,
        silence: float | int = 10.0,
        champion: Champion | None = None,
        consumers: Callable[[Page, Desk], Sequence[RecordConsumer]] = lambda page, desk: (),
        controller: AbstractController | None = None,
        policy: "Policy | None" = None,
        design: "ControllerDesign | None" = None,
        about: Mapping[str, Any] | None = None,
        raised: Callable[[Finding], object] = lambda _: None,
        publisher: Publisher | None = None,
        takes_mqtt_orders: bool = False,
    ):
        is_live = isinstance(source, RigConnection)
        outputs = () if controller is None else controller.output_names(beside.twin.channels)
        ring, rig = FrameRing(), beside.twin.rig
        self._source, self._raised, self._publisher = source, raised, publisher
        self._records = recording is not None
        disk = (recording or Path.cwd() / "-").absolute()
        self.page = Page(
            ring,
            source,
            beside,
            {
                "source": name,
                "is_live": is_live,
                "recording": "" if recording is None else recording.name,
                "control": access.allow_control,
                "outputs": outputs,
            },
            self._on_finding,
            disk=disk.parent if is_live else None,
        )
        recent = RecentSamples(beside.twin)
        self._diagnosis = LiveDiagnosis(beside.twin, recent, self.page.show_diagnosis, beside.noise)
        self._refit = None
        if champion is not None:
            say = partial(self._say, "notice")
            self._refit = LiveRefit(champion.store, recent, say)
        self._optimiser = None
        if policy is not None and champion is not None and controller and design:
            from ._self_optimiser import SelfOptimiser

            self._optimiser = SelfOptimiser(
                champion.store, rig, controller, design, policy, self._say
            )
        self.desk = Desk(stop)
        if publisher is not None and takes_mqtt_orders:
            MqttOrders(publisher, self.desk)
        watching: list[RecordConsumer] = [recent, *consumers(self.page, self.desk)]
        if is_live:
            limit = rig.maximum_temperature
            hottest = None if limit is None else limit - ZERO_CELSIUS
            names = [channel.name for channel in rig.channels]
            now = source.clock.now()
            alarms = Alarms(names, hottest, silence, disk, now, self.page.on_finding)
            watching.append(alarms)
            if recording is not None or publisher is not None:
                # A note comes back with the next records, and so reaches the publisher too.
                watching.append(EstimateJournal(source.note, lambda: self.page.followed))
        elif publisher is not None:  # a replay takes no notes
            watching.append(EstimateJournal(publisher.send, lambda: self.page.followed))
        if publisher is not None:
            watching.append(publisher)
        self.loop = RigLoop(
            source,
            self.page,
            self.desk,
            consumers=tuple(watching),
            diagnosis=self._diagnosis,
            refit=self._refit,
            champion=champion,
            controller=controller,
            optimiser=self._optimiser,
            about=about,
        )
        self._web = WebServer(web_app(self.page, self.desk, access), opened)
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> "PageServer":
        self._stack.callback(self._diagnosis.close)
        for process in (self._refit, self._optimiser):
            if process is not None:
                self._stack.callback(process.close)
        self._stack.enter_context(self._web)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        where: TracebackType | None,
    ) -> None:
        self._stack.close()

    def _say(self, level: str, text: str) -> None:
        """Says something of the store, also to the subscribers of the broker."""
        self.page.say(level, text)
        if self._publisher is not None:
            self._publisher.send_log(level, text)

    def _on_finding(self, finding: Finding) -> None:
        self._diagnosis.on_finding(finding)
        self.loop.on_finding(finding)
        self._raised(finding)
        if self._publisher is not None:
            self._publisher.send_finding(finding)
        if self._records and finding.is_alarm and isinstance(self._source, RigConnection):
            detail = f"{finding.kind}: {finding.detail} ({finding.severity})"
            self._source.note(Event("", self._source.clock.now(), "alarm", detail))
