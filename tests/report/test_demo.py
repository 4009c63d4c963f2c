"""The demo's report holds what the computation gave; `make demo` does the whole computation."""

import json
import re
import time
import tomllib
from dataclasses import replace

import numpy as np
import pytest
import xarray
from small_results import analysis, fit, recordings

import jaxtwin.report._demo_match as demo_match
import jaxtwin.report._parameters as report_sensitivity
from jaxtwin import Experiment, Twin, load_rig
from jaxtwin._number_text import interval_text
from jaxtwin.errors import RecordingError
from jaxtwin.matching import FittedParameters
from jaxtwin.physics import ThermoelectricModule
from jaxtwin.report import _demo, write_demo
from jaxtwin.report._demo import check_table
from jaxtwin.report._demo_match import significance_text
from jaxtwin.report._demo_simulate import Source, _largest_difference, _timed, find_source
from jaxtwin.report._parameters import parameter_table
from jaxtwin.report._recordings import shows_sawtooth
from jaxtwin.sensitivity_analysis import Sensitivity

PICTURES = {
    "plate-beside",
    "uniformity",
    "netlist",  # Figs. 8 and 13a of the paper
    "recordings",  # Fig. 6
    "dc-sweep-CP10-127-05",  # Fig. 11
    "dc-sweep-TEC1-12706",
    "published-response",
    "plate-map",  # Figs. 5 and 13b
    "history",  # Fig. 14
    "parameters",  # Table 4
    "response",  # Fig. 15
    "residuals",
    "tornado",  # Fig. 16
    "sensitivity-matrix",
}


@pytest.fixture
def nowhere(tmp_path, monkeypatch):
    """A machine without recordings."""
    monkeypatch.delenv("JAXTWIN_RECORDINGS", raising=False)
    monkeypatch.setattr("jaxtwin.io._fetch._usual_folders", lambda: [tmp_path / "none"])


def test_a_module_s_largest_difference_is_where_the_peltier_heat_is_used_up():
    """At $Z T_c^2 / 2 = T_h - T_c$."""
    module = ThermoelectricModule(0.05, 2.0, 1.5)
    difference = _largest_difference(module, 300.0)
    Z = 0.05**2 * 1.5 / 2.0
    assert Z * (300.0 - difference) ** 2 / 2 == pytest.approx(difference, rel=1e-12)


def test_the_time_of_a_simulation_is_part_of_the_time_around_it():
    drive = Experiment.schedule("0:0.5", duration=3, channels=("T",))
    began = time.perf_counter()
    measured = _timed(Twin("single-cell"), drive)
    assert 0 < measured < time.perf_counter() - began


def test_without_recordings_the_synthetic_ones_are_taken_and_said_so(nowhere):
    source = find_source(None)
    assert not source.real
    assert "not on this machine" in source.note
    assert [experiment.name for experiment in source.experiments] == [
        "synthetic-A",
        "synthetic-B",
        "synthetic-C",
    ]


def test_a_folder_that_was_asked_for_is_not_replaced_by_another(nowhere, tmp_path, monkeypatch):
    with pytest.raises(RecordingError, match="no such folder"):
        find_source(tmp_path / "asked")
    monkeypatch.undo()
    monkeypatch.setenv("JAXTWIN_RECORDINGS", str(tmp_path / "set"))
    with pytest.raises(RecordingError, match="no such folder"):
        find_source(None)


def test_a_number_that_is_off_is_marked():
    numbers = {
        "plate_nodes": 24,
        "plate_resistances": 83,
        "states": 28,
        "plate_capacitance_J_per_K": 681.66,
        "plate_to_ambient_W_per_K": 4.7,
    }
    verdicts = {row[0]: row[-1] for row in check_table(numbers, real=False).rows}
    assert verdicts.pop("plate to ambient, W/K") == "!differs"
    assert set(verdicts.values()) == {"as it should be"}


@pytest.mark.parametrize(("seen", "simulated"), [(False, False), (True, False), (True, True)])
def test_the_report_speaks_of_a_sawtooth_where_there_is_one(seen, simulated):
    """Four corrections 70 s apart, as uncooled cameras make them, against noise alone, and against
    a plate that moves so by itself."""
    run = fit().runs["synthetic-A"]
    time = np.arange(0.0, 300.0)
    duty, noise = np.zeros((300, 2)), 0.01 * np.random.default_rng(0).standard_normal((300, 5))
    sawtooth = 5.0 * (time[:, None] % 70.0) / 70.0
    temperatures = 20.0 + noise + (sawtooth if seen else 0.0)
    experiment = Experiment(time, duty, channels=run.channels, temperatures=temperatures)
    own = np.full((300, 5), 20.0) + (sawtooth if simulated else 0.0)
    states = np.full((300, len(run.nodes)), 20.0)
    made = replace(run, experiment=experiment, temperatures=own, states=states)
    assert shows_sawtooth([made]) == (seen and not simulated)


