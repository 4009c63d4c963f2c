"""A model of the user: any function from draws to outputs, such as a simulation of closed loops."""

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias, cast

import numpy as np
from jaxtyping import ArrayLike, Float

from ..errors import SimulationError
from ..simulation import REDUCTIONS, Reductions
from ._outputs import Column, Output, columns_of_values

# From parameter -> values `(runs,)`, in the unit of the rig's table, to output -> values `(runs,)`
# or `(runs, ...)`, NaN if a run failed; or to `Reductions`.
Model: TypeAlias = Callable[
    [dict[str, Float[np.ndarray, " runs"]]], Mapping[str, ArrayLike] | Reductions
]


def run_model(model: Model, draws: dict[str, Float[np.ndarray, " runs"]]) -> list[Column]:
    """Runs a user's model and returns its outputs.

    **Raises:** `SimulationError` if the model does not return one or several numbers for each draw.
    """
    runs = len(next(iter(draws.values())))
    results: Any = model(draws)
    failed, units = np.zeros(runs, bool), {}
    if isinstance(results, Reductions):
        failed = results.failed
        known = {name: reduction.unit for name, reduction in REDUCTIONS.items()}
        present = [name for name in known if getattr(results, name) is not None]
        units = {name: known[name] for name in present} | dict(results.custom_units)
        results = {name: results[name] for name in (*present, *results.custom)}
    if not isinstance(results, Mapping) or not results:
        raise SimulationError(
            "sensitivity: model: expected a function that returns output -> values, got one that "
            f"returns {results!r}"
        )
    columns: list[Column] = []
    for name, values in cast(Mapping[Any, Any], results).items():
        array = np.asarray(values)
        if not isinstance(name, str) or array.dtype.kind not in "fiu" or array.shape[:1] != (runs,):
            raise SimulationError(
                f"sensitivity: model: output {name!r}: expected a number for each of {runs} draws, "
                f"got {array.dtype} of shape {array.shape}"
            )
        named = Output(name, unit=units.get(name, ""))
        for output, column in columns_of_values(named, array.astype(float)):
            columns.append((output, np.where(failed, np.nan, column)))
    return columns
