"""The joint distribution of the parameters of a global analysis."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr, ndtri

from ..errors import ParameterError
from ._marginals import MIN_PROBABILITY, AbstractMarginal


@final
@dataclass(frozen=True, eq=False)
class Inputs:
    """The joint distribution of the drawn parameters: their marginal distributions and their
    correlation.

    Correlated parameters are a Gaussian copula: their normal scores, `ndtri` of their
    probabilities, are jointly normal.

    **Arguments:**

    - `marginals`: name -> distribution.
    - `correlation`: the correlation of the normal scores; None for independent parameters.
    - `relative_to`: the values around which parameters are drawn, name -> value. A twin with other
      values then gets draws at the same ratios to its own values. None if all twins get the same
      draws.
    """

    marginals: Mapping[str, AbstractMarginal]
    correlation: Float[np.ndarray, "parameters parameters"] | None = None
    relative_to: Mapping[str, float] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the parameters."""
        return tuple(self.marginals)

    def correlated(
        self, unit: Float[np.ndarray, "draws parameters"]
    ) -> Float[np.ndarray, "draws parameters"]:
        """Transforms independent probabilities to probabilities with the correlation of the
        parameters."""
        if self.correlation is None:
            return unit
        return ndtr(ndtri(np.clip(unit, MIN_PROBABILITY, 1 - 2.0**-53)) @ self.root.T)

    @cached_property
    def root(self) -> Float[np.ndarray, "parameters parameters"]:
        """A matrix whose product with its transpose is the correlation, which may be singular."""
        if self.correlation is None:
            return np.eye(len(self.names))
        squares, directions = np.linalg.eigh(self.correlation)
        return directions * np.sqrt(np.maximum(squares, 0.0))

    def values(
        self, unit: Float[np.ndarray, "draws parameters"]
    ) -> Float[np.ndarray, "draws parameters"]:
        """Transforms probabilities to values of the parameters, each by its quantile function."""
        pairs = zip(self.marginals.values(), unit.T, strict=True)
        return np.column_stack([marginal.quantile(column) for marginal, column in pairs])

    def check_independent(self, method: str) -> None:
        """Refuses correlated parameters.

        **Raises:** `ParameterError`.
        """
        if self.correlation is not None:
            raise ParameterError(
                f"sensitivity: inputs: expected independent parameters for {method}, whose indices "
                'have no meaning for others, got correlated ones; use method="shapley", or "src" '
                'or "prcc" for the effect of a parameter while the others are held'
            )

    def to_salib(self) -> dict[str, Any]:
        """Returns the problem in SALib's form, for its samplers and analysers.

        **Raises:** `ParameterError` for correlated parameters, which SALib's form cannot represent.
        """
        if self.correlation is not None:
            raise ParameterError(
                "to_salib: expected independent parameters, got correlated ones, for which SALib "
                "has no form"
            )
        written = [marginal.to_salib() for marginal in self.marginals.values()]
        return {
            "num_vars": len(written),
            "names": list(self.names),
            "bounds": [numbers for _, numbers in written],
            "dists": [kind for kind, _ in written],
        }
