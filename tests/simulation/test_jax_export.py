"""`response` and its derivatives as artefacts of `jax.export`, run in a process without jaxtwin."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import export
from jaxtyping import Array, Float

import jaxtwin as jt

NAMES = ("R_E", "R_Th")

ELSEWHERE = """
import sys
sys.modules["jaxtwin"] = None  # importing it fails
import jax, numpy
from jax import export
jax.config.update("jax_enable_x64", True)
draws = numpy.load("draws.npy")
batch, slope = (
    export.deserialize(open(name, "rb").read()) for name in ("batch.bin", "slope.bin")
)
value, gradient = slope.call(draws[0])
numpy.savez("found.npz", batch=batch.call(draws), value=value, gradient=gradient)
"""


@pytest.mark.slow
@pytest.mark.usefixtures("float64")
@pytest.mark.parametrize(
    "name", [pytest.param("paper-2024", marks=pytest.mark.long), "dual-cell"]
)  # dual-cell has a lag and a delay
def test_an_artefact_runs_without_jaxtwin(name: str, tmp_path: Path):
    twin = jt.Twin(name)
    drive = jt.Experiment.schedule("0:0.5,60:0.8", duration=120, cells=2)

    def temperatures(values: Float[Array, " 2"]) -> Float[Array, "times channels"]:
        return jt.response(twin.with_values(dict(zip(NAMES, values, strict=True))), drive)

    def cost(values: Float[Array, " 2"]) -> Float[Array, ""]:
        return jnp.mean((temperatures(values) - 25.0) ** 2)

    (n,) = export.symbolic_shape("n")
    functions = {
        "batch.bin": (jax.vmap(temperatures), (n, 2)),
        "slope.bin": (jax.value_and_grad(cost), (2,)),
    }
    for file, (function, shape) in functions.items():
        artefact = export.export(jax.jit(function))(jax.ShapeDtypeStruct(shape, "float64"))
        (tmp_path / file).write_bytes(artefact.serialize())
    draws = np.array([float(twin.values[name]) for name in NAMES]) * np.array(
        [[1.0, 1.0], [1.1, 0.9], [0.9, 1.2]]
    )
    np.save(tmp_path / "draws.npy", draws)
    subprocess.run([sys.executable, "-c", ELSEWHERE], cwd=tmp_path, check=True, env=os.environ)
    found = np.load(tmp_path / "found.npz")
    for row, values in zip(found["batch"], draws, strict=True):
        single = twin.with_values(dict(zip(NAMES, values, strict=True))).simulate(drive)
        np.testing.assert_allclose(row, single.temperatures, atol=1e-9)
    # Forwards; the artefact's derivative is in reverse mode.
    value, forward = jax.jit(lambda draw: (cost(draw), jax.jacfwd(cost)(draw)))(draws[0])
    np.testing.assert_allclose(found["value"], value, rtol=1e-12)
    np.testing.assert_allclose(found["gradient"], forward, rtol=1e-8)
