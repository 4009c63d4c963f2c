r"""The loss of a match: how much a residual counts, by its size.

A match minimises $\sum \rho(z)$ over the standardised residuals $z$, in units of their robust
standard deviation. With $\rho = z^2 / 2$ these are least squares; a robust loss grows more slowly,
so that outliers count less (Huber 1964). Everything else follows from $\rho$ (Huber 1981, chapters
3 and 7):

- the influence $\psi = \rho'$,
- the weight $w = \psi(z) / z$ by which least squares, repeated with new weights, minimise the loss,
- the curvature $\rho''$, by which a residual contributes to the information of the match,
- $E[\psi^2]$ of normal residuals, by which their standard deviation is found.
"""

from abc import abstractmethod
from dataclasses import fields
from functools import lru_cache
from typing import ClassVar, NamedTuple, TypeVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._arguments import finite_number, of_kind
from .._compilation import persistent_jit
from .._jax_settings import own_settings
from .._kinds import add_kind
from .._padded_rows import padded
from ..errors import MatchError

# The smallest weight of an outlier. The derivatives of a sample without any weight would be lost,
# and with them its part of the uncertainty.
MIN_WEIGHT = 1e-12

# The standardised residuals at which a loss is checked.
CHECKED_RESIDUALS = np.concatenate([-(np.geomspace(1e3, 1e-3, 61)), np.geomspace(1e-3, 1e3, 61)])


class AbstractLoss(eqx.Module):
    r"""A loss of a match. A class of your own says its cost, by `jax.numpy`; its fields are
    numbers.

    - `kind`: its name in saved fits, if it is registered by `register_loss`.
    """

    kind: ClassVar[str] = ""

    @abstractmethod
    def cost(self, residual: Float[Array, ""]) -> Float[Array, ""]:
        r"""$\rho(z)$ of a standardised residual: an even function that is $z^2 / 2$ near 0 and
        grows nowhere faster."""

    def influence(self, residual: Float[Array, ""]) -> Float[Array, ""]:
        r"""$\psi(z) = \rho'(z)$ of a standardised residual, by differentiation of `cost`."""
        return jax.grad(self.cost)(residual)

    def weight(self, residual: Float[Array, ""]) -> Float[Array, ""]:
        r"""$\psi(z) / z$ of a standardised residual; 1 at 0."""
        return jnp.where(residual == 0, 1.0, self.influence(residual) / residual)


Registered = TypeVar("Registered", bound=type[AbstractLoss])

# Kind of loss -> its class.
_KINDS: dict[str, type[AbstractLoss]] = {}


def register_loss(loss: Registered) -> Registered:
    """Makes `Fit.save` and `Fit.load` know a class of losses by its `kind`. A saved fit holds the
    kind and the class's fields, which are numbers. Returns the class, so that it can be a
    decorator.

    **Raises:** `MatchError` for a class without a `kind`, or with the `kind` of another class.
    """
    add_kind(_KINDS, loss, "register_loss", "saved fits, such as 'huber'", MatchError)
    return loss


@final
@register_loss
class Huber(AbstractLoss):
    r"""Huber's loss (1964): $z^2 / 2$ up to the threshold, and its tangent beyond it. An outlier
    counts with its limited residual, whatever its size.

    - `threshold`: in robust standard deviations.
    """

    kind: ClassVar[str] = "huber"
    threshold: float = 1.345

    def __check_init__(self) -> None:
        _check_threshold("Huber", self.threshold)

    def cost(self, residual: Float[Array, ""]) -> Float[Array, ""]:
        size = jnp.abs(residual)
        tangent = self.threshold * (size - self.threshold / 2)
        return jnp.where(size <= self.threshold, residual * residual / 2, tangent)


@final
@register_loss
class Cauchy(AbstractLoss):
    r"""Cauchy's loss, $\frac{k^2}{2} \ln(1 + z^2 / k^2)$. The larger an outlier, the less it
    counts; the loss has several minima if much of a recording is wrong.

    - `threshold`: $k$ in robust standard deviations.
    """

    kind: ClassVar[str] = "cauchy"
    threshold: float = 2.385

    def __check_init__(self) -> None:
        _check_threshold("Cauchy", self.threshold)

    def cost(self, residual: Float[Array, ""]) -> Float[Array, ""]:
        return self.threshold**2 / 2 * jnp.log1p((residual / self.threshold) ** 2)


def _check_threshold(name: str, threshold: float) -> None:
    finite_number(f"{name}: threshold", threshold, MatchError, above=0)


