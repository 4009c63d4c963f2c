"""The pictures of the README and of these pages: `make pictures`.

Needs the authors' three step recordings (`jaxtwin data fetch`). Nearly all of its time goes into
one match of `dual-cell` to them.
"""

from pathlib import Path

from matplotlib import pyplot
from matplotlib.figure import Figure

import jaxtwin as jt
from jaxtwin import plots
from jaxtwin.control import PID
from jaxtwin.data import synthetic_recordings

FOLDER = Path(__file__).parent / "images"
TIMES = (120.0, 480.0, 980.0)
"""Of the maps, s: while the plate warms up, and near the end of each of the two steps."""


def main() -> None:
    """Matches, draws and writes."""
    experiments = [jt.read_recording(path) for path in jt.find_recordings()]
    fit = jt.match(jt.Twin("dual-cell"), experiments)
    runs = list(fit.runs.values())
    pictures = {
        "comparison": plots.plot_comparison(runs),
        "plate-beside": plots.plot_plate_beside(fit.twin.rig, runs, TIMES),
        "camera-error": plots.plot_camera_error(fit),
        "network": plots.plot_netlist(jt.Twin("dual-cell")),
        "example-rigs": draw_example_rigs(),
        "plateless-rigs": draw_plateless_rigs(),
        "indices-over-time": draw_indices_over_time(experiments[0]),
    }
    synthetic = [jt.read_recording(path) for path in synthetic_recordings()]
    for style in ("grey", "dark"):
        with plots.style(style):
            pictures[f"style-{style}"] = plots.plot_recordings(synthetic)
    FOLDER.mkdir(exist_ok=True)
    for name, picture in pictures.items():
        (FOLDER / f"{name}.png").write_bytes(plots.to_png(picture, dpi=110))
        print(FOLDER / f"{name}.png")
    run = fit.mean_twin.simulate("0:0.5,500:0.78", duration=1000)
    film = plots.animate_plate(fit.twin.rig, run, frames=25, seconds=5)
    film.save(FOLDER / "plate.gif", dpi=60)


def draw_indices_over_time(experiment: jt.Experiment) -> Figure:
    """Total Sobol indices of a temperature of the paper's rig, over the bounds of Table 4."""
    rig = jt.load_rig("paper-2024")
    found = jt.global_sensitivity(
        jt.Twin(rig, rig.parameter_sets["published"]),
        experiment,
        method="sobol",
        draws=512,
        inputs="bounds",
        outputs=["temperature"],
    )
    figure = found.plot_over_time("TAM").figure
    assert isinstance(figure, Figure)
    return figure


@plots.styled
def draw_example_rigs() -> Figure:
    """The rigs that are not the paper's, each driven as such devices are."""
    figure, grid = pyplot.subplots(
        2, 3, figsize=(11, 4.6), sharex="col", height_ratios=[3, 1], layout="constrained"
    )
    cycler = jt.simulate_closed_loop(
        jt.Twin("pcr-block"),
        PID(Kp=0.3, Ki=0.06, sample_time_s=0.1, limits=(-1, 1)),
        "0:95,40:55,60:72,80:95,95:55,115:72,135:95,150:55,170:72",
        duration=190,
    )
    bed = jt.simulate_closed_loop(
        jt.Twin("printer-bed"),
        PID(Kp=0.2, Ki=0.002, limits=(0, 1), measured=["T_middle"]),
        "0:60,900:100",
        duration=2400,
    )
    # Steps of a fifth of the voltage, then off.
    steps = "0:0,20:-0.2,140:-0.4,260:-0.6,380:-0.8,500:-1,620:0"
    mirror = jt.Twin("dew-point-mirror").simulate(steps, duration=800)
    columns = (
        ("PCR block: three cycles", cycler.run, cycler.reference, 1.0, "s"),
        ("Printer's bed: 60 °C, then 100 °C", bed.run, bed.reference, 60.0, "min"),
        ("Dew-point mirror: in steps", mirror, None, 60.0, "min"),
    )
    for (above, below), (title, run, reference, scale, unit) in zip(grid.T, columns, strict=True):
        time = run.time / scale
        if reference is not None:
            above.step(time, reference[:, 0], where="post", color="0.6", ls="--", lw=1)
        for name, look in zip(run.channels, ("-", (0, (4, 2))), strict=False):
            above.plot(time, run.channel(name), label=name, ls=look)
        below.step(time, 100 * run.experiment.duty[:, 0], where="post", color="0.3", lw=1)
        above.set(title=title, ylabel="temperature, °C")
        below.set(xlabel=f"time, {unit}", ylabel="duty, %", ylim=(-110, 110))
        above.legend()
    figure.align_ylabels()
    return figure


@plots.styled
def draw_plateless_rigs() -> Figure:
    """The rigs without a plate, each with an input that changes while it runs."""
    figure, grid = pyplot.subplots(
        2, 4, figsize=(13, 4.6), sharex="col", height_ratios=[3, 1], layout="constrained"
    )
    columns = (
        ("heated-box", "0:0.2", 5400, {"lid": "0:closed,3000:open,3300:closed"}, (3000, 3300),
         "Heated box: lid open"),
        ("oven", "0:1,540:0.18", 5400, {"door": "0:closed,3000:open,3120:closed"}, (3000, 3120),
         "Oven: door open"),
        ("water-bath", "0:1,1200:0.15", 3600, {"stirrer": "0:1,600:0"}, (600, 3600),
         "Water bath: stirrer off"),
        ("battery-pack", "0:0/0/0,300:1/0.6/0.3,1500:0.1/0.1/0.1,2400:1/0.6/0.3", 3600,
         {"T_coolant": "0:20,3000:10"}, (3000, 3600), "Battery pack: colder coolant"),
    )  # fmt: skip
    for (above, below), (name, duty, duration, inputs, span, title) in zip(
        grid.T, columns, strict=True
    ):
        twin = jt.Twin(name)
        experiment = jt.Experiment.schedule(
            duty, duration=duration, step=5, cells=len(twin.netlist.cells), inputs=inputs
        )
        run = jt.simulate(twin, experiment)
        for channel, look in zip(run.channels, ("-", (0, (4, 2)), (0, (1, 1))), strict=False):
            above.plot(run.time / 60, run.channel(channel), label=channel, ls=look)
        for panel in (above, below):
            panel.axvspan(span[0] / 60, span[1] / 60, color="0.9", lw=0)
        below.step(run.time / 60, 100 * experiment.duty[:, 0], where="post", color="0.3", lw=1)
        above.set(title=title)
        below.set(xlabel="time, min", ylim=(-5, 110))
        above.legend()
    grid[0, 0].set_ylabel("temperature, °C")
    grid[1, 0].set_ylabel("duty, %")
    figure.align_ylabels()
    return figure


if __name__ == "__main__":
    main()
