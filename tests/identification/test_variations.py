"""A room that drifts and a delay, found in a log."""

from typing import Any

import numpy as np
import pytest

import jaxtwin as jt
from jaxtwin.rig import rig_from_tables


def block(**tables: Any) -> jt.Twin:
    """A heated block with a loss to the room."""
    rig: dict[str, Any] = {
        "format": 1,
        "name": "block",
        "ambient": {"temperature": "20 degC"},
        "sensors": {"noise": "0.1 K"},
        "channels": [{"name": "T", "nodes": ["block"]}],
        "heaters": [{"name": "H", "power": "10 W", "contacts": ["block"]}],
        "bodies": [
            {"name": "block", "capacitance": "60 J/K", "initial_temperature": "20 degC"},
        ],
        "links": [{"resistance": "4 K/W", "between": ["block-ambient"]}],
        "initial": {"temperature": "20 degC"},
        "parameters": {},
    }
    return jt.Twin(rig_from_tables(rig | tables, "block"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("twin", "step", "words"),
    [
        (block(ambient={"temperature": "20 degC", "drift": "1.5 K/h"}), 20.0, "a room that drifts"),
        (block(driver={"lag": "0.2 s", "delay": "40 s"}), 5.0, "a delay"),
    ],
    ids=["drift", "delay"],
)
def test_what_follows_a_log_is_predicted(twin: jt.Twin, step: float, words: str):
    count = 720
    levels = np.random.default_rng(3).choice([0.0, 0.3, 0.6, 1.0], count // 30)
    duty = np.repeat(levels, 30)
    duty[:20] = 0.0
    run = twin.simulate(jt.Experiment(np.arange(count) * step, duty[:, None]))
    log = run.to_recording(seed=1)
    split = 480 * step
    identified = jt.identify(log.between(None, split))
    assert words in identified.candidates[0].structure
    band = identified.predict(log)
    error = (band.middle - run.temperatures)[log.time > split]
    assert np.sqrt(np.mean(error**2)) < 0.05
    assert np.mean(band.upper - band.lower) < 1.0
