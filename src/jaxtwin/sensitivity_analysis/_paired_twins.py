"""Pairs the experiments of a study with their twins, and gives their channels distinct names."""

from collections.abc import Iterable, Sequence

from ..errors import SimulationError
from ..io import Experiment
from ..io._experiment import as_experiments
from ..matching import Fit
from ..physics import Twin
from ..physics._twin import check_twin


def paired_twins(
    study: str,
    twin: Twin | Fit | Sequence[Twin],
    experiments: Experiment | Sequence[Experiment] | None,
) -> tuple[list[Twin], list[Experiment]]:
    """Pairs each experiment with its twin.

    **Arguments:**

    - `study`: the name of the calling function, for error messages.
    - `twin`: one twin for all experiments, one for each, or a fit, which has one for each: see
      `Fit.twin_for`.
    - `experiments`: one or several; None for the experiments of the fit.

    **Raises:** `SimulationError` if the numbers of twins and experiments differ, if there are none,
    or if the twins have different rigs; `MatchError` if a recording that was not matched is too
    short to estimate its values.
    """
    if experiments is None:
        if not isinstance(twin, Fit):
            raise SimulationError(
                f"{study}: experiments: expected one or several, got none; only a fit "
                "has experiments"
            )
        experiments = twin.experiments
    recordings = as_experiments(f"{study}: experiments", experiments, SimulationError)
    if isinstance(twin, Fit):
        twins = [twin.twin_for(experiment) for experiment in recordings]
    elif isinstance(twin, Twin):
        twins = [twin] * len(recordings)
    else:
        if isinstance(twin, str) or not isinstance(twin, Iterable):
            check_twin(f"{study}: twin", twin, SimulationError)
        twins = list(twin)
    for candidate in twins:
        check_twin(f"{study}: twin", candidate, SimulationError)
    if not recordings or len(twins) != len(recordings):
        raise SimulationError(
            f"{study}: expected one twin for all experiments or one for each, got {len(twins)} "
            f"twins for {len(recordings)} experiments"
        )
    if any(twin.rig != twins[0].rig for twin in twins):
        raise SimulationError(f"{study}: expected twins of the same rig, got twins of several rigs")
    return twins, recordings


def distinct_names(names: Iterable[str]) -> list[str]:
    """The names, each made unique: a second `T` becomes `T (2)`."""
    counts: dict[str, int] = {}
    labels = []
    for name in names:
        counts[name] = counts.get(name, 0) + 1
        labels.append(name if counts[name] == 1 else f"{name} ({counts[name]})")
    return labels
