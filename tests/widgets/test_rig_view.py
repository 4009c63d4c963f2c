"""The page of a rig in a notebook, as the kernel sees it: a recording that is replayed."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hand_clock import HandClock, virtual_bench
from small_page import twin

import jaxtwin as jt
from jaxtwin.live import Recorder, Replay, Service, VirtualRig
from jaxtwin.widgets import RigView


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Half a minute of a virtual rig."""
    file, clock = tmp_path / "session.db", HandClock()
    device = VirtualRig(twin(), controller_rate=4.0)
    with Recorder(file, twin().rig, clock=clock) as recorder:
        source = virtual_bench(twin().rig, device, clock, journal=recorder)
        end, service = clock.now() + 30 * 10**9, Service(source)
        service.run(lambda: clock.now() > end)
        source.close()
    return file


def answers(view: RigView, request: dict[str, Any]) -> list[dict[str, Any]]:
    """What a view gets that asks after the thread has ended."""
    assert view._thread is not None
    view._thread.join(60)
    messages: list[dict[str, Any]] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(view, "send", lambda content, buffers: messages.append(content))
        view.on_request(request)
    return messages


def frames_of(view: RigView) -> dict[str, Any]:
    """The frames with which a view begins."""
    return {one["kind"]: json.loads(one["content"]) for one in answers(view, {"kind": "hello"})}


@pytest.mark.slow
def test_a_replay_is_shown_with_what_the_twin_expects(recording: Path) -> None:
    view = RigView(Replay(recording, speed=20), twin())
    frames = frames_of(view)
    assert frames["layout"]["rig"] == "tclab"
    assert not frames["layout"]["is_live"]
    assert not frames["layout"]["control"]
    np.testing.assert_allclose(frames["outlook"]["channels"], 23.0, atol=0.5)
    assert {"story", "log"} <= frames.keys()
    assert view.problem is None
    view.close()


def test_a_history_is_that_of_the_asked_span(recording: Path) -> None:
    view = RigView(Replay(recording, speed=np.inf), twin())
    (answer,) = answers(view, {"kind": "history", "span": 10})
    assert answer["kind"] == "history"
    assert answer["content"]["span"] == 10
    assert 9 <= len(answer["content"]["time"]) <= 12
    np.testing.assert_allclose(answer["content"]["mean"], 23.0, atol=1.0)
    view.close()


def test_a_damaged_recording_ends_with_its_error_on_the_page(recording: Path) -> None:
    replay = Replay(recording, speed=np.inf)  # which has read the beginning
    content = bytearray(recording.read_bytes())
    content[8192:] = bytes(len(content) - 8192)
    recording.write_bytes(content)
    view = RigView(replay, twin())
    frames = frames_of(view)
    assert str(view.problem) == frames["log"][-1]["text"]
    assert frames["log"][-1]["level"] == "critical"
    view.close()


def test_a_view_that_is_closed_polls_no_more(recording: Path) -> None:
    view = RigView(Replay(recording, speed=0.1), twin())
    view.close()
    assert view._thread is not None
    assert not view._thread.is_alive()


def test_a_recording_of_another_rig_is_refused(recording: Path) -> None:
    with (
        Replay(recording) as replay,
        pytest.raises(jt.errors.RecordingError, match="'paper-2024', got one of 'tclab'"),
    ):
        RigView(replay, jt.Twin("paper-2024"))


def test_without_anywidget_the_error_says_what_to_install() -> None:
    program = (
        "import sys; sys.modules['anywidget'] = None\n"
        "import jaxtwin.widgets\n"
        "try: jaxtwin.widgets.Sliders\n"
        "except jaxtwin.JaxtwinError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert "pip install 'jaxtwin[widgets]'" in done.stdout, done.stderr
