"""A fleet of `tclab` rigs, which compile in seconds, and the messages that they publish."""

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from hand_clock import START

from jaxtwin import Twin
from jaxtwin.fleet._sample_queue import Kind as Kind


@cache
def twin() -> Twin:
    return Twin("tclab")


def fleet_file(folder: Path, members: str = '["a", "b", "c"]', **fields: object) -> Path:
    """The file of a fleet; `fields` are further ones of the whole file."""
    path = folder / "fleet.toml"
    head = {"broker": "mqtt://127.0.0.1:1/plant", **fields}
    lines = [f"{name} = {json.dumps(value)}" for name, value in head.items()]
    group = ["[groups.hall]", 'rig = "tclab"', f"members = {members}"]
    path.write_text("\n".join(["format = 1", *lines, *group, ""]))
    return path


@cache
def run(seed: int, seconds: int = 420) -> tuple[np.ndarray, np.ndarray]:
    """Readings of each second and the duty from then on, in counts."""
    duty = "0:0.4/0.1,90:0.6/0.3,260:0.2/0.5"
    simulated = twin().simulate(duty, duration=seconds)
    recorded = simulated.to_recording(seed=seed)
    steps = np.arange(seconds)
    at = np.searchsorted(recorded.time, steps)
    counts = np.rint(np.asarray(recorded.duty)[at] * twin().rig.driver.counts).astype(int)
    return np.asarray(recorded.temperatures)[at], counts


def messages(
    readings: np.ndarray, counts: np.ndarray, leave_out: Sequence[int] = ()
) -> Iterator[tuple[Kind, dict[str, Any]]]:
    """The messages of a rig: readings, and the duty where it changes. Those of some seconds are
    missing."""
    before = None
    for second, (row, duty) in enumerate(zip(readings, counts.tolist(), strict=True)):
        time = START / 1e9 + second
        if second not in leave_out:
            values = [None if np.isnan(one) else round(float(one), 3) for one in row]
            yield "readings", {"time": time, **dict(zip(twin().channels, values, strict=True))}
        if duty != before:
            before = duty
            content: Mapping[str, Any] = dict(zip(twin().rig.driven, duty, strict=True))
            yield "duty", {"time": time, **content, "ambient_degC": 23.0}


def encoded(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content).encode()
