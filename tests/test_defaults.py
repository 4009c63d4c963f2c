"""What Python functions take for an argument that is left out: scripts and results rely on it.

Each number stands in the documentation of its function or can be read off its results, so a change
is one of behaviour. Those of the commands are in `commands/test_commands.py`.
"""

import importlib
import inspect
from typing import Any

import pytest

RANGE = (-1.0, 1.0)

DEFAULTS = {
    "jaxtwin": {
        "Experiment.from_dataframe": {"counts": None, "polarity": 1},
        "Experiment.schedule": {"step": 1.0, "cells": 1},
        "Fit.report": {"draws": 0},
        "Fit.summary": {"style": "text"},
        "Stepper": {"step_size": 1.0},
        "Stepper.step": {"steps": 1},
        "design_experiment": {
            "duration": 1200.0,
            "hold": 60.0,
            "levels": 5,
            "criterion": "D",
            "margin": 5.0,
            "starts": 1,
            "seed": 0,
        },
        "design_rig": {
            "objective": "range",
            "further_cells": 0,
            "clearance": 0.0,
            "limits": RANGE,
            "starts": 4,
            "seed": 0,
        },
        "export_c": {"name": "model", "precision": "double"},
        "export_fmu": {"step_size": None, "version": "2.0", "compiler": "cc"},
        "global_sensitivity": {"spread": 0.25, "seed": 0, "inputs": "normal"},
        "leave_one_out": {"by": "recording", "warm_up": 60.0},
        "match": {"starts": 1, "seed": 0, "max_iterations": 200},
        "match_many": {"max_iterations": 200},
        "prediction_band": {"level": 0.95, "warm_up": 60.0},
        "profile": {"points": 9},
        "read_recording": {"counts": None, "polarity": None, "ignore": ()},
        "sensitivity": {"draws": 50, "spread": 0.25, "seed": 0},
        "simulate_batch": {"precision": "float64"},
        "simulate_closed_loops": {"precision": "float64"},
        "sweep": {"spread": 0.25, "seed": 0, "precision": "float64", "chunk_size": 65_536},
        "tune": {
            "objective": "integral_absolute_error",
            "tail_weight": 0.5,
            "sensitivity_limit": 2.0,
            "starts": 4,
            "rounds": 30,
            "seed": 0,
        },
        "validate": {"warm_up": 60.0},
    },
    "jaxtwin.control": {
        "StateSpace": {"delay_s": 0.0, "lag_s": 0.0},
        "DecoupledPI": {"setpoint_weight": 1.0, "limits": None, "sample_time_s": 1.0},
        "FunctionController": {"sample_time_s": 1.0},
        "design_lqi": {
            "output_deviation": 1.0,
            "integral_deviation": 30.0,
            "duty_deviation": 0.5,
            "drift": 0.1,
            "reading_noise": 1.0,
            "setpoint_weight": 0.0,
            "limits": None,
        },
        "design_mpc": {
            "horizon": 20,
            "output_deviation": 1.0,
            "duty_deviation": 0.05,
            "duty_change_deviation": 0.05,
            "drift": 0.1,
            "reading_noise": 0.5,
            "limits": None,
            "excess_deviation": 0.1,
        },
        "PID": {
            "Ki": 0.0,
            "Kd": 0.0,
            "Tf": 0.0,
            "setpoint_weight": 1.0,
            "derivative_weight": 0.0,
            "limits": None,
            "sample_time_s": 1.0,
        },
        "Relay": {"timeout_s": 600.0, "limits": None, "sample_time_s": 1.0},
        "UltimatePoint.pid": {"rule": "tyreus-luyben"},
        "LiveLoop": {"silence": 3.0},
        "disk_margin": {"skew": 0.0},
        "frontier": {
            "against": "largest_plate_range",
            "objective": "integral_absolute_error",
            "tail_weight": 0.5,
            "sensitivity_limit": 2.0,
            "rounds": 20,
            "seed": 0,
        },
        "most_even_point": {"limits": RANGE},
        "scenario": {"faults": "", "seed": 0, "sensor_delay": 0.0, "silence": 3.0},
        "ultimate_point": {"cycles": 3},
    },
    "jaxtwin.errors": {
        "SafetyStop": {"kind": "not-ready"},
    },
    "jaxtwin.physics": {
        "plate_map": {"points": 120},
    },
    "jaxtwin.io": {"Session.experiment": {"step": 1.0}},
    "jaxtwin.live": {
        "RigConnection": {"stale_after": 2.0},
        "RigConnection.poll": {"timeout": 0.1},
        "Guard.of": {"silence": 3.0},
        "Hello": {"counts": 255, "rate": 1.0},
        "Replay": {"speed": 1.0},
        "Replay.poll": {"timeout": 0.1},
        "VirtualRig": {
            "speed": 1.0,
            "seed": 0,
            "camera_rate": 9.0,
            "controller_rate": 10.0,
            "watchdog": 2.0,
        },
        "connect": {"baud": 115_200},
        "interlocks_of": {"silence": 3.0},
        "opener": {"baud": 115_200},
    },
    "jaxtwin.matching": {
        "BoundedLevenbergMarquardt": {"rtol": 1e-8, "atol": 1e-10, "gtol": 1e-7, "damping": 1e-3},
        "estimate_initial_conditions": {"warm_up": 60.0},
        "posterior_draws": {"seed": 0},
    },
    "jaxtwin.plots": {
        "animate_plate": {"frames": 100, "seconds": 8.0},
        "plot_bands": {"level": 0.95},
        "plot_dc_sweep": {"delta_T": (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0)},
        "plot_plate_map": {"columns": 2},
        "plot_tornado": {"channel": "mean"},
        "to_png": {"dpi": 150},
    },
    "jaxtwin.rig": {
        "Driver": {"off_phase": "brake"},
        "Parameter": {"scope": "shared", "scale": 1.0, "offset": 0.0},
    },
    "jaxtwin.serve": {
        "Access.of": {"names": (), "allow_control": False},
        "FrameRing": {"size": 1200},
        "History.over": {"points": 600},
        "PageServer": {"silence": 10.0},
        "TwinBeside": {"sample_time": 1.0},
        "VirtualLink": {"speed": 1.0, "seed": 0},
    },
    "jaxtwin.sensitivity_analysis": {
        "Sensitivity.tornado": {"channel": "mean"},
        "Sensitivity.significant": {"channel": "mean"},
        "Sensitivity.ranking": {"channel": "mean"},
        "Morris": {"levels": 4},
        "indices_of": {"seed": 0},
        "normal_draws": {"start": 0},
    },
}


@pytest.mark.parametrize("module", DEFAULTS)
def test_arguments_that_are_left_out_have_the_values_that_scripts_rely_on(module):
    for name, expected in DEFAULTS[module].items():
        part: Any = importlib.import_module(module)
        for step in name.split("."):
            part = getattr(part, step)
        parameters = inspect.signature(part).parameters
        assert {key: parameters[key].default for key in expected} == expected, name
