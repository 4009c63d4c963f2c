"""Linearises a twin at an operating point."""

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from ..._arguments import finite_number
from ..._celsius import ZERO_CELSIUS
from ..._compilation import persistent_jit_unoptimised
from ..._jax_settings import is_traced, own_settings, settings_for, to_numpy
from ...errors import ControlError
from ...matching import Fit, nominal_twin
from ...physics import System, Twin
from ...simulation import Run, assembled, check_values, input_levels, lagged_duty, stated_levels
from ._operating_point import OperatingPoint, Target, duty_for, slopes, target_of
from ._state_space import StateSpace


@runtime_checkable
class HasRun(Protocol):
    """A result that holds a run of the twin, such as a `ClosedLoopRun`."""

    @property
    def run(self) -> Run:
        """The run."""
        ...


class PointOfRun(NamedTuple):
    """A state of a rig, not at rest.

    - `nodes`: the temperatures of the nodes, degC.
    - `duty`: the duty that reaches the cells, -1 to 1.
    - `ambient`: the temperature of the surroundings, degC.
    - `levels`: the rig's other inputs, as numbers (`input_levels`); None for a rig without any.
    """

    nodes: Float[Array | np.ndarray, " nodes"]
    duty: Float[Array | np.ndarray, " cells"]
    ambient: Float[Array | np.ndarray, ""]
    levels: Float[Array | np.ndarray, " inputs"] | None


def point_of_run(twin: Twin, run: Run, time: Any, ambient: float | int | None) -> PointOfRun:
    """The state of a run at a time, s.

    **Arguments:**

    - `ambient`: the ambient temperature, degC; None for that of the run.

    **Raises:** `ControlError` if the run has other nodes than the twin, or the time is outside
    of it.
    """
    names = tuple(node.name for node in twin.netlist.nodes)
    if run.nodes != names:
        raise ControlError(
            f"linearize: run: expected a run of {twin.rig.name}, whose nodes begin with "
            f"{', '.join(names[:3])}, got one of {run.rig}"
        )
    at = finite_number("linearize: time", time, ControlError)
    times = run.time
    if not times[0] <= at <= times[-1]:
        raise ControlError(
            f"linearize: time: expected {times[0]:g} to {times[-1]:g} s, the times of the run, got "
            f"{at:g} s"
        )
    experiment, system = run.experiment, assembled(twin)
    now = int(np.searchsorted(times, at, side="right")) - 1
    recorded = experiment.ambient
    if ambient is not None:
        room = float(ambient)
    elif recorded is not None:
        room = float(np.broadcast_to(np.asarray(recorded, float), times.shape)[now])
    else:
        drift = 0.0 if system.ambient_drift is None else float(system.ambient_drift)
        room = float(system.ambient_temperature) - ZERO_CELSIUS + drift * (at - float(times[0]))
    duty = np.asarray(experiment.duty, float)[now]
    if system.lag is not None:
        duty = lagged_duty(
            system.lag,
            system.delay,
            jnp.asarray(times),
            jnp.asarray(experiment.duty),
            jnp.asarray([at]),
            run.is_steady_start,
        )[0]
    nodes = np.array([np.interp(at, times, column) for column in run.states.T])
    levels = input_levels(experiment, twin.rig.inputs)
    return PointOfRun(nodes, duty, np.asarray(room), None if levels is None else levels[now])


# The largest heat flow into a node of a steady state, relative to all flows.
REST_TOLERANCE = 1e-6

# The largest distance from a requested temperature, K.
TEMPERATURE_TOLERANCE = 1e-3


