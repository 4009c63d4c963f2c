"""The methods of global sensitivity analysis by name."""

from typing import Literal, TypeAlias

from .._arguments import of_kind
from .._name_suggestions import did_you_mean
from ..errors import SimulationError
from ._correlations import Pearson, Spearman
from ._derivative_based import DerivativeBased
from ._method import AbstractMethod
from ._morris import Morris
from ._one_at_a_time import OneAtATime
from ._polynomial_chaos import PolynomialChaos
from ._regression import PartialRankCorrelation, StandardisedRegression
from ._shapley import Shapley
from ._sobol import Sobol

MethodName: TypeAlias = Literal[
    "pearson", "spearman", "src", "prcc", "oat", "morris", "sobol", "shapley", "dgsm", "pce"
]
"""The name of a method of `global_sensitivity`."""

METHODS: dict[MethodName, AbstractMethod] = {
    "pearson": Pearson(),
    "spearman": Spearman(),
    "src": StandardisedRegression(),
    "prcc": PartialRankCorrelation(),
    "oat": OneAtATime(),
    "morris": Morris(),
    "sobol": Sobol(),
    "shapley": Shapley(),
    "dgsm": DerivativeBased(),
    "pce": PolynomialChaos(),
}
"""Name -> method, with its usual settings."""


def checked_method(method: MethodName | AbstractMethod) -> AbstractMethod:
    """Returns a method, given as an object or by its name.

    **Raises:** `SimulationError` for anything else.
    """
    if isinstance(method, str):
        for name, known in METHODS.items():
            if name == method:
                return known
        raise SimulationError(
            f"sensitivity: method: expected {', '.join(METHODS)}, got {method!r}"
            f"{did_you_mean([method], METHODS)}"
        )
    expected = "the name of a method, or one such as Sobol(second_order=True)"
    return of_kind("sensitivity: method", method, AbstractMethod, expected, SimulationError)
