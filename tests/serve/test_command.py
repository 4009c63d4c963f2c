"""`jaxtwin serve` as a command: what it refuses before anything begins, and a run."""

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest
from small_page import twin

from jaxtwin.cli import run
from jaxtwin.io import Session
from jaxtwin.live import Recorder, report
from jaxtwin.serve import listening

REFUSED = {
    "no source": ("serve tclab", "give one of --link, --virtual and --replay"),
    "two sources": (
        "serve tclab --virtual --link socket://127.0.0.1:7000",
        "give one of --link, --virtual and --replay",
    ),
    "a replay that is recorded": ("serve tclab --replay a.db --out b.db", "neither recorded"),
    "a replay that is commanded": ("serve tclab --replay a.db --allow-control", "neither recorded"),
    "two twins": ("serve tclab --virtual --store a.db --set x", "give --store, or --parameters"),
    "faults of a real rig": ("serve tclab --link loop:// --faults drop=0.1", "--faults"),
    "a store that is not there": ("serve tclab --virtual --store a.db", "no such store"),
    "a recording in no folder": ("serve tclab --virtual --out none/a.db", "there is no folder"),
    "an unknown rig": ("serve nothing --virtual", "nothing"),
    "a port of no machine": ("serve tclab --virtual --host 192.0.2.1", "expected a free port"),
    "a link of no kind": ("serve tclab --link nowhere://x", "link: expected"),
    "a fault of no kind": ("serve tclab --virtual --faults explode=now", "fault: expected"),
}


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def said(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert run([*words, "--port", "0"]) == 2
    return " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_served_is_refused_in_a_sentence(
    case: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words, expected = REFUSED[case]
    assert expected in said(words.split(), capsys)
    assert list(Path.cwd().iterdir()) == []


def test_a_recording_of_another_rig_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with Recorder("session.db", twin().rig):
        pass
    text = said(["serve", "heated-box", "--replay", "session.db"], capsys)
    assert "expected a recording of 'heated-box', got one of 'tclab'" in text


def test_two_servers_on_a_port_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with listening("127.0.0.1", 0) as taken:
        port = str(taken.getsockname()[1])
        assert run(["serve", "tclab", "--virtual", "--port", port]) == 2
    assert "is another server running?" in capsys.readouterr().err


def test_without_the_extra_it_says_how_to_install_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(
        "jaxtwin.commands._serve.find_spec", lambda name: None if name == "uvicorn" else found(name)
    )
    assert "pip install 'jaxtwin[serve]'" in said(["serve", "tclab", "--virtual"], capsys)


@pytest.mark.slow
def test_a_served_virtual_rig_is_commanded_and_stopped_and_its_recording_is_continued(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """From the command line to the browser and back, twice: the second server goes on with the
    recording of the first, which was killed, and with its compiled programs."""
    monkeypatch.setenv("JAXTWIN_COMPILATION_CACHE", "compiled")
    for number in range(2):
        words = "serve tclab --virtual --port 0 --allow-control --token-file token --out session.db"
        command = [sys.executable, "-m", "jaxtwin", *words.split()]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ)
        try:
            assert process.stdout is not None
            address = process.stdout.readline().strip()
            token = Path("token")
            assert token.stat().st_mode & 0o777 == 0o600
            _wait_until(lambda a=address: b"<td>2" in _read(a))
            answer = _post(
                address, "drive", token.read_text().strip(), {"duty": [0.4, 0.4], "seconds": 600}
            )
            assert answer == (200, {"text": "the rig is driven with a duty of 40 %, 40 %"})
            _wait_until(lambda a=address: b'cell="H1"} 0.4' in _read(f"{a}metrics"))
            assert _post(address, "stop", "wrong", {})[0] == 401
            assert _post(address, "stop", token.read_text().strip(), {}) == (
                200,
                {"text": "stopped by hand; the device reports off"},
            )
            _wait_until(lambda a=address: b'cell="H1"} 0\n' in _read(f"{a}metrics"))
            process.send_signal(signal.SIGKILL if number == 0 else signal.SIGTERM)
            assert process.wait(60) == (-signal.SIGKILL if number == 0 else 0)
        finally:
            process.kill()
            process.communicate()
    assert any(Path("compiled").rglob("*"))
    with Session("session.db") as session:
        assert report(session)["events"]["not-recorded"] == 1  # the gap between the two
        assert set(session.estimates().run) == {1, 2}


def _read(address: str) -> bytes:
    with urllib.request.urlopen(address, timeout=20) as answer:
        return answer.read()


def _post(address: str, kind: str, token: str, content: object) -> tuple[int, object]:
    headers = {
        "origin": address.rstrip("/"),
        "content-type": "application/json",
        "authorization": f"Bearer {token}",
    }
    body = json.dumps(content).encode()
    request = urllib.request.Request(f"{address}control/{kind}", body, headers)
    try:
        with urllib.request.urlopen(request, timeout=20) as answer:
            return answer.status, json.loads(answer.read())
    except urllib.error.HTTPError as error:
        return error.code, json.loads(error.read())


def _wait_until(condition, seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"waited for {seconds:g} s"
        time.sleep(0.1)