def linearize(
    twin: Twin | Fit,
    *,
    duty: ArrayLike | float | int | None = None,
    temperatures: Mapping[str, float] | float | int | None = None,
    ambient: float | int | None = None,
    inputs: Mapping[str, Any] | None = None,
    run: Run | HasRun | None = None,
    time: float | int | None = None,
) -> StateSpace:
    r"""Linearises a twin at a steady state, or at a time of a run, by exact derivatives.

    With the temperatures of the nodes $x$, the duty of the cells $u$ and the readings of the
    channels $y$, all as deviations from the operating point, the model is

    $$\dot x = r + A x + B u, \quad y = C x + D u$$

    At a steady state $r$ is left out. At a time of a run the plate is not at rest, and $r$
    (`rates`) is the rate at which the temperatures change there. JAX computes $A$ and $B$ as
    derivatives of the twin's equations; $D$ is 0. The driver's delay and lag are separate fields
    of the model.

    ```python
    model = jt.linearize(jt.Twin("dual-cell"), duty=[0.4, 0.4])
    model = jt.linearize(jt.Twin("dual-cell"), temperatures={"TAM": 40.0, "TCM": 40.0})
    model = jt.linearize(run.twin, run=run, time=60.0)
    ```

    The heat flows of a cell have a kink at a duty of 0, because heating and cooling both add Joule
    heat. Exactly at 0, the model has the mean of the two slopes, the initial response to a small
    signal of both signs. The slopes can differ much: on `dual-cell` the DC gain is 49 K per
    unit of duty for heating and about 0 for cooling. At a small duty of either sign, the model has
    the slope of that side.

    The function can be called inside `jax.jit`, `jax.vmap` and `jax.grad`, and its result can be
    differentiated with respect to the twin's parameters. Outside of them it computes in float64.

    **Arguments:**

    - `twin`: the twin; or a fit, whose recordings' own values are averaged (`Fit.mean_twin`).
    - `duty`: the duty at the operating point, one value for all cells or one for each, -1 to 1.
    - `temperatures`: the temperatures at the operating point, instead of a duty. A number is the
      mean of all channels, degC, reached with the same duty for all cells. A mapping has
      temperatures of channels, degC: of one channel, reached with the same duty for all cells; of
      as many channels as cells; or of more, which are approximated in the sense of least squares.
    - `ambient`: the temperature of the surroundings, degC; None for that of the rig, or of the run.
    - `inputs`: the rig's other inputs, name -> number or name of a state, such as
      `{"lid": "open"}`. Those that are not given have the value of the rig file. With a run they
      are those of the run.
    - `run`: a run of this rig, or a `ClosedLoopRun`, instead of duty and temperatures, for its
      state at a `time`. The duty of the operating point is the one that reaches the cells then,
      behind delay and lag.
    - `time`: the time of the run, s; temperatures are linear between two samples.

    **Returns:** a `StateSpace`, whose operating point has the duty and all temperatures.

    **Raises:** `ControlError` if not exactly one of duty, temperatures and run is given, if a time
    is given without a run or is outside of it, if they do not fit the rig, if no duty from -1 to 1
    reaches the temperatures, for an unknown input or state, or if no steady state is found;
    `ParameterError` if a parameter has several values, or if a resistance, a heat capacity, a lag
    or a delay is not above 0.
    """
    twin = nominal_twin("linearize: twin", twin, ControlError)
    given_points = {"duty": duty, "temperatures": temperatures, "run": run}
    chosen = [name for name, value in given_points.items() if value is not None]
    if len(chosen) != 1:
        raise ControlError(
            "linearize: expected one of duty, temperatures and run, got "
            f"{' and '.join(chosen) or 'none'}; for example duty=0.4"
        )
    if (run is None) != (time is None):
        raise ControlError(
            "linearize: expected a time beside a run, s, got "
            f"{'no time' if time is None else f'time {time!r} without a run'}"
        )
    if run is not None and inputs is not None:
        raise ControlError(f"linearize: inputs: expected none beside a run, got {inputs!r}")
    if not is_traced(twin):
        check_values(twin)
    target = None if temperatures is None else target_of(twin, temperatures)
    if ambient is not None:
        ambient = finite_number("linearize: ambient", ambient, ControlError)
    if run is not None:
        own = run if isinstance(run, Run) else run.run
        with own_settings():
            point = point_of_run(twin, own, time, ambient)
            return to_numpy(_model_in_motion(twin, point))
    with settings_for(twin, duty):
        given = None if duty is None else _duty(twin, duty)
        room = None if ambient is None else jnp.asarray(ambient)
        levels = None
        if inputs:
            levels = stated_levels("linearize", twin.rig.inputs, inputs, ControlError)
        model, reached, imbalance = to_numpy(model_at_rest(twin, given, target, room, levels))
    if not is_traced(imbalance) and not float(imbalance) <= REST_TOLERANCE:
        raise ControlError(
            f"linearize: {twin.rig.name}: expected a steady state, but the rig does not come to "
            "rest under this duty; take a smaller one"
        )
    if target is not None and not is_traced(reached):
        _check_reached(target, np.asarray(reached), np.asarray(model.operating_point.duty))
    return model


def _duty(twin: Twin, duty: ArrayLike | float | int) -> Array:
    cells = len(twin.netlist.cells)
    lowest = np.array(twin.rig.lowest_duty)
    heats = ", of heaters from 0 to 1" if lowest.max() == 0 else ""
    expected = f"linearize: duty: expected {cells} numbers from -1 to 1{heats}, or a single one"
    try:
        values: Any = duty if is_traced(duty) else np.asarray(duty)
    except ValueError:  # rows of different lengths
        values = np.array(None)
    if values.shape not in ((), (cells,)) or values.dtype.kind not in "iuf":
        raise ControlError(f"{expected}, got {duty!r}")
    if not is_traced(values) and not np.all((values >= lowest) & (values <= 1)):
        raise ControlError(f"{expected}, got {duty!r}")
    return jnp.broadcast_to(jnp.asarray(values, float), (cells,))


