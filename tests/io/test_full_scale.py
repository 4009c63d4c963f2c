"""Columns of the voltage, power or current of a heater, whose full scale the rig states."""

import copy
from pathlib import Path

import numpy as np
import pytest
from radiating_rig import TABLE

from jaxtwin import read_recording
from jaxtwin.errors import RecordingError
from jaxtwin.rig import Rig, rig_from_tables

VOLTS = np.array([0.0, 6.0, 6.0, 12.0, 3.0, 0.0])


def rig(full_scale: str) -> Rig:
    table = copy.deepcopy(TABLE)
    table["heaters"][0] |= {"full_scale": full_scale, "drive": "proportional"}
    del table["parameters"]["p"]
    return rig_from_tables(table, "rig.toml")


def duty(folder: Path, title: str, numbers, full_scale="12 V", **choices) -> np.ndarray:
    path = folder / "log.csv"
    rows = [f"{second},{number},20,21" for second, number in enumerate(numbers)]
    path.write_text("\n".join([f"time_s,{title},T1_degC,T2_degC", *rows]))
    return read_recording(path, rig=rig(full_scale), **choices).duty[:, 0]


@pytest.mark.parametrize(
    "title",
    ["voltage_H", "voltage_H [V]", "duty_H [V]", "duty_H_V", "voltage_P1", "Supply", "Supply [V]"],
)
def test_a_voltage_is_a_share_of_full_duty(title: str, tmp_path: Path):
    columns = {"Supply": "voltage_H", "Supply [V]": "duty_H"}
    chosen = {title: columns[title]} if title in columns else None
    np.testing.assert_allclose(duty(tmp_path, title, VOLTS, columns=chosen), VOLTS / 12)


def test_a_power_in_another_unit_of_power(tmp_path: Path):
    numbers = [0, 15000, 30000]
    np.testing.assert_allclose(duty(tmp_path, "power_H [mW]", numbers, "30 W"), [0, 0.5, 1])


def test_a_current_is_a_share_of_full_duty(tmp_path: Path):
    np.testing.assert_allclose(duty(tmp_path, "current_H [A]", [0, 1, 2], "2 A"), [0, 0.5, 1])


def test_a_column_of_duty_stays_one(tmp_path: Path):
    np.testing.assert_allclose(duty(tmp_path, "duty_H", [0, 0.5, 1]), [0, 0.5, 1])
    np.testing.assert_allclose(duty(tmp_path, "duty_H [%]", [0, 50, 100]), [0, 0.5, 1])


def test_the_same_scale_may_be_given_and_another_is_refused(tmp_path: Path):
    same = duty(tmp_path, "voltage_H", VOLTS, scale={"duty_H": "1/12 V"})
    np.testing.assert_allclose(same, VOLTS / 12)
    with pytest.raises(RecordingError, match=r"voltage_H: expected the full_scale .* '1/24 V'"):
        duty(tmp_path, "voltage_H", VOLTS, scale={"duty_H": "1/24 V"})


@pytest.mark.parametrize("title", ["voltage_H [W]", "duty_H [W]"])
def test_another_quantity_than_that_of_the_rig_is_refused(title: str, tmp_path: Path):
    with pytest.raises(RecordingError, match=r"log.csv: column .*expected V, .* got W \(power\)"):
        duty(tmp_path, title, VOLTS)
