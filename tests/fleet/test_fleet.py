"""A fleet without a broker: what it is told, what it keeps, and what it says."""

import json
import time

import pytest
from asgi import ask
from small_fleet import encoded, fleet_file, messages, run, twin

from jaxtwin import JaxtwinError
from jaxtwin.fleet import Fleet, fleet_app, overview
from jaxtwin.fleet._jobs import Jobs
from jaxtwin.fleet._journal import FleetJournal
from jaxtwin.fleet._sample_queue import Kind
from jaxtwin.live import Finding
from jaxtwin.serve import Access

ACCESS = Access(frozenset({"127.0.0.1:8000"}), "the-token", False)


def give(fleet: Fleet, begin: int, end: int, offset: float = 3.0, rigs: str = "abc") -> None:
    """Gives a fleet the messages of some seconds; a channel of `b` is off from 250 s on."""
    for place, name in enumerate(rigs):
        readings, counts = run(place + 1)
        readings = readings.copy()
        if name == "b":
            readings[250:, 0] += offset
        several = list(messages(readings, counts))
        times = [content["time"] for _, content in several]
        first = min(times)
        chosen: list[tuple[str, Kind, bytes]] = [
            (name, kind, encoded(content))
            for kind, content in several
            if begin <= content["time"] - first < end
        ]
        fleet.hear(fleet._journal.add(time.time_ns(), chosen))
    fleet.step(is_all=True)


def keys(fleet: Fleet, rig: str) -> list[tuple]:
    found = fleet.rigs[rig]._findings.findings
    return [(one.kind, one.channel, one.since, one.found, one.until) for one in found]


@pytest.fixture
def fleets():
    """Makes fleets that are closed at the end."""
    made: list[Fleet] = []

    def make(*arguments, **options) -> Fleet:
        made.append(Fleet(*arguments, **options))
        return made[-1]

    yield make
    for one in made:
        one.close()


@pytest.mark.slow
def test_what_is_found_survives_a_process_that_ends_at_any_time(tmp_path, fleets):
    told: list[tuple] = []

    def ring(alarm: Finding, rig: str) -> None:
        told.append((rig, alarm.kind, alarm.channel, alarm.found))

    (tmp_path / "whole").mkdir()
    (tmp_path / "parts").mkdir()
    whole = fleets(fleet_file(tmp_path / "whole"))
    give(whole, 0, 420)
    path = fleet_file(tmp_path / "parts")
    first = fleets(path, ring)
    give(first, 0, 100)
    first._keep_states(list(first.rigs.values()))
    give(first, 100, 300)  # which the kept states do not know
    first._tell()
    second = fleets(path, ring)
    assert keys(second, "b") == keys(first, "b")
    give(second, 300, 420)
    second._tell()
    assert keys(second, "b") == keys(whole, "b") != []
    assert keys(second, "a") == keys(whole, "a")
    assert second.rigs["b"].queue.counts["used"] == 420
    assert len(told) == len(set(told))  # nothing is told twice
    assert {one[0] for one in told} == {"b"}


def test_rigs_come_go_and_get_other_twins_while_it_runs(tmp_path, fleets):
    path = fleet_file(tmp_path, '["a", "b"]')
    fleet = fleets(path)
    give(fleet, 0, 30, rigs="ab")
    blocks = len(fleet._blocks)
    path.write_text(path.read_text().replace('["a", "b"]', '["b", "c"]'))

    def look() -> None:
        fleet._read = 0
        fleet._look_at_files()
        for future in fleet._making.values():
            future.exception()
        fleet._take_made()

    look()
    assert list(fleet.rigs) == ["b", "c"]
    assert fleet.rigs["b"].queue.counts["used"] == 30
    assert len(fleet._blocks) == blocks  # it compiles nothing
    values = tmp_path / "values.toml"
    values.write_text('[parameters]\nR_1 = { value = 66.0, unit = "K/W" }\n')
    path.write_text(f'{path.read_text()}parameters = "values.toml"\n')
    look()
    assert fleet.rigs["c"].made.label == "values of values.toml"
    assert float(fleet.rigs["c"].made.twin.values["R_1"]) == 66.0
    path.write_text(path.read_text().replace("tclab", "no-rig"))
    look()
    assert list(fleet.rigs) == ["b", "c"]  # which go on
    assert any("no-rig" in problem for problem in fleet.problems)
    path.write_text("format = 1")
    look()
    assert "broker: missing" in fleet.problem


