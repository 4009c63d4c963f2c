"""What estimates the states of a plant from its readings, for state feedback."""

from abc import abstractmethod

import equinox as eqx
from jaxtyping import Array, Float, PyTree


class AbstractEstimator(eqx.Module):
    """Estimates the states of a plant, followed by its disturbances, K.

    Duty cycles are deviations from the plant's operating point. What a reading is, an estimator
    says.
    """

    @abstractmethod
    def init(self, duty: Float[Array, " cell"], readings: Float[Array, " reading"]) -> PyTree:
        """The estimate at the start, from the duty until then and the first readings."""

    @abstractmethod
    def update(self, estimate: PyTree, readings: Float[Array, " reading"]) -> PyTree:
        """Corrects a predicted estimate by readings."""

    @abstractmethod
    def states(self, estimate: PyTree) -> Float[Array, " state"]:
        """The states of the plant and its disturbances, K."""

    @abstractmethod
    def predict(self, estimate: PyTree, duty: Float[Array, " cell"]) -> PyTree:
        """Predicts the estimate of the next sample."""
