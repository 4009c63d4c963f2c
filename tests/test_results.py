"""Whatever a public function gives can be plotted, printed, and taken to xarray and pandas."""

import inspect
import json
import math
import pickle
import typing
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
import xarray
from aged_sessions import session
from faulty_runs import bench, recording
from matplotlib import pyplot
from matplotlib.figure import Figure
from placed_rig import GRID, placed_text
from small_results import analysis, fit, global_analysis, recordings

import jaxtwin as jt
from jaxtwin import control, plots
from jaxtwin.control import (
    PID,
    ClosedLoopRun,
    Frontier,
    OperatingPoint,
    Tuning,
    UltimatePoint,
    frontier,
    most_even_point,
    ultimate_point,
)
from jaxtwin.matching import FittedParameters, Profile
from jaxtwin.physics import DCSweep
from jaxtwin.refitting import GateCheck
from jaxtwin.retuning import LoopTrial, Retuned, ScenarioTrial, TrialScenario
from jaxtwin.simulation import Grid, GridConvergence, Reductions
from jaxtwin.validation import Prediction

DRAWS = {"R_E": np.array([1.9, 2.0, 2.1])}


@cache
def reductions() -> Reductions:
    return jt.reduce_batch(fit().twin, recordings()[0], DRAWS, ["cost", "final", "plate_range"])


@cache
def shifted() -> jt.Fit:
    """The fit with a room that is warmer by three of its standard errors."""
    row = fit()["T_amb"]
    warmer = replace(row, value=row.value + 3 * row.standard_error)
    return replace(fit(), parameters=FittedParameters({**fit().parameters, "T_amb": warmer}))


def dc_sweep() -> DCSweep:
    module = jt.physics.ThermoelectricModule.from_datasheet("CP10-127-05")
    return module.dc_sweep(np.linspace(0.0, 3.0, 20), [0.0, 20.0], 300.0)


def swept(folder: Path) -> jt.sweeps.Sweep:
    return jt.sweep(fit(), None, folder, draws=4, names=["R_E"], reductions=["final"])


def closed_loop() -> ClosedLoopRun:
    controller = PID(Kp=0.1, Ki=0.001)
    return jt.simulate_closed_loop(fit().twin, controller, 25.0, duration=20)


def tuning() -> Tuning:
    controller = PID(Kp=0.1, Ki=0.001)
    return jt.tune(fit().twin, controller, 25.0, duration=20, starts=1, rounds=1)


def frontier_of_two() -> Frontier:
    controller = PID(Kp=0.1, Ki=0.001)
    return frontier(fit().twin, controller, 25.0, duration=20, weights=[0, 1], rounds=1)


def even() -> OperatingPoint:
    return most_even_point(jt.Twin("dual-cell"), 30)


def oscillation() -> UltimatePoint:
    time = np.arange(100.0)
    wave = np.sin(2 * np.pi * time / 20)
    return ultimate_point((time, 40 - 0.25 * wave, np.where(wave >= 0, 0.5, 0.3)))


def two_grids() -> GridConvergence:
    return GridConvergence((Grid(0.02, 8, math.nan, 0.3), Grid(0.01, 32, 0.3, 0.0)), 0.1, "rig")


def refitted() -> jt.refitting.Refit:
    check = GateCheck("readings", True, 0.0, 0.0, "every channel is alive")
    return jt.refitting.Refit("unchanged", "nothing has changed", fit(), fit(), (check,), ())


def retuned() -> jt.retuning.Retuned:
    pid = PID(Kp=0.1, Ki=0.001)
    loop = LoopTrial(2.0, 1.0, 40.0, 0.1)
    steps = TrialScenario("steps", "the references")
    trial = ScenarioTrial(steps, loop, loop._replace(cost=1.0), True, "a cost of 1")
    return Retuned("rig", "rejected", "too hot", pid, pid, None, (trial,), 1.5, None, 1.0)


def aged() -> jt.prognostics.Health:
    sessions = [session(value) for value in (2.0, 2.1, 2.05, 2.2)]
    return jt.health(sessions, limits={"R_E": 3.0})


