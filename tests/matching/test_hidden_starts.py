"""States that no reading shows at the start of a recording: their prior and its predictions."""

import tomllib

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from jaxtwin import Experiment, Fit, Twin, match, simulate, validate
from jaxtwin.matching import estimate_initial_conditions
from jaxtwin.matching._initial_condition_priors import (
    MatchedStart,
    Share,
    expected_distance,
    starting_shares,
)
from jaxtwin.rig import rig_from_tables

BOX = """
format = 1
name = "box"
ambient = { temperature = "T_amb" }
initial = { temperature = "T_air" }
sensors = { noise = "0.05 K" }
channels = [{ name = "T", nodes = ["V11"] }]
bodies = [{ name = "wall", capacitance = "C_wall", initial_temperature = "T_wall" }]
links = [
    { resistance = "R_wall", between = ["V11-wall"] },
    { resistance = "1.5 K/W", between = ["wall-ambient"] },
]

[plate]
columns = ["10 cm"]
rows = ["10 cm"]
thickness = "1 cm"

[circuit]
capacitance = "C_air"
links = [{ resistance = "3 K/W", between = ["V11-ambient"] }]

[[cells]]
name = "heater"
seebeck_coefficient = "0 V/K"
electrical_resistance = "3 ohm"
thermal_resistance = "0.1 K/W"
side_capacitance = "20 J/K"
contacts = { V11 = "0.3 K/W" }
sink_resistance = "100 K/W"

[driver]
supply_voltage = "12 V"
on_resistance = "0 ohm"
counts = 255
polarity = 1
averaging = "on-off"
off_phase = "open"

[parameters.C_air]
value = 250.0
unit = "J/K"
bounds = [20.0, 2000.0]
prior = { spread = 0.7 }
free = true

[parameters.C_wall]
value = 2000.0
unit = "J/K"
bounds = [100.0, 20000.0]
prior = { spread = 0.7 }
free = true

[parameters.R_wall]
value = 1.5
unit = "K/W"
bounds = [0.1, 20.0]
prior = { spread = 0.7 }
free = true

[parameters.T_amb]
value = 22.0
unit = "degC"
bounds = [5.0, 40.0]

[parameters.T_air]
value = 22.0
unit = "degC"
bounds = [5.0, 60.0]
prior = { spread = 3.0 }
free = true
scope = "recording"

[parameters.T_wall]
value = 22.0
unit = "degC"
bounds = [5.0, 60.0]
prior = { spread = 3.0 }
free = true
scope = "recording"
"""
TRUTH = {"C_air": 300.0, "C_wall": 3000.0, "R_wall": 1.0}


def box() -> Twin:
    return Twin(rig_from_tables(tomllib.loads(BOX), "box"))


def session(seed: int) -> Experiment:
    """An hour in a room of 18 to 26 degC, whose temperature is recorded. The wall begins 2 K above
    it, the air somewhere between the wall and 2 K more."""
    rng = np.random.default_rng(seed)
    room, wall = rng.uniform(18, 26), 2 + 0.7 * rng.standard_normal()
    start = {"T_air": room + wall + rng.uniform(-1, 2), "T_wall": room + wall}
    drive = Experiment.schedule(
        "0:0,40:0.5,700:0,1500:0.6,2200:0", duration=3600, step=6.0, ambient=room
    )
    seen = simulate(box().with_values(TRUTH | start), drive).temperatures
    seen = seen + 0.05 * rng.standard_normal(seen.shape)
    return Experiment(
        drive.time,
        drive.duty,
        channels=("T",),
        temperatures=seen,
        ambient=room,
        name=f"{seed}: {start['T_wall']:.3f}",
    )


@pytest.fixture(scope="module")
def fit() -> Fit:
    return match(box(), [session(seed) for seed in range(3)])


