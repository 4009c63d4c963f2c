"""A sweep of half a minute, and an engine that needs no compiler where only the store matters."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from jaxtwin import Experiment, Twin
from jaxtwin.simulation import Reductions
from jaxtwin.sweeps import _plan, sweep

CHANNELS = ("T11", "TAM")


@pytest.fixture(scope="session")
def twin() -> Twin:
    return Twin("paper-2024")


@pytest.fixture(scope="session")
def experiment() -> Experiment:
    """Half a minute with a switch; only two channels are asked for."""
    return Experiment.schedule(
        "0:0.5,10:0.8", duration=30.0, cells=2, channels=CHANNELS, name="half a minute"
    )


class FakeEngine:
    """Results that are plain functions of the draws; it remembers which draws it was given."""

    def __init__(self) -> None:
        self.given: list[np.ndarray] = []

    def __call__(
        self,
        twin: Twin,
        experiment: Experiment,
        draws: dict[str, np.ndarray],
        *_: Any,
        **options: Any,
    ) -> Reductions:
        R_E = draws["R_E"]
        self.given.append(R_E)
        if options["on_progress"] is not None:
            options["on_progress"](len(R_E))
        channels = experiment.channels or twin.channels
        return Reductions(
            channels=channels,
            failed=R_E > 2.8,
            final=R_E[:, None] * np.arange(1, len(channels) + 1),
            plate_range=np.sqrt(R_E),
        )


@pytest.fixture
def engine(monkeypatch: pytest.MonkeyPatch) -> FakeEngine:
    """Takes the place of the simulation in every sweep of the test."""
    fake = FakeEngine()
    monkeypatch.setattr(_plan, "reduce_batch", fake)
    return fake


class RealSweep(NamedTuple):
    """A sweep that went through at once, and the command line that asks for the same."""

    folder: Path
    chunks: int
    command: list[str]


@pytest.fixture(scope="session")
def real_sweep(tmp_path_factory: pytest.TempPathFactory, twin: Twin) -> RealSweep:
    """Four hundred draws in chunks of ten, by the true engine."""
    folder = tmp_path_factory.mktemp("real") / "sweep"
    experiment = Experiment.schedule("0:0.5,10:0.8", duration=30.0, cells=2)
    sweep(twin, experiment, folder, draws=400, chunk_size=10)
    command = ["sweep", "paper-2024", "--duty", "0:0.5,10:0.8", "--duration", "30"]
    return RealSweep(folder, 40, [*command, "--draws", "400", "--chunk", "10"])


@pytest.fixture(scope="session")
def stored() -> Callable[[Path], dict[str, bytes]]:
    """Every file of a folder by its name, but for what a kill may leave beside them."""

    def contents(folder: Path) -> dict[str, bytes]:
        files = (file for file in folder.rglob("*") if file.is_file())
        kept = [file for file in files if not file.name.endswith((".part", ".partial"))]
        return {str(file.relative_to(folder)): file.read_bytes() for file in kept}

    return contents
