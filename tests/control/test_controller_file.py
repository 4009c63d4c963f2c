"""Controller files: read, written, refused by file and field."""

import contextlib
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from jaxtwin import JaxtwinError, Twin, linearize
from jaxtwin.control import (
    LQI,
    MPC,
    PID,
    ControllerDesign,
    DecoupledPI,
    FunctionController,
    GainScheduled,
    OperatingPoint,
    RangeCost,
    Relay,
    StateSpace,
    design_lqi,
    design_mpc,
    loop_margins,
    read_controller,
    read_design,
    save_controller,
)
from jaxtwin.control.controllers._controller import with_values
from jaxtwin.errors import ControlError

PID_FILE = """
format = 1
rig = "dual-cell"
kind = "pid"
sample_time = "0.5 min"
measured = [["T11", "T21"], "T16"]
limits = [0.0, 0.9]
Kp = "0.1 1/K"
Ki = ["7.2 1/(K hour)", "0.001 1/(K s)"]
tracking_time = "1 min"
"""

RELAY_FILE = """
format = 1
rig = "dual-cell"
kind = "relay"
sample_time = "0.5 s"
measured = [["T11", "T16"]]
limits = [0.0, 0.9]
amplitude = ["0.1", "0.0"]
bias = ["30 %", "0.2"]
hysteresis = "50 mK"
timeout = "5 min"
"""


def read(folder: Path, text: str, twin: Twin):
    path = folder / "controller.toml"
    path.write_text(text)
    return read_controller(path, twin.rig)


def test_units_become_those_of_the_si(tmp_path: Path, twin: Twin):
    pid = read(tmp_path, PID_FILE, twin)
    assert isinstance(pid, PID)
    assert pid.sample_time_s == 30
    assert pid.limits == (0.0, 0.9)
    assert pid.measured == (("T11", "T21"), ("T16",))
    np.testing.assert_allclose(np.asarray(pid.Ki), [0.002, 0.001])
    assert float(np.asarray(pid.tracking_time_s)) == 60


def test_a_relay_is_read_with_its_units(tmp_path: Path, twin: Twin):
    relay = read(tmp_path, RELAY_FILE, twin)
    assert isinstance(relay, Relay)
    np.testing.assert_array_equal(relay.amplitude, [0.1, 0.0])
    np.testing.assert_allclose(np.asarray(relay.bias), [0.3, 0.2])
    assert float(np.asarray(relay.hysteresis)) == pytest.approx(0.05)
    assert relay.timeout_s == 300
    assert relay.measured == (("T11", "T16"),)
    assert (relay.sample_time_s, relay.limits) == (0.5, (0.0, 0.9))


@pytest.mark.parametrize(
    "controller",
    [
        Relay(0.1, 0.4, 0.05, timeout_s=90, measured=["T11", "T16"], limits=(0, 1)),
        Relay(np.array([0.1, 0.0]), -0.2, 0.1, sample_time_s=0.5),
        PID(0.1, 0.002, 0.3, 2.0, setpoint_weight=0.7, limits=(0, 1)),
        PID(np.array([0.1, 0.2]), measured=["T11", ["T16", "T26"]], tracking_time_s=9.0),
        DecoupledPI(
            0.1, 0.001, 0.2, 0.002, measured=["T11", "T16"], decoupling=[[1.1, -0.1], [0, 1]]
        ),
    ],
)
def test_what_is_saved_is_read_again(tmp_path: Path, twin: Twin, controller):
    path = tmp_path / "controller.toml"
    save_controller(path, controller, twin.rig)
    again = read_controller(path, twin.rig)
    assert type(again) is type(controller)
    for name, value in vars(controller.for_rig(twin.rig)).items():
        found = getattr(again, name)
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(found, value)
        else:
            assert found == value