def design() -> jt.experiment_design.ExperimentDesign:
    return jt.design_experiment(jt.Twin("single-cell"), duration=20, hold=10, levels=2)


def moved(folder: Path) -> jt.control.RigDesign:
    file = folder / "plate.toml"
    file.write_text(placed_text(grid=GRID.replace('"1 cm"', '"4 cm"')))
    return jt.design_rig(jt.Twin(file), 30, limits=(0, 1), starts=1)


def separating() -> jt.experiment_design.DiagnosisDesign:
    return jt.design_experiment(
        bench(), purpose="diagnosis", faults=["age H1", "leak H1"], duration=40, hold=40, levels=2
    )


def identified() -> jt.identification.Identified:
    plan = jt.Experiment.schedule("0:0,100:1,500:0.2,900:0.8", duration=1200, step=10, cells=2)
    run = jt.simulate(jt.Twin("tclab"), plan)
    return jt.identify(
        jt.Experiment(
            plan.time, plan.duty[:, :1], channels=["T1"], temperatures=run.temperatures[:, :1]
        )
    )


# Class -> one of it.
RESULTS: dict[str, Callable[[Path], Any]] = {
    "Experiment": lambda _: recordings()[0],
    "Run": lambda _: fit().runs["synthetic-A"],
    "Reductions": lambda _: reductions(),
    "Fit": lambda _: fit(),
    "Identified": lambda _: identified(),
    "FitDifference": lambda _: jt.compare_fits(fit(), shifted()),
    "Band": lambda _: jt.prediction_band(fit()),
    "Profile": lambda _: jt.profile(fit(), "R_E", points=3),
    "Validation": lambda _: jt.validate(fit(), recordings()[0], warm_up=20),
    "Sensitivity": lambda _: analysis(),
    "GlobalSensitivity": lambda _: global_analysis(),
    "Sweep": lambda folder: swept(folder / "sweep"),
    "DCSweep": lambda _: dc_sweep(),
    "ExperimentDesign": lambda _: design(),
    "DiagnosisDesign": lambda _: separating(),
    "RigDesign": moved,
    "StateSpace": lambda _: jt.linearize(fit().twin, duty=0.4),
    "ClosedLoopRun": lambda _: closed_loop(),
    "Tuning": lambda _: tuning(),
    "Frontier": lambda _: frontier_of_two(),
    "OperatingPoint": lambda _: even(),
    "UltimatePoint": lambda _: oscillation(),
    "GridConvergence": lambda _: two_grids(),
    "Observed": lambda _: jt.observe(fit(), recordings()[0]),
    "Monitored": lambda _: jt.monitor(bench(), recording("gain", "T1", 0.8)),
    "Diagnosis": lambda _: jt.diagnose(bench(), recording("gain", "T1", 0.8)),
    "Isolability": lambda _: jt.isolability(bench(), faults=["age H1", "gain T1"]),
    "Refit": lambda _: refitted(),
    "Retuned": lambda _: retuned(),
    "Health": lambda _: aged(),
}

# Of these, those that are a few numbers: they have a table and a dataset, but no picture.
NUMBERS = {"OperatingPoint", "UltimatePoint", "GridConvergence", "Refit"}

# Of these, those that are saved as something other than their dataset: the ending of the file.
ENDINGS = {"Fit": ".toml", "RigDesign": ".toml"}

# Of these, those that take more than some seconds, nearly all of it compilation.
LONG = {
    "Band",
    "ClosedLoopRun",
    "Diagnosis",
    "DiagnosisDesign",
    "ExperimentDesign",
    "Frontier",
    "GlobalSensitivity",
    "Identified",
    "Isolability",
    "Monitored",
    "Observed",
    "Profile",
    "Run",
    "Sensitivity",
    "Tuning",
    "Validation",
}

