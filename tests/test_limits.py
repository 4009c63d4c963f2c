"""The last value that is allowed is taken, and the next one is refused.

The limits are those that docstrings, error messages and docs/protocol.md state.
"""

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from jaxtwin import Experiment, JaxtwinError, LinearModel, ThermoelectricModule, Twin, plots
from jaxtwin._residual_statistics import ljung_box
from jaxtwin.control import PID
from jaxtwin.control.controllers._controller import check_non_negative, checked_deviations
from jaxtwin.control.loops._disturbances import Draught, HeatInput, disturbance_tables
from jaxtwin.experiment_design._schedules import make_schedules
from jaxtwin.live import opener
from jaxtwin.live.protocol._codec import parse
from jaxtwin.live.protocol._framing import encode_line
from jaxtwin.live.protocol._words import read_integer, read_name, read_number, read_word, split
from jaxtwin.live.virtual_rig._serve import TcpServer
from jaxtwin.physics import Faults
from jaxtwin.rig import load_rig
from jaxtwin.sensitivity_analysis import Morris, Normal, Uniform
from jaxtwin.sensitivity_analysis._sampling import checked_seed, checked_spread
from jaxtwin.simulation._initial import checked_initial

TCLAB = load_rig("tclab")

TWO_SAMPLES = Experiment(np.array([0.0, 1.0, 2.0]), np.zeros((3, 1)))
FIRST_ORDER = LinearModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
PELTIER = partial(
    ThermoelectricModule.from_datasheet,
    maximum_voltage=15.0,
    maximum_current=6.0,
    hot_side_temperature=300.0,
)
SINGLE_CELL = Twin("single-cell")
DESIGN = partial(make_schedules, SINGLE_CELL, levels=3, interval=1.0)


def schedule(text: str = "0:0.5", **arguments: float) -> Experiment:
    return Experiment.schedule(text, **({"duration": 10.0} | arguments))  # pyright: ignore[reportArgumentType]


def pid(**arguments: object) -> PID:
    return PID(0.1, **arguments)  # pyright: ignore[reportArgumentType]


def design(duration: float, hold: float, bounds: tuple[float, float] = (-1.0, 1.0)) -> object:
    return DESIGN(duration=duration, hold=hold, bounds=bounds)


def image(device_us: int = 2**62, width: int = 1, pixels: int = 1) -> object:
    header = b"\x01\x00" + (0).to_bytes(2, "little") + (7).to_bytes(4, "little")
    header += device_us.to_bytes(8, "little")
    return parse(header + width.to_bytes(2, "little") + b"\x01\x00" + b"\x00\x01" * pixels)


def heated(start: float, end: float, film: float | None = None) -> object:
    elements = ("V11",)
    disturbance = (
        HeatInput(elements, start, end, 1.0)
        if film is None
        else Draught(elements, start, end, film)
    )
    return disturbance_tables("loop", Twin("paper-2024"), [disturbance], np.arange(3.0))


def listen(address: str) -> None:
    TcpServer(address).close()


