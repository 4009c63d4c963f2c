"""What an `Experiment` holds, refuses and offers."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pandas
import pytest

from jaxtwin.errors import RecordingError
from jaxtwin.io import Experiment

TIME = np.array([0.0, 1.0, 2.0, 3.0])
DUTY = np.zeros((4, 2))


def test_lists_and_integers_are_held_as_float64():
    experiment = Experiment([0, 1], [[1, 0], [0, -1]], ambient=15)
    assert experiment.time.dtype == experiment.duty.dtype == np.float64
    assert isinstance(experiment.ambient, float)


def test_nobody_can_change_it_afterwards():
    """A cache keyed by the fingerprint would otherwise give the results of other contents."""
    duty = DUTY.copy()
    experiment = Experiment(TIME, duty)
    duty[0] = 1
    assert np.all(experiment.duty == 0)
    with pytest.raises(ValueError, match="read-only"):
        experiment.duty[0] = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        experiment.name = "other"  # pyright: ignore[reportAttributeAccessIssue]


def test_duty_and_temperatures_without_a_second_dimension_are_one_cell_and_one_channel():
    experiment = Experiment(TIME, [0, 0, 1, 1], channels="T", temperatures=[20, 20, 20, 21])
    assert experiment.duty.shape == (4, 1)
    assert experiment.channels == ("T",)
    assert experiment.temperatures is not None
    assert experiment.temperatures.shape == (4, 1)


def test_an_ambient_that_never_changes_is_one_number():
    assert Experiment(TIME, DUTY, ambient=np.full(4, 15.5)).ambient == 15.5
    series = Experiment(TIME, DUTY, ambient=[15, 15, 15, 16]).ambient
    np.testing.assert_array_equal(series, [15, 15, 15, 16])


def test_duty_a_rounding_above_one_is_one():
    """255 * (1 / 255) and the like may end a last bit above full duty."""
    assert Experiment(TIME, np.full(4, np.nextafter(1, 2))).duty.max() == 1


def test_switch_times_are_where_any_cell_changes():
    duty = [[0.5, 0.5], [0.5, 0.5], [0.5, 0.4], [0.2, 0.4]]
    np.testing.assert_array_equal(Experiment(TIME, duty).switch_times, [2, 3])
    assert Experiment(TIME, DUTY).switch_times.size == 0


def test_size_and_duration():
    experiment = Experiment(TIME + 100, DUTY)
    assert experiment.n_cells == 2
    assert experiment.duration == 3


def test_a_gap_is_a_step_above_three_median_steps():
    time = [0, 1, 2, 5, 6, 7, 10.5, 11.5]
    np.testing.assert_array_equal(Experiment(time, np.zeros(8)).gaps, [[7, 10.5]])


def test_between_keeps_its_end_out_and_its_times():
    part = Experiment(TIME, DUTY, channels=["T"], temperatures=TIME, ambient=TIME).between(1, 3)
    np.testing.assert_array_equal(part.time, [1, 2])
    np.testing.assert_array_equal(part.temperatures, [[1], [2]])
    np.testing.assert_array_equal(part.ambient, [1, 2])


def test_between_with_too_little_left_says_how_much():
    with pytest.raises(RecordingError, match=r"at least 2 samples .* between 3 s and inf s, got 1"):
        Experiment(TIME, DUTY).between(3)


def test_select_takes_channels_in_the_order_asked_for():
    experiment = Experiment(TIME, DUTY, channels=["a", "b", "c"], temperatures=np.eye(4)[:, :3])
    part = experiment.select(["c", "a"])
    assert part.channels == ("c", "a")
    np.testing.assert_array_equal(part.temperatures, np.eye(4)[:, [2, 0]])


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (["b"], "expected some of a, got b"),
        ([], "expected some of a, got"),
        (["a", "a"], "more than once"),
    ],
)
def test_select_of_what_is_not_there_says_what_is(asked, said):
    experiment = Experiment(TIME, DUTY, channels=["a"], temperatures=TIME)
    with pytest.raises(RecordingError, match=said):
        experiment.select(asked)


def test_equality_is_of_contents_and_not_of_names():
    first, same = Experiment(TIME, DUTY, name="one"), Experiment(TIME, -DUTY, name="same")
    assert first == same  # DUTY is 0.0 and -DUTY -0.0: the same number
    assert hash(first) == hash(same)
    assert first != Experiment(TIME, DUTY, ambient=15)
    assert first != Experiment(TIME, DUTY, channels=["T"])
    assert first != "one"


def test_fingerprint_tells_shapes_apart_that_have_the_same_numbers():
    four = np.zeros((4, 4))
    assert Experiment(TIME, four).fingerprint != Experiment(TIME, four[:, :2]).fingerprint


def test_fingerprint_takes_every_kind_of_nan_for_the_same():
    other = np.array([20, 0, 21, 22.0])
    other[1] = np.frombuffer(b"\x01\x00\x00\x00\x00\x00\xf8\xff", "<f8")[0]  # another bit pattern
    plain = np.array([20, np.nan, 21, 22])
    assert np.isnan(other[1])
    assert other.tobytes() != plain.tobytes()
    first, same = (Experiment(TIME, DUTY, channels=["T"], temperatures=t) for t in (other, plain))
    assert first == same


@pytest.mark.parametrize(
    "column",
    [
        [20.5, None, 22, 23],
        np.ma.masked_equal([20.5, 0, 22, 23], 0),
        pandas.Series([20.5, np.nan, 22, 23]),
        pandas.Series([20.5, None, 22, 23], dtype="Float64"),
        jnp.array([20.5, jnp.nan, 22, 23]),
        np.array([20.5, np.nan, 22, 23], np.float32),
    ],
    ids=["None", "masked", "Series", "Series with NA", "JAX", "float32"],
)
def test_missing_samples_of_any_kind_are_nan(column):
    experiment = Experiment(TIME, DUTY, channels=["T"], temperatures=column)
    np.testing.assert_array_equal(experiment.temperatures, [[20.5], [np.nan], [22], [23]])
    np.testing.assert_array_equal(experiment.sampled, [[True], [False], [True], [True]])


READ_ONLY = np.eye(4)[:, :2]
READ_ONLY.setflags(write=False)


@pytest.mark.parametrize(
    "table",
    [
        np.eye(4)[:, :2].tolist(),
        np.eye(4, dtype=np.int16)[:, :2],
        np.asfortranarray(np.eye(4)[:, :2]),
        np.repeat(np.eye(4)[:, :2], 2, axis=1)[:, ::2],
        READ_ONLY,
        jnp.eye(4)[:, :2],
        pandas.DataFrame(np.eye(4)[:, :2], columns=["a", "b"]),
        pandas.DataFrame(np.eye(4)[:, :2], columns=["a", "b"], dtype="Int64"),
    ],
    ids=["lists", "int16", "Fortran", "strided", "read-only", "JAX", "DataFrame", "Int64"],
)
def test_tables_of_any_kind_hold_the_same(table):
    frame = pandas.DataFrame(index=pandas.Index(TIME, name="time_s"), columns=["a", "b"])
    experiment = Experiment(frame.index, table, channels=frame.columns, temperatures=table)
    assert experiment == Experiment(
        TIME, np.eye(4)[:, :2], channels=["a", "b"], temperatures=np.eye(4)[:, :2]
    )


def test_missing_ambient_samples_lie_between_their_neighbours():
    gappy = [np.nan, 15, np.nan, 17]
    np.testing.assert_array_equal(Experiment(TIME, DUTY, ambient=gappy).ambient, [15, 15, 16, 17])
    assert Experiment(TIME, DUTY, ambient=[np.nan, 15, np.nan, 15]).ambient == 15.0


def test_it_says_how_many_samples_are_missing():
    temperatures = [[20, np.nan], [np.nan, np.nan], [20, np.nan], [20, np.nan]]
    experiment = Experiment(TIME, DUTY, channels=["a", "b"], temperatures=temperatures)
    assert "5 of 8 samples missing, b without any" in repr(experiment)
    assert "missing" not in repr(experiment.select(["a"]).between(2, None))


def test_a_part_without_any_temperature_is_refused():
    experiment = Experiment(TIME, DUTY, channels=["a"], temperatures=[20, 20, np.nan, np.nan])
    with pytest.raises(RecordingError, match="expected at least one sample"):
        experiment.between(2, None)


def test_to_xarray_labels_everything_with_units(experiment):
    data = experiment.to_xarray()
    assert data["duty"].dims == ("time", "cell")
    assert data["temperature"].dims == ("time", "channel")
    assert {name: data[name].attrs["units"] for name in ("time", "duty", "temperature")} == {
        "time": "s",
        "duty": "1",
        "temperature": "degC",
    }
    np.testing.assert_array_equal(
        data["temperature"].sel(channel="T11"), experiment.temperatures[:, 1]
    )
    np.testing.assert_array_equal(data["ambient"], experiment.ambient)


def test_it_prints_what_is_in_it(experiment):
    text = repr(experiment)
    for part in (
        "made here",
        "40 samples",
        "every 1 s",
        "2 cells",
        "T12, T11, TAM",
        "15.0 to 15.1",
    ):
        assert part in text
    assert "not recorded" in repr(Experiment(TIME, DUTY, channels=["T"]))
    assert "<b>" not in Experiment(TIME, DUTY, name="<b>")._repr_html_()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"time": [], "duty": []}, "empty: expected at least 2 samples, got 0"),
        ({"time": [0], "duty": [0]}, "empty: expected at least 2 samples, got 1"),
        ({"time": [[0, 1], [2, 3]]}, r"time: expected shape \(times,\), got \(2, 2\)"),
        ({"time": [0, 1, 1, 2]}, r"got 1 s at sample 2 after 1 s"),
        ({"time": [0, 2, 1, 3]}, r"got 1 s at sample 2 after 2 s"),
        ({"time": [0, 1, np.nan, 3]}, r"time: .* got nan at sample 2"),
        ({"time": ["0", "1", "2", "3"]}, "time: expected real numbers, got str"),
        ({"time": [0, 1j, 2, 3]}, "time: expected real numbers, got complex"),
        ({"duty": [[0], [0, 1], [0], [0]]}, "rows of different lengths"),
        ({"duty": np.zeros((3, 2))}, r"duty: .* 4 times .* got \(3, 2\)"),
        ({"duty": np.zeros((4, 0))}, "at least one cell"),
        ({"duty": [0, 0, 1.01, 0]}, r"duty of cell 1: expected -1 to 1, got 1.01 at sample 2"),
        ({"duty": [0, 0, -128, 0]}, "duty of cell 1: .* got -128"),
        ({"duty": np.ma.masked_equal([0, 1, 0, 0], 1)}, "masked"),
        ({"duty": [0, None, 0, 0]}, "duty of cell 1: .* got nan at sample 1"),
        ({"time": [0, 1, None, 3]}, "time: .* got nan at sample 2"),
        ({"duty": [0, "off", 0, 0]}, "duty: expected real numbers, got str"),
        ({"duty": [False, True, False, False]}, "duty: expected real numbers, got bool"),
        (
            {"time": np.array([0, 1, 2, 3], "datetime64[s]")},
            "time: expected real numbers, got datetime64",
        ),
        ({"channels": ["a"], "temperatures": np.full(4, np.nan)}, "expected at least one sample"),
        ({"ambient": np.full(4, np.nan)}, "ambient: .* got nan at all times"),
        ({"channels": ["a", "a"]}, "channels: expected each name once, got a more"),
        ({"channels": {"b", "a"}}, r"several in the order of the columns.* got \{\'[ab]\'"),
        ({"channels": ["a,b"]}, "channel name: .* got 'a,b'"),
        ({"channels": [""]}, "channel name: .* got ''"),
        ({"channels": ["ambient"]}, "another name than 'ambient'"),
        ({"temperatures": np.zeros((4, 2))}, "and 0 channels"),
        ({"temperatures": np.zeros((4, 0))}, "and 0 channels"),
        ({"channels": ["a"], "temperatures": np.zeros((4, 2))}, r"temperatures: .* got \(4, 2\)"),
        (
            {"channels": ["a"], "temperatures": [0, 0, np.inf, 0]},
            "temperature a: .* got inf at sample 2",
        ),
        ({"channels": ["a"], "temperatures": [0, -274, 0, 0]}, "-274 degC at sample 1"),
        ({"ambient": np.nan}, "ambient: .* got nan"),
        ({"ambient": [15, 15, 15]}, r"ambient: .* got shape \(3,\)"),
        ({"ambient": -300}, "ambient: .* got -300 degC"),
        ({"ambient": -253.15}, r"ambient: .* got -253.15 degC; is it 20 degC, called K\?"),
        # What Keysight and Keithley send for an open thermocouple.
        (
            {"channels": ["a"], "temperatures": [0, 9.9e37, 0, 0]},
            r"expected -273.15 to 10000 degC, got 9.9e\+37 degC at sample 1 .* a missing sample",
        ),
        ({"duty": [0, 1.00001, 0, 0]}, r"expected -1 to 1, got 1.00001 at"),
        (
            {"time": [0, 1, 0.9999999, 3]},
            r"increasing times, got 0.9999999 s at sample 2 after 1 s",
        ),
    ],
)
def test_what_breaks_a_rule_is_refused_by_name(change, said):
    arguments = {"time": TIME, "duty": np.zeros(4)} | change
    with pytest.raises(RecordingError, match=said):
        Experiment(arguments.pop("time"), arguments.pop("duty"), **arguments)


@pytest.mark.parametrize("duty", [1 + 1e-7, float(np.float32(0.1) * 10 + 1e-7)])
def test_a_duty_that_is_full_but_for_rounding_is_full(duty):
    assert Experiment(TIME, np.full(4, duty)).duty.max() == 1.0
