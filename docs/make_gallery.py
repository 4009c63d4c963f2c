"""The thumbnails of the gallery, and the first picture of the README: `make pictures`.

They are drawn from what comes with jaxtwin, and need no recordings of a rig.
"""

import re
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import jaxtwin as jt
from jaxtwin import plots
from jaxtwin.control import (
    PID,
    ClosedLoopRun,
    OperatingPoint,
    design_mpc,
    design_uniformity_mpc,
    loop_margins,
    most_even_point,
)
from jaxtwin.data import data_folder, synthetic_recordings, synthetic_truth
from jaxtwin.physics import FAULT_MODELS

FOLDER = Path(__file__).parent / "images"
FREE = ("R_E", "R_pc", "R_Tez", "R_Tfx", "T_amb", "T_start")

WITHOUT_A_PLATE = {
    "heated-box": ("0:0.5,1200:0.1,2400:0.3", {"lid": "0:closed,1800:open,1920:closed"}),
    "oven": ("0:1,540:0.18,2400:0.4", {"door": "0:closed,1800:open,1860:closed"}),
    "water-bath": ("0:1,1200:0.1,2400:0.8", {"stirrer": "0:1,1800:0.2,3000:1"}),
    "battery-pack": (
        "0:1/0.6/0.3,900:0/0/0,1500:0.3/1/0.6,2400:0.8/0.1/0.4",
        {"T_coolant": "0:20,1800:12", "flow": "0:1,2700:0.3"},
    ),
}
"""Duty and inputs of an hour of each bundled rig without a plate that has inputs."""

PLACED = (
    (
        r"columns = .*\nrows = .*",
        'width = "25.5 cm"\nheight = "11.5 cm"\nresolution = "1 cm"',
    ),
    (r"film_coefficient = .*\nfilm_row_factor = .*", 'film_coefficient = "h_A"'),
    (r"(h_B|h_C|f_row1|f_row3|R_pc\d_(row1|end)) = .*", ""),
    *(
        (
            rf"contacts = .* = \"R_pc{number}_.*",
            f'at = ["{x}", "4.25 cm"]\nsize = "4 cm"\ncontact_resistance = "R_pc{number}"',
        )
        for number, x in enumerate(("5.75 cm", "17 cm"), 1)
    ),
    (r"R_pc(\d)_row2 = (.*)", r"R_pc\1 = \2"),
    *(
        (
            rf"{name} = (.*) value = [^,]*(.*) free = true(.*)",
            rf"{name} = \1 value = {value}\2 free = false\3",
        )
        for name, value in {"n_film": 0.2, "R_supply": 0.2, "C_sink": 200.0}.items()
    ),
)
"""Lines of the file of `dual-cell`, and what they become for cells that have a place."""