INPUTS = {"CSources", "FMU", "Netlist", "PlateMap", "Rig", "Twin"}
INPUTS |= {
    "AbstractController",
    "ControllerDesign",
    "LQI",
    "MPC",
    "NonlinearMPC",
    "MonitorCalibration",
    "ProcessNoise",
    "Scenario",
}
"""Classes that public functions give and that are no results."""

# Signals as JAX arrays; `ClosedLoopRun` shows them.
INSIDE_JAX = {"ClosedLoop"}

# Named tuples of numbers, as python-control gives them.
TUPLES = {"DiskMargin", "LoopMargins", "Margins"}


@pytest.fixture(autouse=True)
def _closed_figures():
    yield
    pyplot.close("all")


def test_every_class_that_a_public_function_gives_is_looked_at_here():
    given = set()
    public = [(package, name) for package in (jt, control) for name in package.__all__]
    for package, name in public:
        function = getattr(package, name)
        if inspect.isfunction(function):
            kind = inspect.signature(function).return_annotation
            for part in (kind, *typing.get_args(kind)):
                if inspect.isclass(part) and part.__module__.startswith("jaxtwin"):
                    given.add(part.__name__)
    assert given - INPUTS - INSIDE_JAX - TUPLES <= set(RESULTS)
    assert {"Run", "Fit", "Validation", "Sensitivity", "Sweep", "Frontier"} <= given


def parts_of(result: Any) -> list[Any]:
    """The public attributes of a result that are of classes of the library."""
    names = [name for name in dir(type(result)) if not name.startswith("_")]
    values = [getattr(result, name) for name in {*names, *vars(result)} if name[0] != "_"]
    return [value for value in values if type(value).__module__.startswith("jaxtwin")]


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind",
    [pytest.param(kind, marks=pytest.mark.slow) if kind in LONG else kind for kind in RESULTS],
)
def test_every_result_shows_itself_and_can_be_taken_along(kind: str, tmp_path: Path):
    result = RESULTS[kind](tmp_path)
    assert type(result).__name__ == kind
    assert repr(result).startswith((f"<{kind} ", f"{kind}("))
    # Printed, neither the result nor a part of it is longer than a screen.
    for part in [result, *parts_of(result)]:
        assert len(str(part).splitlines()) <= 40, type(part)
    # As worker processes hand it on.
    assert repr(pickle.loads(pickle.dumps(result))) == repr(result)
    html = result._repr_html_()
    assert html.startswith("<table><caption>")
    assert html.count("<tr>") == html.count("</tr>") > 1
    table = result.to_dataframe()
    assert isinstance(table, pandas.DataFrame)
    assert len(table) > 0
    assert isinstance(result.to_xarray(), xarray.Dataset)
    assert json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert len(result.summary().splitlines()) > 1
    file = tmp_path / f"result{ENDINGS.get(kind, '.nc')}"
    assert result.save(file) == file
    assert file.stat().st_size > 0
    if kind in NUMBERS:
        return
    picture = result.plot()
    figure = picture if isinstance(picture, Figure) else picture.get_figure(root=True)
    assert isinstance(figure, Figure)
    assert figure.axes


