"""The loop around the rig that a page shows: it polls, and obeys the orders of the desk."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, final

import numpy as np

from ..control import AbstractController, is_same, is_same_kind
from ..errors import ControlError, JaxtwinError, RecordingError, SafetyStop, StoreError
from ..live import (
    AlarmInterlock,
    Document,
    Ending,
    Finding,
    Guard,
    Moment,
    Record,
    RecordConsumer,
    Replay,
    RigConnection,
    RigState,
    Service,
    interlocks_of,
    operate,
    switch_off,
)
from ..monitoring import KINDS
from ._champion import Champion
from ._desk import (
    AcknowledgeOrder,
    Answer,
    Asked,
    Desk,
    DriveOrder,
    HoldOrder,
    PromoteOrder,
    RefitOrder,
    RollbackOrder,
    RunOrder,
)
from ._live_diagnosis import LiveDiagnosis, LiveRefit
from ._order_in_force import (
    AfterRun,
    Command,
    HeldDuty,
    HeldReferences,
    OrderInForce,
    compile_loop,
    described,
    plan_of,
)
from ._page import Page

if TYPE_CHECKING:  # a page whose controller is not tuned does not import it
    from ..control import Decision
    from ._self_optimiser import SelfOptimiser

# The time between two turns after a replay has ended, s.
IDLE_SECONDS = 0.2

# The last time of the rig to which its twin is refitted where its loop is worse, s.
REFIT_SECONDS = 900.0

# How a run has ended that somebody stopped.
STOPPED_BY_HAND = "stopped by hand"

log = logging.getLogger("jaxtwin.serve")

# `starting` until the device has acknowledged a command of the order.
RunState = Literal["idle", "starting", "driving"]


@final
class RigLoop:
    """Polls a source, hands its records to a page and other consumers, and obeys orders.

    There is one service for the whole time. While a run commands the rig, `operate` polls; the
    service then gets the records from it, as a consumer.

    **Arguments:**

    - `source`: the connection, started, or the replay.
    - `page`: the page.
    - `desk`: where clients leave orders.
    - `consumers`: who else gets the records.
    - `diagnosis`: says why the rig has changed; None: nobody does.
    - `champion`: the store whose champion is followed; None: there is no store.
    - `refit`: refits that champion when it is asked; None: nobody does.
    - `controller`: holds references on order; None: nobody does.
    - `optimiser`: has that controller tuned when the champion changes; None: nobody does.
    - `about`: what a recording keeps of each run, such as who started the server.
    """

    def __init__(
        self,
        source: RigConnection | Replay,
        page: Page,
        desk: Desk,
        *,
        consumers: tuple[RecordConsumer, ...] = (),
        diagnosis: LiveDiagnosis | None = None,
        champion: Champion | None = None,
        refit: LiveRefit | None = None,
        controller: AbstractController | None = None,
        optimiser: "SelfOptimiser | None" = None,
        about: Mapping[str, Any] | None = None,
    ):
        self._source, self._page, self._desk, self._champion = source, page, desk, champion
        self._diagnosis, self._refit = diagnosis, refit
        beside = [consumer for consumer in (diagnosis, refit) if consumer is not None]
        self._after = AfterRun(source, page)
        self._service = Service(source, [*consumers, *beside, page, self._after])
        self._optimiser = optimiser
        self._controller = controller if optimiser is None else optimiser.controller
        self._about = about or {}
        self._interlock = AlarmInterlock()
        self._order: OrderInForce | None = None
        self._command: Command = HeldDuty((), 0.0)
        self._guard = Guard([])  # that of the present or last run
        self._began = self._elapsed = 0.0
        self._show_run("idle", "")
        self._show_twins()

    def on_finding(self, finding: Finding) -> None:
        """Tells a run of a finding of the monitor, which ends it where the rig file says so."""
        if finding.kind in KINDS.values():
            self._interlock.ring(finding)
        if finding.is_alarm and self._is_on_probation:
            self._doubt(f"an alarm, {finding.kind}: {finding.detail}")

    def run(self, early: Sequence[Record] = ()) -> None:
        """Runs until the program is to end. A run that commanded the cells has switched them off
        then.

        **Arguments:**

        - `early`: records that were polled before.

        **Raises:** the errors of consumers, and of a replay that is damaged.
        """
        self._service.take(early)
        while not self._desk.is_over:
            if self._desk.take_stop():
                self._stop()
            self.turn()
        if self._after.is_watching:
            self._watch_on()

    def _watch_on(self) -> None:
        """Also a program that ends says what the readings show, unless it is told again to end."""
        self._desk.stop.clear()
        while self._after.is_watching and not (self._source.ended or self._desk.stop.is_set()):
            self._service.turn(0.05)
        self._desk.stop.set()

    def turn(self) -> None:
        """Polls once, or obeys an order, which may be a whole run."""
        self._judge_controller()
        self._follow_champion()
        asked = self._desk.next()
        if asked is not None:
            self._obey(asked)
        elif self._source.ended:
            self._desk.stop.wait(IDLE_SECONDS)
            self._service.take([])
        else:
            if isinstance(self._source, RigConnection):  # a replay waits by itself
                clock = self._source.clock
                clock.wait(self._desk.stop, self._page.pause(clock.now()))
            try:
                self._service.turn(0.05)
            except RecordingError as error:
                self._go_on_unrecorded(error)

    def take(self, record: Record) -> None:
        """Hands a record of a run to the service, and looks for the acknowledgement of an order."""
        if self._order is not None and self._order.see(record, self._service.state.trip):
            self._page.say("notice", described(self._order.order))
            self._show_run("driving", "")
        self._service.take([record])

    def look(self) -> None:
        """Looks at the desk during a run.

        **Raises:** `SafetyStop` if the run has not begun, and nobody waits for it any more.
        """
        self._service.take([])
        self._judge_controller()
        self._follow_champion(is_driven=True)
        if self._order is not None and not self._order.is_answered:
            # The next order waits for the answer to this one.
            if self._order.is_void:
                raise SafetyStop("not started: nobody waits for it any more", "stopped")
            return
        asked = self._desk.next()
        if asked is None:
            return
        if not isinstance(asked.order, RunOrder):
            self._obey(asked)
            return
        try:
            self._begin(asked, asked.order, self._guard, changes_run=True)
        except JaxtwinError as error:
            asked.answer(Answer(False, str(error)))

    def _obey(self, asked: Asked) -> None:
        order = asked.order
        if isinstance(order, DriveOrder | HoldOrder):
            self._drive(asked, order)
        elif asked.take():
            match order:
                case RefitOrder():
                    answer = self._begin_refit(order)
                case AcknowledgeOrder():
                    self._page.acknowledge()
                    answer = Answer(True, "acknowledged")
                case _:
                    answer = self._move(order)
            asked.answer(answer)

    def _begin(self, asked: Asked, order: RunOrder, guard: Guard, *, changes_run: bool) -> None:
        """Commands the rig by an order from now on.

        **Raises:** `JaxtwinError` if it cannot be obeyed, or if `guard` would stop the rig; the
        order before goes on.
        """
        assert isinstance(self._source, RigConnection)
        if isinstance(order, DriveOrder):
            command = HeldDuty(order.duty, order.seconds)
        else:
            command = self._held(order, self._controller)
        guard.check_plan(command.simulated_plan())
        in_force = OrderInForce(asked, order, self._source, changes_run=changes_run)
        if changes_run and not in_force.begin():
            return  # nobody waits for it any more
        self._order, self._command, self._began = in_force, command, self._elapsed
        begun = {"after_s": self._elapsed, **plan_of(order)}
        self._source.note(Document(self._source.clock.now(), "order", "page", begun))
        self._show_run("starting", "")

    def _held(self, order: HoldOrder, controller: AbstractController | None) -> HeldReferences:
        """A controller at the references of an order, which takes over from the present command."""
        assert isinstance(self._source, RigConnection)
        twin, rate = self._page.twin, self._service.state.rate
        return HeldReferences(
            self._source, twin, controller, order, self._command, rate, self._on_decision
        )

    def _drive(self, asked: Asked, order: RunOrder) -> None:
        """Commands the rig until the time is over, a stop, or an interlock."""
        connection = self._source
        if not isinstance(connection, RigConnection):
            asked.answer(Answer(False, "a replay drives nothing"))
            return
        self._elapsed = 0.0
        try:
            limits, self._interlock = connection.rig.limits, AlarmInterlock()
            more = [self._interlock] if limits is not None and limits.stop_on_alarm else []
            locks = interlocks_of(self._page.twin, draws=self._page.draws)
            self._guard = guard = Guard([*locks, *more])
            self._begin(asked, order, guard, changes_run=False)
        except JaxtwinError as error:
            asked.answer(Answer(False, str(error)))
            return
        for finding in self._page.present:  # an alarm that was there before the run
            self.on_finding(finding)
        level, is_off, ends = "plain", False, list[Ending]()
        self._after.end()
        try:
            outcome = operate(
                connection,
                guard,
                self._duty,
                reset=order.reset,
                about={**self._about, "plan": plan_of(order)},
                stop=self._desk.stop,
                consumers=[_DuringRun(self)],
                on_alarm=self._page.on_finding,
                on_end=ends.append,
                confirm_off=False,  # the page goes on meanwhile, see `AfterRun`
            )
            text = "the time is over" if outcome == "completed" else STOPPED_BY_HAND
            text, is_off = f"{text}; {ends[-1]}", True
        except SafetyStop as error:
            level, text = "critical", str(error)
            if self._is_on_probation and isinstance(self._command, HeldReferences):
                self._doubt(text)
        except RecordingError as error:
            self._go_on_unrecorded(error)
            level, text = "critical", str(error)
        self._page.say(level, text)
        if ends and ends[-1].off:
            self._after.begin(guard)
        in_force, self._order, self._command = self._order, None, HeldDuty((), 0.0)
        self._show_run("idle", text)
        assert in_force is not None
        in_force.refuse(f"no command was acknowledged: {text}" if is_off else text)
        if in_force.has_commanded:  # a stop ended the run, and nothing more
            self._desk.take_stop()
            self._desk.answer_stops(Answer(is_off, text))

    def _duty(self, moment: Moment) -> Sequence[float] | np.ndarray | None:
        self._elapsed = moment.time
        if self._order is not None and not self._order.begin():
            return None  # nobody waits for it any more
        return self._command(moment._replace(time=moment.time - self._began))

    def _stop(self) -> None:
        """Stops a rig that this program does not drive: its device trips."""
        if not isinstance(self._source, RigConnection):
            self._desk.answer_stops(Answer(False, "a replay drives nothing"))
            return
        self._page.say("notice", "stop")
        ending = switch_off(self._source, trip=True, insist=False)
        self._page.say("notice" if ending.off else "critical", str(ending))
        self._show_run("idle", str(ending))
        self._desk.answer_stops(Answer(ending.off, str(ending)))

    def _begin_refit(self, order: RefitOrder) -> Answer:
        if self._refit is None:
            return Answer(False, "there is no store whose champion could be refitted")
        if self._refit.is_running:
            return Answer(False, "a refit goes on already")
        try:
            self._refit.begin(order.seconds)
        except RecordingError as error:
            return Answer(False, str(error))
        self._page.say("notice", f"refit to the last {order.seconds:.0f} s of the rig")
        return Answer(True, "the champion is being refitted")

    def _move(self, order: PromoteOrder | RollbackOrder) -> Answer:
        """Moves the champion."""
        if self._champion is None:
            return Answer(False, "there is no store")
        store = self._champion.store
        try:
            if isinstance(order, PromoteOrder):
                version = int(order.version) if order.version.isdecimal() else order.version
                champion = store.promote(version, reason=order.reason)
            else:
                champion = store.rollback(reason=order.reason)
        except StoreError as error:
            return Answer(False, str(error))
        self._champion.look_at_once()
        self._show_twins()
        return Answer(True, f"the champion is version {champion.number}")

    def _follow_champion(self, *, is_driven: bool = False) -> None:
        """Goes on with a new champion. A run is guarded by the twin with which it began."""
        if self._champion is None:
            return
        number = self._champion.number
        try:
            optimiser = self._optimiser
            if optimiser is not None and optimiser.turn(is_at_rest=self._is_at_rest):
                self._champion.look_at_once()
            waits = optimiser.fits if optimiser is not None and is_driven else None
            beside = self._champion.next(
                self._source.clock.now(), is_driven=is_driven, accepts=waits
            )
        except JaxtwinError as error:
            self._page.say("warning", f"the champion is not followed: {error}")
            return
        if beside is not None:
            self._page.follow(beside)
            if self._diagnosis is not None:
                self._diagnosis.use(beside.twin, beside.noise)
            self._page.say("notice", f"the twin is {beside.label} from now on")
        if self._champion.number != number:
            self._follow_controller()
            self._show_twins()

    def _follow_controller(self) -> None:
        """Goes on with the controller of a new champion."""
        optimiser, champion = self._optimiser, self._champion
        if optimiser is None or champion is None:
            return
        try:
            version = champion.store.version(champion.number)
            controller = optimiser.controller_of(version)
            if not is_same(controller, optimiser.controller):
                if self._order is None:
                    compile_loop(self._page.twin, controller)
                self._swap(controller, f"version {version.number}: {version.reason}")
            optimiser.use(version)
        except JaxtwinError as error:
            self._page.say("warning", f"the controller stays as it is: {error}")
            self._roll_back(champion.number, f"its controller was not taken: {error}")

    def _swap(self, controller: AbstractController, reason: str) -> None:
        """Commands the rig with another controller from now on. In a run it takes over from the
        duty that it finds.

        **Raises:** `JaxtwinError` if its loop is not stable, or if the guard would stop the rig;
        the controller before goes on.
        """
        before, in_force = self._command, self._order
        if isinstance(before, HeldReferences) and in_force is not None:
            order = in_force.order
            assert isinstance(order, HoldOrder)
            if not is_same_kind(controller, self._controller):  # which would compile for seconds
                raise ControlError("expected a controller of the same kind and limits in a run")
            left = max(order.seconds - (self._elapsed - self._began), controller.sample_time_s)
            command = self._held(replace(order, seconds=left), controller)
            self._guard.check_plan(command.simulated_plan())
            in_force.order = command.order
            self._command, self._began = command, self._elapsed
        self._controller = controller
        self._page.say("notice", f"another controller from now on: {reason}")
        if isinstance(self._source, RigConnection):
            content = {"reason": reason, "controller": repr(controller)}
            now = self._source.clock.now()
            self._source.note(Document(now, "controller", "page", content))

    @property
    def _is_on_probation(self) -> bool:
        return self._optimiser is not None and self._optimiser.is_on_probation

    @property
    def _is_at_rest(self) -> bool:
        """Whether a controller may take over: it commands nothing, or its loop is at rest."""
        optimiser = self._optimiser
        commands = isinstance(self._command, HeldReferences)
        return optimiser is not None and (not commands or optimiser.is_at_rest)

    def _on_decision(self, decision: "Decision") -> None:
        if self._optimiser is not None:
            self._optimiser.update(decision)

    def _doubt(self, reason: str) -> None:
        if self._optimiser is not None and not self._optimiser.worse:
            self._optimiser.worse = reason

    def _judge_controller(self) -> None:
        """Goes back to the controller before one that is worse on the rig than in its trial. One
        that was trusted stays; its twin is refitted, because the rig may have changed."""
        optimiser = self._optimiser
        if optimiser is None or not optimiser.worse:
            return
        reason = optimiser.worse
        if not optimiser.is_on_probation:
            optimiser.worse = ""
            self._page.say("warning", reason)
            if self._refit is not None and not self._refit.is_running:
                self._page.say("notice", self._begin_refit(RefitOrder(REFIT_SECONDS)).text)
            return
        before = optimiser.previous
        try:
            self._swap(before, f"back to the one before, because {reason}")
        except JaxtwinError as error:
            # Neither is safe: the run ends, which switches the cells off. Then it goes back.
            raise SafetyStop(f"stopped: {reason}; the controller before: {error}") from error
        optimiser.controller, optimiser.worse, optimiser.is_on_probation = before, "", False
        self._roll_back(optimiser.number, reason)

    def _roll_back(self, number: int, reason: str) -> None:
        """Makes the champion before the champion again, unless somebody has moved it meanwhile."""
        assert self._champion is not None
        try:
            if self._champion.store.aliases.get("champion") == number:
                self._champion.store.rollback(reason=reason)
        except StoreError as error:
            self._page.say("warning", f"the store was not rolled back: {error}")
        self._champion.look_at_once()

    def _go_on_unrecorded(self, error: RecordingError) -> None:
        """A journal that fails, as on a full disk, does not end the page."""
        if not isinstance(self._source, RigConnection):
            raise error
        log.error("the recording has ended: %s", error)
        self._source.record_into(None)
        self._page.problem = f"Nothing is recorded any more: {error}."
        self._page.on_finding(Finding("not-recorded", str(error), severity="critical"))

    def _show_run(self, state: RunState, text: str) -> None:
        plan = {} if self._order is None else plan_of(self._order.order)
        self._page.ring.append("run", {"state": state, "text": text, **plan})

    def _show_twins(self) -> None:
        if self._champion is not None:
            self._page.ring.append("twins", self._champion.content())


@final
class _DuringRun:
    """Hands what `operate` polls to the loop's service."""

    def __init__(self, loop: RigLoop):
        self._loop = loop

    def on_record(self, record: Record, state: RigState) -> None:
        self._loop.take(record)

    def on_time(self, state: RigState, now: int) -> None:
        self._loop.look()
