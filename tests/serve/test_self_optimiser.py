"""A controller that is tuned again and watched: when a candidate is promoted, how it takes over,
and how the one before comes back."""

from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hand_clock import HandClock, virtual_bench
from tuned_board import DESIGN, fit, pid, text

from jaxtwin import TwinStore
from jaxtwin.control import PID, Decision
from jaxtwin.live import Finding, Record, RigState, Sample, StopRequest, VirtualRig
from jaxtwin.retuning import LoopBand, TrialScenario, retune_champion
from jaxtwin.serve import Champion, Desk, FrameRing, Page, RigLoop, SelfOptimiser, TwinBeside
from jaxtwin.serve import _self_optimiser as module
from jaxtwin.serve._child_process import Outcome
from jaxtwin.serve._desk import HoldOrder, PromoteOrder
from jaxtwin.serve._self_optimiser import (
    MAX_A_DAY,
    PAUSE_SECONDS,
    PROBATION_SECONDS,
    PROBATION_TAG,
    Policy,
    retuned_champion,
)

TRIAL = {
    "decision": "accepted",
    "scenarios": [{"name": "steps"}],
    "band": LoopBand(0.2, (1.0, 1.0, 1.0, 0.5, 0.2, 0.1, 0.0), 10.0).to_dict(),
}


def candidate(store: TwinStore, Kp: float = 0.04) -> int:
    """Adds a pair of the champion's twin and another controller, and returns its version."""
    return store.add(
        fit(),
        reason="all scenarios were passed",
        parent="champion",
        aliases=["challenger"],
        controller=text(pid(Kp)),
        trial=TRIAL,
    ).number


@pytest.fixture
def store(tmp_path: Path) -> TwinStore:
    store = TwinStore(tmp_path / "twins.db")
    store.add(fit(), reason="first match", aliases=["champion"])
    return store


class Optimised:
    """An optimiser with its clock and with what it says."""

    def __init__(self, store: TwinStore, policy: Policy = "apply"):
        self.time = datetime.now(UTC)
        self.lines: list[str] = []
        self.optimiser = SelfOptimiser(
            store,
            fit().twin.rig,
            pid(),
            DESIGN,
            policy,
            lambda level, line: self.lines.append(line),
            lambda: self.time,
        )

    def propose(self, number: int | None) -> None:
        """As a process would that has tuned the controller."""
        outcome = Outcome(("accepted: better", number), "")
        with patch.object(self.optimiser._process, "take", return_value=outcome):
            self.optimiser.turn(is_at_rest=False)


def test_a_candidate_is_promoted_at_rest_and_not_before(store: TwinStore):
    optimised = Optimised(store)
    optimised.propose(candidate(store))
    assert not optimised.optimiser.turn(is_at_rest=False)
    assert store.aliases["champion"] == 1
    assert optimised.optimiser.turn(is_at_rest=True)
    assert store.aliases == {"champion": 2, "previous": 1}


def test_a_proposal_waits_for_somebody(store: TwinStore):
    optimised = Optimised(store, "propose")
    optimised.propose(candidate(store))
    assert not optimised.optimiser.turn(is_at_rest=True)
    assert store.aliases == {"champion": 1, "challenger": 2}
    assert optimised.lines[-1] == "version 2 waits for somebody to promote it"


def test_a_candidate_of_another_twin_than_the_champion_is_not_promoted(store: TwinStore):
    optimised = Optimised(store)
    optimised.propose(candidate(store))
    refitted = store.add(fit(), reason="refitted", parent=1, aliases=["champion"])
    optimised.optimiser.number = refitted.number  # as the loop has followed it
    assert not optimised.optimiser.turn(is_at_rest=True)
    assert store.aliases["champion"] == refitted.number


def test_promotions_are_few_and_far_apart(store: TwinStore):
    """Also if the server is started again in between, because the store remembers them."""
    promoted, optimised = 0, Optimised(store)
    for _ in range(12):
        optimised = Optimised(store)
        optimised.time += timedelta(seconds=promoted * PAUSE_SECONDS)
        store.set_tag("champion", PROBATION_TAG, "passed")
        optimised.optimiser.use(store.version("champion"))
        optimised.propose(candidate(store))
        promoted += optimised.optimiser.turn(is_at_rest=True)
    assert promoted == MAX_A_DAY
    optimised.time += timedelta(days=1)
    assert optimised.optimiser.turn(is_at_rest=True)


def test_nothing_is_promoted_during_a_probation_and_too_soon_after(store: TwinStore):
    optimised = Optimised(store)
    store.promote(candidate(store), reason="by hand")
    optimised.optimiser.use(store.version("champion"))
    assert optimised.optimiser.is_on_probation
    optimised.time += timedelta(days=2)
    optimised.propose(candidate(store, 0.05))
    assert not optimised.optimiser.turn(is_at_rest=True)
    optimised.optimiser.is_on_probation = False
    optimised.time += timedelta(seconds=10)
    assert optimised.optimiser.turn(is_at_rest=True)


