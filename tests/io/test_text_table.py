"""Where titles and rows are in text: the same table, whatever stands above it."""

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.errors import RecordingError
from jaxtwin.io import Experiment, column_names, read_recording
from jaxtwin.io._text_table import table_of_text

ROWS = "0.0,0,21.5\n1.0,1,21.6\n2.0,1,21.8\n"
NAMES = {"X_Value": "time_s", "Heater": "duty_P1", "Temperature": "T1"}
TITLED = "X_Value,Heater,Temperature\n" + ROWS

LABVIEW = """LabVIEW Measurement\t
Separator\tTab
Decimal_Separator\t.
Date\t2024/03/05
Time\t14:03:20.5
***End_of_Header***\t
\t
Channels\t2\t\t
Samples\t4\t4\t
Date\t2024/03/05\t2024/03/05\t
X_Dimension\tTime\tTime\t
X0\t0.0\t0.0\t
Delta_X\t1.0\t1.0\t
***End_of_Header***\t\t\t
X_Value\tHeater\tTemperature\tComment
0.000000\t0\t21.5\t
1.000000\t1\t21.6
2.000000\t1\t21.8\t
"""
BENCHLINK = """Name:,Config,,
Owner:,lab,,
Acquisition Date:,3/5/2024 2:03:20 PM,,
,,,
Scan,Time,101 <oven> (C),201 (VDC)
1,3/5/2024 14:03:20:000,21.5,0
2,3/5/2024 14:03:21:000,21.6,5
3,3/5/2024 14:03:22:000,21.8,5
"""
PICO = "Time,Ave. Temp.,Ave. Heater\n(s),(°C),(V)\n\n0.0,21.5,0\n1.0,21.6,5\n2.0,21.8,5\n"


@pytest.fixture
def read(tmp_path):
    def read(text: str, **options) -> Experiment:
        path = tmp_path / "run.csv"
        path.write_text(text, encoding="utf-8")
        return read_recording(path, **options)

    return read


EXPECTED = Experiment(
    [0.0, 1.0, 2.0],
    [0.0, 1.0, 1.0],
    channels=["T1"],
    temperatures=[[21.5], [21.6], [21.8]],
)
BY_NUMBER = {"1": "time_s", "2": "duty_P1", "3": "T1"}
VOLTS = {"duty_P1": "1/5 V"}


@pytest.mark.parametrize(
    ("text", "options"),
    [
        (LABVIEW, {"columns": NAMES, "ignore": ["Comment"]}),
        (LABVIEW, {"columns": NAMES, "ignore": ["*"], "header": 15}),
        (
            BENCHLINK,
            {
                "columns": {"101 <oven> (C)": "T1", "201 (VDC)": "duty_P1"},
                "ignore": ["Scan"],
                "scale": VOLTS,
            },
        ),
        (PICO, {"columns": {"Ave. Temp.": "T1", "Ave. Heater": "duty_P1"}, "scale": VOLTS}),
        (
            PICO,
            {"columns": {"Ave. Temp. (°C)": "T1", "Ave. Heater (V)": "duty_P1"}, "scale": VOLTS},
        ),
        (ROWS, {"columns": BY_NUMBER, "header": 0}),
        (ROWS.replace(",", "  "), {"columns": BY_NUMBER, "header": 0}),
        (ROWS.replace(",", ";").replace(".", ","), {"columns": BY_NUMBER, "header": 0}),
        ("# time_s,duty_P1,T1_degC\n" + ROWS, {}),
        ("# a note\n# time_s duty_P1 T1_degC\n" + ROWS.replace(",", " "), {}),
        ("#time_s,duty_P1,T1_degC\n" + ROWS, {}),
        ("% time_s,duty_P1,T1_degC\n" + ROWS, {}),
        ("time_s,duty_P1,T1_degC\n# day 2\n" + ROWS, {}),
        (TITLED, {"columns": {"1": "time_s", "2": "duty_P1", "3": "T1"}}),
    ],
    ids=[
        "LabVIEW",
        "the line of titles is named",
        "BenchLink",
        "a row of units",
        "titles with their row of units",
        "no titles",
        "no titles, blanks",
        "no titles, decimal commas",
        "titles in a note",
        "numpy.savetxt",
        "no blank behind #",
        "MATLAB's note",
        "a note below the titles",
        "columns by number beside titles",
    ],
)
def test_forms_of_the_same_table(read, text, options):
    assert read(text, **options) == EXPECTED


LINES = st.lists(
    st.sampled_from(
        [
            *("", "Logger 3000", "Owner:,lab,,", "Interval,10,s", "X0,0.0,0.0", "# note"),
            *(
                "Start,2024-03-05 14:03:20",
                "Time,14:03:20",
                "a,b,c",
                "Channel;2;x",
                '"quoted, text"',
            ),
        ]
    ),
    max_size=8,
)


@given(LINES)
def test_a_preamble_changes_nothing(tmp_path_factory, lines):
    path = tmp_path_factory.mktemp("preamble") / "run.csv"
    path.write_text("\n".join([*lines, TITLED]), encoding="utf-8")
    assert read_recording(path, columns=NAMES) == EXPECTED


@given(LINES)
def test_titles_are_found_without_names(lines):
    table = table_of_text("\n".join([*lines, TITLED]))
    assert table.titles == ["X_Value", "Heater", "Temperature"]


