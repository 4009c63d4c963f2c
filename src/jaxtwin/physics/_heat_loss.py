r"""Losses of the plate that do not grow in proportion to its temperature.

Natural convection takes away heat as $\Delta T^{1 + n}$ ($n = 1/4$ for a plate in laminar flow,
Churchill and Chu 1975), radiation as $T^4 - T_a^4$. The conductance matrix of the network contains
the film at the reference rise. The remainder is a small heat flow that is not stiff.
"""

from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..rig._plate import FILM_REFERENCE

STEFAN_BOLTZMANN = 5.670374419e-8
"""The Stefan-Boltzmann constant, W/(m^2 K^4), exact since 2019."""

CALM = 1.0
"""The rise below which the film stops falling, K: the air of a room is never still, and a
fractional power has no derivative at zero."""


@final
class NonlinearLoss(eqx.Module):
    r"""The losses of the plate beyond its linear film.

    $$q = g \left[\left(\frac{\Delta T^2 + s^2}{\Delta T_0^2 + s^2}\right)^{n/2} - 1\right]
    \Delta T + \varepsilon \sigma A (T^4 - T_a^4)$$

    with $\Delta T_0$ = `FILM_REFERENCE` and $s$ = `CALM`.

    **Arguments:**

    - `film`: $g$, of each plate node at the reference rise, W/K.
    - `exponent`: $n$.
    - `radiating`: $\varepsilon A$ of each plate node, m^2.
    """

    film: Float[Array, "*elements"]
    exponent: Float[Array, "*#elements"]
    radiating: Float[Array, "*elements"]

    def heat(
        self, rise: Float[Array, "*elements"], ambient: Float[Array, "*#elements"]
    ) -> Float[Array, "*elements"]:
        """Computes the heat flow to the surroundings in addition to that of the linear film, W.

        **Arguments:**

        - `rise`: the rise of each plate node above the surroundings, K.
        - `ambient`: absolute temperature of the surroundings, K.
        """
        square = (rise**2 + CALM**2) / (FILM_REFERENCE**2 + CALM**2)
        convection = self.film * (jnp.exp(self.exponent / 2 * jnp.log(square)) - 1) * rise
        # T^4 - Ta^4 without the difference of two large numbers.
        hot = ambient + rise
        radiation = rise * (hot + ambient) * (hot**2 + ambient**2)
        return convection + STEFAN_BOLTZMANN * self.radiating * radiation

    def slope(
        self, rise: Float[Array, "*elements"], ambient: Float[Array, "*#elements"]
    ) -> Float[Array, "*elements"]:
        """Derivative of `heat` with respect to the rise, W/K."""
        return jax.jvp(lambda rise: self.heat(rise, ambient), (rise,), (jnp.ones_like(rise),))[1]
