"""One draw alone: the first call, warm calls, and the first call of a process whose programs are in
JAX's persistent compilation cache.

    python -m benchmarks.one_draw --quick
"""

import tempfile
import time
from collections.abc import Callable
from typing import Any

from ._measure import in_fresh_process, run_alone, warm_median

CALLS = ("simulate", "simulate_batch")


def measure(quick: bool = False) -> dict[str, Any]:
    """Seconds of each call, on `paper-2024` around the published values and on `dual-cell`.

    **Returns:** rig -> call -> `first` (in a fresh process with an empty cache), `import_to_result`
    (there, from before the import), `cached_first`, `cached_import_to_result` (in the second
    process with this cache), `warm` (median).
    """
    answer = {"paper-2024": {call: _of("paper-2024", call) for call in CALLS}}
    return answer if quick else answer | {"dual-cell": {"simulate": _of("dual-cell", "simulate")}}


def _of(rig: str, call: str) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        # As `jaxtwin`'s command line sets it. The first process finds nothing there.
        cache = {
            "JAX_COMPILATION_CACHE_DIR": folder,
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.1",
        }
        cold = in_fresh_process("one_draw:first_call", rig, call, environment=cache)
        second = in_fresh_process("one_draw:first_call", rig, call, environment=cache)
    return {
        "first": cold["first"],
        "import_to_result": cold["import_to_result"],
        "cached_first": second["first"],
        "cached_import_to_result": second["import_to_result"],
        "warm": cold["warm"],
    }


def first_call(rig: str, call: str) -> dict[str, float]:
    """In a process that has not imported anything yet."""
    began = time.perf_counter()
    run = _call(rig, call)
    ready = time.perf_counter()
    run()
    done = time.perf_counter()
    return {
        "first": done - ready,
        "import_to_result": done - began,
        "warm": warm_median(run, 50),
    }


def _call(rig: str, call: str) -> Callable[[], object]:
    import numpy as np

    import jaxtwin as jt

    description = jt.load_rig(rig)
    twin = jt.Twin(description, description.parameter_sets.get("published", {}))
    experiment = jt.Experiment.schedule("0:0.502,500:0.784", duration=1000, cells=2)
    if call == "simulate":
        return lambda: jt.simulate(twin, experiment)
    draws = {name: np.array([float(value)]) for name, value in twin.values.items()}
    return lambda: jt.simulate_batch(twin, experiment, draws)


if __name__ == "__main__":
    run_alone(measure, __doc__)