def _check_reached(
    target: Target, reached: Float[np.ndarray, " targets"], duty: Float[np.ndarray, " cells"]
) -> None:
    is_square = target.directions.shape[1] == len(target.temperatures)
    is_reached = np.abs(reached - target.temperatures).max() <= TEMPERATURE_TOLERANCE
    # A heater that is off may hold a temperature; any other end of the range is a duty that is cut.
    is_inside = (duty > target.lowest_duty).all() or (is_reached and duty.min() > -1)
    is_found = np.isfinite(reached).all() and (is_reached or not is_square)
    if is_found and is_inside and duty.max() < 1:
        return
    wanted, got, at = (
        ", ".join(f"{value:.4g}" for value in values)
        for values in (target.temperatures, reached, duty)
    )
    raise ControlError(
        "linearize: temperatures: expected some that duty cycles from -1 to 1 reach, got "
        f"{wanted} degC; the nearest found was {got} degC with duty {at}"
    )


@persistent_jit_unoptimised
def model_at_rest(
    twin: Twin,
    duty: Float[Array, " cells"] | None,
    target: Target | None,
    ambient: Float[Array, ""] | None,
    levels: Float[Array, " inputs"] | None = None,
) -> tuple[StateSpace, Float[Array, " targets"], Float[Array, ""]]:
    """Computes the model, the temperatures that were reached, and the relative heat flow that is
    left in the steady state."""
    system = _under(twin.system(), levels)
    reference = jnp.asarray(system.ambient_temperature)
    if ambient is not None:
        reference = jnp.asarray(ambient, reference.dtype) + ZERO_CELSIUS
    if duty is None:
        assert target is not None
        duty, reached, nodes = duty_for(system, target, reference)
    else:
        duty, reached = jnp.asarray(duty, reference.dtype), jnp.zeros(0, reference.dtype)
        nodes = system.steady_state(duty, reference)
    model, by_duty = _model(twin, system, nodes, duty, reference)
    flows = jnp.abs(system.conductance @ nodes).max() + jnp.abs(by_duty).max()
    imbalance = jnp.abs(system.heat_into_nodes(nodes, duty, reference)).max() / flows
    return model, reached, imbalance


@persistent_jit_unoptimised
def _model_in_motion(twin: Twin, point: PointOfRun) -> StateSpace:
    """The model at a state that is not at rest."""
    system = _under(twin.system(), point.levels)
    reference = jnp.asarray(point.ambient) + ZERO_CELSIUS
    nodes, duty = jnp.asarray(point.nodes) - point.ambient, jnp.asarray(point.duty)
    model, _ = _model(twin, system, nodes, duty, reference)
    rates = system.heat_into_nodes(nodes, duty, reference) / system.capacitance
    return eqx.tree_at(lambda m: m.offset, model, rates, is_leaf=lambda leaf: leaf is None)


def _under(system: System, levels: Float[Array | np.ndarray, " inputs"] | None) -> System:
    """The equations under the rig's other inputs; None for those of the rig file."""
    return system if levels is None else system.under(system.conditions(jnp.asarray(levels)))


def _model(
    twin: Twin,
    system: System,
    nodes: Float[Array, " nodes"],
    duty: Float[Array, " cells"],
    reference: Float[Array, ""],
) -> tuple[StateSpace, Float[Array, "nodes cells"]]:
    """Computes the model at a state, and the derivatives of the heat by the duty, W."""
    by_nodes, by_duty = slopes(system, nodes, duty, reference)
    zero = jnp.zeros((), reference.dtype)
    celsius = reference - ZERO_CELSIUS
    cells = tuple(cell.name for cell in twin.netlist.cells)
    states = tuple(node.name for node in twin.netlist.nodes)
    model = StateSpace(
        by_nodes / system.capacitance[:, None],
        by_duty / system.capacitance[:, None],
        jax.jacfwd(system.channel_temperatures)(nodes),
        jnp.zeros((system.gain.size, duty.size), reference.dtype),
        operating_point=OperatingPoint(
            duty,
            nodes + celsius,
            system.channel_temperatures(nodes) + celsius,
            celsius,
            cell_names=cells,
            node_names=states,
            channel_names=twin.channels,
            rig=twin.rig.name,
            elements=system.wiring.elements,
        ),
        state_names=states,
        input_names=cells,
        output_names=twin.channels,
        delay_s=zero if system.delay is None else system.delay,
        lag_s=zero if system.lag is None else system.lag,
        is_delayed=system.delay is not None,
        is_lagged=system.lag is not None,
        projection=jnp.eye(len(states), dtype=reference.dtype),
    )
    return model, by_duty
