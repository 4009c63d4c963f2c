r"""What float64 can tell of a network: how far apart its rates may be.

Conductances are summed, and rates found, to a part of about $\varepsilon = 2.2 \cdot 10^{-16}$ of
the largest. Every rate is off by about $\varepsilon \lambda_{max}$ then, and a temperature that
has followed a slow one for a time $\tau$ by about $\varepsilon \lambda_{max} \tau$ of itself:

$$\lambda_{max} \, \min(t_{run}, 1 / \lambda_{min}) \le 2 \cdot 10^{11}$$

leaves errors below 1e-3 K. Measured with contacts and conductances of 1e-7 to 1e-13 K/W in the
bundled rigs, the error is at most 11 K times $\varepsilon \lambda_{max} \tau$, half a
millikelvin at the limit; a circuit whose nodes are made one beforehand says the same. A contact of
1e-10 K/W in a rig of a common size is inside, one of 1e-12 K/W is not.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._errors import SimulationError
from ..physics import Link, Twin

LARGEST_SPAN = 2e11
"""Of the largest rate, times the shorter of the run and the longest time constant."""


def resolved_rates(
    rates: Float[Array, " modes"], duration: Float[Array, ""]
) -> Float[Array, " modes"]:
    """The rates (1/s), or NaN where they are too far apart for a run of a duration (s)."""
    fastest, slowest = rates.max(), jnp.abs(rates).min()
    # A slowest rate below the rounding of the fastest is nothing but rounding.
    remembered = jnp.minimum(duration, 1 / jnp.maximum(slowest, 1 / duration))
    return jnp.where(fastest * remembered <= LARGEST_SPAN, rates, jnp.nan)


def unresolved_network(twin: Twin) -> SimulationError:
    """The error to raise where `resolved_rates` has none for a twin: names its fastest link."""
    values, netlist = twin.numbers_si, twin.netlist
    capacitance = {node.name: float(node.capacitance.evaluate(values)) for node in netlist.nodes}

    def time_constant(link: Link) -> float:
        ends = [capacitance[end] for end in (link.a, link.b) if end in capacitance]
        return link.resistance(values) * min(ends)

    link = min(netlist.links, key=time_constant)
    return SimulationError(
        f"{twin.rig.name}: resistance {link.a} - {link.b}: found {link.resistance(values):g} K/W, "
        f"with which a node settles within {time_constant(link):.2g} s, allowed are rates that "
        f"differ by a factor of at most {LARGEST_SPAN:g} within the run, which float64 can "
        "tell apart; raise the resistance, or make one node of the two"
    )
