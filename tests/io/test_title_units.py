"""Units in titles of columns: whatever the spelling, the quantity that arrives is the same, or the
title is refused. The factors are the definitions of the units."""

import numpy as np
import pytest
from heated_block import heated_block
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin import Experiment, read_recording
from jaxtwin.errors import RecordingError
from jaxtwin.io._title_units import unit_of_title

# Ways to write a unit behind a name.
FORMS = ("{} [{}]", "{} ({})", "{}({})", "{}/{}", "{} / {}", "{}_{}", "{} {}", "{} in {}")

TEMPERATURES = {
    "degC": ("°C", "degC", "deg C", "Celsius", "℃", "ºC", "˚C", "DEGC"),
    "degF": ("°F", "degF", "deg F", "Fahrenheit", "℉", "fahrenheit"),
    "K": ("K", "kelvin", "Kelvin", "°K"),
    "mdegC": ("mC", "m°C", "mdegC", "millicelsius"),
}
FROM_CELSIUS = {
    "degC": lambda t: t,
    "degF": lambda t: 1.8 * t + 32,
    "K": lambda t: t + 273.15,
    "mdegC": lambda t: 1000 * t,
}
TIMES = {
    1.0: ("s", "sec", "seconds", "Sekunden"),
    1e-3: ("ms", "msec", "milliseconds", "MS"),
    60.0: ("min", "mins", "minutes", "Minuten"),
    3600.0: ("h", "hr", "hours"),
    86400.0: ("d", "days"),
}
PERCENT = ("%", "percent", "pct")
NO_DUTY = ("W", "kW", "V", "VDC", "mV", "A", "mA", "watts", "counts", "°C", "s", "Pa", "raw")
NO_TEMPERATURE = ("V", "mV", "W", "ohm", "%", "counts", "%RH", "s", "bar", "°Ré")
EXPLICIT = FORMS[:3]
CELSIUS = (21.5, 22.0, 24.25)
ROOM = {"heater": "duty_P1", "clock": "time_s"}


def _read(folder, titles: list[str], numbers: list[list[float]], **options) -> Experiment:
    """The recording in a file with these titles and columns."""
    path = folder.mktemp("units") / "run.csv"
    rows = [";".join(map(repr, row)) for row in zip(*numbers, strict=True)]
    path.write_text("\n".join([";".join(titles), *rows, ""]), encoding="utf-8")
    return read_recording(path, **options)


def _spelled(spellings: dict) -> st.SearchStrategy:
    pairs = [(unit, word) for unit, words in spellings.items() for word in words]
    return st.sampled_from(pairs)


@given(_spelled(TEMPERATURES), st.sampled_from(FORMS), st.sampled_from(["T1", "ambient"]))
def test_a_temperature_arrives_in_degC_under_any_name(tmp_path_factory, spelled, form, name):
    unit, word = spelled
    title = form.format("bed temp", word)
    values = [FROM_CELSIUS[unit](t) for t in CELSIUS]
    columns = {title: name, **ROOM}
    run = _read(
        tmp_path_factory,
        ["clock", "heater", title],
        [[0.0, 1.0, 2.0], [0.0, 1.0, 1.0], values],
        columns=columns,
    )
    values = run.ambient if name == "ambient" else run.temperatures
    assert values is not None
    np.testing.assert_allclose(np.ravel(values), CELSIUS, atol=1e-9)


@given(_spelled(TIMES), st.sampled_from(FORMS), st.sampled_from(["time", "time_s"]))
def test_a_time_arrives_in_seconds_under_any_name(tmp_path_factory, spelled, form, name):
    second, word = spelled
    title = form.format("Elapsed", word)
    run = _read(
        tmp_path_factory,
        [title, "duty_P1", "T1_degC"],
        [[0.0, 60 / second, 7200 / second], [0.0, 0.5, 1.0], [*CELSIUS]],
        columns={title: name},
    )
    np.testing.assert_allclose(run.time, [0, 60, 7200], rtol=1e-12)