def test_a_refit_begins_the_tuning_and_a_rollback_does_not(
    store: TwinStore, monkeypatch: pytest.MonkeyPatch
):
    optimised = Optimised(store)
    begun: list[Any] = []
    monkeypatch.setattr(optimised.optimiser._process, "begin", lambda *given: begun.append(given))
    refitted = store.add(fit(), reason="refitted", parent=1, aliases=["champion"])
    optimised.optimiser.use(refitted)
    assert [given[0] for given in begun] == [retuned_champion]
    optimised.optimiser.use(store.version(candidate(store)))
    optimised.optimiser.use(refitted)
    optimised.optimiser.use(store.version(1))
    assert len(begun) == 1


def test_a_controller_that_keeps_to_its_trial_is_trusted(store: TwinStore):
    optimised = Optimised(store)
    store.promote(candidate(store), reason="by hand")
    optimised.optimiser.use(store.version("champion"))
    assert not optimised.optimiser.is_at_rest
    for second in range(int(PROBATION_SECONDS) + 2):
        optimised.optimiser.update(
            Decision(float(second), np.full(2, 30.0), np.full(2, 29.9), np.zeros(2))
        )
    assert optimised.optimiser.is_at_rest
    assert not optimised.optimiser.worse
    assert not optimised.optimiser.is_on_probation
    assert PROBATION_TAG in store.version("champion").tags
    again = Optimised(store)  # after a restart
    assert not again.optimiser.is_on_probation


def test_a_restart_goes_on_with_the_probation(store: TwinStore):
    store.promote(candidate(store), reason="by hand")
    again = Optimised(store)
    assert again.optimiser.is_on_probation
    assert isinstance(again.optimiser.controller, PID)
    np.testing.assert_allclose(again.optimiser.controller.Kp, 0.04)
    assert isinstance(again.optimiser.previous, PID)
    np.testing.assert_allclose(again.optimiser.previous.Kp, 0.02)


@pytest.mark.slow
def test_a_champion_is_retuned_and_the_decision_is_kept(
    store: TwinStore, monkeypatch: pytest.MonkeyPatch
):
    steps = [TrialScenario("steps", "the references")]
    quick = partial(retune_champion, draws=4, scenarios=steps)
    monkeypatch.setattr(module, "retune_champion", quick)
    said, number = retuned_champion(store, pid(), DESIGN)
    assert said.startswith("accepted: the cost is")
    assert number == 2
    version = store.version(2)
    assert (version.parent, version.aliases) == (1, ("challenger",))


class Bench:
    """A virtual `tclab` whose loop has an optimiser."""

    def __init__(self, store: TwinStore, policy: Policy = "apply", **differs: float):
        self.clock = HandClock()
        self.device = VirtualRig(fit().twin.with_values(differs), controller_rate=4.0)
        source = virtual_bench(fit().twin.rig, self.device, self.clock)
        about = {"source": "virtual rig", "is_live": True, "recording": "", "control": True}
        beside = TwinBeside(fit().twin, "version 1")
        self.page = Page(FrameRing(), source, beside, about)
        self.desk = Desk(StopRequest())
        self.optimiser = SelfOptimiser(store, fit().twin.rig, pid(), DESIGN, policy, self.page.say)
        champion = Champion(store, lambda version: TwinBeside(fit().twin, str(version.number)))
        self.notes: list[Any] = []
        self.samples: list[tuple[float, tuple[int, ...]]] = []
        self.actions: dict[int, Any] = {}
        self.loop = RigLoop(
            source,
            self.page,
            self.desk,
            champion=champion,
            optimiser=self.optimiser,
            controller=pid(),
            consumers=(self,),
        )

    def on_record(self, record: Record, state: RigState) -> None:
        if isinstance(record, Sample) and self.loop._order is not None:
            self.samples.append((self.loop._elapsed, record.pwm))

    def on_time(self, state: RigState, now: int) -> None:
        for second in [one for one in self.actions if one <= self.loop._elapsed]:
            self.actions.pop(second)()

    def lines(self) -> list[str]:
        return [line["text"] for line in self.page.ring.newest_of("log")]

    def hold(self, reference: float, seconds: float) -> None:
        while self.clock.now() < 3e9 + 1_700_000_000_000_000_000:
            self.loop.turn()
        self.desk.ask(HoldOrder((reference, reference), seconds))
        self.loop.turn()

    def duty(self, since: float, until: float) -> np.ndarray:
        counts = fit().twin.rig.driver.counts
        rows = [pwm for at, pwm in self.samples if since <= at < until]
        return np.array(rows, float) / counts


def test_a_promoted_controller_takes_over_in_a_run_without_a_jump_of_the_duty(store: TwinStore):
    bench = Bench(store)
    bench.actions[60] = lambda: candidate(store)
    bench.actions[61] = lambda: bench.desk.ask(PromoteOrder("2", "it passed"))
    bench.hold(30.0, 120.0)
    assert "another controller from now on: version 2: all scenarios were passed" in bench.lines()
    assert "the time is over; the device reports off" in bench.lines()
    assert bench.optimiser.number == 2
    assert bench.page.ring.newest_of("twins")["followed"] == 2
    assert bench.page.followed[1] == "version 1"  # the twin is the same: its observer goes on
    driven = bench.duty(50.0, 100.0)
    assert len(driven) > 50
    assert (driven.max(axis=1) > 0).all()
    assert np.abs(np.diff(driven, axis=0)).max() < 0.05  # noise of 0.04 1/K and an LSB