def main() -> None:
    """Draws and writes."""
    (FOLDER / "gallery").mkdir(parents=True, exist_ok=True)
    write("from-a-log", forecast().plot(), dpi=100)
    twin = jt.Twin("paper-2024")
    experiments = [jt.read_recording(path) for path in synthetic_recordings()]
    truth = jt.read_parameters(synthetic_truth(), twin.rig)
    known = {name: value for name, value in truth.items() if name not in FREE}
    fit = jt.match(twin.with_values(known), experiments, free=FREE)
    plate = jt.Twin("dual-cell")
    run = plate.simulate("0:0.5,500:0.78", duration=1000)
    sensitivity = jt.sensitivity(fit, draws=1000)
    linear = jt.linearize(plate, duty=[0.4, 0.4])
    loop = jt.simulate_closed_loop(
        plate,
        PID(Kp=0.1, Ki=0.001, measured=[["T11", "T21", "TAM"], ["T16", "T26", "TCM"]]),
        "0:40/35,400:30/45",
        duration=800,
    )
    schedule = jt.Experiment.schedule("0:0.5,300:-0.3", duration=600, cells=2)
    draws = jt.reduce_batch(
        plate,
        schedule,
        {"R_E": [1.6 + 0.01 * k for k in range(64)]},
        ["final", "plate_range", "energy"],
    )
    pictures: dict[str, Callable[[], object]] = {
        "netlist": lambda: plots.plot_netlist(jt.Twin("single-cell")),
        "module": lambda: plots.plot_dc_sweep(plate.module("P1"), T_hot=300.15),
        "recordings": lambda: plots.plot_recordings(experiments),
        "comparison": fit.plot,
        "residuals": lambda: plots.plot_residual_tests(list(fit.runs.values())[:1]),
        "parameters": lambda: plots.plot_parameters(fit),
        "correlation": lambda: plots.plot_correlation(fit),
        "plate": lambda: plots.plot_plate_map(
            plate.rig, run.states[[120, 980], : run.elements], ["120 s", "980 s"]
        ),
        "tornado": lambda: sensitivity.tornado("TAM"),
        "matrix": lambda: plots.plot_sensitivity_matrix(sensitivity),
        "distributions": lambda: plots.plot_distributions(draws.to_xarray()),
        "bode": lambda: plots.plot_bode(linear),
        "closed-loop": lambda: plots.plot_closed_loop(loop),
    }
    for name, draw in pictures.items():
        is_wide = name in ("comparison", "residuals", "parameters")
        thumbnail(name, draw, 7.2 if is_wide else 5.0)
    runs, best = warmed(plate)
    write("plate-range", plots.plot_plate_range(runs, best), dpi=80)
    write("plate-seen", plots.plot_plate_seen(plate.rig, best), dpi=80)
    side_by_side = {"MPC": runs["MPC, step"], "uniformity MPC": runs["uniformity MPC"]}
    write("plates", plots.plot_plates(plate.rig, side_by_side, [30, 60, 600]), dpi=80)
    film = plots.animate_plate(plate.rig, shortened(side_by_side), frames=25, seconds=5)
    film.save(FOLDER / "plates.gif", dpi=50)
    write("nyquist", loop_margins(plate, PID(0.05, 5e-4, limits=(0, 1)), 40.0).plot(), dpi=80)
    write("rig-design", placed_better().plot(), dpi=80)
    observed = followed()
    write("innovations", observed.plot_innovations(), dpi=80)
    thumbnail("observed", observed.plot)
    thumbnail("ahead", observed.ahead(60.0).plot)
    write("monitored", watched().plot(), dpi=80)
    write("diagnosis", diagnosed().plot(), dpi=80)
    write("isolability", jt.isolability(jt.Twin("tclab")).plot(), dpi=70)
    write("separation", separated().plot(), dpi=80)
    write("health", aged().plot(), dpi=80)
    for name in WITHOUT_A_PLATE:
        thumbnail(name, lambda name=name: plots.plot_netlist(jt.Twin(name)))
        thumbnail(f"{name}-match", matched(name).plot)


def forecast() -> jt.matching.Band:
    """What the README shows: a twin from the first hour of the log of an oven, and the rest."""
    plan = jt.Experiment.schedule(
        "0:0, 120:0.3, 1200:0.1, 2400:0.35, 3600:0.05, 4500:0.3", duration=5400, step=10
    )
    oven = jt.Twin("oven").simulate(plan).to_recording(seed=1)
    log = jt.Experiment(
        plan.time, plan.duty, channels=["oven"], temperatures=oven.temperatures, name="oven"
    )
    return jt.identify(log.between(None, 3600)).predict(log)


