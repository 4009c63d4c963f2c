"""A linear model in discrete time, and how it follows from one in continuous time."""

from typing import TYPE_CHECKING, Any, TypeAlias, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from ..._compilation import persistent_jit_unoptimised
from ..._jax_settings import is_traced, settings_for, to_numpy
from ..._lapack import solve
from ...errors import ControlError
from ._operating_point import OperatingPoint

if TYPE_CHECKING:
    import control

    from ._linear_model import LinearModel


def continuous(model: "LinearModel", pade_order: int | None) -> Any:
    """Converts a continuous model to a `control.StateSpace` with the lag among its states."""
    control = _library()
    if model.is_delayed and pade_order is None:
        raise ControlError(
            f"to_control: expected pade_order, because the driver's delay of "
            f"{float(model.delay_s):.3g} s cannot be in a StateSpace, got None; or take "
            "model.discretise(...).to_control(), which has it exactly"
        )
    names = {"inputs": list(model.input_names), "outputs": list(model.output_names)}
    states = list(model.state_names)
    system = control.ss(model.A, model.B, model.C, model.D)
    inputs = len(model.input_names)
    unit, zero = np.eye(inputs), np.zeros((inputs, inputs))
    if model.is_lagged:
        system = control.ss(-unit / model.lag_s, unit / model.lag_s, unit, zero)
        system = control.ss(model.A, model.B, model.C, model.D) * system
        states = states + [f"duty {name}" for name in model.input_names]
    if model.is_delayed:
        late = control.ss(control.tf(*control.pade(float(model.delay_s), pade_order)))
        order = late.nstates
        system = system * control.append(*[late] * inputs)
        states = states + [
            f"delay {name} {n + 1}" for name in names["inputs"] for n in range(order)
        ]
    return control.ss(system.A, system.B, system.C, system.D, states=states, **names)


def discrete(model: "DiscreteModel") -> Any:
    """Converts a discrete model to a discrete `control.StateSpace`."""
    return _library().ss(
        model.A,
        model.B,
        model.C,
        model.D,
        model.sample_time_s,
        states=list(model.state_names),
        inputs=list(model.input_names),
        outputs=list(model.output_names),
    )


def _library() -> Any:
    try:
        import control
    except ImportError:
        raise ControlError(
            "to_control: expected python-control, which is not installed; pip install "
            "'jaxtwin[control]'"
        ) from None
    return control


