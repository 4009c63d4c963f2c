"""Steps 1 and 2 of the paper: what the rig is, and what is known about it."""

import numpy as np

from ..data import table
from ..io import Experiment
from ..physics import Twin
from ..physics._netlist import network_counts
from ..plots import plot_netlist, plot_recordings, to_png
from ._blocks import Numbers, Picture, Section, Table, Text
from ._source import Source, recorded


def define(twin: Twin) -> tuple[Section, dict[str, float | int]]:
    """The rig and the network that it becomes.

    **Returns:** the section, and the network's numbers.
    """
    rig = twin.rig
    counts = network_counts(twin.netlist, rig)
    section = Section(
        "1 Define: the rig and its network",
        (
            Text(" ".join(rig.description.split())),
            Text(
                f"The rig file `{rig.name}` holds the circuit exactly as its authors built it. It "
                "becomes a network of heat capacities, thermal resistances and two thermoelectric "
                "cells, each with a side at the plate and a side at its sink."
            ),
            Numbers(
                (
                    (f"{counts['plate_nodes']:.0f}", "plate elements"),
                    (f"{counts['plate_resistances']:.0f}", "resistances on the plate"),
                    (f"{counts['states']:.0f}", "states"),
                    (
                        f"{counts['plate_capacitance_J_per_K']:.1f} J/K",
                        "heat capacity of the plate",
                    ),
                    (f"{counts['plate_to_ambient_W_per_K']:.3f} W/K", "plate to ambient"),
                )
            ),
            Picture(
                "netlist",
                to_png(plot_netlist(twin)),
                "The network with the model file's start-up values.",
            ),
        ),
    )
    return section, counts


def document(source: Source) -> Section:
    """What was recorded, and where the paper's numbers disagree with each other."""
    return Section(
        "2 Document: recordings and datasheets",
        (
            Text(source.note),
            Picture(
                "recordings",
                to_png(plot_recordings(source.experiments)),
                "Recorded temperatures and the duty cycle of both cells (the paper's Fig. 6).",
            ),
            Table(
                "The recordings.",
                ("recording", "samples", "duration, s", "duty, %", "start, °C", "end, °C"),
                [_recording_row(experiment) for experiment in source.experiments],
            ),
            Table(
                "Tables 1 to 4 of the paper come with jaxtwin as data. Where their numbers "
                "disagree with each other or with the authors' model file:",
                ("table", "entry", "note"),
                [
                    (str(number), str(row.get("symbol", row.get("property"))), str(row["note"]))
                    for number in (1, 2, 3, 4)
                    for row in table(number).rows
                    if row["note"]
                ],
            ),
        ),
    )


def _recording_row(experiment: Experiment) -> tuple[str, ...]:
    duty = np.unique(np.round(100 * experiment.duty, 1))
    temperatures = recorded(experiment)
    start, end = temperatures[:5].mean(axis=0), temperatures[-50:].mean(axis=0)
    return (
        experiment.name,
        str(len(experiment.time)),
        f"{experiment.duration:g}",
        ", ".join(f"{level:g}" for level in duty),
        f"{start.min():.1f} ... {start.max():.1f}",
        f"{end.min():.1f} ... {end.max():.1f}",
    )
