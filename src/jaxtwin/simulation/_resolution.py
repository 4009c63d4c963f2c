r"""The range of rates that float64 can resolve in a network.

Conductances are summed, and rates found, to a part of about $\varepsilon = 2.2 \cdot 10^{-16}$ of
the largest. Every rate then has an error of about $\varepsilon \lambda_{max}$, and a temperature
that has followed a slow mode for a time $\tau$ a relative error of about
$\varepsilon \lambda_{max} \tau$:

$$\lambda_{max} \, \min(t_{run}, 1 / \lambda_{min}) \le 2 \cdot 10^{11}$$

leaves errors below 1e-3 K. Measured with contacts and conductances of 1e-7 to 1e-13 K/W in
`paper-2024`, `dual-cell` and `single-cell`, the error is at most 11 K times
$\varepsilon \lambda_{max} \tau$, half a millikelvin at the limit; a circuit whose nodes are merged
beforehand gives the same result. In a rig of a common size a contact of 1e-10 K/W is inside the
limit, and one of 1e-12 K/W is outside.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..errors import SimulationError
from ..physics import Link, System, Twin

# The largest span of the rates. A network beyond it is refused. Modes beyond it, which losses or
# cells far from their linearisation can cause, are not used: a stiff solver takes over.
MAX_SPAN = 2e11


def network_span(
    system: System, slowest: Float[Array, ""], duration: Float[Array, ""]
) -> Float[Array, ""]:
    """The span of the rates of the network: `spanned` of the fastest rate of a single node, which
    is the largest rate within a factor of 2 (Gershgorin)."""
    return spanned((jnp.diag(system.conductance) / system.capacitance).max(), slowest, duration)


def spanned(
    fastest: Float[Array, ""], slowest: Float[Array, ""], duration: Float[Array, ""]
) -> Float[Array, ""]:
    """The fastest rate (1/s) times the duration of a run or the longest time constant, whichever is
    shorter (s)."""
    # A slowest rate of 0 or below is a rounding error.
    remembered = 1 / jnp.maximum(jnp.abs(slowest), 1 / duration)
    return fastest * jnp.where(jnp.isfinite(remembered), remembered, duration)


def unresolved_network(twin: Twin) -> SimulationError:
    """Makes the error for a twin whose `network_span` is too large. It names the fastest link."""
    values, netlist = twin.numbers_si, twin.netlist
    capacitance = {node.name: float(node.capacitance.evaluate(values)) for node in netlist.nodes}

    def time_constant(link: Link) -> float:
        ends = [capacitance[end] for end in (link.a, link.b) if end in capacitance]
        return link.resistance(values) * min(ends)

    link = min(netlist.links, key=time_constant)
    return SimulationError(
        f"{twin.rig.name}: resistance {link.a} - {link.b}: expected rates that differ by a factor "
        f"of at most {MAX_SPAN:g} within the run, which float64 can tell apart, got "
        f"{link.resistance(values):g} K/W, with which a node settles within "
        f"{time_constant(link):.2g} s; raise the resistance, or make one node of the two"
    )