def checked_loss(loss: AbstractLoss | None) -> AbstractLoss | None:
    """Returns a loss; None stands for plain squares.

    **Raises:** `MatchError` for anything else, and for a cost that is not a loss.
    """
    if loss is None:
        return None
    expected = "a loss, such as jaxtwin.matching.Huber(3.0), or None"
    of_kind("loss", loss, AbstractLoss, expected, MatchError)
    _numbers(loss)
    try:
        weights, _ = _evaluated(loss, CHECKED_RESIDUALS)
    except TypeError as problem:  # those of JAX among them
        raise MatchError(
            f"loss: {type(loss).__name__}.cost: expected a function of a number, written with "
            f"jax.numpy (jnp.where in place of if), got {type(problem).__name__}: "
            f"{str(problem).splitlines()[0]}"
        ) from problem
    near = weights[np.abs(CHECKED_RESIDUALS) < 1.1e-3]
    if not (np.all((weights > -1e-9) & (weights < 1 + 1e-9)) and np.all(near > 0.99)):
        raise MatchError(
            f"loss: {type(loss).__name__}.cost: expected z**2 / 2 near 0, and that it grows with "
            f"the size of z but nowhere faster, so that weights are 0 to 1, got weights from "
            f"{weights.min():.3g} to {weights.max():.3g}, and {near.min():.3g} near 0"
        )
    return loss


@final
class LossWeights(NamedTuple):
    r"""The weights $\psi(z) / z$ of residuals, and the curvature $\rho''(z)$ of their loss."""

    weights: Float[np.ndarray, "*shape"]
    curvature: Float[np.ndarray, "*shape"]


def loss_weights(
    loss: AbstractLoss | None,
    residuals: Float[np.ndarray, "*shape"],
    counted: Bool[np.ndarray, "*shape"],
) -> LossWeights:
    """The weights that turn least squares into a loss of residuals in units of the robust standard
    deviation of the counted ones. If most of these are 0, there is no such unit, and all weights
    are 1, as they are for plain squares."""
    plain = LossWeights(np.ones(residuals.shape), np.ones(residuals.shape))
    if loss is None or not counted.any():
        return plain
    scale = 1.4826 * np.median(np.abs(residuals[counted]))
    if scale == 0:
        return plain
    flat = np.ravel(residuals / scale)
    weights, curvature = (part[: flat.size] for part in _evaluated(loss, padded(flat, 0.0)))
    weights = np.clip(weights, MIN_WEIGHT, 1.0)
    return LossWeights(weights.reshape(residuals.shape), curvature.reshape(residuals.shape))


@lru_cache(maxsize=64)
def influence_variance(loss: AbstractLoss | None) -> float:
    r"""$E[\psi(z)^2]$ of a normally distributed number with a standard deviation of 1."""
    if loss is None:
        return 1.0
    from scipy.integrate import quad  # which takes a fifth of a second to import

    def integrand(z: float) -> float:
        (weight,), _ = _evaluated(loss, np.array([z]))
        return float((weight * z) ** 2 * np.exp(-(z**2) / 2))

    # The interval is halved about the kinks of the influence until its integral is exact.
    halves = [
        quad(integrand, *of, epsabs=1e-13, epsrel=1e-11, limit=200)[0] for of in ((-12, 0), (0, 12))
    ]
    return sum(halves) / np.sqrt(2 * np.pi)


def saved_loss(loss: AbstractLoss | None) -> dict[str, str | float] | None:
    """The kind of a loss and its fields, as a saved fit holds them.

    **Raises:** `MatchError` for a class that is not registered.
    """
    if loss is None:
        return None
    if not isinstance(loss, _KINDS.get(loss.kind, ())):
        raise MatchError(
            f"loss: {type(loss).__name__}: expected a class that Fit.load knows, got one that is "
            "not registered; call jaxtwin.matching.register_loss with it"
        )
    return {"kind": loss.kind} | _numbers(loss)


def loaded_loss(saved: dict[str, str | float] | None) -> AbstractLoss | None:
    """The loss of a saved fit.

    **Raises:** `MatchError` for a kind that is not registered, or fields that its class does not
    take.
    """
    if saved is None:
        return None
    values = dict(saved)
    kind = values.pop("kind", None)
    loss = _KINDS.get(str(kind))
    if loss is None:
        raise MatchError(
            f"expected the kind {', '.join(_KINDS)}, got {kind!r}; register a class of your own by "
            "jaxtwin.matching.register_loss before"
        )
    try:
        return loss(**values)
    except TypeError:
        raise MatchError(
            f"expected the fields {[field.name for field in fields(loss)]} of {loss.__name__}, got "
            f"{list(values)}"
        ) from None


def _numbers(loss: AbstractLoss) -> dict[str, float]:
    """Field -> value of a loss.

    **Raises:** `MatchError` for a field that is no number.
    """
    return {
        field.name: finite_number(
            f"loss: {type(loss).__name__}.{field.name}", getattr(loss, field.name), MatchError
        )
        for field in fields(loss)
    }


def _evaluated(loss: AbstractLoss, residuals: Float[np.ndarray, " count"]) -> LossWeights:
    with own_settings():
        return LossWeights(*(np.asarray(part) for part in _weights_and_curvature(loss, residuals)))


@persistent_jit
def _weights_and_curvature(
    loss: AbstractLoss, residuals: Float[np.ndarray | Array, " count"]
) -> tuple[Float[Array, " count"], Float[Array, " count"]]:
    residuals = jnp.asarray(residuals)
    return jax.vmap(loss.weight)(residuals), jax.vmap(jax.grad(loss.influence))(residuals)