@given(st.text('0123456789.,;\t \n#"abT_(s)°:/-', max_size=200), st.sampled_from([None, 0, 1, 3]))
def test_no_text_is_answered_with_another_error(text, header):
    with contextlib.suppress(RecordingError):
        table_of_text(text, header)


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        (ROWS, {}, "must name the columns.* header=0 is for a file without titles"),
        (TITLED, {"header": 9}, "header: expected the number of a line, 1 to 4, got 9"),
        (
            ROWS,
            {"header": 0, "columns": {"4": "T1"}},
            "expected titles of the file, 1, 2, 3, got 4",
        ),
        (TITLED, {"columns": {"X": "time_s"}}, "got X"),
        ("a,a\n0,1\n", {"columns": {"a": "time_s"}}, "occurs once, got 'a' in the columns 1, 2"),
        (
            PICO,
            {"columns": {"Ave. Heater": "duty_P1"}},
            r"Ave. Heater \(V\): expected a unit of duty",
        ),
    ],
)
def test_what_is_wrong_is_named(read, text, options, message):
    with pytest.raises(RecordingError, match=message):
        read(text, **options)


def test_a_star_leaves_out_all_that_would_be_refused(read):
    """Set points, a column without a title, a second clock, a temperature that is there twice."""
    text = (
        "time_s,Date/Time,duty_P1,T1_degC,,humidity,T1 (K),note\n"
        "0,2024-03-05 14:03:20,0,21.5,3,40,294.65,a\n"
        "1,2024-03-05 14:03:21,1,21.6,,40,294.75,\n"
        "2,2024-03-05 14:03:22,1,21.8,,40,294.95,\n"
    )
    assert read(text, ignore=["*"]) == EXPECTED


def test_a_star_leaves_out_channels_that_the_rig_has_not(tmp_path):
    from heated_block import heated_block

    path = tmp_path / "run.csv"
    path.write_text("time_s,duty_P1,duty_P2,T_degC,Set Point (degC)\n0,0,0,20,25\n1,1,0,20,25\n")
    run = read_recording(path, rig=heated_block(), ignore=["*"])
    assert (run.channels, run.n_cells) == (("T",), 1)
    names = column_names(path, rig=heated_block(), ignore=["*"])
    assert [title for title, name in names.items() if name is None] == [
        "duty_P2",
        "Set Point (degC)",
    ]
    assert read_recording(path).channels == ("T", "Set Point")


def test_an_index_of_times_without_a_title_holds_the_times(read):
    rows = [f"2024-03-05 14:03:2{row}" for row in ("0,0,21.5", "1,1,21.6", "2,1,21.8")]
    text = "\n".join([",duty_P1,T1_degC", *rows])
    assert read(text) == EXPECTED


@pytest.mark.parametrize(
    "words", [("off", "on"), ("False", "True"), ("no", "yes"), ("Aus", "Ein"), ("idle", "heating")]
)
def test_words_for_on_and_off(read, words):
    off, on = words
    text = f"time_s,duty_P1,T1_degC\n0,{off},21.5\n1,{on},21.6\n2,{on},21.8\n"
    assert read(text) == EXPECTED


def test_a_duty_that_is_logged_only_when_it_changes_is_held_and_said(read):
    run = read("time_s,duty_P1,T1_degC\n-1,,20\n0,0,21.5\n1,1,21.6\n2,,21.8\n")
    assert run == EXPECTED
    assert run.notes == (
        "duty_P1: missing in 1 of 4 samples, held",
        "left out before the first duty: 1 of 4 samples",
    )
    assert "held" in repr(run)


def test_a_state_is_held_too_and_open_is_one(read):
    run = read("time_s,duty_P1,input_lid\n0,0,closed\n1,0,\n2,0,open\n3,0,\n")
    assert run.inputs["lid"].tolist() == ["closed", "closed", "open", "open"]


def test_a_duty_that_is_never_there_is_refused(read):
    with pytest.raises(RecordingError, match="line 2, column duty_P1: expected a number"):
        read("time_s,duty_P1,T1_degC\n0,,20\n1,,20\n")


def test_a_constant_duty_is_stated(read):
    text = "time_s,T1_degC\n0,80\n60,75\n"
    assert read(text, duty=0.25).duty[:, 0].tolist() == [0.25, 0.25]
    with pytest.raises(RecordingError, match="duty= states one that is constant"):
        read(text)
    with pytest.raises(RecordingError, match="duty: expected none, as every drive has a column"):
        read("time_s,duty_P1\n0,1\n1,1\n", duty=0.5)
    both = read("time_s,duty_P2,T1_degC\n0,1,80\n60,1,75\n", duty=0)
    assert both.duty.tolist() == [[0, 1], [0, 1]]


def test_samples_of_one_second_are_spread_if_it_is_asked_for(read):
    """Two samples a second, then three, then one after a gap: each second is divided evenly."""
    seconds = [20, 20, 21, 21, 21, 50]
    rows = "".join(f"2024-03-05 14:03:{s},0.5,{20 + k}\n" for k, s in enumerate(seconds))
    text = "time,duty_P1,T1_degC\n" + rows
    with pytest.raises(RecordingError, match=r"line 3: time: .* spread=True spreads them evenly"):
        read(text)
    run = read(text, spread=True)
    np.testing.assert_allclose(run.time, [0, 0.5, 1, 1 + 15 / 3, 1 + 30 / 3, 30])
    assert run.notes == ("time: spread evenly, 3 of 6 samples had the time before",)


@pytest.mark.parametrize("gap", [",", " "])
def test_a_note_of_titles_may_be_named_by_its_line(read, gap):
    text = "# bench 7\n# time_s,duty_P1,T1_degC\n# 12 V\n".replace(",", gap) + ROWS.replace(
        ",", gap
    )
    assert read(text, header=2) == EXPECTED