def warmed(twin: jt.Twin) -> tuple[dict[str, ClosedLoopRun], OperatingPoint]:
    """The plate on its way to its most even steady state at 40 °C: by a step of the references, by
    an S-curve, and by a controller of evenness."""
    groups = [["T11", "T12", "T21", "T22"], ["T15", "T16", "T25", "T26"]]
    best = most_even_point(twin, 40, limits=(0, 1))
    model = jt.linearize(twin, temperatures={"TAM": 40.0, "TCM": 40.0})
    mpc = design_mpc(
        model.reduce(4).discretise(1.0),
        measured=groups,
        duty_deviation=0.04,
        reading_noise=0.5,
        limits=(0, 1),
    )
    at = dict(zip(twin.channels, best.outputs, strict=True))
    aim = "/".join(f"{np.mean([at[name] for name in group]):.2f}" for group in groups)
    plans = {
        "MPC, step": f"0:{aim}",
        "MPC, S-curve of 600 s": f"0:16,curve 600:{aim}",
    }
    runs = {
        name: jt.simulate_closed_loop(twin, mpc, plan, duration=1200)
        for name, plan in plans.items()
    }
    even = design_uniformity_mpc(jt.linearize(twin, temperatures=40), limits=(0, 1))
    runs["uniformity MPC"] = jt.simulate_closed_loop(twin, even, 40, duration=1200)
    return runs, best


def shortened(runs: dict[str, ClosedLoopRun]) -> dict[str, jt.simulation.Run]:
    """The first 200 s, in which the plates differ."""
    cut = {}
    for name, loop in runs.items():
        run, some = loop.run, loop.time < 200
        part = run.experiment.between(0, 200)
        cut[name] = replace(
            run, experiment=part, states=run.states[some], temperatures=run.temperatures[some]
        )
    return cut


def placed_better() -> jt.control.RigDesign:
    """The cells of `dual-cell` as squares, and a third one, where the plate is most even."""
    text = (data_folder() / "rigs" / "dual-cell.toml").read_text()
    for pattern, replacement in PLACED:
        text = re.sub(f"^{pattern}$", replacement, text, flags=re.MULTILINE)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "placed.toml"
        file.write_text(text)
        twin = jt.Twin(jt.load_rig(file))
        return jt.design_rig(twin, 40, limits=(0, 1), further_cells=1, clearance=0.005)


def followed() -> jt.observers.Observed:
    """An observation of a Temperature Control Lab that stands in a draught: its twin was matched to
    another recording of it."""
    twin = jt.Twin("tclab")
    rig = twin.with_values({"R_1": 51.0, "R_2": 68.0, "C_1": 2.3, "T_amb": 21.0, "T_start": 21.0})
    plans = "0:0.6/0,300:0/0.8,600:0.4/0.4", "0:0/0.5,240:0.7/0,480:0.2/0.6,720:0.5/0.1"
    recordings = [
        jt.simulate(
            rig, jt.Experiment.schedule(plan, duration=900, step=2, cells=2, ambient=21)
        ).to_recording(seed=seed, name=f"TCLab {seed}")
        for seed, plan in enumerate(plans, 1)
    ]
    return jt.observe(jt.match(twin, recordings[0]), recordings[1])


def watched() -> jt.monitoring.Monitored:
    """A Temperature Control Lab of which a sensor comes loose after eight minutes, and is pressed
    on again four minutes later."""
    rig = jt.Twin("tclab")
    plan = jt.Experiment.schedule("0:0.5/0.6,400:0.8/0.3", duration=1200, step=1, cells=2)
    healthy = jt.simulate(rig, plan).to_recording(seed=1)
    assert healthy.temperatures is not None
    readings = healthy.temperatures.copy()
    readings[480:720, 1] = 23 + 0.8 * (readings[480:720, 1] - 23)
    return jt.monitor(
        rig,
        jt.Experiment(
            healthy.time, healthy.duty, channels=rig.channels, temperatures=readings,
            name="a loose sensor",
        ),
    )  # fmt: skip