@given(st.sampled_from(PERCENT), st.sampled_from(FORMS))
def test_a_duty_in_percent_arrives_as_a_share(tmp_path_factory, word, form):
    title = form.format("Heater", word)
    run = _read(
        tmp_path_factory,
        ["time_s", title, "T1_degC"],
        [[0.0, 1.0, 2.0], [0.0, 0.5, 100.0], [*CELSIUS]],
        columns={title: "duty_P1"},
    )
    np.testing.assert_allclose(run.duty[:, 0], [0, 0.005, 1])


@given(
    st.sampled_from(NO_DUTY), st.sampled_from(EXPLICIT), st.sampled_from(["duty_P1", "duty_P1_%"])
)
def test_another_quantity_is_no_duty(tmp_path_factory, word, form, name):
    """Numbers that are a duty by their size alone."""
    title = form.format("Heater", word)
    with pytest.raises(RecordingError, match=r"column Heater.*: expected a (known )?unit of duty"):
        _read(
            tmp_path_factory,
            ["time_s", title, "T1_degC"],
            [[0.0, 1.0, 2.0], [0.0, 0.5, 1.0], [*CELSIUS]],
            columns={title: "duty_P1"},
        )


@given(
    st.sampled_from(NO_TEMPERATURE), st.sampled_from(EXPLICIT), st.sampled_from(["T1", "ambient"])
)
def test_another_quantity_is_no_temperature(tmp_path_factory, word, form, name):
    title = form.format("probe", word)
    with pytest.raises(RecordingError, match=r"column probe.*: expected a (known )?unit of temp"):
        _read(
            tmp_path_factory,
            ["time_s", "duty_P1", title],
            [[0.0, 1.0, 2.0], [0.0, 0.5, 1.0], [*CELSIUS]],
            columns={title: name},
        )


@given(
    st.sampled_from(["{}_f", "{} F", "{} f", "{}_k", "{} K", "{}_F"]),
    st.sampled_from(["zone", "sensor", "Row", "plate B"]),
)
def test_a_letter_that_may_be_a_unit_or_a_name_is_asked_for(tmp_path_factory, form, stem):
    title = form.format(stem)
    columns = [[0.0, 1.0, 2.0], [0.0, 0.5, 1.0], [*CELSIUS]]
    titles = ["time_s", "duty_P1", title]
    with pytest.raises(RecordingError, match=r"may be either; name the column (T1_degF|T1_K) or"):
        _read(tmp_path_factory, titles, columns, columns={title: "T1"})
    run = _read(tmp_path_factory, titles, columns, columns={title: "T1_degC"})
    assert run.temperatures is not None
    np.testing.assert_array_equal(run.temperatures[:, 0], CELSIUS)


@pytest.mark.parametrize(
    ("title", "stem", "symbol"),
    [
        ("temp_f", "temp", "degF"),
        ("tempF", "temp", "degF"),
        ("TempC", "Temp", "degC"),
        ("T°F", "T", "degF"),
        ("T..degF.", "T", "degF"),  # as R writes `T (degF)`
        ("°F bed", "bed", "degF"),
        ("T (°F) avg", "T avg", "degF"),
        ("T_degF (bed)", "T", "degF"),
        ("bed_K", "bed", "K"),
        ("bed_kelvin", "bed", "K"),
        ("201 (VDC)", "201", "V"),
        ("P_kW", "P", "kW"),
        ("duty_P1 [-]", "duty_P1", "1"),
        ("T (1)", "T", "1"),
        ("heater on/off", "heater", "1"),
        ("ms", "", "ms"),
        ("°F", "", "degF"),
        ("1", "1", None),
        ("millis()", "", "ms"),
        ("heater()", "heater", "1"),
        ("ms elapsed", "elapsed", "ms"),
        ("minutes since start", "since start", "min"),
        ("heater % mean", "heater  mean", "%"),
        ("Volts heater", "heater", "V"),
        ("T 0.1°C", "T 0.1", None),  # tenths of a degree
        ("T x10 degC", "T x10", None),
        ("T11 degC", "T11", "degC"),
        ("temp_f1", "temp_f1", "degF"),
        ("programs", "programs", None),
        ("T_amb", "T_amb", None),
        ("Date/Time", "Date/Time", None),
        ("P_MW", "P_MW", None),  # a megawatt is no milliwatt
        ("Temp (bed)", "Temp", None),
    ],
)
def test_a_title_and_its_unit(title, stem, symbol):
    parts = unit_of_title(title)
    assert (parts.stem, parts.unit and parts.unit.symbol) == (stem, symbol)


