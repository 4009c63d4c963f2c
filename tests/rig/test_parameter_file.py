"""Parameter files: written as a whole or not at all, read back with units and bounds checked."""

import math
import tomllib
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.errors import ParameterError
from jaxtwin.rig import Rig, load_rig, read_parameters, write_parameters
from jaxtwin.rig._parameter_file import parameters_toml

RIG = load_rig("paper-2024")


@pytest.fixture
def rig() -> Rig:
    return RIG


def with_values(rig: Rig, **values: float):
    """The rig's parameters, some with other values."""
    table = dict(rig.parameters) | {
        n: replace(rig.parameters[n], value=v) for n, v in values.items()
    }
    return list(table.values())


@pytest.mark.slow
@given(st.floats(1e-5, 10.0), st.floats(0.0, 40.0), st.text(max_size=30), st.text(max_size=30))
def test_values_come_back_exactly(tmp_path_factory, r_e, t_amb, recording, comment):
    path = tmp_path_factory.mktemp("fit") / "fit.toml"
    parameters = with_values(RIG, R_E=r_e)
    write_parameters(path, parameters, {recording: {"T_amb": t_amb}}, comment)
    shared = read_parameters(path, RIG)
    assert shared == {p.name: p.value for p in parameters}
    own = read_parameters(path, RIG, recording)
    assert own == {**shared, "T_amb": t_amb}


def test_the_table_of_a_rig_file_is_a_parameter_file(rig, tmp_path):
    """Both have the same form; a fit can be pasted into a rig file."""
    path = tmp_path / "table.toml"
    path.write_text(parameters_toml(rig.parameters.values()), "utf-8")
    assert read_parameters(path, rig) == {n: p.value for n, p in rig.parameters.items()}


def test_a_prior_that_knows_no_value_is_written_without_one(rig):
    """TOML has no None; rig files say `prior = { spread = ... }` too."""
    row = replace(rig.parameters["R_E"], prior_value=None, prior_spread=0.2)
    text = parameters_toml([row])
    assert tomllib.loads(text)["parameters"]["R_E"]["prior"] == {"spread": 0.2}


def test_other_units_of_the_same_kind_are_converted(rig, tmp_path):
    path = tmp_path / "fit.toml"
    path.write_text(
        '[parameters]\nR_E = { value = 2200.0, unit = "mohm" }\n'
        'T_amb = { value = 290.15, unit = "K" }\n'
        "[recordings]\nA = { T_amb = 291.15 }\n",
        "utf-8",
    )
    assert read_parameters(path, rig) == pytest.approx({"R_E": 2.2, "T_amb": 17.0})
    assert read_parameters(path, rig, "A")["T_amb"] == pytest.approx(18.0)


def test_a_recording_without_values_of_its_own_gets_the_shared_ones(rig, tmp_path):
    path = tmp_path / "fit.toml"
    write_parameters(path, rig.parameters.values(), {"A": {"T_amb": 16.0}})
    assert read_parameters(path, rig, "B")["T_amb"] == rig.parameters["T_amb"].value


def test_bounds_in_the_file_replace_those_of_the_rig(rig, tmp_path):
    """Matching may have been given wider ones; its result must be readable."""
    path = tmp_path / "fit.toml"
    path.write_text(
        '[parameters]\nR_pc = { value = 5.0, unit = "K/W", bounds = [0.1, 9.0] }\n', "utf-8"
    )
    assert read_parameters(path, rig) == {"R_pc": 5.0}


def test_a_value_at_a_bound_may_have_been_rounded(rig, tmp_path):
    path = tmp_path / "fit.toml"
    bound = rig.parameters["R_E"].upper
    path.write_text(
        f'[parameters]\nR_E = {{ value = {math.nextafter(bound, 99)!r}, unit = "ohm" }}\n', "utf-8"
    )
    assert read_parameters(path, rig) == {"R_E": bound}