@pytest.mark.slow
def test_a_hidden_start_stays_among_those_of_the_matched_recordings(fit: Fit):
    """Whatever the first minute says: it determines no wall whose time constant is 25 minutes."""
    distances = [
        own["T_wall"] - sample.ambient
        for own, sample in zip(fit.recording_values.values(), fit.first_samples, strict=True)
        if sample.ambient is not None
    ]
    for seed in range(10, 18):
        unseen = session(seed)
        found = estimate_initial_conditions(fit, unseen)
        assert isinstance(unseen.ambient, float)
        distance = found.values["T_wall"] - unseen.ambient
        assert min(distances) - 2 < distance < max(distances) + 2
        truth = float(unseen.name.split(": ")[1])
        place = list(found.values).index("T_wall")
        assert abs(found.values["T_wall"] - truth) < 3.5 * np.sqrt(found.covariance[place, place])


@pytest.mark.long
def test_bands_of_unseen_recordings_hold_as_often_as_they_say_and_are_not_wide(fit: Fit):
    """Readings span 20 K. The noise alone makes a band of 0.2 K."""
    result = validate(fit, [session(seed) for seed in range(10, 18)])
    assert 0.9 < result.coverage <= 1.0
    assert result.band_width < 1.5
    assert result.mean_fit_percent > 90


def test_without_other_recordings_a_hidden_state_has_its_share_of_the_distance():
    mean, standard_deviation = expected_distance("T", Share(0.3, 0.2), 10.0, ())
    assert mean == pytest.approx(3.0)
    # The offset of 1 K, the recording's deviation of 1 K, and 0.2 of 10 K.
    assert standard_deviation == pytest.approx(np.sqrt(1 + 1 + 4))


def test_recordings_that_agree_pull_the_prior_to_them_and_narrow_it():
    starts = [MatchedStart(20.0, 24.0, {"T": 22.5}, {"T": 0.01}) for _ in range(40)]
    mean, standard_deviation = expected_distance("T", Share(0.0, 0.5), 4.0, starts)
    assert mean == pytest.approx(2.5, abs=0.05)
    assert standard_deviation < 0.3


def test_an_undetermined_start_of_a_matched_recording_does_not_change_the_prior():
    unknown = MatchedStart(20.0, 24.0, {"T": 60.0}, {"T": np.inf})
    found = expected_distance("T", Share(0.1, 0.2), 4.0, [unknown])
    assert found == expected_distance("T", Share(0.1, 0.2), 4.0, ())


def test_shares_are_those_of_a_lyapunov_equation():
    """The network of the box by hand, solved by scipy: air, heater, wall."""
    links = {(0, 1): 0.3, (1, 2): 0.1, (0, 3): 1.5}
    to_room = {0: 3.0, 2: 100.0, 3: 1.5}
    matrix = np.diag([1 / to_room.get(node, np.inf) for node in range(4)])
    for (a, b), resistance in links.items():
        matrix[[a, b], [a, b]] += 1 / resistance
        matrix[[a, b], [b, a]] -= 1 / resistance
    capacitance = np.array([250.0, 20.0, 20.0, 2000.0])
    heat = np.diag([0.0, 1.0, 1.0, 0.0]) / np.outer(capacitance, capacitance)
    covariance = solve_continuous_lyapunov(-matrix / capacitance[:, None], -heat)
    mean = covariance[3, 0] / covariance[0, 0]
    shares = starting_shares(box(), ["T_wall"])
    assert shares["T_wall"].mean == pytest.approx(mean, rel=1e-6)
    variance = covariance[3, 3] / covariance[0, 0] - mean**2
    assert shares["T_wall"].standard_deviation == pytest.approx(np.sqrt(variance), rel=1e-6)
    assert 0 < mean < 0.3


@pytest.mark.slow
def test_a_room_that_recordings_replace_is_not_printed_as_fixed(fit: Fit):
    said = fit.summary()
    assert "replaced by the recorded ambient temperature: T_amb" in said
    assert "fixed: T_amb" not in said
