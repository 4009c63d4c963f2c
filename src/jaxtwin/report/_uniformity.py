"""How even the plate is: what the rig was built to control."""

from ..matching import Fit
from ..plots import plot_plate_beside, plot_uniformity, to_png
from ..simulation import Run
from ._blocks import Picture, Section, Table, Text
from ._corrections import shows_sawtooth

MAP_TIMES = (100.0, 500.0, 1000.0)
"""Of the maps, s; those that a recording does not reach are left out."""


def uniformity(fit: Fit) -> tuple[Section, dict[str, dict[str, float]]]:
    """Spread over the channels and the plate as a picture, recorded beside simulated.

    **Returns:** the section, and its numbers for each recording.
    """
    runs = list(fit.runs.values())
    numbers = {name: _numbers(run) for name, run in fit.runs.items()}
    channels = "what all channels share does not count"
    if shows_sawtooth(runs):
        channels += ", so the camera's sawtooth drops out"
    times = [time for time in MAP_TIMES if all(run.time[0] <= time <= run.time[-1] for run in runs)]
    section = Section(
        "Uniformity",
        (
            Text(
                "The rig was built to make a plate evenly warm. How far it is from that is the "
                "range over the channels of a recording, highest less lowest, and their standard "
                f"deviation; {channels}."
            ),
            Table(
                "Over time, K. The plate's own range is that of all its elements, of which the "
                "channels of one recording see a third.",
                (
                    "recording",
                    "mean range",
                    "twin",
                    "mean standard deviation",
                    "twin",
                    "plate, mean",
                ),
                [
                    (name, *(f"{value:.2f}" for value in row.values()))
                    for name, row in numbers.items()
                ],
            ),
            Picture(
                "uniformity",
                to_png(plot_uniformity(runs)),
                "Range and standard deviation over the channels, recorded and by the twin "
                "matched with one ambient per recording.",
            ),
            Picture(
                "plate-beside",
                to_png(plot_plate_beside(fit.twin.rig, runs, times or [float(runs[0].time[-1])])),
                "The plate, between its nodes, as the twin has it; what its camera would read; "
                "what was recorded; the difference of the two. Together the recordings cover the "
                "plate.",
            ),
        ),
        level=3,
    )
    return section, numbers


def _numbers(run: Run) -> dict[str, float]:
    recorded, twin = run.recorded_uniformity, run.uniformity
    return {
        "recorded_mean_range_K": recorded.mean_range,
        "twin_mean_range_K": twin.mean_range,
        "recorded_mean_std_K": recorded.mean_std,
        "twin_mean_std_K": twin.mean_std,
        "plate_mean_range_K": run.plate_uniformity.mean_range,
    }