@pytest.mark.slow
def test_the_tables_hold_the_numbers_of_the_results():
    matched = fit()
    data = matched.to_xarray()
    rows = matched.parameters.values()
    np.testing.assert_array_equal(data.value, [row.value for row in rows])
    np.testing.assert_array_equal(data.standard_error, [row.standard_error for row in rows])
    room = "T_amb[synthetic-A]"
    variance = float(data.covariance.sel(entry=room, other_entry=room))
    assert variance == pytest.approx(matched.uncertainty.standard_errors[room] ** 2)
    room = data.recording_value.sel(recording="synthetic-B", own_parameter="T_amb")
    assert float(room) == matched.recording_values["synthetic-B"]["T_amb"]
    percent = matched.fit_percent["synthetic-A", "T11"]
    assert float(data.fit_percent.sel(recording="synthetic-A", channel="T11")) == percent
    # The channels of zone B are not those of zone A.
    assert np.isnan(data.fit_percent.sel(recording="synthetic-B", channel="T11"))
    run = matched.runs["synthetic-A"]
    assert run.to_dataframe().loc[30.0, "T11"] == run.channel("T11")[30]
    reduced = reductions()
    assert reduced.cost is not None
    table = reduced.to_dataframe()
    assert table.loc[1, "cost[T11]"] == reduced.cost[1, 0]
    band = jt.prediction_band(matched)
    assert band.to_dataframe().loc[(30.0, "T11"), "upper"] == band.upper[30, 0]
    checked = jt.validate(matched, recordings()[0], warm_up=20)
    numbers = checked.to_dataframe().loc[("synthetic-A", "T11")]
    assert numbers.fit_percent == checked.fit_percent["synthetic-A", "T11"]
    assert float(checked.to_xarray().rmse.sel(channel="T11").item()) == numbers.rmse
    difference = jt.compare_fits(matched, shifted()).to_xarray()
    assert float(difference.new.sel(parameter="T_amb")) == shifted()["T_amb"].value
    # Both fits have the same standard error: that of their difference is larger by sqrt(2).
    three = float(difference.standard_errors.sel(parameter="T_amb"))
    assert three == pytest.approx(3 / np.sqrt(2))
    curves = dc_sweep()
    assert curves.to_dataframe().loc[(20.0, 3.0), "heat_flow"] == curves.heat_flow[1, -1]


def test_a_notebook_and_a_summary_show_the_same_numbers_with_four_digits():
    """With a sign where there is none."""
    found = GridConvergence(
        (Grid(0.02, 8, math.nan, 0.34567), Grid(0.01, 32, 0.3, 0.0)), 0.1, "rig"
    )
    assert "<tr><th>2</th><td>8</td><td>-</td><td>0.3457</td></tr>" in found._repr_html_()
    head, first, _ = found.summary().splitlines()[1:]
    assert head.split("  ") == ["resolution, cm", "elements", "change, K", "error, K"]
    assert first.split() == ["2", "8", "-", "0.3457"]


def test_json_has_everything_in_a_dataset_and_null_where_there_is_no_number():
    curves = dc_sweep()
    numbers = curves.to_dict()
    assert list(numbers) == ["T_hot_K", "heat_flow", "power", "cop", "delta_T", "current"]
    assert numbers["heat_flow"] == curves.heat_flow.tolist()
    assert numbers["cop"][0][0] is None  # without current there is no power


@pytest.mark.slow
def test_draws_that_failed_are_said():
    failed = np.arange(20) < 3
    assert "20 draws (3 failed, left out), strongest" in repr(replace(analysis(), failed=failed))


@pytest.mark.slow
def test_the_table_of_a_validation_is_a_dataset_with_units():
    run = fit().runs["synthetic-A"]
    made = Prediction("synthetic-A", run, fit().twin, {}, (), fit())
    data = jt.validation.Validation("made", "predicted", (made,)).to_xarray()
    units = {name: data[name].attrs["units"] for name in ("fit_percent", "rmse", "coverage")}
    assert units == {"fit_percent": "%", "rmse": "K", "coverage": "1"}


def test_a_saved_dataset_reads_back_the_same(tmp_path: Path):
    curves = dc_sweep()
    with xarray.open_dataset(curves.save(tmp_path / "curves.nc"), engine="scipy") as data:
        xarray.testing.assert_identical(data.load(), curves.to_xarray())
    with pytest.raises(jt.errors.RecordingError, match=r"expected \.nc"):
        curves.save(tmp_path / "curves.csv")


@pytest.mark.slow
def test_a_profile_is_drawn_with_its_limit_and_interval():
    found = jt.profile(fit(), "R_E", points=3)
    axes = found.plot()
    curve, limit = axes.lines[:2]
    np.testing.assert_array_equal(curve.get_ydata(), found.excess)
    assert set(np.asarray(limit.get_ydata())) == {3.841}


