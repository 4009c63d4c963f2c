"""The parameters that a study draws, and the values around which it draws them."""

from collections.abc import Iterable, Mapping

import numpy as np
from jaxtyping import Float

from .._arguments import names_of
from .._name_suggestions import did_you_mean
from ..errors import ParameterError
from ..physics import Twin


def central_values(twin: Twin, names: Iterable[str] | None) -> dict[str, float]:
    """Returns the values around which parameters are drawn: name -> value in the rig's unit.

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


def drawn_names(twin: Twin, names: Iterable[str] | None) -> list[str]:
    """Returns the names of the parameters that are drawn.

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


def rescaled_draws(
    twin: Twin, values: Mapping[str, float], samples: Mapping[str, Float[np.ndarray, " draws"]]
) -> dict[str, Float[np.ndarray, " draws"]]:
    """Moves draws from around `values` to around the values of a twin, at the same ratios.

    Twins of several recordings thus get the same draws relative to their values.
    """
    return {
        name: float(twin.values[name]) / values[name] * sample for name, sample in samples.items()
    }
