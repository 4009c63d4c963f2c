"""What a fault does to an observer, against the observer of a rig that has the fault."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from faulty_runs import ONSET, bench, clean, with_readings

from jaxtwin import Experiment, Stepper, Twin, observe, simulate
from jaxtwin._jax_settings import own_settings
from jaxtwin.diagnosis import Suspect, suspects
from jaxtwin.diagnosis._causes import diagnosed
from jaxtwin.diagnosis._diagnose import learned
from jaxtwin.diagnosis._likelihood_ratio import (
    CANDIDATES,
    Candidates,
    _replaced,
    likelihood_ratios,
    log_ratios,
    signature,
)
from jaxtwin.diagnosis._recorded import inputs_of
from jaxtwin.diagnosis._signatures import suspected
from jaxtwin.errors import ObserverError
from jaxtwin.observers import Observed
from jaxtwin.physics import FAULT_MODELS

# The size of a fault for a finite difference, as a part of its usual one.
SMALL = 0.02

SAMPLES = 120


@cache
def healthy() -> Observed:
    duty, readings = clean()
    return observe(bench(), with_readings(readings, duty))


@jax.jit
def _seen(kalman, faults, inputs):
    def take(carry, given):
        error, begun = carry
        begun = begun | given.begins
        held = jnp.zeros((1, len(kalman.model.columns)))
        (error, seen), _ = signature(kalman, faults, given.before, error, held, given.sample)
        error, seen = jnp.where(begun, error, 0.0), jnp.where(begun, seen[1:, 0], 0.0)
        return (error, begun), seen

    none = jnp.zeros((kalman.model.layout.size, 1, len(faults.drift))), jnp.asarray(False)
    return jax.lax.scan(take, none, inputs)[1]


def signatures(observed: Observed, several: list[Suspect], onset: int) -> np.ndarray:
    """The change of the whitened innovations, (samples, channels, faults), from an onset on."""
    inputs = inputs_of(observed, 0)
    begins = np.zeros(len(inputs.begins), bool)
    begins[onset + 1] = True
    with own_settings():
        arrays = suspected(observed.observer.model, several)
        return np.asarray(_seen(observed.observer, arrays, inputs._replace(begins=begins)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "part", "none"),
    [
        ("loosen", "H1", 1.0),
        ("age", "H1", 1.0),
        ("leak", "H2", 1.0),
        ("load", "H1", 1.0),
        ("gain", "T1", 1.0),
        ("offset", "T2", 0.0),
        ("swap", "T1+T2", 0.0),
    ],
)
def test_a_signature_is_the_difference_of_two_observers(model: str, part: str, none: float):
    """The observer of a rig with a small fault less that of the rig without it."""
    usual = suspects(bench())[f"{model} {part}"]
    size = usual.size_of(SMALL)
    factor = size / usual.none if usual.unit == "W/K" else size
    assert (factor if none else 1 + factor) != 1
    duty, readings = clean(model, part, factor)
    changed = observe(bench(), with_readings(readings, duty))
    expected = (changed.standardised - healthy().standardised) / SMALL
    found = signatures(healthy(), [usual], ONSET)[: len(expected), :, 0]
    assert np.abs(expected[:ONSET]).max() < 1e-9
    rows = slice(ONSET, ONSET + SAMPLES)
    # An observer linearises at another state, and its heats are held during a step.
    np.testing.assert_allclose(
        found[rows], expected[rows], atol=0.05 * np.abs(expected[rows]).max()
    )


@pytest.mark.long
def test_the_signature_of_a_cell_is_the_difference_of_two_observers_with_a_lag_and_a_delay():
    twin, onset = Twin("dual-cell"), 200
    plan = Experiment.schedule("0:0.5/0.2,150:0.3/0.7,210:0.6/0.4", duration=280, step=1, cells=2)
    recording = simulate(twin, plan).to_recording(noise=0.0)
    observed = observe(twin, recording)
    usual = suspects(twin)
    names = ["loosen P1", "fail P1", "weaken supply", "leak plate", "delay command"]
    found = signatures(observed, [usual[name] for name in names], onset)
    for place, name in enumerate(names):
        one = usual[name]
        assert one.fault is not None
        # A command that is late by part of a second is not late by part of the effect of a second.
        part = 1.0 if name == "delay command" else SMALL
        with jax.enable_x64(True):
            stepper = Stepper(twin, 1.0, longest_delay=8.0)
            faulty = one.fault(one.size_of(part))(stepper.system)
            hurt = Stepper(faulty, 1.0, longest_delay=8.0)
        both = []
        for after in (stepper, hurt):
            readings = _run(stepper, after, plan.duty, onset)
            run = Experiment(plan.time, plan.duty, channels=twin.channels, temperatures=readings)
            both.append(observe(twin, run).standardised)
        expected = (both[1] - both[0])[onset:]
        own = found[onset : len(plan.time), :, place]
        if name == "fail P1":  # its size is a share of the strings, its multiple one of the heat
            part = float((own * expected).sum() / (own**2).sum())
            assert 0 < part < SMALL
        np.testing.assert_allclose(
            own, expected / part, atol=0.08 * np.abs(own).max(), err_msg=name
        )


def _run(stepper: Stepper, after: Stepper, duty: np.ndarray, onset: int) -> np.ndarray:
    state = stepper.start()
    rows = [np.asarray(stepper.channels(state))]
    for number, command in enumerate(duty[:-1]):
        now = after if number >= onset else stepper
        state = now.step(state, command)
        rows.append(np.asarray(now.channels(state)))
    return np.array(rows)


def test_faults_that_change_the_nodes_are_refused_in_a_sentence():
    model = healthy().observer.model

    def fewer(system):
        import equinox as eqx

        return eqx.tree_at(lambda s: s.capacitance, system, system.capacitance[:-1])

    for fault, words in ((fewer, "nodes and the parts of the rig to stay"), (str, "returns str")):
        odd = Suspect("odd", lambda _, own=fault: own)  # pyright: ignore[reportArgumentType]
        with pytest.raises(ObserverError, match=words):
            suspected(model, [odd])


@pytest.mark.slow
def test_a_fault_of_no_effect_is_never_found():
    nothing = Suspect("nothing", lambda _: lambda system: system)
    arrays = suspected(healthy().observer.model, [nothing])
    found = diagnosed(healthy(), [nothing], arrays, learned([nothing], []))
    assert found.causes == ()


def test_the_usual_suspects_are_models_of_faults():
    names = list(suspects(Twin("dual-cell")))
    assert {name.split()[0] for name in names} - {"stuck", "drift"} <= FAULT_MODELS.keys()
    assert {"loosen P1", "age P2", "fade P1", "weaken P1", "weaken supply", "block P2"} < set(names)
    assert "swap T1+T2" in suspects(bench())
    assert "gain T2" not in suspects(bench(), ["T1"])


def test_the_band_of_an_onset_is_the_shortest_set_of_95_percent():
    """That of onsets sorted by their weights, where each stands for one sample."""
    random = np.random.default_rng(0)
    several = [Suspect(name, None) for name in ("a", "b", "c")]
    faults, channels = len(several), 2
    with own_settings():
        score = random.normal(0, 4, (CANDIDATES, faults))
        none = Candidates.none(5, faults, channels)
        onset, sums = jnp.arange(CANDIDATES), random.normal(size=(CANDIDATES, channels))
        several_onsets = Candidates(
            onset, none.error, jnp.asarray(score), jnp.ones_like(none.score) * 9.0,
            jnp.asarray(sums), jnp.ones_like(none.counts), none.held,
        )  # fmt: skip
        prior = learned(several, [])
        ratios = jax.tree.map(np.asarray, jax.jit(likelihood_ratios)(prior, several_onsets))
        weights = np.exp(np.asarray(jax.jit(log_ratios)(prior, several_onsets)))
    for fault in range(faults + 1):
        shares = weights[:, fault] / weights[:, fault].sum()
        order = np.argsort(-shares)
        inside = order[: 1 + np.searchsorted(shares[order].cumsum(), 0.95)]
        assert ratios.earliest[fault] == inside.min()
        assert ratios.latest[fault] == inside.max()
        assert ratios.onset[fault] == order[0]


def test_an_onset_that_shows_nothing_for_long_makes_room_first():
    """Of onsets that say the same, the one that stands for most samples is kept but for that."""
    faults, channels, patience = 3, 2, 600.0
    with own_settings():
        none = Candidates.none(5, faults, channels)
        onset = jnp.arange(CANDIDATES).at[:2].set(jnp.array([-950, -900]) + CANDIDATES)
        several_onsets = Candidates(
            onset + 1000, none.error, none.score + 1.0, none.information + 1.0, none.sums,
            none.counts, none.held,
        )  # fmt: skip
        prior = learned([Suspect(name, None) for name in ("a", "b", "c")], [])
        place = jax.jit(_replaced)
        number, by_age = jnp.asarray(1000 + CANDIDATES), jnp.asarray(False)

        def goes(patience: float, forget_below: float) -> int:
            own = prior._replace(
                patience=np.asarray(patience), forget_below=np.asarray(forget_below)
            )
            return int(place(own, several_onsets, number, by_age))

        assert goes(patience, 20.0) == 0
        assert goes(patience, -20.0) > 1
        assert goes(2000.0, 20.0) > 1
