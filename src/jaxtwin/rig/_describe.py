"""A rig in a few lines, for prompts and notebooks."""

import html
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the rig itself prints with these
    from ._rig import Rig


def rig_parts(rig: "Rig") -> dict[str, str]:
    """What a rig consists of, part -> one line of text."""
    plate = rig.plate
    circuit = "by finite volumes"
    if rig.circuit is not None:
        count = sum(len(link.between) for link in rig.circuit.links)
        circuit = f"given, {count} resistance{'s' * (count != 1)} on the plate"
    free = sum(parameter.free for parameter in rig.parameters.values())
    return {
        "plate": (
            f"{100 * plate.width:g} cm x {100 * plate.height:g} cm, "
            f"{len(plate.rows)} x {len(plate.columns)} elements, circuit {circuit}"
        ),
        "cells": ", ".join(
            f"{cell.name} on {' '.join(element for element, _ in cell.contacts)}"
            for cell in rig.cells
        ),
        "driver": f"{rig.driver.averaging} averaging, {rig.driver.counts} counts",
        "channels": " ".join(channel.name for channel in rig.channels),
        "parameters": f"{len(rig.parameters)}, {free} of them free",
        "parameter sets": ", ".join(rig.parameter_sets) or "none",
        "file": rig.source,
    }


def rig_html(rig: "Rig") -> str:
    """A rig as a heading and two tables: its parts and its parameters."""
    parts = "".join(_row(part, text) for part, text in rig_parts(rig).items())
    parameters = "".join(
        _row(
            p.name,
            f"{p.value:g}",
            p.unit,
            f"{p.lower:g} … {p.upper:g}",
            "free" if p.free else "fixed",
            p.scope,
            p.description,
        )
        for p in rig.parameters.values()
    )
    heading = "".join(
        f"<th>{name}</th>"
        for name in ("parameter", "value", "unit", "bounds", "", "scope", "description")
    )
    return (
        f"<b>{html.escape(rig.name)}</b>: {html.escape(rig.title)}<table>{parts}</table>"
        f"<details><summary>parameters</summary>"
        f"<table><tr>{heading}</tr>{parameters}</table></details>"
    )


def _row(*cells: str) -> str:
    return "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>"