def test_a_controller_with_other_limits_waits_until_the_run_has_ended(store: TwinStore):
    bench = Bench(store)
    other = PID(Kp=0.04, Ki=0.0003, limits=(0, 0.9), measured=(("T1",), ("T2",)))
    numbers: list[int] = []
    bench.actions[20] = lambda: store.add(
        fit(), reason="lower limits", parent=1, aliases=["champion"], controller=text(other)
    )
    bench.actions[40] = lambda: numbers.append(bench.optimiser.number)
    bench.hold(30.0, 50.0)
    assert numbers == [1]
    assert "the time is over; the device reports off" in bench.lines()
    bench.clock.turn(6.0)
    bench.loop.turn()
    assert bench.optimiser.number == 2
    assert bench.loop._controller is not None
    assert bench.loop._controller.limits == (0, 0.9)


@pytest.mark.slow
def test_a_loop_that_swings_on_a_rig_that_is_slower_than_its_twin_goes_back_by_itself(
    store: TwinStore,
):
    """The sensors lag by 80 s in place of 20, which nothing says."""
    store.promote(candidate(store, 0.4), reason="by hand")
    bench = Bench(store, tau_1=80.0, tau_2=80.0)
    bench.loop._champion.number = 2  # pyright: ignore[reportOptionalMemberAccess]
    bench.hold(30.0, 900.0)
    assert store.aliases["champion"] == 1
    assert "above the" in store.history("champion")[-1].reason
    assert "the time is over; the device reports off" in bench.lines()
    assert isinstance(bench.loop._controller, PID)
    np.testing.assert_allclose(bench.loop._controller.Kp, 0.02)
    driven = bench.duty(600.0, 900.0)
    assert np.abs(np.diff(driven, axis=0)).max() < 0.05


@pytest.mark.parametrize("reason", ["trial", "alarm"])
def test_the_controller_before_is_back_within_a_sample_of_a_reason(store: TwinStore, reason: str):
    bench = Bench(store)
    store.promote(candidate(store), reason="by hand")
    bench.optimiser.use(store.version("champion"))
    bench.loop._controller = bench.optimiser.controller
    assert bench.loop._champion is not None
    bench.loop._champion.number = 2
    gains: list[float] = []

    def doubt() -> None:
        if reason == "trial":
            bench.optimiser.worse = "it swings"
        else:
            bench.loop.on_finding(Finding("changed", "it swings", severity="warning"))
        begun.append(bench.loop._elapsed)

    def look() -> None:
        assert isinstance(bench.loop._controller, PID)
        gains.append(float(np.asarray(bench.loop._controller.Kp)))

    begun: list[float] = []
    bench.actions[40] = doubt
    bench.actions[41] = look  # a sample later
    bench.hold(30.0, 80.0)
    assert gains == [0.02]
    assert store.aliases["champion"] == 1
    assert "it swings" in store.history("champion")[-1].reason
    assert any(line.startswith("another controller from now on: back") for line in bench.lines())
    assert "the time is over; the device reports off" in bench.lines()
    driven = bench.duty(35.0, 70.0)
    assert np.abs(np.diff(driven, axis=0)).max() < 0.05
    assert not bench.optimiser.is_on_probation


def test_a_trip_during_a_probation_brings_the_controller_before_back_once_the_cells_are_off(
    store: TwinStore, monkeypatch: pytest.MonkeyPatch
):
    bench = Bench(store)
    store.promote(candidate(store), reason="by hand")
    bench.optimiser.use(store.version("champion"))
    assert bench.loop._champion is not None
    bench.loop._champion.number = 2
    bench.actions[20] = lambda: setattr(bench.loop._source, "tap", without_readings)
    rolled: list[Any] = []
    back = TwinStore.rollback

    def rolling(self: TwinStore, *, reason: str) -> Any:
        rolled.append(bench.device.pwm)
        return back(self, reason=reason)

    monkeypatch.setattr(TwinStore, "rollback", rolling)
    bench.hold(30.0, 60.0)
    assert not any(bench.device.pwm)
    bench.loop.turn()
    assert rolled == [(0, 0)]
    assert store.aliases["champion"] == 1
    assert "stopped" in store.history("champion")[-1].reason
    assert isinstance(bench.loop._controller, PID)
    np.testing.assert_allclose(bench.loop._controller.Kp, 0.02)


def without_readings(records: list[Any]) -> list[Any]:
    return [record for record in records if isinstance(record, Sample)]


def test_times_are_those_of_the_documentation():
    assert (PAUSE_SECONDS, MAX_A_DAY, PROBATION_SECONDS) == (1800.0, 3, 1800.0)
    assert module.PROBATION_TAG == "probation"
