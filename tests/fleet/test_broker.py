"""A fleet behind a real broker: Debian's mosquitto, on loopback."""

import contextlib
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from mosquitto import running_broker, topic_client
from small_fleet import fleet_file

from jaxtwin.fleet import Fleet, FleetFile, VirtualFleet
from jaxtwin.physics import Faults

pytestmark = pytest.mark.mosquitto


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[str]:
    with running_broker(tmp_path, "allow_anonymous true\nmax_queued_messages 0\n") as address:
        yield f"mqtt://{address}/plant"


def turn_until(fleet: Fleet, is_done: Callable[[], bool]) -> None:
    end = time.monotonic() + 60.0
    while not is_done() and time.monotonic() < end:
        fleet._receive(0.02)
        fleet.step()
    assert is_done()


def used(fleet: Fleet) -> int:
    return sum(rig.queue.counts["used"] for rig in fleet.rigs.values())


@pytest.mark.slow
def test_no_sample_is_lost_while_a_fleet_is_away(tmp_path: Path, broker: str) -> None:
    path = fleet_file(tmp_path, '["rig-{1..4}"]', broker=broker)
    first = Fleet(path)
    turn_until(first, lambda: first.is_connected)
    with contextlib.closing(VirtualFleet(FleetFile.read(path))) as virtual:
        for _ in range(10):
            virtual.second()
        turn_until(first, lambda: used(first) == 40)
        # It ends as by a kill: nothing is kept, no connection is closed.
        first._inbox._client.socket().close()
        for _ in range(30):
            virtual.second()
        with contextlib.closing(Fleet(path)) as second:
            assert used(second) == 40  # from the journal
            turn_until(second, lambda: used(second) == virtual.sent)
            for rig in second.rigs.values():
                assert rig.queue.counts["gap"] == 0
                assert rig.queue.counts["malformed"] == 0
    first.close()  # what a kill would have left to the system


@pytest.mark.slow
def test_a_fault_is_found_on_its_rig_and_told_to_subscribers(tmp_path: Path, broker: str) -> None:
    path = fleet_file(tmp_path, '["rig-{1..3}"]', broker=broker)
    told: list[str] = []
    heard = topic_client(f"{broker}/rig-2", reads="alerts")
    fault = {"rig-2": Faults.parse("offset=T1@200/4")}
    with (
        contextlib.closing(Fleet(path, lambda alarm, rig: told.append(rig))) as fleet,
        contextlib.closing(VirtualFleet(FleetFile.read(path), fault)) as virtual,
    ):
        turn_until(fleet, lambda: fleet.is_connected)
        for _ in range(260):
            virtual.second()
            fleet._receive(0.0)
        turn_until(fleet, lambda: used(fleet) == virtual.sent)
        fleet._tell()
        assert set(told) == {"rig-2"}
        fleet._receive(0.0)
        text = b""
        while b"}" not in text:
            text += heard.read()
        alert = json.loads(text[: text.index(b"}") + 1])
        assert (alert["rig"], alert["group"]) == ("rig-2", "hall")
    heard.close()


def test_a_rig_that_floods_is_not_listened_to_for_a_while(
    tmp_path: Path, broker: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("jaxtwin.fleet._inbox.GRACE_SECONDS", 0.0)
    monkeypatch.setattr("jaxtwin.fleet._inbox.FLOOD_MULTIPLE", 5.0)
    path = fleet_file(tmp_path, '["rig-{1..2}"]', broker=broker)
    flood = topic_client(f"{broker}/rig-1", writes="readings")
    with contextlib.closing(Fleet(path)) as fleet:
        turn_until(fleet, lambda: fleet.is_connected)
        fleet._receive(0.1)
        for _ in range(200):
            flood.write(b"nonsense")
        turn_until(fleet, lambda: "rig-1" in fleet._inbox.muted)
        assert fleet.problems == ["rig-1 floods, and is not listened to for a minute"]
        assert fleet.rigs["rig-1"].queue.counts["malformed"] > 0
        assert fleet.rigs["rig-2"].queue.counts == {}
    flood.close()
