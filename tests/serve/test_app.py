"""The page, its files, its stream and its numbers, through the ASGI application."""

import asyncio
import json
import re
from collections.abc import AsyncIterator
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from asgi import ask
from hand_clock import START
from small_page import SECOND, NoSource, bench, page, read, twin

from jaxtwin import Experiment, Twin, simulate
from jaxtwin.live import Finding, Reading, RigState
from jaxtwin.observers import ProcessNoise
from jaxtwin.serve import FrameRing, Page, TwinBeside
from jaxtwin.serve._app import KEEPALIVE_SECONDS, stream
from jaxtwin.serve._metrics import Metric, metrics_text
from jaxtwin.serve._rig_layout import rig_layout

ASSETS = files("jaxtwin.serve") / "assets"
SCRIPTS = [entry.name for entry in ASSETS.iterdir() if entry.name.endswith(".js")]


class Links(HTMLParser):
    """The addresses that a page loads, and its inline scripts and styles."""

    def __init__(self, text: str):
        super().__init__()
        self.found: list[str] = []
        self.inline: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.found += [given[key] or "" for key in ("src", "href") if key in given]
        if "style" in given or tag == "style" or (tag == "script" and "src" not in given):
            self.inline.append(tag)


@pytest.mark.slow
def test_everything_that_the_page_loads_is_there_with_its_type() -> None:
    index = ask(bench().app, "/")
    assert index.status == 200
    assert index.headers["content-type"].startswith("text/html")
    links = Links(index.body.decode())
    assert links.inline == []
    for address in links.found:
        answer = ask(bench().app, address)
        assert answer.status == 200
        kind = {"js": "text/javascript", "css": "text/css", "svg": "image/svg+xml"}
        assert answer.headers["content-type"].startswith(kind[address.rsplit(".", 1)[-1]])


@pytest.mark.parametrize("name", SCRIPTS)
def test_modules_import_only_files_that_are_there(name: str) -> None:
    text = (ASSETS / name).read_text(encoding="utf-8")
    imported = re.findall(r'from "([^"]+)"', text)
    assert all(one.startswith("./") for one in imported)
    assert {one.removeprefix("./") for one in imported} <= set(SCRIPTS)


@pytest.mark.parametrize("name", [*SCRIPTS, "page.css", "index.html", "icon.svg"])
def test_nothing_comes_from_another_site(name: str) -> None:
    text = (ASSETS / name).read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
    assert "//" not in re.sub(r"(^|\s)//.*", "", text)
    assert "innerHTML" not in text


