"""The same rig on another grid."""

import pytest
from placed_rig import placed_text

from jaxtwin import load_rig
from jaxtwin.rig._variants import with_resolution


def test_the_same_rig_on_another_grid(tmp_path):
    file = tmp_path / "placed.toml"
    file.write_text(placed_text(), encoding="utf-8")
    rig = load_rig(file)
    fine = with_resolution(rig, 0.005)
    assert (len(rig.plate.columns), len(fine.plate.columns)) == (16, 32)
    assert fine.plate.width == pytest.approx(rig.plate.width)
    assert fine.parameters == rig.parameters
    assert fine.cells[0].placement == rig.cells[0].placement