# id: (text of the file, field, what else the message says)
MISTAKES = {
    "no table": ("x = 1", "parameters", "a table [parameters]"),
    "unknown name": (
        '[parameters]\nR_e = { value = 1.0, unit = "ohm" }',
        "parameters.R_e",
        "Known: C_esp",
    ),
    "wrong unit": ('[parameters]\nR_E = { value = 1.0, unit = "K/W" }', "parameters.R_E", "'ohm'"),
    "unknown unit": ('[parameters]\nR_E = { value = 1.0, unit = "om" }', "parameters.R_E", "'om'"),
    "no unit": ("[parameters]\nR_E = { value = 1.0 }", "parameters.R_E", "unit"),
    "no value": ('[parameters]\nR_E = { unit = "ohm" }', "parameters.R_E", "a number"),
    "text": ('[parameters]\nR_E = { value = "1", unit = "ohm" }', "parameters.R_E", "'1'"),
    "above": (
        '[parameters]\nR_E = { value = 11.0, unit = "ohm" }',
        "parameters.R_E",
        "1e-05 to 10",
    ),
    "nan": ('[parameters]\nR_E = { value = nan, unit = "ohm" }', "parameters.R_E", "got nan"),
    "negative bounds": (
        '[parameters]\nR_E = { value = -1.0, unit = "ohm", bounds = [-2.0, 2.0] }',
        "parameters.R_E",
        "above 0",
    ),
    "one bound": (
        '[parameters]\nR_E = { value = 1.0, unit = "ohm", bounds = [2.0] }',
        "parameters.R_E",
        "[lower, upper]",
    ),
    "recording out of bounds": (
        '[parameters]\nT_amb = { value = 15.0, unit = "degC" }\n[recordings.A]\nT_amb = 99',
        "recordings.A.T_amb",
        "got 99",
    ),
    "recording with an unknown name": (
        '[parameters]\nT_amb = { value = 15.0, unit = "degC" }\n[recordings.A]\nT_start = 15',
        "recordings.A.T_start",
        "Known: T_amb",
    ),
    "recordings that are no table": ("recordings = 3\n[parameters]\n", "recordings", "tables"),
    "no toml": ("[parameters", "no valid TOML", "line 1"),
}


@pytest.mark.parametrize("mistake", MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_told_with_file_field_and_what_is_allowed(mistake, rig, tmp_path):
    text, field, fragment = mistake
    path = tmp_path / "fit.toml"
    path.write_text(text, "utf-8")
    with pytest.raises(ParameterError) as caught:
        read_parameters(path, rig, "A")
    assert str(caught.value).startswith(f"{path}: {field}")
    assert fragment in str(caught.value)


def test_a_missing_file_is_a_parameter_error(rig, tmp_path):
    with pytest.raises(ParameterError, match=r"no\.toml: .*cannot be read"):
        read_parameters(tmp_path / "no.toml", rig)


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0, 10.1])
def test_nothing_is_written_for_a_value_that_could_not_be_read_back(rig, tmp_path, value):
    path = tmp_path / "fit.toml"
    path.write_text("as it was", "utf-8")
    with pytest.raises(ParameterError, match="R_E"):
        write_parameters(path, with_values(rig, R_E=value))
    assert path.read_text("utf-8") == "as it was"
    assert list(tmp_path.iterdir()) == [path]


def test_nothing_is_written_for_an_unknown_parameter_of_a_recording(rig, tmp_path):
    path = tmp_path / "fit.toml"
    with pytest.raises(ParameterError, match=r"recordings\.A\.T_ambient"):
        write_parameters(path, rig.parameters.values(), {"A": {"T_ambient": 15.0}})
    assert not path.exists()


def test_an_ending_of_another_format_is_refused(rig, tmp_path):
    with pytest.raises(ParameterError, match=r"ending: expected \.toml.*, got '\.json'"):
        write_parameters(tmp_path / "fit.json", rig.parameters.values())
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_not_there_is_told(rig, tmp_path):
    with pytest.raises(ParameterError, match="cannot be written"):
        write_parameters(tmp_path / "no" / "fit.toml", rig.parameters.values())


def test_a_failed_write_leaves_the_old_file_and_no_rest(rig, tmp_path, monkeypatch):
    """A full disk is simulated: the last step before the file is moved to its place fails."""

    def full(_):
        raise OSError(28, "No space left on device")

    path = tmp_path / "fit.toml"
    path.write_text("as it was", "utf-8")
    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(ParameterError, match="No space left"):
        write_parameters(path, rig.parameters.values())
    assert path.read_text("utf-8") == "as it was"
    assert list(tmp_path.iterdir()) == [path]