def test_an_overview_a_page_and_metrics_of_each_rig(tmp_path, fleets):
    fleet = fleets(fleet_file(tmp_path))
    give(fleet, 0, 420)
    content = overview(fleet)
    json.dumps(content, allow_nan=False)
    assert content["answers"]["rig"]["head"] == "2 of 3 are well"
    lines = {line["name"]: line["rig"][0] for line in content["rigs"]}
    assert lines == {"a": "good", "b": "warning", "c": "good"}
    app = fleet_app(fleet, ACCESS)
    for path in ("/", "/rigs/b", "/assets/fleet/fleet.js", "/assets/view.js", "/overview"):
        assert ask(app, path).status == 200
    frames = dict(ask(app, "/rigs/b/frames").json)
    assert frames["sample"]["measured"][0] is not None
    assert frames["findings"]
    assert frames["story"]["rig"]["level"] == "warning"
    history = ask(app, "/rigs/b/history").json
    assert len(history["mean"]) == len(twin().channels)
    text = ask(app, "/metrics").body.decode()
    assert 'jaxtwin_rig_severity{rig="b"} 3' in text
    assert text.count("# TYPE jaxtwin_rig_severity") == 1
    assert ask(app, "/rigs/none/frames").status == 404
    assert ask(app, "/", headers={"host": "evil.example"}).status == 403
    assert ask(app, "/healthz").status == 503  # there is no broker


def test_an_old_forecast_is_not_compared_with_readings_of_now(tmp_path, fleets):
    fleet = fleets(fleet_file(tmp_path))
    give(fleet, 0, 60)
    fleet._look_ahead()
    assert fleet.rigs["a"].story()["minute"].level == "good"
    give(fleet, 60, 80)
    assert fleet.rigs["a"].story()["minute"].level == "good"
    give(fleet, 80, 120)
    assert fleet.rigs["a"].story()["minute"].head == "No forecast"


def test_who_has_no_token_orders_nothing(tmp_path, fleets):
    fleet = fleets(fleet_file(tmp_path))
    headers = {"content-type": "application/json", "origin": "http://127.0.0.1:8000"}
    app = fleet_app(fleet, ACCESS)

    def refit(rig: str, **more: str) -> int:
        path = f"/rigs/{rig}/refit"
        return ask(app, path, method="POST", headers={**headers, **more}, body=(b"{}",)).status

    assert refit("a") == 401
    assert refit("a", authorization="Bearer the-token") == 403  # it only shows
    assert refit("none", authorization="Bearer the-token") == 404


def test_what_several_rigs_have_in_common_and_an_alarm_for_all_of_them(tmp_path, fleets):
    told: list[tuple[Finding, str]] = []
    path = fleet_file(tmp_path, '["rig-{1..5}"]', silence_s=1.0)
    fleet = fleets(path, lambda alarm, rig: told.append((alarm, rig)))
    for rig in fleet.rigs.values():
        rig._since = time.monotonic() - 2.0
        rig.update_alarms("")
    fleet._tell()
    ((alarm, rig),) = told
    assert (alarm.kind, rig) == ("silent", "")
    assert alarm.detail.startswith("5 rigs, such as rig-1, rig-2, rig-3")
    (trend,) = overview(fleet)["trends"]
    assert trend["text"] == "5 of 5 in hall: no readings"


def test_a_broker_that_is_gone_is_no_silence_of_its_rigs(tmp_path, fleets):
    fleet = fleets(fleet_file(tmp_path, silence_s=1.0))
    rig = fleet.rigs["a"]
    rig._since = time.monotonic() - 2.0
    rig.update_alarms("the broker is gone")
    assert rig.findings == ()


def test_the_last_minutes_are_a_recording(tmp_path, fleets):
    fleet = fleets(fleet_file(tmp_path))
    give(fleet, 0, 300)
    recorded = fleet.rigs["a"].recorded(fleet._journal)
    assert len(recorded.time) == 300
    readings, counts = run(1)
    assert recorded.temperatures == pytest.approx(readings[:300], abs=1e-3)
    duty = counts[:300] / twin().rig.driver.counts
    assert recorded.duty[:299] == pytest.approx(duty[:299], abs=1e-2)


def test_jobs_end_with_their_result_or_their_problem():
    class Here:
        """An executor that works at once."""

        def submit(self, work, *arguments):
            from concurrent.futures import Future

            future = Future()
            try:
                future.set_result(work(*arguments))
            except Exception as problem:
                future.set_exception(problem)
            return future

    jobs = Jobs(Here())
    assert jobs.begin("a", "double", lambda number: 2 * number, lambda: (21,))

    def refuse():
        raise JaxtwinError("expected 180 samples, got 3")

    jobs.begin("b", "double", lambda: 0, refuse)
    ended = []
    while len(ended) < 2:
        ended += jobs.take()
    assert {(one.rig, one.value, one.problem) for one in ended} == {
        ("a", 42, ""),
        ("b", None, "expected 180 samples, got 3"),
    }
    jobs.close()


def test_a_file_that_is_no_journal_is_refused(tmp_path):
    file = tmp_path / "notes.db"
    file.write_text("some text that is long enough to be no database" * 20)
    with pytest.raises(JaxtwinError, match="expected the journal of a fleet"):
        FleetJournal(file)


def test_old_messages_are_forgotten(tmp_path):
    journal = FleetJournal(tmp_path / "fleet.db")
    journal.add(10, [("a", "readings", b"1"), ("b", "readings", b"2")])
    journal.add(20, [("a", "readings", b"3")])
    journal.forget(15)
    assert [message.payload for message in journal.after("a", 0, 9)] == [b"3"]
    assert journal.after("b", 0, 9) == []
    journal.close()
