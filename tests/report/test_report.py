"""The report of any fit: with a camera or with thermocouples, from Python and from the shell."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_results import fit, recordings
from small_rigs import small_rig_file
from typer.testing import CliRunner

from jaxtwin import Experiment, Fit, JaxtwinError, Twin, load_rig, match, simulate
from jaxtwin.cli import app
from jaxtwin.errors import MatchError
from jaxtwin.io import write_recording
from jaxtwin.report._demo_match import _deviation
from jaxtwin.report._page import ReportPicture, ReportTable, Text
from jaxtwin.report._parameters import own_values_table, parameter_table
from jaxtwin.report._recordings import (
    _map_times,
    _row,
    _seen_together,
    residuals_section,
    uniformity_section,
)
from jaxtwin.report._report import rig_section
from jaxtwin.simulation import Run

SECTIONS = (
    "The rig",
    "The recordings",
    "Recorded and simulated temperatures",
    "Parameters",
    "Residuals",
    "Uniformity",
    "How to use the matched twin",
    "Environment",
)
PICTURES = {
    "correlation",
    "history",
    "netlist",
    "parameters",
    "plate-beside",
    "recordings",
    "residual-tests",
    "residuals",
    "response",
    "uniformity",
}


@pytest.mark.slow
def test_a_fit_becomes_a_page_with_its_numbers_beside_it(tmp_path: Path):
    page = fit().report(tmp_path / "report")
    html = page.read_text(encoding="utf-8")
    for title in SECTIONS:
        assert f">{title}</h2>" in html
    assert {path.stem for path in page.parent.glob("*.png")} == PICTURES
    assert html.count("data:image/png") == len(PICTURES)
    assert "Sensitivity" not in html
    numbers = json.loads((page.parent / "numbers.json").read_text())
    assert f"<dd>{numbers['fit']['mean_fit_percent']:.1f} %</dd>" in html
    assert numbers["network"]["plate_resistances"] == 83
    saved = Fit.load(page.parent / "fit.toml", experiments=recordings())
    assert saved["R_E"].value == fit()["R_E"].value


@pytest.mark.slow
def test_a_rig_with_thermocouples_has_a_report_with_priors_and_sensitivity(tmp_path: Path):
    """One recording, one channel, one parameter with a prior; no word of a camera."""
    rig = load_rig(strip(tmp_path))
    drive = Experiment.schedule("0:0.4", duration=60.0, step=2.0, cells=1, name="day")
    exact = simulate(Twin(rig, {"h": 22.0}), drive).temperatures
    noise = 0.05 * np.random.default_rng(0).standard_normal(exact.shape)
    day = replace(drive, channels=("near",), temperatures=exact + noise)
    matched = match(Twin(rig), day)
    (row,) = parameter_table(matched, "Values.").rows
    assert row[0] == "h"
    assert "15 (factor 2.01)" in row
    page = matched.report(tmp_path / "report", draws=50)
    html = page.read_text(encoding="utf-8")
    assert "camera" not in html.lower()
    assert ">Sensitivity</h2>" in html
    assert ">Uniformity</h2>" not in html  # of a single channel there is none
    assert (page.parent / "sensitivity.nc").exists()
    assert (page.parent / "tornado.png").exists()


def test_own_values_stand_beside_their_standard_errors():
    table = own_values_table(fit())
    assert table is not None
    assert table.head == ("recording", "T_amb, degC")
    error = fit().uncertainty.standard_errors["T_amb[synthetic-B]"]
    value = fit().recording_values["synthetic-B"]["T_amb"]
    assert table.rows[1] == ("synthetic-B", f"{value:.4g} ± {error:.2g}")


@pytest.mark.slow
def test_the_tests_of_residuals_are_those_of_the_runs():
    (table,) = [
        b for b in residuals_section(fit(), "Residuals").blocks if isinstance(b, ReportTable)
    ]
    run = fit().runs["synthetic-A"]
    residual = np.asarray(run.experiment.temperatures)[:, 0] - run.temperatures[:, 0]
    assert table.rows[0][:4] == (
        "synthetic-A",
        run.channels[0],
        f"{residual.std():.3f}",
        f"{residual.mean():+.3f}",
    )


def test_uniformity_is_shown_over_time_and_over_the_plate():
    section, numbers = uniformity_section(fit(), level=2)
    pictures = [block for block in section.blocks if isinstance(block, ReportPicture)]
    assert [picture.name for picture in pictures] == ["uniformity", "plate-beside"]
    assert all(picture.png.startswith(b"\x89PNG") for picture in pictures)
    assert numbers.keys() == fit().runs.keys()


def test_recordings_of_other_places_under_the_same_drive_are_one_picture_of_the_plate():
    first, second = fit().runs.values()
    assert _seen_together([first, second]) == [first, second]
    assert _seen_together([first, first]) == [first]
    driven = replace(second.experiment, duty=second.experiment.duty + 0.1)
    assert _seen_together([first, replace(second, experiment=driven)]) == [first]


def test_the_plate_is_shown_at_times_that_all_recordings_reach():
    """From 20 to 45 s: after a tenth and half of it, and at the end."""
    runs = []
    for times in (np.arange(20.0, 51.0), np.arange(10.0, 46.0)):
        rest = np.full((len(times), 1), 20.0)
        plan = Experiment(times, np.full((len(times), 1), 0.5))
        runs.append(Run(plan, ("T",), rest, ("V11",), rest, "bench", 1))
    assert _map_times(runs) == [22.5, 32.5, 45.0]


def test_a_recording_is_described_by_its_first_5_and_last_50_samples():
    """A channel that rises by 1 K a sample and one that is 0.5 K above it: means over the samples
    from 0 to 4, and from 150 to 199."""
    rise = np.arange(200.0)
    experiment = Experiment(
        rise,
        np.where(rise < 100, 0.25, 0.5)[:, None],
        channels=("T1", "T2"),
        temperatures=np.column_stack([rise, rise + 0.5]),
        name="ramp",
    )
    assert _row(experiment) == ("ramp", "200", "199", "25, 50", "2.0 ... 2.5", "174.5 ... 175.0")


@pytest.mark.slow
def test_the_command_writes_the_same_page(tmp_path: Path):
    fit().save(tmp_path / "fit.toml")
    names = []
    for experiment in recordings():
        names.append(str(tmp_path / f"{experiment.name}.nc"))
        write_recording(experiment, names[-1])
    out = tmp_path / "report"
    words = ["report", str(tmp_path / "fit.toml"), *names, "--out", str(out)]
    result = CliRunner().invoke(app, words, catch_exceptions=False)
    assert result.output.strip().endswith("index.html")
    assert (out / "response.png").exists()


def test_a_fit_without_its_recordings_and_a_folder_of_somebody_are_refused(tmp_path: Path):
    fit().save(tmp_path / "fit.toml")
    with pytest.raises(MatchError, match="loaded without"):
        Fit.load(tmp_path / "fit.toml").report(tmp_path / "report")
    with pytest.raises(JaxtwinError, match="an older report of jaxtwin"):
        fit().report(tmp_path)
    assert not (tmp_path / "report").exists()


def strip(folder: Path) -> Path:
    """A rig file of one cell and one thermocouple."""
    return small_rig_file(
        folder,
        ["4 cm", "4 cm"],
        ["2 cm"],
        [{"V11": "0.6 K/W"}],
        conductivity="180 W/(m K)",
        film_coefficient="h",
        sink_resistance="0.5 K/W",
        sensors='[sensors]\nnoise = "0.05 K"',
        channels='[[channels]]\nname = "near"\nnodes = ["V11"]',
        parameters="""
        [parameters.h]
        value = 15.0
        unit = "W/(m^2 K)"
        bounds = [2.0, 100.0]
        prior = { spread = 0.7 }
        free = true
        """,
    )


def test_the_words_of_the_rig_are_its_description_or_else_its_title():
    twin = Twin("paper-2024")
    section, _ = rig_section(twin, "The rig")
    assert section.blocks[0] == Text(" ".join(twin.rig.description.split()))
    nameless = replace(twin, rig=replace(twin.rig, description=" "))
    section, _ = rig_section(nameless, "The rig")
    assert section.blocks[0] == Text(twin.rig.title)


def test_deviations_are_in_standard_errors_on_the_scale_of_the_match():
    row = replace(fit()["T_amb"], value=20.0, standard_error=0.5, is_logarithmic=False)
    assert _deviation(row, 19.0) == pytest.approx(2.0)
