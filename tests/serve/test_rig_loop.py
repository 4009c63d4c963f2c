"""The loop around a virtual rig: the page follows it, orders are obeyed behind the interlocks, and
a stop reaches it whatever it does. A clock that tests turn; no waiting."""

import socket
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from asgi import HOST, ask
from faulty_runs import ONSET, recording
from hand_clock import START, HandClock, virtual_bench
from small_page import TOKEN, twin
from small_results import fit

from jaxtwin import Experiment, Twin, TwinStore, simulate
from jaxtwin.control import DecoupledPI
from jaxtwin.errors import RecordingError, SafetyStop
from jaxtwin.live import (
    Duty,
    Finding,
    Moment,
    Publisher,
    Reading,
    Record,
    Recorder,
    RigConnection,
    RigState,
    Sample,
    StateEstimate,
    StopRequest,
    VirtualRig,
    encode,
)
from jaxtwin.serve import (
    Access,
    Champion,
    Desk,
    FrameRing,
    LiveDiagnosis,
    LiveRefit,
    Page,
    PageServer,
    RecentSamples,
    RigLoop,
    TwinBeside,
    web_app,
)
from jaxtwin.serve._child_process import ChildProcess, Outcome
from jaxtwin.serve._desk import (
    Asked,
    DriveOrder,
    HoldOrder,
    PromoteOrder,
    RefitOrder,
    RollbackOrder,
)
from jaxtwin.serve._order_in_force import HeldDuty, HeldReferences, OrderInForce


class Bench:
    """A virtual `tclab` with its loop."""

    def __init__(self, **more: Any):
        self.twin: Twin = more.pop("twin", twin())
        self.clock = HandClock()
        self.device = VirtualRig(self.twin, controller_rate=4.0)
        journal = more.pop("journal", None)
        self.source: RigConnection = virtual_bench(
            self.twin.rig, self.device, self.clock, journal=journal
        )
        about = {"source": "virtual rig", "is_live": True, "recording": "", "control": True}
        self.raised: list[Any] = []
        beside = TwinBeside(self.twin, "values of the rig file")
        self.page = Page(FrameRing(), self.source, beside, about, self.raised.append)
        self.desk = Desk(StopRequest())
        self.loop = RigLoop(self.source, self.page, self.desk, **more)

    def turn(self, seconds: float) -> None:
        until = self.clock.now() + seconds * 1e9
        while self.clock.now() < until:
            self.loop.turn()

    def frame(self, kind: str) -> Any:
        return self.page.ring.newest_of(kind)

    def lines(self) -> list[str]:
        return [line["text"] for line in self.frame("log")]


class When:
    """A consumer that does something once, when the cells are driven."""

    def __init__(self, action: Callable[[], object]):
        self.action: Callable[[], object] | None = action

    def on_record(self, record: Record, state: RigState) -> None:
        if isinstance(record, Sample) and any(record.pwm) and self.action is not None:
            action, self.action = self.action, None
            action()

    def on_time(self, state: RigState, now: int) -> None:
        pass


@pytest.mark.slow
def test_the_page_follows_a_rig() -> None:
    bench = Bench()
    bench.turn(130.0)
    story = bench.frame("story")
    assert {name: story[name]["level"] for name in ("rig", "twin", "minute")} == {
        "rig": "good",
        "twin": "good",
        "minute": "good",
    }
    assert story["links"] == {"rig": "live"}
    sample, outlook = bench.frame("sample"), bench.frame("outlook")
    assert sample["measured"] == pytest.approx(sample["expected"], abs=1.0)
    assert sample["t"] == pytest.approx(bench.clock.now() * 1e-9, abs=0.5)
    assert len(outlook["nodes"]) == len(bench.frame("layout")["nodes"])
    assert outlook["times"][-1] == pytest.approx(sample["t"] + 60.0, abs=2.0)
    history = bench.page.history.over(300.0)
    assert 120 <= len(history["time"]) <= 132


def test_pictures_are_at_most_ten_in_a_second_however_fast_the_rig_is() -> None:
    bench = Bench()
    bench.turn(5.0)
    before, records = bench.page.ring.count, bench.page.records
    bench.turn(10.0)
    made = bench.page.ring.count - before
    assert made <= 10 * (10 + 2)
    assert bench.page.records > records


