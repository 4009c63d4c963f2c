"""A process that finds all programs kept has nothing left to compile."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

CODE = """
import jax
import jaxtwin as jt

compiled = []

def listen(event, seconds, **about):
    if event == "/jax/core/compile/backend_compile_duration":
        compiled.append(about.get("fun_name"))

jax.monitoring.register_event_duration_secs_listener(listen)
twin = jt.Twin("paper-2024", {"T_amb": 20.0, "T_start": 20.0})
run = twin.simulate("0:0.5", duration=60)
recording = jt.Experiment(
    run.time, run.experiment.duty, channels=run.channels, temperatures=run.temperatures
)
jt.match(twin, recording, free=["R_E"], max_iterations=3)
print(compiled)
"""


@pytest.mark.slow  # half a minute of compilation, in the first of the two
def test_the_second_process_compiles_nothing(tmp_path: Path):
    """Neither the large programs nor small ones that NumPy would do for."""
    environment = os.environ | {"JAXTWIN_COMPILATION_CACHE": str(tmp_path)}
    first, second = (
        subprocess.run(
            [sys.executable, "-c", CODE],
            env=environment,
            check=True,
            capture_output=True,
            text=True,
        ).stdout.strip()
        for _ in range(2)
    )
    assert "jit(_differentiate)" in first
    assert second == "[]"