def assert_refused(tmp_path: Path, twin: Twin, text: str, old: str, new: str, message: str) -> None:
    """A file with this change is refused in a message that begins with its name."""
    assert old in text
    with pytest.raises(ControlError, match=message) as error:
        read(tmp_path, text.replace(old, new), twin)
    assert str(error.value).startswith(str(tmp_path / "controller.toml"))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('["0.1", "0.0"]', '"0.1 K"', "amplitude: expected a duty .* does not measure a duty"),
        ('["0.1", "0.0"]', '["0.1"]', "amplitude: expected one value, or one for each of the 2"),
        ('["0.1", "0.0"]', '"0"', "Relay: amplitude: expected a number above 0"),
        ('["30 %", "0.2"]', '"1.5"', "Relay: bias: expected a duty from -1 to 1"),
        ('"50 mK"', '["50 mK", "60 mK"]', "hysteresis: expected a temperature difference"),
        ('"50 mK"', '"0.1 degC"', "hysteresis: expected a temperature difference"),
        ('timeout = "5 min"', 'timeout_s = "5 min"', "timeout_s: unknown field"),
        ('"5 min"', '"0 s"', "timeout: expected a time above 0"),
        ('hysteresis = "50 mK"', "", "hysteresis: expected this field, got none"),
        ('[["T11", "T16"]]', '["T11", "T16"]', "measured: expected one output, got 2; channels"),
    ],
)
def test_a_wrong_field_of_a_relay_is_named(
    tmp_path: Path, twin: Twin, old: str, new: str, message: str
):
    assert_refused(tmp_path, twin, RELAY_FILE, old, new, message)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('rig = "dual-cell"', 'rig = "mine"', "rig: expected a controller for 'dual-cell', got "),
        ("format = 1", "format = 2", "format: expected 1, got 2"),
        ('kind = "pid"', 'kind = "pit"', "got 'pit'; did you mean 'pid'"),
        ('Kp = "0.1 1/K"', 'Kp = "0.1 1/s"', "Kp: expected a gain .* does not measure a gain"),
        ('Kp = "0.1 1/K"', "Kp = 0.1", "Kp: expected a gain of at least 0 such as"),
        ('Kp = "0.1 1/K"', 'Kp = "-1 1/K"', "Kp: expected a gain of at least 0"),
        ('Kp = "0.1 1/K"', 'Kq = "0.1 1/K"', "Kq: unknown field 'Kq'. Known: format"),
        ('sample_time = "0.5 min"', "", "sample_time: expected this field, got none"),
        ('"T16"]', '"T99"]', "measured: unknown channel 'T99'"),
        ('"T16"]', '"T16", "T12"]', "measured: expected an output for each of the 2 cells, got 3"),
        ("[0.0, 0.9]", "[0.9]", "limits: expected the lowest and the highest duty"),
        ('["7.2 1/(K hour)", ', '["1 1/(K s)", "1 1/(K s)", ', "Ki: expected one value, or one"),
        ("format", "]", "controller.toml"),
    ],
)
def test_a_wrong_field_is_named(tmp_path: Path, twin: Twin, old: str, new: str, message: str):
    assert_refused(tmp_path, twin, PID_FILE, old, new, message)


FIELDS = [
    (text, line.partition(" =")[0]) for text in (PID_FILE, RELAY_FILE) for line in text.split("\n")
]


@given(
    st.sampled_from([(text, field) for text, field in FIELDS if field]),
    st.recursive(
        st.none() | st.booleans() | st.floats(allow_nan=False) | st.integers() | st.text(),
        lambda inner: st.lists(inner, max_size=3),
        max_leaves=5,
    ),
)
def test_a_wrong_value_of_a_field_raises_only_errors_of_jaxtwin(
    tmp_path_factory: pytest.TempPathFactory, twin: Twin, place: tuple[str, str], value: object
):
    file, field = place
    lines = [line for line in file.splitlines() if not line.startswith(f"{field} =")]
    text = json.dumps(value) if value is not None else "nan"
    path = tmp_path_factory.mktemp("files") / "controller.toml"
    path.write_text("\n".join([*lines, f"{field} = {text}"]), encoding="utf-8", errors="replace")
    with contextlib.suppress(JaxtwinError):
        read_controller(path, twin.rig)


def designed(twin: Twin, design: Callable[..., LQI | MPC], **settings: Any) -> Any:
    """A controller of the rig's channels for a plate of two places, each with a cell."""
    left = np.linspace(1, 0, len(twin.channels))
    model = StateSpace(
        np.array([[-0.03, 0.01], [0.008, -0.025]]),
        np.array([[1.2, 0.1], [0.1, 1.0]]),
        np.column_stack([left, 1 - left]),
        np.zeros((len(left), 2)),
        operating_point=OperatingPoint(
            np.array([0.3, 0.1]), np.full(2, 36.6), 40.1 + left, np.asarray(16.0), rig=twin.rig.name
        ),
        output_names=twin.channels,
        delay_s=1.5,
        lag_s=2.0,
    )
    measured = [twin.channels[:3], twin.channels[-1]]
    return design(model.discretise(0.5), measured=measured, limits=(0, 0.9), **settings)