@pytest.mark.slow
def test_a_duty_is_held_for_its_time_and_the_cells_are_off_after_it() -> None:
    seen: list[Any] = []
    watch = When(lambda: None)
    bench = Bench(consumers=(watch,))
    bench.turn(3.0)
    watch.action = lambda: seen.append((bench.frame("run")["state"], bench.device.pwm))
    answer = bench.desk.ask(DriveOrder((0.3, 0.2), 20.0))
    begin = bench.clock.now()
    bench.loop.turn()
    assert answer.result(0).obeyed
    assert seen[0][0] == "driving"
    assert any(seen[0][1])
    assert (bench.clock.now() - begin) * 1e-9 == pytest.approx(21.0, abs=2.0)
    assert not any(bench.device.pwm)
    assert bench.frame("run")["state"] == "idle"
    assert "the time is over; the device reports off" in bench.lines()
    assert not bench.desk.is_over


def test_a_second_order_changes_the_duty_without_a_pause() -> None:
    duties: list[Any] = []
    watch = When(lambda: None)
    bench = Bench(consumers=(watch,))
    bench.turn(3.0)

    def change() -> None:
        bench.desk.ask(DriveOrder((0.5, 0.5), 5.0))
        watch.action = lambda: duties.append(bench.frame("run")["duty"])

    watch.action = change
    bench.desk.ask(DriveOrder((0.3, 0.2), 600.0))
    begin = bench.clock.now()
    bench.loop.turn()
    assert (bench.clock.now() - begin) * 1e-9 < 30.0
    assert duties[-1] == [0.5, 0.5]


def with_limit(temperature: float) -> Twin:
    """A board with another limit, degC."""
    rig = twin().rig
    assert rig.limits is not None
    return Twin(replace(rig, limits=replace(rig.limits, temperature=273.15 + temperature)))


def test_an_order_beyond_the_limit_changes_no_run() -> None:
    asked: list[Any] = []
    watch = When(lambda: None)
    bench = Bench(consumers=(watch,), twin=with_limit(50.0))
    bench.turn(3.0)

    def change() -> None:
        asked.append(bench.desk.ask(DriveOrder((1.0, 1.0), 3600.0)))
        watch.action = lambda: None

    watch.action = change
    bench.desk.ask(DriveOrder((0.3, 0.2), 20.0))
    bench.loop.turn()
    answer = asked[0].result(0)
    assert not answer.obeyed
    assert answer.text.startswith("plan: expected at most ")
    assert "the time is over; the device reports off" in bench.lines()


@cache
def controller() -> DecoupledPI:
    return DecoupledPI(0.05, 1e-3, 0.05, 1e-3, measured=(("T1",), ("T2",)), limits=(0, 1))


@pytest.mark.slow
def test_a_virtual_rig_that_runs_faster_is_not_silent_while_an_order_is_checked() -> None:
    order = HoldOrder((32.0, 30.0), 60.0)
    source, before = Bench().source, HeldDuty((0.0, 0.0), 60.0)
    old = Moment(0.0, np.full(2, 30.0), np.full(2, 20.0), np.zeros(2), None)  # read 20 s ago
    assert HeldReferences(source, twin(), controller(), order, before, 10.0)(old) is not None
    with pytest.raises(SafetyStop, match=r"no reading that it uses for 20\.0 s"):
        HeldReferences(source, twin(), controller(), order, before, 1.0)(old)


@pytest.mark.slow
def test_references_are_held_and_changed_without_a_jump_of_the_duty() -> None:
    duties: list[tuple[float, ...]] = []
    watch = When(lambda: None)
    bench = Bench(consumers=(watch,), controller=controller())
    bench.turn(3.0)

    def change() -> None:
        duties.append(bench.device.pwm)
        if len(duties) == 100:
            changed.append(bench.desk.ask(HoldOrder((34.0, 30.0), 200.0)))
        watch.action = change

    changed: list[Any] = []
    watch.action = change
    answer = bench.desk.ask(HoldOrder((32.0, 30.0), 300.0))
    bench.loop.turn()
    assert answer.result(0) == (True, "the rig is held at 32 °C, 30 °C")
    assert changed[0].result(0).text == "the rig is held at 34 °C, 30 °C from now on"
    counts = bench.twin.rig.driver.counts
    driven = np.array([one for one in duties[90:] if any(one)], float)
    steps = np.abs(np.diff(driven, axis=0)) / counts
    assert steps.max() < 0.2  # a gain of 0.05 and 2 K more
    readings = bench.frame("sample")["measured"]
    assert readings == pytest.approx([34.0, 30.0], abs=1.0)
    assert not any(bench.device.pwm)
    assert "the time is over; the device reports off" in bench.lines()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("more", "references", "message"),
    [({}, (30.0, 30.0), "--controller"), ({"controller": True}, (300.0, 30.0), "can hold")],
)
def test_references_that_nobody_can_hold_are_refused(
    more: dict[str, Any], references: tuple[float, ...], message: str
) -> None:
    bench = Bench(**({"controller": controller()} if more else {}))
    bench.turn(1.0)
    answer = bench.desk.ask(HoldOrder(references, 60.0))
    bench.loop.turn()
    assert not answer.result(0).obeyed
    assert message in answer.result(0).text
    assert bench.frame("run")["state"] == "idle"
    assert not any(bench.device.pwm)


