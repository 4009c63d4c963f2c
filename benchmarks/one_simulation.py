"""How long does one simulation take, with and without compilation?

`python benchmarks/one_simulation.py` prints the first call, the median of warm calls and the error
against a tight Kvaerno5 solve, for both bundled rigs on the paper's schedule (1000 s at 1 Hz).
"""

import statistics
import time

import diffrax
import numpy as np

import jaxtwin as jt

experiment = jt.Experiment.schedule("0:0.502,500:0.784", duration=1000, cells=2)
tight = diffrax.PIDController(rtol=1e-10, atol=1e-10)
for name in jt.bundled_rigs():
    rig = jt.load_rig(name)
    if len(rig.cells) != experiment.n_cells:
        continue
    twin = jt.Twin(rig, rig.parameter_sets.get("published", {}))
    began = time.perf_counter()
    run = jt.simulate(twin, experiment)
    first = time.perf_counter() - began
    warm = []
    for _ in range(50):
        began = time.perf_counter()
        jt.simulate(twin, experiment)
        warm.append(time.perf_counter() - began)
    reference = jt.simulate(twin, experiment, solver=diffrax.Kvaerno5(), stepsize_controller=tight)
    error = np.abs(run.temperatures - reference.temperatures).max()
    print(
        f"{name}: first call {first:.2f} s, warm {1e3 * statistics.median(warm):.2f} ms "
        f"(median of 50), largest error {error:.1e} K"
    )