def test_a_profile_is_drawn_into_given_axes():
    found = Profile("R_E", "ohm", np.array([1.0, 2.0, 3.0]), np.array([9.0, 0.0, 9.0]), (1.3, 2.7))
    _, (left, right) = pyplot.subplots(1, 2)
    assert plots.plot_profile(found, ax=right) is right
    assert right.get_xlabel().endswith("ohm")
    assert not left.has_data()


def test_the_table_of_an_operating_point_holds_its_numbers_by_name():
    twin = jt.Twin("dual-cell")
    point = jt.linearize(twin, duty=[0.4, 0.3]).operating_point
    table = point.to_dataframe()
    assert table.loc[("duty", "P2")].tolist() == [0.3, "1"]
    assert table.loc[("channel", "TAM"), "value"] == point.outputs[twin.channels.index("TAM")]
    assert table.loc[("node", "P1.TC"), "value"] == point.nodes[twin.netlist.index["P1.TC"]]
    assert len(table) == 2 + len(point.nodes) + len(point.outputs) + 1
    at_rest = jt.control.StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]).operating_point
    assert at_rest.to_dataframe().index.tolist() == [
        ("duty", "u1"), ("node", "x1"), ("channel", "y1"), ("ambient", "")
    ]  # fmt: skip


def test_the_dataset_of_an_operating_point_holds_its_numbers_by_name():
    twin = jt.Twin("dual-cell")
    point = jt.linearize(twin, duty=[0.4, 0.3]).operating_point
    data = point.to_xarray()
    assert float(data.duty.sel(cell="P2")) == 0.3
    assert float(data.temperature.sel(channel="TAM")) == point.outputs[twin.channels.index("TAM")]
    assert float(data.state.sel(node="P1.TC")) == point.nodes[twin.netlist.index["P1.TC"]]
    assert float(data.ambient) == point.ambient
    units = {name: values.attrs["units"] for name, values in data.items()}
    assert units == {"duty": "1", "state": "degC", "temperature": "degC", "ambient": "degC"}
    at_rest = jt.control.StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]).operating_point.to_xarray()
    labels = [at_rest[dimension].item() for dimension in ("cell", "node", "channel")]
    assert labels == ["u1", "x1", "y1"]


def test_the_table_of_an_ultimate_point_holds_its_numbers():
    """A square wave of 0.1 has a fundamental of 0.4 / pi, a wave of 0.25 K against it: gain
    1.6 / pi per kelvin, in a period of 20 s."""
    table = oscillation().to_dataframe()
    assert table.loc["gain", "value"] == pytest.approx(1.6 / np.pi, rel=0.02)
    assert table.loc["period_s"].tolist() == [20.0, "s"]
    assert table.loc["amplitude", "value"] == pytest.approx(0.25)


def test_the_dataset_of_an_ultimate_point_holds_its_numbers_with_units():
    point = oscillation()
    data = point.to_xarray()
    units = {"gain": "1/K", "period_s": "s", "phase_deg": "deg", "amplitude": "K", "cycles": "1"}
    assert {name: values.attrs["units"] for name, values in data.items()} == units
    assert {name: values.item() for name, values in data.items()} == asdict(point)


@pytest.mark.slow
def test_distributions_are_those_of_the_draws():
    reduced = reductions()
    assert reduced.final is not None
    figure = reduced.plot()
    (axes,) = [axes for axes in figure.axes if axes.get_title(loc="left") == "final"]
    medians = np.asarray(axes.lines[0].get_xdata(), float)
    np.testing.assert_allclose(medians, np.median(reduced.final, axis=0))


def test_a_long_table_says_how_many_rows_it_leaves_out():
    from jaxtwin._display import html_table

    rows = [(f"row {number}", "<1>") for number in range(45)]
    html = html_table("forty-five & more", ("name", "value"), rows)
    assert html.count("&lt;1&gt;") == 40
    assert "5 more rows" in html
    assert "forty-five &amp; more" in html


