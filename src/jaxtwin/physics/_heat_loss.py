r"""Heat flows that do not grow in proportion to a temperature difference: the losses of the plate,
and links by natural convection and radiation.

Natural convection takes away heat as $\Delta T^{1 + n}$ ($n = 1/4$ for a plate in laminar flow,
Churchill and Chu 1975), radiation as $T^4 - T_a^4$. The conductance matrix of the network contains
the film at the reference rise, and the radiation of links at `REFERENCE_TEMPERATURE`. The rest is a
small heat flow that is not stiff.
"""

from pathlib import Path
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..rig._plate import FILM_REFERENCE

STEFAN_BOLTZMANN = 5.670374419e-8
"""The Stefan-Boltzmann constant, W/(m^2 K^4), exact since 2019."""

MIN_FILM_RISE = 1.0
"""The rise below which the film stops falling, K: the air of a room is never still, and a
fractional power has no derivative at zero."""

# The factor of the squared rise with which the film is that of the matrix at the reference, 1/K^2.
FILM_SCALE = 1 / (FILM_REFERENCE**2 + MIN_FILM_RISE**2)

# The temperature at which the radiation of a link is a part of the conductance matrix, K.
REFERENCE_TEMPERATURE = 293.15

# The conductance there of a link that radiates, divided by its area, its emissivity and the
# constant, K^3.
RADIATION_AT_REFERENCE = 4 * REFERENCE_TEMPERATURE**3

# Where the laws stand as C and as SPICE, which `_make_laws.py` writes.
LAW_FOLDER = Path(__file__).with_name("laws")


def lost_heat(
    rise: Float[Array, "*paths"],
    ambient: Float[Array, "*#paths"],
    film: Float[Array, "*paths"],
    half_exponent: Float[Array, "*#paths"],
    radiating: Float[Array, "*paths"],
    linear: Float[Array, "*#paths"] | float,
) -> Float[Array, "*paths"]:
    r"""The heat that a path loses beyond that of the conductance matrix, W.

    C and SPICE are written from this function (`_make_laws.py`), so that it takes scalars too.

    **Arguments:** the symbols are those of `NonlinearLoss`.

    - `rise`, `ambient`: as in `NonlinearLoss.heat`.
    - `film`: $g$, W/K. `half_exponent`: $n / 2$.
    - `radiating`: $\varepsilon \sigma A$, W/K^4. `linear`: $b$, K^3.
    """
    square = (rise**2 + MIN_FILM_RISE**2) * FILM_SCALE
    # Not a power: its derivative would be another one.
    film_factor = jnp.exp(half_exponent * jnp.log(square))
    # T^4 - Ta^4 = (T - Ta) (T + Ta) (T^2 + Ta^2), without the difference of two large numbers.
    hot = ambient + rise
    fourth_powers = (hot + ambient) * (hot**2 + ambient**2)
    return rise * (film * (film_factor - 1) + radiating * (fourth_powers - linear))


@final
class NonlinearLoss(eqx.Module):
    r"""The heat flows beyond those of the conductance matrix.

    $$q = g \left[\left(\frac{\Delta T^2 + s^2}{\Delta T_0^2 + s^2}\right)^{n/2} - 1\right]
    \Delta T + \varepsilon \sigma A (T^4 - T_a^4 - b \Delta T)$$

    with $\Delta T_0$ = `FILM_REFERENCE` and $s$ = `MIN_FILM_RISE`.

    **Arguments:**

    - `film`: $g$, of each path at the reference rise, W/K.
    - `exponent`: $n$.
    - `radiating`: $\varepsilon A$ of each path, m^2.
    - `linear`: $b$, what the conductance matrix contains of the radiation: 0 for the plate,
      `RADIATION_AT_REFERENCE` for links, K^3; None for paths of the plate alone.
    """

    film: Float[Array, "*elements"]
    exponent: Float[Array, "*#elements"]
    radiating: Float[Array, "*elements"]
    linear: Float[Array, "*elements"] | None = None

    def heat(
        self, rise: Float[Array, "*elements"], ambient: Float[Array, "*#elements"]
    ) -> Float[Array, "*elements"]:
        """Computes the heat flow in addition to that of the conductance matrix, W.

        **Arguments:**

        - `rise`: the rise of the near end of each path above the far end, K.
        - `ambient`: absolute temperature of the far end, such as the surroundings, K.
        """
        return lost_heat(
            rise,
            ambient,
            self.film,
            self.exponent / 2,
            STEFAN_BOLTZMANN * self.radiating,
            0.0 if self.linear is None else self.linear,
        )

    def slope(
        self, rise: Float[Array, "*elements"], ambient: Float[Array, "*#elements"]
    ) -> Float[Array, "*elements"]:
        """Derivative of `heat` with respect to the rise, W/K."""
        return jax.jvp(lambda rise: self.heat(rise, ambient), (rise,), (jnp.ones_like(rise),))[1]