def test_an_order_is_answered_when_the_device_has_acknowledged_it() -> None:
    """Not when it was taken, nor when it was sent."""
    answers: list[Any] = []
    seen: list[tuple[Any, bool, str]] = []

    class Watch:
        def on_record(self, record: Record, state: RigState) -> None:
            if answers:
                said = record.number if isinstance(record, Sample) else None
                seen.append((said, answers[0].done(), bench.frame("run")["state"]))

        def on_time(self, state: RigState, now: int) -> None:
            pass

    bench = Bench(consumers=(Watch(),))
    bench.turn(3.0)
    before = bench.source.number
    answers.append(bench.desk.ask(DriveOrder((0.3, 0.2), 5.0)))
    bench.loop.turn()
    place = next(k for k, (number, *_) in enumerate(seen) if number is not None and number > before)
    assert {one[1:] for one in seen[:place]} <= {(False, "idle"), (False, "starting")}
    assert seen[place][1:] == (True, "driving")
    assert answers[0].result(0) == (True, "the rig is driven with a duty of 30 %, 20 %")


def commands_of(owner: str, number: int) -> bytes:
    return encode(Duty(number, (300, 300), owner))


def test_an_order_for_a_rig_that_another_host_commands_is_refused() -> None:
    bench = Bench()
    bench.turn(3.0)
    bench.device.receive(commands_of("other", 1))
    answer = bench.desk.ask(DriveOrder((0.3, 0.2), 60.0))
    bench.loop.turn()
    assert not answer.result(0).obeyed
    assert "another host, other, commands the cells" in answer.result(0).text
    assert bench.frame("run")["state"] == "idle"
    assert not any("driven" in line for line in bench.lines())


def test_an_order_that_no_device_acknowledges_is_refused() -> None:
    """A device that applies nothing and acknowledges nothing: an interlock finds it."""
    bench = Bench()
    bench.turn(3.0)

    def deaf(records: list[Record]) -> list[Record]:
        return [
            replace(one, owner="", number=None, pwm=(0, 0)) if isinstance(one, Sample) else one
            for one in records
        ]

    bench.source.tap = deaf
    answer = bench.desk.ask(DriveOrder((0.0, 0.0), 60.0))
    bench.loop.turn()
    assert not answer.result(0).obeyed
    assert "no command was acknowledged" in answer.result(0).text
    assert not any("driven" in line for line in bench.lines())


@pytest.mark.parametrize(
    ("number", "owner", "is_acknowledged"),
    [(5, "us", False), (6, "us", True), (8, "us", True), (9, "us", False), (7, "them", False)],
)
@pytest.mark.parametrize("start", [5, 2**32 - 2])
def test_only_a_command_of_the_order_is_acknowledged(
    number: int, owner: str, is_acknowledged: bool, start: int
) -> None:
    """Commands 6 to 8, also where the numbers of 32 bits begin anew."""
    connection = RigConnection(twin().rig, {})
    connection.owner, connection._number = "us", start
    order = DriveOrder((0.3,), 60.0)
    asked = Asked(order)
    in_force = OrderInForce(asked, order, connection, changes_run=False)
    assert in_force.begin()
    connection._number = (start + 3) % 2**32
    said = (start - 5 + number) % 2**32
    sample = Sample("rig", "b", START, 0, 0, (300,), None, owner=owner, number=said)
    assert in_force.see(sample, "") == is_acknowledged
    assert asked.waiting.done() == is_acknowledged


def test_a_client_that_gives_up_before_the_rig_is_ready_starts_no_heater() -> None:
    bench = Bench()
    bench.turn(3.0)
    bench.source.tap = lambda records: [one for one in records if not isinstance(one, Sample)]
    polls = [0]
    poll = bench.source.poll

    def counted(timeout: float = 0.1) -> list[Record]:
        polls[0] += 1
        if polls[0] == 40:
            assert gone.cancel()
            bench.source.tap = None
        return poll(timeout)

    bench.source.poll = counted  # pyright: ignore[reportAttributeAccessIssue]
    gone = bench.desk.ask(DriveOrder((0.3, 0.2), 600.0))
    begin = bench.clock.now()
    bench.loop.turn()
    assert (bench.clock.now() - begin) * 1e-9 < 6.0
    assert bench.device.stage.number is None
    assert "nobody waits for it any more" in bench.frame("run")["text"]