@given(st.text(max_size=30))
def test_no_title_is_answered_with_an_error(title):
    assert len(unit_of_title(title).stem) <= len(title)


@pytest.mark.parametrize(
    ("title", "name"),
    [("T_min", "T1"), ("T_s", "T1"), ("zone_A", "T1_degC"), ("cell_C", "duty_P1")],
)
def test_the_last_word_of_a_name_is_not_always_a_unit(tmp_path_factory, title, name):
    other = "duty_P1" if name != "duty_P1" else "T1_degC"
    numbers = [0.25, 0.5, 0.75]
    run = _read(
        tmp_path_factory,
        ["time_s", title, other],
        [[0.0, 1.0, 2.0], numbers, [0.1, 0.2, 0.3]],
        columns={title: name},
    )
    values = run.duty if name == "duty_P1" else run.temperatures
    assert values is not None
    np.testing.assert_array_equal(values[:, 0], numbers)


@pytest.mark.parametrize("title", ["pwm_P1 [%]", "PWM (%)", "PWM pct"])
def test_counts_have_no_percentage(tmp_path_factory, title):
    with pytest.raises(RecordingError, match="a share of full duty is called duty_P1"):
        _read(
            tmp_path_factory,
            ["time_s", title],
            [[0.0, 1.0], [0.0, 50.0]],
            columns={title: "pwm_P1"},
            counts=255,
        )


def test_counts_of_a_rig_that_states_none_are_refused(tmp_path_factory):
    """255 would be assumed; the scale of the device was 127."""
    rig = heated_block()
    assert not rig.driver.states_counts
    titles, columns = ["time_s", "pwm_P1", "T_degC"], [[0.0, 1.0], [0.0, 127.0], [20.0, 21.0]]
    with pytest.raises(RecordingError, match=r"counts=255, or the rig .* \[driver\]"):
        _read(tmp_path_factory, titles, columns, rig=rig)
    run = _read(tmp_path_factory, titles, columns, rig=rig, counts=127)
    assert run.duty[:, 0].tolist() == [0, 1]


@pytest.mark.parametrize(
    ("title", "scale", "numbers"),
    [
        ("P_W", "1/2220 W", [0, 1110, 2220]),
        ("P (kW)", "1/2220 W", [0, 1.11, 2.22]),
        ("power", "1/2.22 kW", [0, 1.11, 2.22]),
        ("P_W", "1/2.22 kW", [0, 1110, 2220]),
        ("P [kW]", "1/2.22", [0, 1.11, 2.22]),
        ("U [V]", "1/12 V", [0, 6, 12]),
        ("I_mA", "1/2 A", [0, 1000, 2000]),
        ("level", "1/127 counts", [0, 63.5, 127]),
        ("level (steps)", "0.02", [0, 25, 50]),
    ],
)
def test_a_scale_makes_a_duty_of_another_quantity(tmp_path_factory, title, scale, numbers):
    run = _read(
        tmp_path_factory,
        ["time_s", title, "T1_degC"],
        [[0.0, 1.0, 2.0], numbers, [*CELSIUS]],
        columns={title: "duty_P1"},
        scale={"duty_P1": scale},
    )
    np.testing.assert_allclose(run.duty[:, 0], [0, 0.5, 1], rtol=1e-12)


def test_a_scale_makes_temperatures_of_tenths_and_volts(tmp_path_factory):
    for title, scale in (("T1 (0.1 °C)", "0.1"), ("probe", "0.1 degC"), ("U_mV", "100 V")):
        numbers = [10 * t for t in CELSIUS]
        run = _read(
            tmp_path_factory,
            ["time_s", "duty_P1", title],
            [[0.0, 1.0, 2.0], [0.0, 1.0, 1.0], numbers],
            columns={title: "T1"},
            scale={"T1": scale},
        )
        assert run.temperatures is not None
        np.testing.assert_allclose(run.temperatures[:, 0], CELSIUS, rtol=1e-12)