def of_models(twin: Twin) -> list[Any]:
    limited = {"T11": (10.1, 60), "T26": (-3, 41.7, 0.5)}
    return [
        designed(twin, design_lqi, setpoint_weight=0.3, drift=0.2),
        designed(twin, design_lqi, setpoint_weight=[0.3, 0.1]),
        designed(twin, design_mpc, horizon=4, duty_deviation=[0.1, 0.2], reading_noise=0.03),
        designed(
            twin, design_mpc, horizon=3, rate_limit=0.07, temperature_limits=limited, preview=True
        ),
        designed(
            twin,
            design_mpc,
            horizon=8,
            control_horizon=2,
            temperature_limits={"T12": (0, 50)},
            evenness=RangeCost(energy_price=0.5),
            points=["T11", "T16", "T26"],
        ),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("number", range(5))
def test_a_controller_of_a_model_is_read_again(tmp_path: Path, twin: Twin, number: int):
    """With the same numbers, but for the last digits of what is computed anew."""
    path = tmp_path / "controller.toml"
    controller = of_models(twin)[number].for_rig(twin.rig)
    save_controller(path, controller, twin.rig)
    again = read_controller(path, twin.rig)
    # A file has the gains of a filter, and not the noises for which they were designed.
    kept = {"weights": None} if isinstance(controller, LQI) else {"noises": None}
    controller = with_values(controller, kept)
    assert jax.tree.structure(again) == jax.tree.structure(controller)
    for found, value in zip(jax.tree.leaves(again), jax.tree.leaves(controller), strict=True):
        np.testing.assert_allclose(found, value, rtol=1e-9, atol=1e-12)
    if isinstance(controller, LQI):
        for name in ("Kx", "Ki", "Kt", "N"):
            np.testing.assert_array_equal(getattr(again, name), getattr(controller, name))
    save_controller(tmp_path / "again.toml", again, twin.rig)
    assert (tmp_path / "again.toml").read_text() == path.read_text()


def test_a_file_names_an_anti_windup_that_is_not_the_usual_one(tmp_path: Path, twin: Twin):
    path = tmp_path / "pid.toml"
    save_controller(path, PID(0.1, 0.001, anti_windup="clamping"), twin.rig)
    assert 'anti_windup = "clamping"' in path.read_text()
    again = read_controller(path, twin.rig)
    assert isinstance(again, PID)
    assert again.anti_windup == "clamping"
    with pytest.raises(ControlError, match="anti_windup: expected 'back-calculation' or 'clampi"):
        read(tmp_path, path.read_text().replace("clamping", "off"), twin)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("design", "noise", "is_fragile"), [(design_lqi, 0.1, True), (design_mpc, 1.0, False)]
)
def test_a_file_says_how_far_from_instability_its_loop_is(
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    design: Callable[..., LQI | MPC],
    noise: float,
    is_fragile: bool,
):
    """On its own model, which for a linear twin is the twin; a fragile loop is a warning."""
    twin = Twin("tclab")
    model = linearize(twin, temperatures=40.0).discretise(5.0)
    path = tmp_path / "loop.toml"
    made = design(model, measured=["T1", "T2"], limits=(0, 1), reading_noise=noise)
    save_controller(path, made, twin.rig)
    said = loop_margins(twin, made, 40.0).summary()
    assert f"# on its own model: {said}" in path.read_text().splitlines()
    assert [said in record.getMessage() for record in caplog.records] == [True] * is_fragile
    assert ("fragile" in said) == is_fragile


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "pattern", "new", "message"),
    [
        (0, r'rig = "dual-cell"', 'rig = "mine"', "rig: expected a controller for 'dual-cell'"),
        (0, r"duty = .*", "duty = [0.1]", "duty: expected 2 numbers from -1 to 1"),
        (
            0,
            r"outputs = .*",
            'outputs = ["1 degC", "2 s"]',
            r"outputs\[1\]: expected a temperature",
        ),
        (0, r"outputs = .*", "outputs = [1, 2]", r"outputs\[0\]: expected a temperature"),
        (0, r'"1/\(K s\)"', '"1/K"', r"gains\.Ki\.unit: expected 1/\(K s\) or alike"),
        (0, r"Kx = \[", "Kx = [\n    [0.1],", r"gains\.Kx: expected 2 x 10 finite numbers"),
        (0, r"Kx = \[\n    \[", "Kx = [\n    [-9e9, ", r"gains\.Kx: expected 2 x 10 finite"),
        (0, r"Ki = {", "Ko = {", r"gains\.Ko: unknown field 'Ko'"),
        (0, r"\[gains\]", "[other]", "other: unknown field"),
        (0, r'1/\(K s\)"', '1/(K hour)"', None),
        (0, r'1/\(K s\)"', '1e3/(K s)"', "is not a known unit"),
        (0, r'"1/K", rows = \[\n    \[', '"1/K", rows = [\n    [1e9, ', "gains.N: expected 2 x 2"),
        (2, r"horizon = 4", "horizon = 0", "MPC: horizon: expected a whole number"),
        (2, r"horizon = 4\n", "", "horizon: expected this field, got none"),
        (3, r"preview = true", 'preview = "yes"', "preview: expected true or false, got"),
        (2, r"\[model\]\nA = \[", "[model]\nA = 3\nQ = [", r"model\.Q: unknown field"),
        (2, r"A = \[\n    \[", "A = [\n    [7, ", r"model\.A: expected any x any finite"),
        (3, r'rate_limit = "', 'rate_limit = "-', "rate_limit: expected a rate of the duty above"),
        (4, r"excess_deviation = .*", "", "excess_deviation: expected this field, got none"),
        (3, r"accepted_excess = .*", "", r"T11\.accepted_excess: expected this field, got none"),
        (
            3,
            r'excess = "0.5 K"',
            'excess = "0 K"',
            r"T26\.accepted_excess: expected a temp",
        ),
        (3, r'_limits\."T11"', '_limits."T99"', r"temperature_limits\.T99: unknown channel"),
        (3, r"\nL = 0.*", "\nL = 2.5", r"T11\.L: expected a number above 0 and below 2, got 2.5"),
        (3, r'lowest = "10.1', 'lowest = "70.1', "T11: expected the lowest and the highest"),
        (3, r'lowest = "10.1 degC"', "", r"T11\.lowest: expected this field, got none"),
        (4, r'cost = "range"', 'cost = "rage"', r"evenness\.cost: expected one of range, worst-po"),
        (4, r'energy_price = "', 'energy_price = "-', r"evenness\.energy_price: expected a temper"),
        (4, r"\nL = 0.*\n\n\[evenness\.ch", "\nL = 3\n\n[evenness.ch", r"evenness\.L: expected"),
        (
            4,
            r'names = \["T11"',
            'names = ["T99"',
            r"evenness\.channels\.names: unknown channel 'T9",
        ),
        (4, r'names = \["T11", "T16"', 'names = ["T16", "T16"', "names: expected names, each once"),
        (
            4,
            r"by_errors = \[\n +\[",
            "by_errors = [\n [1, ",
            r"points\.by_errors: expected 3 x any",
        ),
        (4, r"by_errors = ", "by_error = ", r"evenness\.points\.by_error: unknown field"),
        (4, r"\[evenness\.points\]", "[evenness.point]", r"evenness\.point: unknown field 'point'"),
        (
            4,
            r"control_horizon = 2",
            "control_horizon = 9",
            "MPC: control_horizon: expected at most",
        ),
    ],
)
def test_a_wrong_field_of_a_model_s_controller_is_named(
    tmp_path: Path, twin: Twin, number: int, pattern: str, new: str, message: str | None
):
    path = tmp_path / "controller.toml"
    save_controller(path, of_models(twin)[number], twin.rig)
    text, count = re.subn(pattern, lambda _: new, path.read_text(), count=1)
    assert count == 1
    path.write_text(text)
    if message is None:
        read_controller(path, twin.rig)
        return
    with pytest.raises(ControlError, match=message) as error:
        read_controller(path, twin.rig)
    assert str(error.value).startswith(str(path))