def test_a_reset_of_a_run_that_goes_on_says_that_nothing_had_tripped() -> None:
    changed: list[Any] = []
    watch = When(lambda: changed.append(bench.desk.ask(DriveOrder((0.5, 0.5), 5.0, reset=True))))
    bench = Bench(consumers=(watch,))
    bench.turn(3.0)
    first = bench.desk.ask(DriveOrder((0.3, 0.2), 600.0))
    bench.loop.turn()
    assert first.result(0).text == "the rig is driven with a duty of 30 %, 20 %"
    assert changed[0].result(0).text == (
        "the rig is driven with a duty of 50 %, 50 % from now on; nothing had tripped"
    )


def test_a_stop_is_answered_with_what_the_device_reports() -> None:
    bench = Bench()
    bench.turn(3.0)
    idle = bench.desk.press_stop()
    assert bench.desk.take_stop()
    bench.loop._stop()
    assert idle.result(0).obeyed
    assert "the device has tripped" in idle.result(0).text
    watch = When(lambda: stops.append(bench.desk.press_stop()))
    stops: list[Any] = []
    bench = Bench(consumers=(watch,))
    bench.turn(3.0)
    bench.desk.ask(DriveOrder((0.3, 0.2), 600.0))
    bench.loop.turn()
    assert stops[0].result(0) == (True, "stopped by hand; the device reports off")


def test_a_stop_before_a_run_has_begun_trips_the_device() -> None:
    """No run commands the rig yet: whoever does is stopped."""
    bench = Bench()
    bench.turn(3.0)
    bench.source.tap = lambda records: [one for one in records if not isinstance(one, Sample)]
    watch = bench.source.poll
    pressed: list[Any] = []

    def pressing(timeout: float = 0.1) -> list[Record]:
        if not pressed:
            pressed.append(bench.desk.press_stop())
        return watch(timeout)

    bench.source.poll = pressing  # pyright: ignore[reportAttributeAccessIssue]
    answer = bench.desk.ask(DriveOrder((0.3, 0.2), 600.0))
    bench.loop.turn()
    assert not answer.result(0).obeyed
    bench.source.tap = None
    assert bench.desk.take_stop()
    bench.loop._stop()
    assert bench.device.stage.trip_reason == "stop"
    assert pressed[0].result(0).obeyed


def test_an_order_whose_client_has_gone_is_void() -> None:
    bench = Bench()
    bench.turn(1.0)
    gone = bench.desk.ask(DriveOrder((0.3, 0.2), 600.0))
    assert gone.cancel()
    bench.turn(2.0)
    assert bench.frame("run")["state"] == "idle"
    assert bench.desk.next() is None


def test_a_stop_ends_a_run_at_once_and_the_program_goes_on() -> None:
    watch = When(lambda: None)
    bench = Bench(consumers=(watch,))
    bench.turn(3.0)
    watch.action = bench.desk.press_stop
    bench.desk.ask(DriveOrder((0.3, 0.2), 600.0))
    begin = bench.clock.now()
    bench.loop.turn()
    assert (bench.clock.now() - begin) * 1e-9 < 5.0
    assert not any(bench.device.pwm)
    assert bench.device.stage.trip_reason == ""
    assert not bench.desk.is_over
    assert not bench.desk.stop.is_set()
    assert "stopped by hand; the device reports off" in bench.lines()


def test_a_signal_ends_a_run_and_the_program_and_leaves_a_trip() -> None:
    watch = When(lambda: None)
    bench = Bench(consumers=(watch,))
    bench.turn(3.0)

    def end() -> None:
        bench.desk.stop.signal = "SIGTERM"
        bench.desk.stop.set()

    watch.action = end
    bench.desk.ask(DriveOrder((0.3, 0.2), 600.0))
    bench.loop.run()
    assert bench.desk.is_over
    assert not any(bench.device.pwm)
    assert bench.device.stage.trip_reason == "stop"