@pytest.mark.parametrize(
    ("scale", "message"),
    [("1/0 W", "a factor and the unit"), ("half", "a factor"), ("2 furlong", "a factor")],
)
def test_a_scale_that_is_none_is_refused(tmp_path_factory, scale, message):
    with pytest.raises(RecordingError, match=message):
        _read(
            tmp_path_factory,
            ["time_s", "P_W"],
            [[0.0, 1.0], [0.0, 1.0]],
            columns={"P_W": "duty_P1"},
            scale={"duty_P1": scale},
        )
    with pytest.raises(RecordingError, match="column P_W: expected a scale in W, got '1/12 V'"):
        _read(
            tmp_path_factory,
            ["time_s", "P_W"],
            [[0.0, 1.0], [0.0, 1.0]],
            columns={"P_W": "duty_P1"},
            scale={"duty_P1": "1/12 V"},
        )


def test_a_scale_of_no_column_is_refused(tmp_path_factory):
    with pytest.raises(RecordingError, match=r"scale: expected names of columns, .*, got duty_p1"):
        _read(
            tmp_path_factory,
            ["time_s", "duty_P1"],
            [[0.0, 1.0], [0.0, 1.0]],
            scale={"duty_p1": "0.5"},
        )


def test_kelvin_that_says_degC_is_refused_without_the_temperature_of_the_room(tmp_path_factory):
    kelvin = [[0.0, 1.0, 2.0], [0.0, 1.0, 1.0], [293.5, 294.0, 301.0]]
    with pytest.raises(RecordingError, match=r"in K, that is 20\.85 degC: .* is called T1_K"):
        _read(tmp_path_factory, ["time_s", "duty_P1", "T1_degC"], kelvin)
    # An oven that cools from 293 degC falls below what a room in kelvin can be.
    oven = [[0.0, 1.0, 2.0], [0.0, 0.0, 0.0], [293.5, 250.0, 180.0]]
    run = _read(tmp_path_factory, ["time_s", "duty_P1", "T1_degC"], oven)
    assert run.temperatures is not None
    assert run.temperatures[0, 0] == 293.5


@pytest.mark.parametrize(
    ("titles", "names"),
    [
        (["ms", "%", "°F"], ["time_s", "duty_P1", "T1"]),
        (["t/ms", "u/%", "T/°F"], ["time", "duty_P1", "T1"]),
        (["1", "2", "3"], ["time_ms", "duty_P1_%", "T1_degF"]),  # of a file without titles
        (["a", "b", "c"], ["time_ms", "duty_P1 [%]", "T1 (°F)"]),
    ],
)
def test_a_unit_may_be_the_whole_title_or_in_the_name_alone(tmp_path_factory, titles, names):
    numbers = [[0.0, 500.0, 1000.0], [0.0, 50.0, 100.0], [68.0, 70.7, 71.6]]
    columns = dict(zip(titles, names, strict=True))
    run = _read(tmp_path_factory, titles, numbers, columns=columns)
    assert run.time.tolist() == [0, 0.5, 1]
    assert run.duty[:, 0].tolist() == [0, 0.5, 1]
    assert run.temperatures is not None
    np.testing.assert_allclose(run.temperatures[:, 0], [20, 21.5, 22])


@pytest.mark.parametrize(("title", "name"), [("F", "T1"), ("A", "T1"), ("W", "duty_P1")])
def test_a_title_of_a_letter_is_asked_for(tmp_path_factory, title, name):
    numbers = [[0.0, 1.0], [0.0, 0.5], [20.0, 21.0]]
    other = "duty_P1" if name == "T1" else "T1_degC"
    titles = ["time_s", *((other, title) if name == "T1" else (title, other))]
    with pytest.raises(RecordingError, match=f"column {title}: expected a unit"):
        _read(tmp_path_factory, titles, numbers, columns={title: name})
    _read(
        tmp_path_factory,
        titles,
        numbers,
        columns={title: "T1_degC" if name == "T1" else "duty_P1 [-]"},
    )