@final
class DiscreteModel(eqx.Module):
    r"""A linear model at sample times, made by `LinearModel.discretise`.

    $$x_{k+1} = A x_k + B u_k + b, \quad y_k = C x_k + D u_k$$

    All three are deviations from the operating point. The methods take and return duty cycles and
    temperatures themselves.

    ```python
    model = jt.linearize(jt.Twin("dual-cell"), duty=0.4).discretise(1.0)
    state = model.start()
    for _ in range(60):
        state = model.step(state, [0.5, 0.4])
    model.outputs(state, [0.5, 0.4])  # degC
    ```

    **Arguments:**

    - `A`, `B`, `C`, `D`: the matrices, in K and units of duty.
    - `operating_point`: the point from which deviations are counted.
    - `sample_time_s`: the sample time, s.
    - `state_names`, `input_names`, `output_names`: names of states, inputs and outputs.
    - `offset`: $b$, the change of the states in a sample at the operating point, K; None at rest.
    - `projection`: the first states by the deviations of the rig's nodes; the others follow from
      the commands. None if they are not known.
    """

    A: Float[Array | np.ndarray, "state state"]
    B: Float[Array | np.ndarray, "state input"]
    C: Float[Array | np.ndarray, "output state"]
    D: Float[Array | np.ndarray, "output input"]
    operating_point: OperatingPoint
    sample_time_s: float = eqx.field(static=True)
    state_names: tuple[str, ...] = eqx.field(static=True)
    input_names: tuple[str, ...] = eqx.field(static=True)
    output_names: tuple[str, ...] = eqx.field(static=True)
    offset: Float[Array | np.ndarray, " state"] | None = None
    projection: Float[Array | np.ndarray, "first node"] | None = None

    def start(
        self, duty: ArrayLike | float | int | None = None
    ) -> Float[Array | np.ndarray, " state"]:
        """The steady state under a constant duty cycle; None for the operating point.

        **Arguments:**

        - `duty`: a value for each input, or a single value for all.
        """
        with settings_for(self, duty):
            A = jnp.asarray(self.A)
            if duty is None:
                return to_numpy(jnp.zeros(len(A), A.dtype))
            moved = jnp.asarray(self.B) @ self._change(duty)
            if self.offset is not None:
                moved = moved + self.offset
            return to_numpy(solve(jnp.eye(len(A)) - A, moved))

    def step(
        self, state: Float[Array | np.ndarray, " state"], duty: ArrayLike | float | int
    ) -> Float[Array | np.ndarray, " state"]:
        """The state one sample time later, under a command that is held until then.

        **Raises:** `ControlError` if the command does not fit the inputs of the model.
        """
        with settings_for(self, state, duty):
            later = self.A @ state + self.B @ self._change(duty)
            return to_numpy(later if self.offset is None else later + self.offset)

    def outputs(
        self, state: Float[Array | np.ndarray, " state"], duty: ArrayLike | float | int
    ) -> Float[Array | np.ndarray, " output"]:
        """The readings of the channels, degC, if a command is given at that moment.

        The command matters only if `D` is not 0, as in models of reduced order.
        """
        with settings_for(self, state, duty):
            change = self.C @ state + self.D @ self._change(duty)
            return to_numpy(self.operating_point.outputs + change)

    def simulate(
        self, duty: ArrayLike, start: Float[Array | np.ndarray, " state"] | None = None
    ) -> Float[Array | np.ndarray, "steps output"]:
        """Simulates a sequence of commands, and returns the outputs at the beginning of each step,
        degC.

        **Arguments:**

        - `duty`: the commands, `(steps, inputs)`.
        - `start`: the state at the first step; None for the operating point.
        """
        with settings_for(self, duty, start):
            state = self.start() if start is None else start
            if is_traced(self, duty, state):
                return _outputs(self, jnp.asarray(state), jnp.asarray(duty, self.A.dtype))
            rows = []
            for command in np.asarray(duty, float):
                rows.append(self.outputs(state, command))
                state = self.step(state, command)
            return np.array(rows).reshape(len(rows), len(self.output_names))

    def to_control(self) -> "control.StateSpace":
        """Converts the model to python-control (extra `control`), exact with lag and delay.

        **Raises:** `ControlError` if python-control is not installed, or if the model is about a
        point that is not at rest.
        """
        check_at_rest("to_control", self.offset)
        return discrete(self)

    def _change(self, duty: ArrayLike | float | int) -> Float[Array | np.ndarray, " input"]:
        """A command as a deviation from the operating point."""
        command = jnp.asarray(duty) if is_traced(duty) else np.asarray(duty, float)
        inputs = len(self.input_names)
        if command.shape not in ((), (inputs,)):
            raise ControlError(
                f"DiscreteModel: duty: expected {inputs} numbers, or a single one, got an array "
                f"of shape {command.shape}"
            )
        return command - self.operating_point.duty

    def __repr__(self) -> str:
        outputs, states = self.C.shape
        return (
            f"<DiscreteModel: {states} states, {self.B.shape[1]} inputs, {outputs} outputs, "
            f"sample time {self.sample_time_s:g} s>"
        )


def check_at_rest(where: str, change: object) -> None:
    """Refuses a model that changes by itself at its operating point.

    **Arguments:**

    - `change`: its `rates` or `offset`.

    **Raises:** `ControlError`.
    """
    if change is not None:
        raise ControlError(
            f"{where}: expected a model about a rest, got one about a state of a run; take "
            "LinearModel.at_rest() first"
        )


@jax.jit
def _outputs(model: DiscreteModel, start: Array, commands: Array) -> Array:
    def step(state: Array, duty: Array) -> tuple[Array, Array]:
        after, read = model.step(state, duty), model.outputs(state, duty)
        return jnp.asarray(after), jnp.asarray(read)

    return jax.lax.scan(step, start, commands)[1]


# Discretises a linear model under held commands, exactly with lag and delay.
#
# The duty that reaches the cells is a state $v$ behind those of the model. While the same command
# $u$ arrives, the states $z$ change by
#
# $$z(t + h) = e^{F h} z(t) + \int_0^h e^{F s} ds\, H u$$
#
# With a delay of $(n + r) T_s$, $0 \le r < 1$, the command of $n + 1$ steps ago arrives for the
# first $r T_s$ of a step, and that of $n$ steps ago for the rest.

Matrices: TypeAlias = tuple[Any, Any, Any, Any]

# Parts of a step below this are set to 0, so that a delay of n steps is a delay of n steps after
# rounding.
ROUNDING = 1e-9