@pytest.mark.slow
def test_a_stop_without_a_run_trips_the_device_and_a_reset_ends_the_trip() -> None:
    bench = Bench()
    bench.turn(3.0)
    bench.desk.press_stop()
    assert bench.desk.take_stop()
    bench.loop._stop()
    assert bench.device.stage.trip_reason == "stop"
    bench.turn(2.0)
    assert bench.frame("story")["rig"]["head"] == "The device has switched off"
    refused = bench.desk.ask(DriveOrder((0.3, 0.2), 10.0))
    bench.loop.turn()
    assert not refused.result(0).obeyed
    assert "look why" in refused.result(0).text
    assert refused.result(0).text == bench.frame("run")["text"]
    obeyed = bench.desk.ask(DriveOrder((0.3, 0.2), 10.0, reset=True))
    bench.loop.turn()
    assert obeyed.result(0) == (
        True,
        "the rig is driven with a duty of 30 %, 20 %; its trip (stop) was ended first",
    )
    assert bench.frame("run")["text"] == "the time is over; the device reports off"


@pytest.mark.slow
def test_an_interlock_ends_a_run_that_the_page_began() -> None:
    """The readings of a rig whose heater fails do not follow the duty."""
    bench = Bench()
    bench.turn(3.0)
    bench.source.tap = lambda records: [one for one in records if not isinstance(one, Sample)]
    bench.desk.ask(DriveOrder((0.3, 0.2), 600.0))
    bench.loop.turn()
    assert not any(bench.device.pwm)
    assert bench.frame("run")["state"] == "idle"
    assert "not started" in bench.frame("run")["text"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sudden", "disk"])
@pytest.mark.parametrize("stops", [True, False])
def test_an_alarm_of_the_monitor_ends_a_run_where_the_rig_file_says_so(
    kind: str, stops: bool
) -> None:
    """An alarm that is not the monitor's, such as a full disk, ends none."""
    limits = twin().rig.limits
    assert limits is not None
    rig = replace(twin().rig, limits=replace(limits, stop_on_alarm=stops))
    ring = When(lambda: bench.loop.on_finding(Finding(kind, "something changed")))
    bench = Bench(twin=Twin(rig, twin().values), consumers=(ring,))
    bench.turn(3.0)
    bench.desk.ask(DriveOrder((0.3, 0.2), 10.0))
    bench.loop.turn()
    is_stopped = stops and kind == "sudden"
    end = "alarm, sudden: something changed" if is_stopped else "the time is over"
    assert end in bench.frame("run")["text"]
    assert not any(bench.device.pwm)


def test_an_alarm_that_is_there_already_lets_no_run_begin(monkeypatch: pytest.MonkeyPatch) -> None:
    limits = twin().rig.limits
    assert limits is not None
    rig = replace(twin().rig, limits=replace(limits, stop_on_alarm=True))
    bench = Bench(twin=Twin(rig, twin().values))
    bench.turn(3.0)
    there = (Finding("sudden", "something changed"),)
    monkeypatch.setattr(Page, "present", there)
    bench.desk.ask(DriveOrder((0.3, 0.2), 10.0))
    bench.loop.turn()
    assert "something changed" in bench.frame("run")["text"]
    assert not any(bench.device.pwm)


def test_a_recording_that_fails_does_not_end_the_page(tmp_path: Path) -> None:
    file = tmp_path / "session.db"
    recorder = Recorder(file, twin().rig, clock=HandClock())
    bench = Bench(journal=recorder)
    bench.turn(5.0)
    file.unlink()
    bench.turn(5.0)
    assert "Nothing is recorded any more" in bench.page.problem
    assert bench.frame("story")["rig"]["head"] == "The server has a problem"
    assert [one.kind for one in bench.raised] == ["not-recorded"]


@pytest.fixture
def store(tmp_path: Path) -> TwinStore:
    store = TwinStore(tmp_path / "twins.db")
    store.add(fit(), reason="first match", aliases=["champion"])
    store.add(fit(), reason="refitted", parent=1, aliases=["challenger"])
    return store


def of_store(store: TwinStore) -> Bench:
    def made(version: Any) -> TwinBeside:
        return TwinBeside(twin(), f"version {version.number}")

    return Bench(champion=Champion(store, made))


def test_the_champion_is_followed_whoever_promoted_it(store: TwinStore) -> None:
    bench = of_store(store)
    bench.turn(2.0)
    answer = bench.desk.ask(PromoteOrder("2", "it is better"))
    bench.loop.turn()
    assert answer.result(0).text == "the champion is version 2"
    bench.turn(1.0)
    assert bench.frame("layout")["twin"] == "version 2"
    assert bench.frame("twins")["followed"] == 2
    store.rollback(reason="by another process")
    bench.turn(8.0)
    assert bench.frame("layout")["twin"] == "version 1"
    bench.desk.ask(RollbackOrder("it was right"))
    bench.turn(1.0)
    assert bench.frame("layout")["twin"] == "version 2"


def test_a_version_that_is_not_there_is_refused(store: TwinStore) -> None:
    bench = of_store(store)
    answer = bench.desk.ask(PromoteOrder("7", "why not"))
    bench.loop.turn()
    assert not answer.result(0).obeyed
    assert "7" in answer.result(0).text


def test_without_a_store_nothing_is_promoted() -> None:
    bench = Bench()
    answer = bench.desk.ask(RollbackOrder("why not"))
    bench.loop.turn()
    assert answer.result(0) == (False, "there is no store")


def test_a_stop_through_the_application_reaches_a_run() -> None:
    watch = When(lambda: None)
    bench = Bench(consumers=(watch,))
    rules = Access.of("127.0.0.1", 8000)
    app = web_app(bench.page, bench.desk, Access(rules.hosts, TOKEN, allow_control=True))
    headers = {
        "origin": f"http://{HOST}",
        "content-type": "application/json",
        "authorization": f"Bearer {TOKEN}",
    }
    bench.turn(3.0)
    with ThreadPoolExecutor(1) as client:

        def press() -> None:
            answers.append(client.submit(ask, app, "/control/stop", method="POST", headers=headers))

        answers: list[Any] = []
        watch.action = press
        bench.desk.ask(DriveOrder((0.3, 0.2), 600.0))
        bench.loop.turn()
        answer = answers[0].result(20)
    assert answer.status == 200
    assert answer.json == {"text": "stopped by hand; the device reports off"}
    assert not any(bench.device.pwm)


def test_the_last_minutes_are_a_recording_of_a_sample_in_each_second() -> None:
    recent = RecentSamples(twin())
    bench = Bench(consumers=(recent,))
    with pytest.raises(RecordingError, match="expected readings and duty"):
        recent.recorded()
    bench.turn(20.0)
    recorded = recent.recorded()
    assert recorded.channels == twin().channels
    assert len(recorded.time) == pytest.approx(20, abs=2)
    assert 1.0 <= min(np.diff(recorded.time)) <= max(np.diff(recorded.time)) < 1.3
    assert not np.asarray(recorded.duty).any()
    assert recent.recorded(5.0).duration == pytest.approx(5.0, abs=1.3)
    assert recent.host_time(recent.now) == pytest.approx(bench.clock.now() * 1e-9, abs=1.5)


def recorded_steps(part: float) -> Experiment:
    """Ten seconds with a reading every 1.6 s and the state of the device every 0.1 s, whose duty
    rises by `part` at three times: at 3.35, 6.65 and 6.85 s, if in the middle between two."""
    recent, state = RecentSamples(twin()), RigState()
    counts = round(part * twin().rig.driver.counts)
    for tenth in range(100):
        at, now = START + tenth * 10**8, tenth / 10
        level = counts * sum(now >= change for change in (3.4, 6.7, 6.9))
        sample = Sample("rig", "b", at, tenth * 10**5, tenth, (level, 0), None)
        records: list[Record] = [sample]
        if tenth % 16 == 0:
            row = np.array([30.0, 30.0])
            records.append(Reading("rig", "b", at, tenth * 10**5, tenth, row, False, None))
        for record in records:
            state = state.after(record)
            recent.on_record(record, state)
    return recent.recorded()


def test_a_duty_counts_from_when_the_device_reports_it() -> None:
    """The duty of a sample of an experiment is held until the next one: it is the mean until
    then. A command that came a second earlier or later in it would look like another rig. It came
    between two samples of the device: in the middle, on average."""
    recorded = recorded_steps(0.1)
    np.testing.assert_allclose(recorded.time, np.arange(0.0, 9.7, 1.6), atol=1e-6)
    # From 3.2 to 4.8 s: 1.45 s of 0.1; from 6.4 to 8.0 s: 0.25 s, 0.2 s and 1.15 s.
    third, fifth = 0.1 * 1.45 / 1.6, (0.25 * 0.1 + 0.2 * 0.2 + 1.15 * 0.3) / 1.6
    duty = np.asarray(recorded.duty)[:, 0]
    np.testing.assert_allclose(duty, [0, 0, third, 0.1, fifth, 0.3, 0.3], atol=1e-6)


def test_a_large_change_of_the_duty_is_not_averaged() -> None:
    """The heat is not linear in the duty."""
    recorded = recorded_steps(0.3)
    assert recorded.temperatures is not None
    is_read = ~np.isnan(recorded.temperatures).any(axis=1)
    np.testing.assert_allclose(recorded.time[is_read], np.arange(0.0, 9.7, 1.6), atol=1e-6)
    np.testing.assert_allclose(recorded.time[~is_read], [3.35, 6.65, 6.85], atol=1e-6)
    expected = 0.3 * (recorded.time[:, None] >= [3.35 - 1e-6, 6.65 - 1e-6, 6.85 - 1e-6]).sum(axis=1)
    np.testing.assert_allclose(np.asarray(recorded.duty)[:, 0], expected, atol=1e-6)


def test_inputs_of_the_last_minutes_are_those_of_the_rig_file() -> None:
    box, state = Twin("heated-box"), RigState()
    recent = RecentSamples(box)
    for second in range(4):
        at = START + second * 10**9
        for record in (
            Sample("rig", "b", at, second * 10**6, second, (0,), None),
            Reading("rig", "b", at, second * 10**6, second, np.array([22.0]), False, None),
        ):
            state = state.after(record)
            recent.on_record(record, state)
    recorded = recent.recorded()
    assert set(recorded.inputs) == {each.name for each in box.rig.inputs}
    # A recording that lacked one would be refused.
    assert np.isfinite(simulate(box, recorded).temperatures).all()


def test_a_refit_needs_a_store_and_readings(store: TwinStore) -> None:
    bench = Bench()
    answer = bench.desk.ask(RefitOrder(600.0))
    bench.loop.turn()
    assert "no store" in answer.result(0).text
    recent = RecentSamples(twin())
    bench = Bench(refit=LiveRefit(store, recent, print))
    answer = bench.desk.ask(RefitOrder(600.0))
    bench.loop.turn()
    assert answer.result(0) == (
        False,
        "the last minutes: expected readings and duty, got none yet",
    )


@pytest.mark.slow
def test_a_change_is_diagnosed_beside_the_loop() -> None:
    """Half of the strings of a heater fail, and the diagnosis says so, in a process of its own."""
    shown: list[dict[str, Any]] = []
    recent = RecentSamples(twin())
    diagnosis = LiveDiagnosis(twin(), recent, shown.append)
    run = recording("fail", "H1", 1.0)
    state = RigState()
    for number, (duty, row) in enumerate(zip(run.duty, np.asarray(run.temperatures), strict=True)):
        at = START + number * 10**9
        counts = tuple(round(1000 * float(part)) for part in duty)
        for record in (
            Sample("rig", "b", at, number * 10**6, number, counts, None),
            Reading("rig", "b", at, number * 10**6, number, row, False, None),
        ):
            state = state.after(record)
            recent.on_record(record, state)
        if number == ONSET + 30:
            diagnosis.on_finding(Finding("sudden", "T1 is off", "T1"))
    diagnosis.on_time(state, START)
    while len(shown) < 3:
        time.sleep(0.1)
        diagnosis.on_time(state, START)
    diagnosis.close()
    assert [one["state"] for one in shown] == ["awaited", "running", "done"]
    best = shown[2]["causes"][0]["explanations"][0]
    assert best["name"] == "fail H1"
    assert best["onset"] == pytest.approx(START * 1e-9 + ONSET, abs=10.0)


def test_a_diagnosis_with_a_twin_that_is_not_in_use_any_more_is_not_shown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A twin that has learned the change was promoted meanwhile."""
    shown: list[dict[str, Any]] = []
    diagnosis = LiveDiagnosis(twin(), RecentSamples(twin()), shown.append)
    outcomes = [None, Outcome([], ""), Outcome([], "")]
    monkeypatch.setattr(ChildProcess, "is_running", True)
    monkeypatch.setattr(ChildProcess, "take", lambda _: outcomes.pop(0))
    diagnosis.use(twin(), None)
    diagnosis.on_time(RigState(), START)
    diagnosis.on_time(RigState(), START)
    assert shown == []
    diagnosis.on_time(RigState(), START)  # that of the twin in use
    assert [one["state"] for one in shown] == ["done"]
    diagnosis.close()


def test_findings_that_no_diagnosis_can_follow_are_not_awaited_for_ever() -> None:
    shown: list[dict[str, Any]] = []
    recent, state = RecentSamples(twin()), RigState()
    diagnosis = LiveDiagnosis(twin(), recent, shown.append)
    for number in (0, 400):
        at = START + number * 10**9
        for record in (
            Sample("rig", "b", at, number * 10**6, number, (0, 0), None),
            Reading("rig", "b", at, number * 10**6, number, np.full(2, 23.0), False, None),
        ):
            state = state.after(record)
            recent.on_record(record, state)
        if number == 0:
            diagnosis.on_finding(Finding("sudden", "T1 is off", "T1"))
        diagnosis.on_time(state, at)
    diagnosis.close()
    assert [one["state"] for one in shown] == ["awaited", "failed"]
    assert shown[1]["text"] == "expected 180 samples, got 2"


@pytest.mark.slow
def test_an_estimate_that_is_recorded_is_published_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, sent = HandClock(), list[Record]()
    monkeypatch.setattr(Publisher, "send", lambda _, record: sent.append(record))
    publisher = object.__new__(Publisher)  # without a broker
    path = tmp_path / "run.db"
    with Recorder(path, twin().rig) as journal, socket.socket() as opened:
        device = VirtualRig(twin(), controller_rate=4.0)
        source = virtual_bench(twin().rig, device, clock, journal=journal)
        server = PageServer(
            source, TwinBeside(twin(), "values of the rig file"), StopRequest(),
            Access.of("127.0.0.1", 8000), opened, name="virtual rig", recording=path,
            publisher=publisher,
        )  # fmt: skip
        while clock.now() < START + 20e9:
            server.loop.turn()
    times = [one.arrival for one in sent if isinstance(one, StateEstimate)]
    assert len(times) > 10
    assert len(times) == len(set(times))


def test_drive_orders_raise_no_alarm() -> None:
    """A run begins with the greetings that are there already, and the controller has not fallen
    silent by that."""
    clock, raised = HandClock(), list[Finding]()
    with socket.socket() as opened:
        device = VirtualRig(twin(), controller_rate=10.0)
        source = virtual_bench(twin().rig, device, clock)
        server = PageServer(
            source, TwinBeside(twin(), "values of the rig file"), StopRequest(),
            Access.of("127.0.0.1", 8000), opened, name="virtual rig", raised=raised.append,
        )  # fmt: skip
        while clock.now() < START + 12e9:
            server.loop.turn()
        for duty in (0.1, 0.2, 0.3):
            answer = server.desk.ask(DriveOrder((duty, duty), 2.0))
            server.loop.turn()
            assert answer.result(0).obeyed
    assert [one.kind for one in raised if one.is_alarm] == []


@pytest.mark.parametrize("is_welded", [False, True])
def test_after_a_run_the_page_says_what_the_readings_show(is_welded: bool) -> None:
    """A relay that does not open heats on, although the device reports off."""
    clock, raised = HandClock(), list[Finding]()
    with socket.socket() as opened:
        device = VirtualRig(twin(), controller_rate=10.0)
        if is_welded:
            drive_plant = device.twin.drive
            device.twin.drive = lambda duty, ambient=None: (  # pyright: ignore
                drive_plant(duty, ambient) if np.any(duty) else None
            )
        source = virtual_bench(twin().rig, device, clock)
        server = PageServer(
            source, TwinBeside(twin(), "values of the rig file"), StopRequest(),
            Access.of("127.0.0.1", 8000), opened, name="virtual rig", raised=raised.append,
        )  # fmt: skip
        while clock.now() < START + 5e9:
            server.loop.turn()
        answer = server.desk.ask(DriveOrder((0.6, 0.6), 20.0))
        server.loop.turn()
        assert answer.result(0).obeyed
        run = server.page.ring.newest_of("run")["text"]
        assert run == "the time is over; the device reports off"
        end = clock.now() + 61e9
        while clock.now() < end:
            server.loop.turn()
        lines = [line["text"] for line in server.page._lines]
    if is_welded:
        # The stop that follows trips the device.
        assert [one.kind for one in raised if one.is_alarm] == ["heats", "device-trip"]
        assert server.page.heats.startswith("THE RIG HEATS AFTER A STOP: CUT THE POWER; after ")
    else:
        assert [one.kind for one in raised if one.is_alarm] == []
        assert any(line.startswith("the cells are off, as the readings show") for line in lines)


def test_an_order_with_which_the_rig_must_exceed_its_limit_is_refused() -> None:
    low = with_limit(40.0)
    clock = HandClock()
    with socket.socket() as opened:
        source = virtual_bench(low.rig, VirtualRig(low), clock)
        server = PageServer(
            source, TwinBeside(low, "values of the rig file"), StopRequest(),
            Access.of("127.0.0.1", 8000), opened, name="virtual rig",
        )  # fmt: skip
        answer = server.desk.ask(DriveOrder((1.0, 1.0), 600.0))
        server.loop.turn()
    found = answer.result(0)
    assert not found.obeyed
    assert found.text.startswith("plan: expected at most 40 degC, the limit of the rig, got ")
    assert source.number == 0, "nothing was sent"