def test_warnings_of_a_match_stand_in_its_tables():
    lost = replace(fit()["R_pc"], interval=(0.0, np.inf), warnings=("not determined", "correlated"))
    rows = FittedParameters({**fit().parameters, "R_pc": lost})
    table = parameter_table(replace(fit(), parameters=rows), "Table 4.")
    (open_,) = [row for row in table.rows if row[0] == "R_pc"]
    assert open_[5] == "unknown"
    assert open_[-1] == "!not determined, correlated"
    assert "Correlated: another parameter can replace it." in table.caption
    assert "prior" not in table.head  # this rig has none
    (told,) = [row for row in table.rows if row[0] == "R_E"]
    assert told[5] == interval_text(fit()["R_E"].interval)


@pytest.mark.slow
def test_what_few_draws_tell_is_compared_by_name_and_sign():
    """Two sets of one size that differ: a parameter lost, one with the other sign."""
    names = ("R_pc", "R_E", "R_Tez", "R_Tfx")
    row = analysis().channels.index("mean")

    def telling(signs: dict[str, int]) -> Sensitivity:
        interval = np.tile([-0.5, 0.5], (len(analysis().channels), 4, 1))
        for name, sign in signs.items():
            interval[row, names.index(name)] += sign
        return replace(analysis(), names=names, interval=interval, rank_interval=interval)

    text = significance_text(telling({"R_pc": -1, "R_Tez": -1}), telling({"R_pc": -1, "R_Tez": 1}))
    assert "of 20 draws, R_pc (−), R_Tez (−)" in text
    assert "of 20 draws, R_pc (−), R_Tez (+)" in text
    assert "do not confirm R_Tez." in text
    text = significance_text(telling({"R_pc": -1, "R_E": 1}), telling({"R_pc": -1, "R_Tfx": 1}))
    assert "do not confirm R_E." in text
    assert "do not confirm" not in significance_text(telling({}), telling({"R_pc": 1}))


@pytest.mark.slow
def test_the_report_holds_pictures_numbers_fits_and_says_what_it_was_done_on(tmp_path, monkeypatch):
    source = Source(recordings(), False, "Done on a minute of the synthetic recordings.")
    monkeypatch.setattr(_demo, "find_source", lambda folder: source)
    monkeypatch.setattr(demo_match, "synthetic_source", lambda: source)
    monkeypatch.setattr(demo_match, "match", lambda *args, **options: fit())
    monkeypatch.setattr(report_sensitivity, "sensitivity", lambda *args, **options: analysis())
    steps: list[str] = []

    class Listener:
        def step(self, text: str) -> None:
            steps.append(text)

        def update(self, text: str) -> None:
            pass

    page = write_demo(tmp_path / "report", draws=20, progress=Listener())
    folder = page.parent
    html = page.read_text(encoding="utf-8")
    assert {path.stem for path in folder.glob("*.png")} == PICTURES
    assert html.count("data:image/png") == len(PICTURES)
    assert source.note in html
    assert "95 % interval" in html
    assert "std. error</th>" not in html.replace("error / std. error</th>", "")
    assert "sawtooth" not in html  # the synthetic camera has none
    assert "on different days" not in html
    assert len(steps) > 5

    numbers = json.loads((folder / "numbers.json").read_text())
    shown = f"{numbers['match_ambient_fixed']['mean_fit_percent']:.1f} %"
    assert re.search(rf"<dd>{re.escape(shown)}</dd>", html)
    assert numbers["network"]["plate_resistances"] == 83
    assert numbers["real_recordings"] is False
    even = fit().runs["synthetic-A"].recorded_uniformity
    assert numbers["uniformity"]["synthetic-A"]["recorded_mean_range_K"] == even.mean_range

    saved = tomllib.loads((folder / "fit-ambient-per-recording.toml").read_text())
    assert set(saved["recordings"]) == {"synthetic-A", "synthetic-B"}
    assert set(saved["parameters"]) == set(load_rig("paper-2024").parameters)
    with xarray.open_dataset(folder / "sensitivity.nc") as stored:
        assert stored.sizes["draw"] == 20
