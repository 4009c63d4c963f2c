"""The film of a plate."""

import base64
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.colors import to_rgb
from PIL import Image

from jaxtwin import Experiment, load_rig
from jaxtwin.errors import ParameterError
from jaxtwin.plots import animate_plate
from jaxtwin.simulation import Run

RIG = load_rig("dual-cell")
ELEMENTS = RIG.plate.element_names


@pytest.fixture(autouse=True)
def _closed_figures() -> Iterator[None]:
    yield
    pyplot.close("all")


def heated(samples: int = 101) -> Run:
    """All elements warm up by 0.1 K/s, the last one starts 5 K warmer; a cell's side too."""
    times = np.arange(float(samples))
    states = 20 + 0.1 * times[:, None] + np.zeros(len(ELEMENTS) + 1)
    states[:, len(ELEMENTS) - 1] += 5
    return Run(
        experiment=Experiment(times, np.where(times[:, None] < 50, [0.5, 0.25], [1.0, 0.0])),
        channels=(), temperatures=np.zeros((samples, 0)), nodes=(*ELEMENTS, "P1.TC"),
        states=states, rig=RIG.name, elements=len(ELEMENTS),
    )  # fmt: skip


@pytest.mark.slow
def test_a_film_is_a_gif_with_the_pictures_and_the_time_asked_for(tmp_path: Path):
    film = animate_plate(RIG, heated(), frames=6, seconds=3)
    film.save(tmp_path / "plate.gif", writer="pillow", dpi=40)
    with Image.open(tmp_path / "plate.gif") as gif:
        assert getattr(gif, "n_frames", 1) == 6
        assert gif.info["duration"] == pytest.approx(500)


def test_pictures_show_time_extremes_and_colours(tmp_path: Path):
    film = animate_plate(RIG, heated(), frames=3)
    above, duty = film._fig.axes[:2]  # pyright: ignore[reportAttributeAccessIssue]
    colors = []
    for number, (time, low) in enumerate([(0, 20.0), (50, 25.0), (100, 30.0)]):
        film._func(number)  # pyright: ignore[reportAttributeAccessIssue]
        assert above.get_title("left") == f"{time} s"
        assert above.get_title("right") == f"{low:.1f} … {low + 5:.1f} °C"
        assert duty.lines[-1].get_xdata()[0] == time
        patches = above.patches[: len(ELEMENTS)]
        colors.append([sum(to_rgb(patch.get_facecolor())) for patch in patches])
    first, middle, last = np.array(colors)
    assert np.all(first < middle)
    assert np.all(middle < last)
    assert np.argmax(first) == len(ELEMENTS) - 1
    film.save(tmp_path / "plate.gif", writer="pillow", dpi=20)  # else matplotlib warns


def test_a_film_shows_the_duty_of_each_cell(tmp_path: Path):
    film = animate_plate(RIG, heated(), frames=2)
    duty = film._fig.axes[1]  # pyright: ignore[reportAttributeAccessIssue]
    np.testing.assert_array_equal(duty.lines[0].get_ydata()[[0, -1]], [50, 100])
    np.testing.assert_array_equal(duty.lines[1].get_ydata()[[0, -1]], [25, 0])
    film.save(tmp_path / "plate.gif", writer="pillow", dpi=20)  # else matplotlib warns


def test_a_film_of_several_runs_shows_their_plates_side_by_side_above_their_ranges(tmp_path: Path):
    film = animate_plate(RIG, {"long": heated(), "short": heated(51)}, frames=3)
    left, right, ranges = film._fig.axes[:3]  # pyright: ignore[reportAttributeAccessIssue]
    assert [axes.get_title("left") for axes in (left, right)] == ["long", "short"]
    for number, time in enumerate((0, 25, 50)):
        film._func(number)  # pyright: ignore[reportAttributeAccessIssue]
        assert film._fig.get_suptitle() == f"{time} s"  # pyright: ignore[reportAttributeAccessIssue]
        assert [axes.get_title("right") for axes in (left, right)] == ["range 5.0 K"] * 2
        colors = [axes.patches[0].get_facecolor() for axes in (left, right)]
        assert colors[0] == colors[1]
    for line in ranges.lines[:2]:
        np.testing.assert_allclose(line.get_ydata(), 5.0)
    film.save(tmp_path / "plates.gif", writer="pillow", dpi=20)


def test_a_film_for_a_page_holds_all_pictures():
    html = animate_plate(RIG, heated(), frames=3).to_jshtml(default_mode="once")
    pictures = re.findall(r'= "data:image/png;base64,([^"]+)"', html)
    assert len(pictures) == len(set(pictures)) == 3
    assert all(base64.b64decode(picture).startswith(b"\x89PNG") for picture in pictures)


def test_a_run_of_few_samples_has_a_picture_for_each(tmp_path: Path):
    film = animate_plate(RIG, heated(4))
    film.save(tmp_path / "plate.gif", writer="pillow", dpi=20)
    with Image.open(tmp_path / "plate.gif") as gif:
        assert getattr(gif, "n_frames", 1) == 4


def test_a_gif_is_written_by_pillow_without_a_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    monkeypatch.setenv("PATH", str(tmp_path))
    animate_plate(RIG, heated(), frames=2).save(tmp_path / "plate.gif", dpi=20)
    with Image.open(tmp_path / "plate.gif") as gif:
        assert getattr(gif, "n_frames", 1) == 2
    assert not caplog.messages


def test_a_video_without_ffmpeg_is_refused_with_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("PATH", str(tmp_path))
    film = animate_plate(RIG, heated(), frames=2)
    with pytest.raises(ParameterError, match=r"plate.mp4: expected ffmpeg.* or save a \.gif"):
        film.save(tmp_path / "plate.mp4", dpi=20)
    assert not list(tmp_path.iterdir())
    film.save(tmp_path / "plate.gif", dpi=20)


@pytest.mark.slow
@pytest.mark.ffmpeg
def test_ffmpeg_reads_the_pictures_of_a_video(tmp_path: Path):
    video = tmp_path / "plate.mp4"
    animate_plate(RIG, heated(), frames=6, seconds=3).save(video, dpi=40)
    read = ["ffmpeg", "-i", str(video), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run(read, capture_output=True, check=True)
    told = done.stderr.decode()
    assert "Duration: 00:00:03.00" in told
    width, height = map(int, re.findall(r", (\d+)x(\d+)[, ]", told)[0])
    pictures = np.frombuffer(done.stdout, np.uint8).reshape(-1, height, width, 3)
    assert len(pictures) == 6
    assert np.all(np.diff(pictures.mean(axis=(1, 2, 3))) != 0)


def test_runs_of_other_rigs_and_numbers_out_of_range_are_refused():
    with pytest.raises(ParameterError, match="expected a run of single-cell, got one of dual-cell"):
        animate_plate(load_rig("single-cell"), _with_other_nodes())
    with pytest.raises(ParameterError, match="frames: expected a whole number of at least 2"):
        animate_plate(RIG, heated(), frames=1)
    with pytest.raises(ParameterError, match="seconds: expected a number above 0, got -1"):
        animate_plate(RIG, heated(), seconds=-1)


def _with_other_nodes() -> Run:
    run = heated(4)
    return Run(
        experiment=run.experiment, channels=(), temperatures=run.temperatures,
        nodes=tuple(f"V{number}" for number in range(len(run.nodes))), states=run.states,
        rig=run.rig, elements=run.elements,
    )  # fmt: skip
