"""What a study of random draws is made of: twins, experiments, and what is drawn around what."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from .._arguments import names_of
from .._errors import ParameterError, SimulationError
from ..io import Experiment, as_experiments
from ..matching import Fit
from ..physics import Twin, check_twin


def paired_twins(
    study: str,
    twin: Twin | Fit | Sequence[Twin],
    experiments: Experiment | Sequence[Experiment] | None,
) -> tuple[list[Twin], list[Experiment]]:
    """One twin for each experiment.

    **Arguments:**

    - `study`: what asks, for its errors.
    - `twin`: one for all experiments, one each, or a fit, which has one for each: see
      `Fit.twin_for`.
    - `experiments`: one or several; None for those of the fit.

    **Raises:** `SimulationError` where their numbers differ, there are none, or the twins' rigs do;
    `MatchError` where a recording that the fit has not seen is too short to take its own values
    from.
    """
    if experiments is None:
        if not isinstance(twin, Fit):
            raise SimulationError(
                f"{study}: experiments: found none, allowed is one or several; only a fit brings "
                "its own"
            )
        experiments = twin.experiments
    recordings = as_experiments(f"{study}: experiments", experiments, SimulationError)
    if isinstance(twin, Fit):
        twins = [twin.twin_for(one) for one in recordings]
    elif isinstance(twin, Twin):
        twins = [twin] * len(recordings)
    else:
        if isinstance(twin, str) or not isinstance(twin, Iterable):
            check_twin(f"{study}: twin", twin, SimulationError)
        twins = list(twin)
    for one in twins:
        check_twin(f"{study}: twin", one, SimulationError)
    if not recordings or len(twins) != len(recordings):
        raise SimulationError(
            f"{study}: found {len(twins)} twins for {len(recordings)} experiments, allowed is one "
            "for all or one each"
        )
    if any(one.rig != twins[0].rig for one in twins):
        raise SimulationError(f"{study}: found twins of several rigs, allowed is one rig")
    return twins, recordings


def drawn_values(twin: Twin, parameters: Iterable[str] | None) -> dict[str, float]:
    """Name -> what that parameter is drawn around, in the rig's unit.

    **Arguments:**

    - `parameters`: names; None for those that the rig calls free and all recordings share.

    **Raises:** `ParameterError` for unknown names, none at all, or a value of 0.
    """
    table = twin.rig.parameters
    if parameters is None:
        names = [name for name, row in table.items() if row.free and row.scope == "shared"]
    else:
        names = list(names_of("parameters", parameters, ParameterError))
    unknown = [name for name in names if name not in table]
    if unknown or not names:
        raise ParameterError(
            f"{twin.rig.name}: parameters: found {', '.join(unknown) or 'none'}, allowed are "
            f"{', '.join(table)}"
        )
    values = {name: float(twin.parameters[name]) for name in names}
    for name, value in values.items():
        if value == 0:
            raise ParameterError(
                f"{twin.rig.name}: parameter {name}: found 0, allowed is a value to spread around"
            )
    return values


def own_draws(
    twin: Twin, values: Mapping[str, float], samples: Mapping[str, Float[np.ndarray, " draws"]]
) -> dict[str, Float[np.ndarray, " draws"]]:
    """Draws around a twin's own values, as far away in proportion as `samples` are from `values`:
    twins that differ get the same draws."""
    return {
        name: float(twin.parameters[name]) / values[name] * sample
        for name, sample in samples.items()
    }


def distinct_names(names: Iterable[str]) -> list[str]:
    """Where several share a name, the later ones carry a number."""
    seen: dict[str, int] = {}
    labels = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        labels.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return labels