@pytest.mark.slow
def test_a_recording_that_there_is_not_is_answered_with_those_that_there_are():
    checked = jt.validate(fit(), recordings()[0], warm_up=20)
    for found in (fit().runs, fit().camera, fit().weights, fit().twins):
        with pytest.raises(
            jt.errors.RecordingError, match="one of synthetic-A, synthetic-B; got 'C'"
        ):
            found["C"]
    with pytest.raises(jt.errors.RecordingError, match="one of synthetic-A; got 'synthetic-B'"):
        checked.runs["synthetic-B"]
    assert "C" not in fit().runs
    assert fit().runs.get("C") is None


def test_a_draw_is_one_row_and_each_of_its_numbers_a_column():
    """Nothing is repeated for each channel, whatever the shape of a quantity."""
    own = {
        "hottest": np.array([1.0, 2.0]),
        "ends": np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]),
        "grid": np.arange(8.0).reshape(2, 2, 2),
    }
    channels, failed = ("T11", "TAM"), np.array([False, False])
    final = np.array([[20.0, 21.0], [22.0, 23.0]])
    table = Reductions(channels, failed, final=final, custom=own).to_dataframe()
    assert (len(table), table.index.name) == (2, "draw")
    assert table.loc[1, "final[TAM]"] == 23.0
    assert table["hottest"].tolist() == [1.0, 2.0]
    assert table.loc[0, ["ends[0]", "ends[1]", "ends[2]"]].tolist() == [1.0, 2.0, 3.0]
    assert table.loc[1, "grid[1, 0]"] == 6.0


def test_distributions_of_a_number_for_each_draw_have_a_single_row():
    values = np.array([1.0, 2.0, 4.0])
    reduced = Reductions(("T",), np.zeros(3, bool), custom={"hottest": values})
    (axes,) = reduced.plot().axes
    np.testing.assert_array_equal(axes.lines[0].get_xdata(), [2.0])


def test_own_results_have_units_where_they_are_known():
    """In the dataset, in the table of a notebook and below the picture."""
    own = {"area": np.array([1.0, 2.0]), "index": np.array([3.0, 4.0])}
    made = Reductions(("T",), np.zeros(2, bool), custom=own, custom_units={"area": "K^2 s"})
    assert made.to_xarray()["area"].attrs == {"units": "K^2 s"}
    assert made.to_xarray()["index"].attrs == {}
    assert "<td>1.95</td><td>K^2 s</td>" in made._repr_html_()
    assert [axes.get_xlabel() for axes in made.plot().axes] == ["K² s", ""]


def test_quantiles_of_infinite_results_are_those_of_draws():
    """Three of four loops never settle."""
    times = np.array([80.0, np.inf, np.inf, np.inf])
    html = Reductions(("T",), np.zeros(4, bool), custom={"settling_time": times})._repr_html_()
    assert "<th>settling_time</th><td>80</td><td>inf</td><td>inf</td>" in html


def test_the_table_of_a_validation_is_named_by_it():
    run = fit().runs["synthetic-A"]
    made = Prediction("synthetic-A", run, fit().twin, {}, (), fit())
    html = jt.validation.Validation("made", "predicted", (made,))._repr_html_()
    assert html.startswith("<table><caption>&lt;Validation")


def test_the_autocorrelation_time_of_a_validation_is_in_seconds():
    """Samples that are twice as far apart make it twice as long."""
    run = fit().runs["synthetic-A"]
    slow = replace(run, experiment=replace(run.experiment, time=2 * run.experiment.time))
    times = [
        jt.validation.Validation(
            "made", "predicted", (Prediction("A", part, fit().twin, {}, (), fit()),)
        )
        .to_dataframe()
        .autocorrelation_time
        for part in (run, slow)
    ]
    np.testing.assert_allclose(times[1], 2 * times[0])


def test_the_head_of_a_table_has_the_units_of_the_dataset():
    profile = jt.profile(fit(), "R_E")
    assert "<th>R_E, ohm</th><th>excess</th>" in profile._repr_html_()
    assert profile.summary().splitlines()[1].split() == ["R_E,", "ohm", "excess"]