LIMITS: list[tuple[Callable[..., object], dict[str, object], dict[str, object]]] = [
    (schedule, {"duration": 1e-3, "step": 1e-3}, {"duration": 0.0}),
    (schedule, {"step": 10.0}, {"step": 10.001}),
    (schedule, {"step": 1e-3}, {"step": 0.0}),
    (schedule, {"cells": 1000, "duration": 1.0}, {"cells": 1001, "duration": 1.0}),
    (schedule, {"step": 1e-4}, {"step": 0.99e-6}),
    (schedule, {"text": "0:0.5,9.999:0.6"}, {"text": "0:0.5,10:0.6"}),
    (schedule, {"text": "0:0.5"}, {"text": "-0.001:0.5"}),
    (schedule, {"text": "0:0.5,1e-3:0.6"}, {"text": "0:0.5,0:0.6"}),
    (schedule, {"text": "0:1,5:-1"}, {"text": "0:1.001"}),
    (schedule, {"text": "0:-1"}, {"text": "0:-1.001"}),
    (TWO_SAMPLES.between, {"t0": 0.0, "t1": 1.001}, {"t0": 0.0, "t1": 1.0}),
    (TWO_SAMPLES.between, {"t0": 1.0, "t1": 3.0}, {"t0": 1.001, "t1": 3.0}),
    (design, {"duration": 60, "hold": 60}, {"duration": 60, "hold": 61}),
    (design, {"duration": 60, "hold": 1}, {"duration": 60, "hold": 0}),
    (design, {"duration": 3600, "hold": 60}, {"duration": 3660, "hold": 60}),
    (
        design,
        {"duration": 60, "hold": 60, "bounds": (-1.0, 1.0)},
        {"duration": 60, "hold": 60, "bounds": (-1.001, 1.0)},
    ),
    (
        design,
        {"duration": 60, "hold": 60, "bounds": (0.0, 1.0)},
        {"duration": 60, "hold": 60, "bounds": (0.0, 1.001)},
    ),
    (pid, {"limits": (-1.0, 1.0)}, {"limits": (-1.001, 1.0)}),
    (pid, {"limits": (0.0, 1.0)}, {"limits": (0.0, 1.001)}),
    (pid, {"limits": (0.499, 0.5)}, {"limits": (0.5, 0.5)}),
    (pid, {"sample_time_s": 1e-3}, {"sample_time_s": 0.0}),
    (partial(check_non_negative, "c"), {"Ki": 0.0}, {"Ki": -1e-9}),
    (partial(checked_deviations, "c", "d", size=1), {"value": 1e-9}, {"value": 0.0}),
    (heated, {"start": 1.0, "end": 1.001}, {"start": 1.0, "end": 1.0}),
    (heated, {"start": 0.0, "end": 1.0, "film": 0.0}, {"start": 0.0, "end": 1.0, "film": -1e-3}),
    (partial(checked_initial, SINGLE_CELL), {"initial": -273.15}, {"initial": -273.151}),
    (FIRST_ORDER.discretise, {"sample_time_s": 1e-3}, {"sample_time_s": 0.0}),
    (Faults.parse, {"text": "drop=0.999"}, {"text": "drop=1"}),
    (Faults.parse, {"text": "corrupt=0"}, {"text": "corrupt=-0.001"}),
    (Faults.parse, {"text": "jumps=0.001"}, {"text": "jumps=0"}),
    (Faults.parse, {"text": "disconnect=999999999"}, {"text": "disconnect=1000000000"}),
    (read_integer, {"text": "7", "least": 0, "most": 7}, {"text": "8", "least": 0, "most": 7}),
    (read_integer, {"text": "-2", "least": -2, "most": 7}, {"text": "-3", "least": -2, "most": 7}),
    (read_number, {"text": "-273.15"}, {"text": "-273.16"}),
    (read_number, {"text": "2000"}, {"text": "2000.1"}),
    (read_word, {"text": "x" * 32}, {"text": "x" * 33}),
    (read_name, {"text": "x" * 32}, {"text": "x" * 33}),
    (split, {"text": "," * 63}, {"text": "," * 64}),
    (image, {}, {"device_us": 2**62 + 1}),
    (image, {"width": 2, "pixels": 2}, {"width": 2, "pixels": 1}),
    (image, {"pixels": 1}, {"width": 0, "pixels": 0}),
    (listen, {"address": "127.0.0.1:0"}, {"address": "127.0.0.1:65536"}),
    (listen, {"address": ":0"}, {"address": ":-1"}),
    (
        opener,
        {"url": "socket://rig:7000", "rig": TCLAB},
        {"url": "socket://rig", "rig": TCLAB},
    ),
    (checked_seed, {"where": "seed", "seed": 2**128 - 1}, {"where": "seed", "seed": 2**128}),
    (checked_seed, {"where": "seed", "seed": 0}, {"where": "seed", "seed": -1}),
    (checked_spread, {"where": "spread", "spread": 0.999}, {"where": "spread", "spread": 1.0}),
    (checked_spread, {"where": "spread", "spread": 1e-3}, {"where": "spread", "spread": 0.0}),
    (Uniform, {"low": 1.0, "high": 1.001}, {"low": 1.0, "high": 1.0}),
    (Normal, {"mean": 0.0, "std": 1e-3}, {"mean": 0.0, "std": 0.0}),
    (Morris, {"levels": 2}, {"levels": 0}),
    (PELTIER, {"maximum_temperature_difference": 299.9}, {"maximum_temperature_difference": 300.0}),
    (PELTIER, {"maximum_temperature_difference": 1e-3}, {"maximum_temperature_difference": 0.0}),
]


@pytest.mark.parametrize(("make", "allowed", "refused"), LIMITS)
def test_the_limit_is_allowed_and_what_is_beyond_is_refused(make, allowed, refused):
    make(**allowed)
    with pytest.raises((JaxtwinError, ValueError), match=r"expected|no image|above|only"):
        make(**refused)


def test_a_line_has_1024_bytes_at_most():
    """docs/protocol.md: a star, eight digits and the end of the line among them."""
    assert len(encode_line("x" * 1014)) == 1024
    with pytest.raises(ValueError, match="1014 printable characters"):
        encode_line("x" * 1015)


def test_ten_residuals_are_enough_for_a_test_of_whiteness():
    residuals = np.array([0.3, -0.1, 0.2, 0.5, -0.7, 0.1, 0.4, -0.2, -0.6, 0.2, math.nan])
    assert ljung_box(residuals).lags == 2  # a fifth of the samples
    with pytest.raises(ValueError, match="at least 10 samples, got 9"):
        ljung_box(residuals[1:])


def test_a_figure_is_an_inch_wide_at_least():
    with plots.style("paper", width=1.0):
        pass
    with pytest.raises(JaxtwinError, match="1 inch"), plots.style("paper", width=0.999):
        pass
