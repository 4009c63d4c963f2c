"""The twins, experiments and central values of a study of random draws."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from .._arguments import names_of
from .._errors import ParameterError, SimulationError
from .._name_suggestions import did_you_mean
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


def drawn_names(twin: Twin, names: Iterable[str] | None) -> list[str]:
    """The parameters that are drawn.

    **Arguments:**

    - `names`: their names; None for the free parameters that recordings share, without the
      camera's registration.

    **Raises:** `ParameterError` for unknown names, or none at all.
    """
    table = twin.rig.parameters
    if names is None:
        # The registration is a length and an angle about 0, and not a property of the plant.
        zones = twin.wiring.zones
        registration = frozenset() if zones is None else zones.registration.names
        selected = [
            name
            for name, row in table.items()
            if row.free and row.scope != "recording" and name not in registration
        ]
    else:
        selected = list(names_of("names", names, ParameterError))
    unknown = [name for name in selected if name not in table]
    if unknown or not selected:
        raise ParameterError(
            f"{twin.rig.name}: names: expected some of {', '.join(table)}, got "
            f"{', '.join(unknown) or 'none'}{did_you_mean(unknown, table)}"
        )
    return selected


def central_values(twin: Twin, names: Iterable[str] | None) -> dict[str, float]:
    """The values around which parameters are drawn: name -> value in the rig's unit.

    **Arguments:**

    - `names`: as in `drawn_names`.

    **Raises:** `ParameterError` for unknown names, none at all, or a value of 0.
    """
    values = {name: float(twin.values[name]) for name in drawn_names(twin, names)}
    for name, value in values.items():
        if value == 0:
            raise ParameterError(
                f"{twin.rig.name}: parameter {name}: expected a value other than 0, because draws "
                "have a standard deviation relative to it, got 0; leave it out with names=[...]"
            )
    return values


def rescaled_draws(
    twin: Twin, values: Mapping[str, float], samples: Mapping[str, Float[np.ndarray, " draws"]]
) -> dict[str, Float[np.ndarray, " draws"]]:
    """Moves draws from around `values` to around the values of a twin, at the same ratios.

    Twins of several recordings thus get the same draws relative to their values.
    """
    return {
        name: float(twin.values[name]) / values[name] * sample for name, sample in samples.items()
    }


def distinct_names(names: Iterable[str]) -> list[str]:
    """The names, each made unique: a second `T` becomes `T (2)`."""
    counts: dict[str, int] = {}
    labels = []
    for name in names:
        counts[name] = counts.get(name, 0) + 1
        labels.append(name if counts[name] == 1 else f"{name} ({counts[name]})")
    return labels