def diagnosed() -> jt.diagnosis.Diagnosis:
    """A Temperature Control Lab of which a heater ages after eight minutes: its resistance grows by
    a fifth."""
    rig = jt.Twin("tclab")
    plan = jt.Experiment.schedule("0:0.5/0.6,400:0.8/0.3", duration=900, step=1, cells=2)
    stepper = jt.Stepper(rig, 1.0)
    worn = jt.Stepper(FAULT_MODELS["age"](rig, "H1", 1.2)(stepper.system), 1.0)
    state = stepper.start()
    rows = [np.asarray(stepper.channels(state))]
    for number, duty in enumerate(plan.duty[:-1]):
        state = (stepper if number < 480 else worn).step(state, duty)
        rows.append(np.asarray(stepper.channels(state)))
    readings = np.array(rows) + np.random.default_rng(1).normal(0.0, 0.1, (len(rows), 2))
    return jt.diagnose(
        rig,
        jt.Experiment(
            plan.time, plan.duty, channels=rig.channels, temperatures=readings, name="a worn heater"
        ),
    )


def separated() -> jt.experiment_design.DiagnosisDesign:
    """A test of a Temperature Control Lab: which of four faults has its first heater?"""
    faults = ["gain T1", "offset T1", "age H1", "leak H1"]
    return jt.design_experiment(
        jt.Twin("tclab"), purpose="diagnosis", faults=faults, duration=600, hold=60, levels=3
    )


def aged() -> jt.prognostics.Health:
    """Eight weekly sessions of a Temperature Control Lab whose second heater loses half a per cent
    of its power in a day, and one per cent more or less from session to session."""
    twin, random = jt.Twin("tclab"), np.random.default_rng(2)
    plan = jt.Experiment.schedule("0:0.5/0.6,300:0.8/0.3,600:0.3/0.8", duration=900, cells=2)
    sessions = []
    for week in range(8):
        left = np.exp(-0.005 * 7 * week + random.normal(0.0, 0.01))
        worn = twin.with_values({"P_2": 0.75 * left})
        sessions.append([jt.simulate(worn, plan).to_recording(seed=week)])
    fits = jt.match_many(twin, sessions, free=["P_2", "R_2", "tau_2", "T_amb", "T_start"])
    found = {f"week {week}": fit for week, fit in enumerate(fits) if fit is not None}
    return jt.health(found, [7 * week for week in range(8)], limits={"P_2": 0.5}, within=28)


def matched(name: str) -> jt.Fit:
    """A match of the values of a rig file to an hour of a rig of the kind, whose resistances and
    heat capacities differ by 20 %."""
    duty, inputs = WITHOUT_A_PLATE[name]
    twin, random = jt.Twin(name), np.random.default_rng(0)
    room = float(twin.values["T_amb"])
    hour = jt.Experiment.schedule(
        duty, duration=3600, step=10, cells=len(twin.rig.driven), ambient=room, inputs=inputs
    )
    unknown = [row.name for row in twin.rig.parameters.values() if row.free and row.name[0] in "RC"]
    factors = np.exp(0.2 * random.normal(size=len(unknown)))
    values = {n: float(twin.values[n]) * f for n, f in zip(unknown, factors, strict=True)}
    recording = jt.simulate(twin.with_values(values), hour).to_recording(seed=1)
    fit = jt.match(twin, recording)
    print(f"{name}: {len(fit.parameters)} parameters, {fit.rmse:.3f} K")
    return fit


def thumbnail(name: str, draw: Callable[[], object], width: float = 5.0) -> None:
    """Writes a picture of the gallery, whose letters can be read where it is as wide as half a
    page."""
    with plots.style("paper", width=width):
        write(f"gallery/{name}", draw(), dpi=round(750 / width))


def write(name: str, picture: object, dpi: int) -> None:
    """Writes a figure, or the figure of some axes."""
    figure = picture.figure if isinstance(picture, Axes) else picture
    assert isinstance(figure, Figure)
    path = FOLDER / f"{name}.png"
    path.write_bytes(plots.to_png(figure, dpi=dpi))
    print(path)


if __name__ == "__main__":
    main()