def test_gains_that_are_not_stable_are_neither_read_nor_written(tmp_path: Path, twin: Twin):
    """Feedback of the wrong sign heats a hot plate."""
    lqi = of_models(twin)[0]
    path = tmp_path / "controller.toml"
    for wrong, message in (
        (with_values(lqi, {"Kx": -np.asarray(lqi.Kx)}), "gains: expected gains with which"),
        (with_values(lqi, {"Ki": -np.asarray(lqi.Ki)}), "gains: expected gains with which"),
        (eqx.tree_at(lambda c: c.kalman.L, lqi, -lqi.kalman.L), r"model\.L: expected a gain"),
    ):
        with pytest.raises(ControlError, match=message):
            save_controller(path, wrong, twin.rig)
        assert not path.exists()


damages = st.lists(
    st.tuples(
        st.integers(0, 2**16),
        st.sampled_from(["cut", "repeat", "flip", "zero", "huge", "sign", "text"]),
    ),
    min_size=1,
    max_size=3,
)


@pytest.fixture(scope="module")
def texts(tmp_path_factory: pytest.TempPathFactory, twin: Twin) -> list[str]:
    """The files of some controllers."""
    path = tmp_path_factory.mktemp("files") / "controller.toml"
    made = []
    pids = [
        PID(0.1, 0.001, anti_windup="clamping"),
        PID(0.2, [0.001, 0.002], anti_windup="clamping"),
    ]
    for controller in [*of_models(twin), GainScheduled(pids, at=[20.5, 40.25])]:
        save_controller(path, controller, twin.rig, design=DESIGN)
        made.append(path.read_text(encoding="utf-8"))
    return made


