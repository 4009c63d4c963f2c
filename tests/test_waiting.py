"""Who waits for more than two seconds is told for what."""

import io
import logging
import time
from types import SimpleNamespace

import pytest

import jaxtwin as jt
from jaxtwin import _progress
from jaxtwin._progress import advanced, announced, counting, silent


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def screen(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    monkeypatch.setattr(_progress, "PRINTED_AFTER", 0.05)
    terminal = Terminal()
    monkeypatch.setattr(_progress, "sys", SimpleNamespace(stderr=terminal, modules={}))
    return terminal


def test_long_work_is_announced_and_timed(screen):
    start = time.perf_counter()
    with announced("match"):
        time.sleep(0.2)
        assert screen.getvalue() == "jaxtwin: match ...\n"
    longest = time.perf_counter() - start
    told = screen.getvalue().splitlines()[1]
    seconds = float(told.removeprefix("jaxtwin: match: ").removesuffix(" s"))
    assert 0.2 <= seconds <= longest + 0.05


def test_short_work_is_not_announced(screen):
    with announced("match"):
        pass
    time.sleep(0.1)
    assert screen.getvalue() == ""


def test_it_says_how_much_was_compilation(screen, monkeypatch):
    clock = iter([1.0, 8.0])
    monkeypatch.setattr(_progress, "compiling_seconds", lambda: next(clock))
    with announced("match"):
        time.sleep(0.1)
    assert "7.0 s of it compilation, which is kept for the next time" in screen.getvalue()


@pytest.mark.parametrize(("seconds", "is_said"), [(0.024, False), (0.026, True)])
def test_compilation_is_mentioned_from_half_of_printed_after(screen, monkeypatch, seconds, is_said):
    """Here 0.05 s, for users 2 s."""
    clock = iter([1.0, 1.0 + seconds])
    monkeypatch.setattr(_progress, "compiling_seconds", lambda: next(clock))
    with announced("match"):
        time.sleep(0.1)
    assert ("of it compilation" in screen.getvalue()) is is_said


def test_work_within_work_is_silent(screen):
    with announced("sensitivity"), announced("simulation"):
        time.sleep(0.1)
    assert "simulation" not in screen.getvalue()
    with silent(), announced("match"):
        time.sleep(0.1)
    assert "match" not in screen.getvalue()


def test_nothing_is_written_where_nobody_reads(monkeypatch):
    """A log or a pipe of somebody else's keeps its form."""
    pipe = io.StringIO()
    monkeypatch.setattr(_progress, "sys", SimpleNamespace(stderr=pipe, modules={}))
    with announced("match"):
        time.sleep(0.1)
    assert pipe.getvalue() == ""


def test_work_is_announced_in_a_notebook(screen, monkeypatch):
    notebook = io.StringIO()
    modules = {"ipykernel": None}
    monkeypatch.setattr(_progress, "sys", SimpleNamespace(stderr=notebook, modules=modules))
    with announced("match"):
        time.sleep(0.1)
    assert notebook.getvalue().startswith("jaxtwin: match ...")


def test_the_time_is_printed_also_where_the_work_fails(screen):
    def fail() -> None:
        time.sleep(0.1)
        raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"), announced("match"):
        fail()
    assert len(screen.getvalue().splitlines()) == 2


@pytest.fixture
def clock(monkeypatch):
    """A clock that a test turns."""
    now = [100.0]
    monkeypatch.setattr(_progress.time, "perf_counter", lambda: now[0])
    return now


def test_progress_is_logged_with_the_time_that_remains_every_ten_seconds(caplog, clock):
    """A quarter is done in 12 s: 36 s remain."""
    caplog.set_level(logging.INFO, "jaxtwin")
    with announced("sensitivity analysis"):
        report = counting(400, None)
        report(50)
        clock[0] += 12
        report(50)
        clock[0] += 9
        report(100)  # less than ten seconds after the last message
        clock[0] += 700
        report(100)
    assert caplog.messages == [
        "sensitivity analysis: 100 of 400, 36 s left",
        "sensitivity analysis: 300 of 400, 4 min left",
        "sensitivity analysis: 721.0 s",
    ]


def test_progress_reaches_a_user_s_callback_and_the_command_line(clock):
    told, shown = [], []
    with silent(shown.append), announced("match"):
        counting(3, told.append)(2)
        advanced(7, None, "RMSE 0.3 K")
    assert told == [2]
    assert shown == ["2 of 3, 0 s left", "7, RMSE 0.3 K"]
    advanced(1)  # outside of work nobody waits


@pytest.mark.slow
@pytest.mark.parametrize(
    "work",
    [
        lambda twin, made: jt.global_sensitivity(twin, made, draws=32, method="sobol"),
        lambda twin, made: jt.sensitivity(twin, made, draws=40),
        lambda twin, made: jt.match(twin, made, free=["R_E"], max_iterations=2),
        lambda twin, made: jt.simulate_batch(twin, made, {"R_E": [1.9, 2.0, 2.1]}),
    ],
    ids=["sobol", "correlations", "match", "batch"],
)
def test_long_work_reports_its_progress(work):
    twin = jt.Twin("dual-cell")
    schedule = jt.Experiment.schedule("0:0.5", duration=20, cells=2)
    shown = []
    with silent(shown.append):
        work(twin, twin.simulate(schedule).to_recording())
    assert shown
