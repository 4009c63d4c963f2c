"""A user's settings of JAX neither stop a computation of this package nor change its result, and
are left as they were: Configuration Options, https://docs.jax.dev/en/latest/config_options.html."""

from collections.abc import Callable, Iterator

import jax
import numpy as np
import pytest

from jaxtwin import (
    Experiment,
    Twin,
    load_rig,
    match,
    reduce_batch,
    response,
    sensitivity,
    simulate,
    simulate_batch,
)

SETTINGS = {
    "jax_numpy_rank_promotion": "raise",
    "jax_numpy_dtype_promotion": "strict",
    "jax_transfer_guard": "disallow",
    "jax_debug_nans": True,
    "jax_debug_infs": True,
    "jax_disable_jit": True,
    "jax_enable_x64": True,
    "jax_default_matmul_precision": "bfloat16",
    "jax_check_tracer_leaks": True,
    "jax_log_compiles": True,
}
TIME = np.arange(40.0)
DRIVE = Experiment(TIME, np.where(TIME < 20, 0.5, 0.0)[:, None])


@pytest.fixture(params=SETTINGS)
def setting(request) -> Iterator[str]:
    """One of the settings, for all threads, as `jax.config.update` at the top of a script."""
    name = request.param
    before = getattr(jax.config, name)
    jax.config.update(name, SETTINGS[name])
    yield name
    assert getattr(jax.config, name) == SETTINGS[name]
    jax.config.update(name, before)


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin(load_rig("single-cell"))


def draws(twin: Twin) -> dict[str, np.ndarray]:
    """The second one's contact is no resistance: a NaN beside numbers."""
    return {"R_pc": np.array([0.1, -0.1, 0.2])}


def recording(twin: Twin) -> Experiment:
    """What a twin with another contact says."""
    run = simulate(twin.with_values({"R_pc": 0.15}), DRIVE)
    return Experiment(TIME, DRIVE.duty, temperatures=run.temperatures, channels=run.channels)


CALLS: dict[str, Callable[[Twin], np.ndarray | None]] = {
    "simulate": lambda twin: simulate(twin, DRIVE).temperatures,
    "simulate_batch": lambda twin: simulate_batch(twin, DRIVE, draws(twin)),
    "reductions": lambda twin: (
        reduce_batch(twin, recording(twin), draws(twin), ["cost", "plate_range"]).cost
    ),
    "match": lambda twin: (
        match(twin, recording(twin), free=["R_pc"]).to_xarray()["value"].to_numpy()
    ),
    "sensitivity": lambda twin: sensitivity(twin, recording(twin), draws=4).cost,
}


@pytest.fixture(scope="module")
def expected(twin) -> dict[str, np.ndarray | None]:
    """With the settings that the tests have otherwise."""
    return {name: call(twin) for name, call in CALLS.items()}


@pytest.mark.slow
@pytest.mark.parametrize("call", CALLS)
def test_results_are_the_same_to_the_last_bit(call, twin, setting, expected):
    found, before = CALLS[call](twin), expected[call]
    assert found is not None
    assert before is not None
    np.testing.assert_array_equal(found, before)


@pytest.mark.slow
def test_response_and_its_derivative_are_finite_under_every_setting_of_jax(twin, setting):
    """In the precision of their surroundings: float32 is right to a few millikelvin here."""
    readings = response(twin, DRIVE)
    np.testing.assert_allclose(readings, simulate(twin, DRIVE).temperatures, atol=0.05)

    def rise(resistance: jax.Array) -> jax.Array:
        return response(twin.with_values({"R_pc": resistance}), DRIVE)

    # Not by jax.jacfwd, which itself does what jax_transfer_guard forbids.
    at, direction = jax.device_put(np.float32(0.1)), jax.device_put(np.float32(1.0))
    _, slope = jax.jvp(rise, (at,), (direction,))
    assert np.isfinite(jax.device_get(slope)).all()