@pytest.mark.slow
@settings(deadline=None, max_examples=50)
@given(st.integers(0, 5), damages)
def test_a_damaged_file_is_refused_or_a_controller(
    tmp_path_factory: pytest.TempPathFactory,
    twin: Twin,
    texts: list[str],
    number: int,
    damage: list[tuple[int, str]],
):
    """Lines cut or repeated, bytes and numbers changed: a clear error, or what commands a duty
    within its limits."""
    path = tmp_path_factory.mktemp("files") / "controller.toml"
    text = texts[number]
    for place, kind in damage:
        text = damaged(text, place, kind)
    path.write_text(text, encoding="utf-8")
    try:
        controller: Any = read_controller(path, twin.rig)
    except ControlError as refusal:
        said = str(refusal)
        event("refused")
    else:
        check_it_starts(controller, twin)
        return
    assert said.startswith(str(path))


def check_it_starts(controller: Any, twin: Twin):
    """With a state of numbers, and a duty within the limits."""
    with jax.enable_x64(True), jax.disable_jit():
        rest = np.full(len(controller.reading_weights(twin.channels)), 20.0)
        states = jax.tree.leaves(controller.init(np.zeros(2), rest))
    assert all(np.isfinite(state).all() for state in states)
    assert all(-1 <= limit <= 1 for limit in controller.limits)


def damaged(text: str, place: int, kind: str) -> str:
    """A file with a line or a number changed."""
    if kind in ("cut", "repeat"):
        lines = text.splitlines()
        at = place % len(lines)
        lines[at : at + 1] = [] if kind == "cut" else [lines[at]] * 2
        return "\n".join(lines)
    if kind == "flip":
        at = place % len(text)
        return text[:at] + chr(33 + place % 90) + text[at + 1 :]
    found = list(re.finditer(r"-?\d+\.\d+(e-?\d+)?", text))
    at = found[place % len(found)]
    number = at.group()
    new = {
        "zero": "0.0",
        "huge": "1e300",
        "sign": number[1:] if number.startswith("-") else "-" + number,
        "text": '"x"',
    }[kind]
    return text[: at.start()] + new + text[at.end() :]


def test_a_function_has_no_file(tmp_path: Path, twin: Twin):
    with pytest.raises(ControlError, match=r"adds a class\), got FunctionController"):
        save_controller(tmp_path / "c.toml", FunctionController(lambda t, r, y: 0.0), twin.rig)


DESIGN = ControllerDesign("0:30,300:45", 900.0, {"integral_absolute_error": 1.0, "energy": 0.001})


def test_a_file_keeps_for_what_its_controller_was_designed(tmp_path: Path, twin: Twin):
    path = tmp_path / "pid.toml"
    save_controller(path, PID(0.1, 0.002), twin.rig, design=DESIGN)
    assert read_design(path, twin.rig) == DESIGN
    assert read_controller(path, twin.rig) == PID(0.1, 0.002).for_rig(twin.rig)
    save_controller(path, PID(0.1, 0.002), twin.rig)
    assert read_design(path, twin.rig) is None


@pytest.mark.parametrize(
    ("line", "field"),
    [
        ("design = 1", "design"),
        ('design.references = "0:30"', "design"),
        ("design.references = 30", "design.references"),
        ('design.duration = "900 K"', "design.duration"),
        ("design.objective = {}", "design.objective"),
        ("design.objective = { energy = -1.0 }", "design.objective.energy"),
        ("design.objective = { energy = nan }", "design.objective.energy"),
    ],
)
def test_a_design_that_is_not_one_is_refused(line: str, field: str, tmp_path: Path, twin: Twin):
    path = tmp_path / "pid.toml"
    save_controller(path, PID(0.1, 0.002), twin.rig, design=DESIGN)
    key = line.partition(" ")[0]
    kept = [
        one for one in path.read_text().splitlines()
        if not one.startswith(key if field != "design" else "design")
    ]  # fmt: skip
    path.write_text("\n".join([*kept, line]), encoding="utf-8")
    for read in (read_controller, read_design):
        with pytest.raises(ControlError, match=f"{re.escape(str(path))}: {field}: expected"):
            read(path, twin.rig)
