"""The compiled programs in which a diffrax solver runs a twin: one run, or a chunk of draws.

They are in a separate module because diffrax takes a third of a second to import, and the
default solver does not need it.
"""

from collections.abc import Mapping

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._celsius import ZERO_CELSIUS
from .._compilation import persistent_jit
from ..io import Experiment
from ..physics import Twin
from ._diffeqsolve import DiffraxMethod, solve_with_diffrax
from ._initial import CheckedInitial, keeps_symmetry
from ._input_levels import input_levels
from ._modes import run_modes
from ._power import SupplyPower, power_of_states
from ._refinement import stability_number
from ._time_grid import TimeGrid


def is_successful(result: diffrax.RESULTS) -> Bool[Array, ""]:
    """Whether a solve reached its end."""
    return result == diffrax.RESULTS.successful


@eqx.filter_jit
def diffrax_run(
    twin: Twin, initial: CheckedInitial, experiment: Experiment, method: DiffraxMethod
) -> tuple[Float[Array, "times rig_nodes"], Float[Array, "times channels"], diffrax.RESULTS]:
    """Computes the absolute temperatures of the rig's nodes and of its channels, K, and the result
    code of diffrax."""
    system = twin.system(lumped=keeps_symmetry(initial))
    return solve_with_diffrax(system, experiment, initial, method)


@persistent_jit
def diffrax_chunk(
    twin: Twin,
    draws: Mapping[str, Float[Array | np.ndarray, " chunk"]],
    grid: TimeGrid,
    initial: CheckedInitial,
    experiment: Experiment,
    method: DiffraxMethod,
    with_power: bool,
) -> tuple[
    Float[Array, "chunk times channels"],
    Float[Array, "chunk elements"],
    SupplyPower | None,
    Bool[Array, " chunk"],
]:
    """Solves a chunk of draws by a diffrax solver.

    **Arguments:** those of `prepare_chunk` in `_chunk_programs.py`, and

    - `experiment`: the inputs.
    - `method`: the diffrax solver with its options.
    - `with_power`: whether power and energy are computed.

    **Returns:** the temperatures of all channels at the samples, and of the plate's elements at the
    last sample, degC; power and energy of the cells if requested; whether the draw failed. All
    numbers of a failed draw are NaN.
    """

    def solve_draw(
        values: Mapping[str, Float[Array | np.ndarray, ""]],
    ) -> tuple[Array, Array, SupplyPower | None, Array]:
        system = twin.with_values(values).system(lumped=keeps_symmetry(initial))
        inputs = grid.summary()
        is_resolved = ~jnp.isnan(stability_number(system, run_modes(system, inputs), inputs))
        states, readings, result = solve_with_diffrax(system, experiment, initial, method)
        is_solved = (result == diffrax.RESULTS.successful) & jnp.all(jnp.isfinite(states))
        failed = ~(system.is_valid & is_resolved & is_solved)
        plate = states[-1, : len(system.wiring.rig_elements)]
        temperatures, plate = (
            jnp.where(failed, jnp.nan, kelvin - ZERO_CELSIUS) for kelvin in (readings, plate)
        )
        drawn = None
        if with_power:
            drawn = power_of_states(
                twin.with_values(values),
                states,
                experiment.elapsed,
                experiment.duty,
                isinstance(initial, str),
                input_levels(experiment, twin.rig.inputs),
            )
            drawn = jax.tree.map(lambda rows: jnp.where(failed, jnp.nan, rows), drawn)
        return temperatures, plate, drawn, failed

    return jax.vmap(solve_draw)(draws)
