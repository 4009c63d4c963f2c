"""What was compiled once is not compiled again: after `jaxtwin warm-up`, and in another process."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

LISTEN = """
import jax
import jaxtwin as jt
from jaxtwin.data import synthetic_recordings

compiled = []

def listen(event, seconds, **about):
    if event == "/jax/core/compile/backend_compile_duration":
        compiled.append(about.get("fun_name"))

jax.monitoring.register_event_duration_secs_listener(listen)
twin = jt.Twin("paper-2024", {"R_E": 2.1})
recording = jt.read_recording(synthetic_recordings()[0])
"""

MATCH = """
twin.simulate(recording)
jt.validate(jt.match(twin, recording, max_iterations=5), recording)
print(compiled)
"""

SENSITIVITY = """
jt.sensitivity(twin, recording, draws=100)
print(compiled)
"""


def printed(folder: Path, *arguments: str) -> str:
    """What another process prints that keeps its programs in a folder."""
    environment = os.environ | {"JAXTWIN_COMPILATION_CACHE": str(folder)}
    command = [sys.executable, *arguments]
    done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    return done.stdout.strip()


@pytest.mark.slow  # half a minute of compilation
def test_a_match_after_it_compiles_nothing(tmp_path: Path):
    """Neither the large programs nor small ones that NumPy would do for."""
    said = printed(tmp_path, "-m", "jaxtwin", "warm-up", "paper-2024", "synthetic-A")
    assert said.endswith(f"MiB in {tmp_path}")
    # The derivatives of a match are not compiled: seven files are all that it and the run need.
    assert len(list(tmp_path.iterdir())) > 4
    assert printed(tmp_path, "-c", LISTEN + MATCH) == "[]"


@pytest.mark.slow  # a quarter of a minute of compilation
def test_a_sensitivity_analysis_in_another_process_compiles_nothing(tmp_path: Path):
    assert printed(tmp_path, "-c", LISTEN + SENSITIVITY) != "[]"
    assert printed(tmp_path, "-c", LISTEN + SENSITIVITY) == "[]"
