"""Controller files: read, written, refused by file and field."""

import contextlib
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin import ControlError, JaxtwinError, Twin
from jaxtwin.control import PID, DecoupledPI, FunctionController, read_controller, save_controller

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


@pytest.mark.parametrize(
    "controller",
    [
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
    for name, value in vars(controller).items():
        found = getattr(again, name)
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(found, value)
        else:
            assert found == value


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('rig = "dual-cell"', 'rig = "mine"', "rig: expected a controller for 'dual-cell', got "),
        ("format = 1", "format = 2", "format: expected 1, got 2"),
        ('kind = "pid"', 'kind = "pit"', "kind: expected one of pid, decoupled-pi, got 'pit'"),
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
    assert old in PID_FILE
    with pytest.raises(ControlError, match=message) as error:
        read(tmp_path, PID_FILE.replace(old, new), twin)
    assert str(error.value).startswith(str(tmp_path / "controller.toml"))


@given(
    st.sampled_from(["format", "rig", "kind", "sample_time", "measured", "limits", "Kp", "Ki"]),
    st.recursive(
        st.none() | st.booleans() | st.floats(allow_nan=False) | st.integers() | st.text(),
        lambda inner: st.lists(inner, max_size=3),
        max_leaves=5,
    ),
)
def test_no_value_of_a_field_ends_in_another_error(
    tmp_path_factory: pytest.TempPathFactory, twin: Twin, field: str, value: object
):
    lines = [line for line in PID_FILE.splitlines() if not line.startswith(field)]
    text = json.dumps(value) if value is not None else "nan"
    path = tmp_path_factory.mktemp("files") / "controller.toml"
    path.write_text("\n".join([*lines, f"{field} = {text}"]), encoding="utf-8", errors="replace")
    with contextlib.suppress(JaxtwinError):
        read_controller(path, twin.rig)


def test_a_function_has_no_file(tmp_path: Path, twin: Twin):
    with pytest.raises(ControlError, match="expected a PID or a DecoupledPI"):
        save_controller(tmp_path / "c.toml", FunctionController(lambda t, r, y: 0.0), twin.rig)