def test_the_library_is_as_it_was_released() -> None:
    """uPlot 1.6.32 of npm: its first line names the version."""
    first = (ASSETS / "uplot/uPlot.iife.min.js").read_text(encoding="utf-8").splitlines()[0]
    assert first == "/*! https://github.com/leeoniya/uPlot (v1.6.32) */"
    assert "Leon Sorokin" in (ASSETS / "uplot/LICENSE").read_text(encoding="utf-8")
    assert "1.6.32" in (ASSETS / "uplot/README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("path", ["/", "/assets/page.js", "/history", "/healthz", "/metrics"])
def test_answers_forbid_what_the_page_does_not_need(path: str) -> None:
    headers = ask(bench().app, path).headers
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "frame-ancestors 'none'" in policy
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["referrer-policy"] == "no-referrer"


def test_a_file_that_has_not_changed_is_not_sent_again() -> None:
    first = ask(bench().app, "/assets/page.css")
    again = ask(bench().app, "/assets/page.css", headers={"if-none-match": first.headers["etag"]})
    assert (again.status, again.body) == (304, b"")


@pytest.mark.parametrize(
    "path",
    ["/assets/../_app.py", "/assets/%2e%2e/_app.py", "/assets/index.html", "/assets/", "/none"],
)
def test_no_other_file_is_served(path: str) -> None:
    assert ask(bench().app, path).status == 404


def test_without_javascript_a_table_shows_the_readings() -> None:
    shown = bench()
    assert b"no reading yet" in ask(shown.app, "/").body or shown.page.ring.newest_of("sample")
    read(shown.page, [31.25, float("nan")], 1)
    text = ask(shown.app, "/").body.decode()
    assert "<noscript>" in text
    assert "<td>31.2</td>" in text
    assert "<td>failed</td>" in text
    assert "Expected (estimate)" in text


@pytest.mark.parametrize("span", ["0", "-1", "1e9", "x", "9999999", ""])
def test_a_history_of_no_length_is_refused(span: str) -> None:
    assert ask(bench().app, f"/history?span={span}").status == 400


def test_the_history_has_what_was_read() -> None:
    read(bench().page, [41.5, 22.0], 50)
    found = ask(bench().app, "/history?span=60").json
    assert found["mean"][0][-1] == 41.5
    assert len(found["time"]) == len(found["duty"][0])


async def taken(source: AsyncIterator[bytes], count: int) -> list[bytes]:
    return [await anext(source) for _ in range(count)]


async def _no_wait(_: float) -> None:
    await asyncio.sleep(0)


def test_a_client_that_comes_back_goes_on_behind_its_last_frame() -> None:
    ring = FrameRing(10, "ring")
    for number in range(4):
        ring.append("sample", number)
    parts = asyncio.run(taken(stream(ring, "ring-2", _no_wait, lambda: False), 2))
    assert parts[0] == b"retry: 1000\n\n"
    assert re.findall(rb"id: (\S+)", parts[1]) == [b"ring-3", b"ring-4"]
    assert b"hello" not in parts[1]


@pytest.mark.parametrize("last", ["", "earlier-2", "ring-99", "nonsense\n"])
def test_any_other_client_gets_the_newest_of_each_kind(last: str) -> None:
    ring = FrameRing(10, "ring")
    ring.append("layout", {})
    for number in range(4):
        ring.append("sample", number)
    parts = asyncio.run(taken(stream(ring, last, _no_wait, lambda: False), 2))
    assert re.findall(rb"event: (\S+)", parts[1]) == [b"hello", b"layout", b"sample"]


def test_a_slow_client_hears_how_many_pictures_it_has_lost() -> None:
    ring = FrameRing(3, "ring")
    for number in range(2):
        ring.append("sample", number)

    async def read_slowly() -> bytes:
        source = stream(ring, "ring-1", _no_wait, lambda: False)
        await taken(source, 2)
        for number in range(8):
            ring.append("sample", number)
        return await anext(source)  # frames 3 to 7 of 10 are gone

    hello = asyncio.run(read_slowly())
    assert json.loads(re.search(rb"event: hello\ndata: (.*)", hello)[1])["lost"] == 5  # pyright: ignore


def test_a_quiet_stream_is_kept_open_and_ends_with_the_server() -> None:
    ring, waited = FrameRing(3, "ring"), [0.0]

    async def wait(seconds: float) -> None:
        waited[0] += seconds

    async def read_all() -> list[bytes]:
        return [
            part
            async for part in stream(
                ring, "ring-0", wait, lambda: waited[0] > 2.5 * KEEPALIVE_SECONDS
            )
        ]

    parts = asyncio.run(read_all())
    assert parts[1:] == [b":\n\n"] * 2


def test_a_stream_through_the_application_begins_at_once_and_is_not_kept() -> None:
    answer = ask(bench().app, "/events", chunks=2)
    assert answer.headers["content-type"].startswith("text/event-stream")
    assert answer.headers["cache-control"] == "no-store"
    assert b"event: layout" in answer.body


def test_metrics_are_in_the_format_of_prometheus() -> None:
    """https://prometheus.io/docs/instrumenting/exposition_formats: names, labels, one kind."""
    text = ask(bench().app, "/metrics").body.decode()
    assert text.endswith("\n")
    kinds: dict[str, str] = {}
    for line in text.splitlines():
        if line.startswith("# TYPE"):
            _, _, name, kind = line.split()
            assert name not in kinds
            kinds[name] = kind
        elif not line.startswith("# HELP"):
            found = re.fullmatch(
                r'([a-z_:][a-z0-9_:]*)\{rig="[^"]*"(?:,[a-z]+="[^"]*")?\} (-?[0-9.e+-]+|NaN)', line
            )
            assert found is not None, line
            assert found[1] in kinds
            assert found[1].endswith("_total") == (kinds[found[1]] == "counter")
    assert "jaxtwin_temperature_celsius" in kinds


def test_labels_of_metrics_are_escaped() -> None:
    metric = Metric("x", "gauge", "About\nit.", "name", {'a"b\\c\n': 1.5})
    expected = '# HELP x About\\nit.\n# TYPE x gauge\nx{rig="r",name="a\\"b\\\\c\\n"} 1.5\n'
    assert metrics_text({"r": [metric]}) == expected


def test_a_loop_that_hangs_is_not_healthy(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = bench()
    read(shown.page, [30.0, 30.0], 100)
    assert ask(shown.app, "/healthz").json["status"] == "ok"
    monkeypatch.setattr(shown.page, "turned", shown.page.turned - 60.0)
    answer = ask(shown.app, "/healthz")
    assert (answer.status, answer.json["status"]) == (503, "stuck")


def test_a_reading_that_another_twin_has_not_expected_is_not_shown_beside_it() -> None:
    shown = page()
    state = read(shown, [30.0, 30.0], 1)
    at = START + SECOND + SECOND // 50  # too early for another picture
    late = Reading("rig", "b", at, 1_020_000, 2, np.array([31.0, 31.0]), False, None)
    shown.on_record(late, state.after(late))
    shown.on_time(state.after(late), at)
    shown.follow(TwinBeside(twin(), "another"))
    shown.on_time(state.after(late), at + SECOND)
    assert shown.ring.newest_of("sample")["measured"] == [30.0, 30.0]
    read(shown, [32.0, 32.0], 3, state)
    assert shown.ring.newest_of("sample")["measured"] == [32.0, 32.0]


def test_a_client_of_an_earlier_server_hears_that_nothing_was_found_since() -> None:
    """It still shows the findings and the diagnosis of that server, as if they were there."""
    shown = page()
    assert shown.ring.newest_of("findings") == []
    assert shown.ring.newest_of("diagnosis") == {"state": "none", "causes": []}


def test_what_was_found_with_the_twin_before_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = page()
    state = read(shown, [30.0, 30.0], 1)
    found = (
        Finding("sudden", "T1 is off", "T1", since=START, found=START),
        Finding("drift", "T2 is off", "T2", since=START, found=START, until=START + 5),
    )
    log = shown._beside.monitor._findings._log
    monkeypatch.setattr(type(log), "findings", property(lambda self: found if self is log else ()))
    best = {"name": "stuck T1", "phrase": "T1 is stuck", "probability": 1.0, "onset": 7.0}
    shown.show_diagnosis({"state": "done", "causes": [{"until_s": None, "explanations": [best]}]})
    state = read(shown, [30.0, 30.0], 2, state)
    assert [one["until"] is None for one in shown.ring.newest_of("findings")] == [False, True]
    assert shown.ring.newest_of("story")["rig"]["head"] == "T1 is stuck"
    shown.follow(TwinBeside(twin(), "another"))
    read(shown, [30.0, 30.0], 3, state)
    assert [one["until"] is None for one in shown.ring.newest_of("findings")] == [False, False]
    assert shown.ring.newest_of("diagnosis")["state"] == "none"
    assert shown.ring.newest_of("story")["rig"]["head"] == "The rig is well"


def test_cells_that_may_be_on_are_said_until_the_device_reports_that_they_are_off() -> None:
    shown = page()
    state = read(shown, [30.0, 30.0], 1, counts=(300, 0))
    shown.on_finding(Finding("still-on", "the device reports heat", severity="critical"))
    state = read(shown, [30.0, 30.0], 2, state, counts=(300, 0))
    assert shown.ring.newest_of("story")["rig"]["head"] == "The cells may be on"
    read(shown, [30.0, 30.0], 3, state)
    assert shown.ring.newest_of("story")["rig"]["head"] == "The rig is well"


def test_a_full_disk_is_said_as_long_as_it_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    beside = TwinBeside(twin(), "values of the rig file")
    about = {"source": "a test", "is_live": True, "recording": "", "control": True}
    shown = Page(FrameRing(), NoSource(), beside, about, disk=tmp_path)
    state = None
    for second, free, level in ((1, 2**40, "good"), (2, 2**20, "warning"), (3, 2**40, "good")):
        usage = SimpleNamespace(free=free)
        monkeypatch.setattr("shutil.disk_usage", lambda _, usage=usage: usage)
        state = read(shown, [30.0, 30.0], second, state)
        assert shown.ring.newest_of("story")["rig"]["level"] == level


def test_a_controller_that_falls_silent_is_said_beside_new_readings() -> None:
    shown = page()
    state = read(shown, [30.0, 30.0], 1)
    for second in range(2, 7):
        at = START + second * SECOND
        reading = Reading("rig", "b", at, second * 10**6, second, np.full(2, 30.0), False, None)
        state = state.after(reading)
        shown.on_record(reading, state)
        shown.on_time(state, at)
    assert shown.ring.newest_of("story")["rig"]["head"] == "The controller is silent"


def test_uncertain_parameters_are_estimated_with_their_bands() -> None:
    """A heater that gives less than its twin says."""
    noise = ProcessNoise(names=("P_2", "R_1"), slow=0.3, disturbance=0.01, heat=0.01)
    shown = page()
    assert shown.ring.newest_of("layout")["uncertain"] == []
    assert shown.history.over(60.0)["parameter"] == []
    shown.follow(TwinBeside(twin(), "with drift", noise=noise))
    rows = shown.ring.newest_of("layout")["uncertain"]
    assert [(row["name"], row["unit"], row["value"]) for row in rows] == [
        ("P_2", "W", 0.75),
        ("R_1", "K/W", 60.0),
    ]
    weaker = simulate(
        twin().with_values({"P_2": 0.6}),
        Experiment.schedule("0:0/1", duration=300, step=1, cells=2),
    )
    state = RigState()
    driven = (0, twin().rig.driver.counts)
    for second, readings in enumerate(weaker.temperatures):
        state = read(shown, readings.tolist(), second + 1, state, driven)
    outlook = shown.ring.newest_of("outlook")
    assert outlook["parameter"][0] == pytest.approx(0.6, rel=0.05)
    assert outlook["parameter_lower"][0] < 0.6 < outlook["parameter_upper"][0] < 0.75
    found = shown.history.over(600.0)
    assert found["parameter"][0][0] is None
    assert found["parameter"][0][2] == pytest.approx(0.75, rel=0.02)
    assert found["parameter"][0][-1] == pytest.approx(outlook["parameter"][0], rel=0.01)


def test_pictures_that_are_late_by_a_turn_are_still_ten_in_a_second() -> None:
    sent: list[str] = []
    shown = page(FrameRing(on_frame=lambda kind, text: sent.append(kind)))
    state = RigState()
    for number in range(100):  # ten in a second, each read up to 40 ms after it came
        at = START + number * SECOND // 10
        reading = Reading("rig", "b", at, number * 100_000, number, np.full(2, 23.0), False, None)
        state = state.after(reading)
        shown.on_record(reading, state)
        shown.on_time(state, at + number * 7 % 5 * SECOND // 100)
    assert 98 <= sent.count("sample") <= 100


def test_a_heater_is_outlined_where_its_heat_goes() -> None:
    """The printer's board touches the nine elements in the middle of its bed, 1 cm from the rim."""
    (heater,) = rig_layout(Twin("printer-bed"))["driven"]
    assert heater["outline"][0] == [0.01, 0.01]
    assert heater["outline"][2] == pytest.approx([0.204, 0.204])


def test_the_log_and_the_ring_do_not_grow() -> None:
    shown = page(FrameRing(50))
    for number in range(300):
        shown.say("plain", f"line {number}")
    lines = shown.ring.newest_of("log")
    assert len(lines) == 60
    assert lines[-1]["text"] == "line 299"


def test_the_dashboard_of_grafana_asks_for_metrics_that_are_there() -> None:
    file = Path(__file__).parents[2] / "docs/operations/grafana-jaxtwin.json"
    asked = set(re.findall(r"jaxtwin_[a-z_]+", file.read_text(encoding="utf-8")))
    text = ask(bench().app, "/metrics").body.decode()
    assert asked <= set(re.findall(r"# TYPE (\S+)", text))
    assert len(asked) >= 8


@pytest.mark.parametrize(("a_second", "longest"), [(10, 0.0), (100, 0.1)])
def test_readings_gather_between_pictures_only_if_there_are_several_for_each(
    a_second: int, longest: float
) -> None:
    """A rig at ten times its speed makes a hundred; one at its own speed is read at once."""
    sent: list[str] = []
    shown = page(FrameRing(on_frame=lambda kind, text: sent.append(kind)))
    state, number, now, pauses = RigState(), 0, START, list[float]()
    while now < START + 5 * SECOND:
        now += SECOND // a_second
        pause = shown.pause(now)
        now += round(pause * SECOND)
        pauses.append(pause)
        while START + number * SECOND // a_second <= now:
            at, number = START + number * SECOND // a_second, number + 1
            us = (at - START) // 1000
            reading = Reading("rig", "b", at, us, number, np.full(2, 23.0), False, None)
            state = state.after(reading)
            shown.on_record(reading, state)
        shown.on_time(state, now)
    assert max(pauses) <= longest
    assert (max(pauses) > 0.05) == (longest > 0)
    assert 48 <= sent.count("sample") <= 51