# The number of terms of the series of a matrix exponential: for a norm of at most a half, the
# remainder is below 1e-21.
SERIES_TERMS = 18

# The largest number of squarings of a matrix exponential.
SQUARINGS = 40


@persistent_jit_unoptimised
def zero_order_hold(
    matrices: Matrices,
    delay: Float[Array | np.ndarray, ""],
    lag: Float[Array | np.ndarray, ""] | None,
    sample_time: Float[Array, ""],
    shifts: int,
) -> Matrices:
    """A, B, C and D of the discrete model, with states for the given number of commands in transit.

    **Arguments:**

    - `matrices`: A, B, C and D of the model.
    - `delay`, `lag`, `sample_time`: s.
    """
    F, H, output, direct = _lagged(matrices, lag)
    states, inputs = H.shape
    # Steps of the delay; the command of `whole` steps ago arrives after the rest.
    late = delay / sample_time if shifts else jnp.zeros((), F.dtype)
    whole = jnp.floor(late + ROUNDING)
    rest = jnp.maximum(late - whole, 0.0)
    rest = jnp.where(rest < ROUNDING, 0.0, rest) * sample_time
    A = matrix_exponential(F * sample_time)
    late_part, late_input = _moved(F, H, sample_time - rest)
    _, early_input = _moved(F, H, rest)
    early_input = late_part @ early_input
    # How much of each command, from the newest on, arrives during a step.
    age = jnp.arange(shifts + 1)
    by_age = (age == whole)[:, None, None] * late_input
    by_age += (age == whole + 1)[:, None, None] * early_input
    # What arrives at the sample time itself.
    arrived = (age == whole + (rest > 0))[:, None, None] * direct
    waiting = shifts * inputs
    top = jnp.concatenate([A, *by_age[1:]], axis=1)
    shift = jnp.eye(waiting, waiting, -inputs, dtype=F.dtype)
    bottom = jnp.concatenate([jnp.zeros((waiting, states), F.dtype), shift], axis=1)
    newest = jnp.eye(waiting, inputs, dtype=F.dtype)
    return (
        jnp.concatenate([top, bottom]),
        jnp.concatenate([by_age[0], newest]),
        jnp.concatenate([output, *arrived[1:]], axis=1),
        arrived[0],
    )


@persistent_jit_unoptimised
def integrated_rates(
    A: Float[Array, "state state"], rates: Float[Array, " state"], sample_time: Float[Array, ""]
) -> Float[Array, " state"]:
    """Computes the change of the states in a sample by a constant rate, K/s, K."""
    _, moved = _moved(A, rates[:, None], sample_time)
    return moved[:, 0]


def _lagged(matrices: Matrices, lag: Float[Array | np.ndarray, ""] | None) -> Matrices:
    """The model with the duty that reaches the cells among its states, if it lags."""
    A, B, C, D = (jnp.asarray(matrix) for matrix in matrices)
    if lag is None:
        return A, B, C, D
    states, inputs = B.shape
    follow = jnp.eye(inputs, dtype=A.dtype) / lag
    F = jnp.block([[A, B], [jnp.zeros((inputs, states)), -follow]])
    H = jnp.concatenate([jnp.zeros((states, inputs)), follow])
    return F, H, jnp.concatenate([C, D], axis=1), jnp.zeros_like(D)


def _moved(F: Array, H: Array, time: Array) -> tuple[Array, Array]:
    """The transition matrix of a time, and the effect of a command that is held for that time."""
    states, inputs = H.shape
    both = jnp.block([[F, H], [jnp.zeros((inputs, states + inputs))]])
    moved = matrix_exponential(both * time)
    return moved[:states, :states], moved[:states, states:]


def matrix_exponential(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """The exponential of a matrix: the Taylor series of the scaled matrix, squared repeatedly.

    LAPACK is not used, because draws are computed in several threads: see `_lapack`.
    """
    unit = jnp.eye(len(matrix), dtype=matrix.dtype)
    norm = jax.lax.stop_gradient(jnp.abs(matrix).sum(axis=0).max())
    halvings = jnp.clip(jnp.ceil(jnp.log2(jnp.maximum(norm, 1e-30))) + 1, 0, SQUARINGS)
    scaled = matrix / 2**halvings
    series = unit
    for term in range(SERIES_TERMS, 0, -1):
        series = unit + scaled @ series / term

    def square(power: Array, number: Array) -> tuple[Array, None]:
        return jnp.where(number < halvings, power @ power, power), None

    return jax.lax.scan(square, series, jnp.arange(SQUARINGS))[0]