@final
class FarEnds(eqx.Module):
    """The far ends of paths that are no nodes, as deviations from a reference.

    - `to_ambient`: 1 for each path that ends at the surroundings, else 0.
    - `held`: the deviation of the body of a given temperature at which a path ends, K, else 0.
    """

    to_ambient: Float[Array, " paths"]
    held: Float[Array, " paths"]


@final
class LossPaths:
    """Where nonlinear heat flows: from which node to which end. Those of the plate, from each
    element to the surroundings, are the first.

    **Arguments:**

    - `near`: the node at which each path begins.
    - `far`: the node at which it ends; -1 for the surroundings, and below that the bodies of given
      temperatures: -2 for the first.
    - `elements`: how many paths are those of the plate, whose elements are the first nodes.
    """

    def __init__(
        self, near: Int[np.ndarray, " paths"], far: Int[np.ndarray, " paths"], elements: int
    ):
        self.near, self.far, self.elements = near, far, elements
        self.is_of_plate = len(near) == elements
        self.linear = np.where(np.arange(len(near)) < elements, 0.0, RADIATION_AT_REFERENCE)
        # The paths that end at nodes. An index of 64 bits is another one where 64 bits are off.
        self.between = np.flatnonzero(far >= 0).astype(np.int32)

    def across(self, of_nodes: Float[Array, "nodes *columns"]) -> Float[Array, "paths *columns"]:
        """The values of the near ends, less those of the far ends that are nodes."""
        if self.is_of_plate:
            return of_nodes[: self.elements]
        near = of_nodes[self.near]
        return near.at[self.between].add(-of_nodes[self.far[self.between]])

    def at_far(self, of_nodes: Float[Array, "nodes *columns"]) -> Float[Array, "paths *columns"]:
        """The values of the far ends, 0 for those that are no nodes."""
        near = jnp.zeros((len(self.near), *of_nodes.shape[1:]), of_nodes.dtype)
        return near.at[self.between].set(of_nodes[self.far[self.between]])

    def into_nodes(
        self, lost: Float[Array, "paths *columns"], heat: Float[Array, "nodes *columns"]
    ) -> Float[Array, "nodes *columns"]:
        """The heat flows into the nodes, less what leaves at the near ends of the paths, plus what
        arrives at the far ends."""
        if self.is_of_plate:
            return heat.at[: self.elements].add(-lost)
        heat = heat.at[self.near].add(-lost)
        return heat.at[self.far[self.between]].add(lost[self.between])

    def conductance_matrix(
        self, values: Float[np.ndarray | Array, " paths"]
    ) -> tuple[Int[np.ndarray, "2 entries"], Float[np.ndarray | Array, " entries"]]:
        """The places in a conductance matrix to which conductances of the paths are added, and the
        values there."""
        near, far, both = self.near, self.far[self.between], self.near[self.between]
        rows, columns = (
            np.concatenate([near, far, both, far]),
            np.concatenate([near, far, far, both]),
        )
        inner = values[self.between]
        joined = jnp.concatenate if isinstance(values, jax.Array) else np.concatenate
        return np.stack([rows, columns]), joined([values, inner, -inner, -inner])

    def ends(
        self,
        across: Float[Array, " paths"],
        at_far: Float[Array, " paths"] | None,
        far: FarEnds | None,
        reference: Float[Array, ""],
        ambient: Float[Array, ""] | float,
    ) -> tuple[Float[Array, " paths"], Float[Array, "*paths"]]:
        """The rise of the near ends above the far ends, K, and the temperatures of these, K.

        **Arguments:** all but `reference` are deviations from it: `across` and `at_far` as those
        methods give them, `far` for the ends that are not nodes, and `ambient`.
        """
        if far is None or at_far is None:
            return across - ambient, jnp.asarray(reference + ambient)
        held = far.to_ambient * ambient + far.held
        return across - held, reference + held + at_far
