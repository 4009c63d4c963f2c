"""A linear model in state space, in continuous or in discrete time."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float
from numpy.typing import ArrayLike

from ..._arguments import finite_number, of_kind, whole_number
from ..._display import picture
from ..._jax_settings import is_traced, settings_for, to_numpy
from ..._lapack import solve
from ..._name_suggestions import unknown_name
from ..._result import AbstractResult, dataset, table
from ...errors import ControlError
from ...simulation import checked_longest_delay
from ._balanced_truncation import Balanced, balanced, residualised
from ._frequency_response import Directions, directions, frequency_response, traced_response
from ._operating_point import OperatingPoint
from ._zero_order_hold import integrated_rates, zero_order_hold

if TYPE_CHECKING:
    import control
    import pandas
    import xarray
    from matplotlib.figure import Figure


# The most commands in transit that a discrete model has states for: each input has one for each,
# and matrices of thousands of states take minutes.
MAX_COMMANDS = 1000


@final
class StateSpace(eqx.Module, AbstractResult):
    r"""A linear model of deviations from an operating point.

    `linearize` makes one in continuous time:

    $$\dot x = A x + B v + b, \quad y = C x + D v, \quad \tau \dot v(t) = u(t - \theta) - v(t)$$

    $u$ is the commanded duty. The driver's delay $\theta$ and lag $\tau$ are not part of the
    matrices. `discretise` makes one at sample times, with delay and lag among its states:

    $$x_{k+1} = A x_k + B u_k + b, \quad y_k = C x_k + D u_k$$

    The methods `start`, `step`, `outputs` and `simulate` of a discrete model take and return duty
    cycles and temperatures themselves.

    ```python
    model = jt.linearize(jt.Twin("dual-cell"), duty=0.4).discretise(1.0)
    state = model.start()
    for _ in range(60):
        state = model.step(state, [0.5, 0.4])
    model.outputs(state, [0.5, 0.4])  # degC
    ```

    A model is a PyTree whose leaves are its numbers. It can pass through `jax.jit`, `jax.vmap` and
    `jax.grad`, where it has `dcgain`, `frequency_response`, `discretise`, and the methods of the
    discrete model; the others need numbers.

    **Arguments:** units are those in continuous time, and in brackets in discrete time.

    - `A` (1/s [1]), `B` (K/s [K] per unit of duty), `C` (K/K), `D` (K per unit of duty): the
      matrices.
    - `sample_time_s`: the sample time, s; None in continuous time.
    - `operating_point`: the point from which deviations are counted; None for zeros.
    - `state_names`, `input_names`, `output_names`: names; None for numbers.
    - `delay_s`, `lag_s`: delay and lag between the command and the duty that reaches the cells, s;
      0 for none, and in discrete time.
    - `offset`: $b$, by which the states change at the operating point, K/s [K a sample]; None for a
      point at rest. Frequency response, poles and margins do not depend on it.
    - `is_delayed`, `is_lagged`: whether the model has a delay, or a lag, which determines the
      number of states of a discrete model and must be known before tracing; None: yes if it is
      above 0 or traced by JAX.
    - `projection`: the matrix that gives the first states for deviations of the rig's node
      temperatures; the other states follow from the commands. None if it is not known.

    **Raises:** `ControlError` if shapes or names do not agree, a delay or a lag is negative, the
    sample time is not positive, or a discrete model has a delay or a lag.
    """

    A: Float[Array | np.ndarray, "state state"]
    B: Float[Array | np.ndarray, "state input"]
    C: Float[Array | np.ndarray, "output state"]
    D: Float[Array | np.ndarray, "output input"]
    operating_point: OperatingPoint
    delay_s: Float[Array | np.ndarray, ""]
    lag_s: Float[Array | np.ndarray, ""]
    offset: Float[Array | np.ndarray, " state"] | None
    projection: Float[Array | np.ndarray, "first node"] | None
    sample_time_s: float | None = eqx.field(static=True)
    state_names: tuple[str, ...] = eqx.field(static=True)
    input_names: tuple[str, ...] = eqx.field(static=True)
    output_names: tuple[str, ...] = eqx.field(static=True)
    is_delayed: bool = eqx.field(static=True)
    is_lagged: bool = eqx.field(static=True)

    def __init__(
        self,
        A: ArrayLike,
        B: ArrayLike,
        C: ArrayLike,
        D: ArrayLike,
        *,
        sample_time_s: float | None = None,
        operating_point: OperatingPoint | None = None,
        state_names: Sequence[str] | None = None,
        input_names: Sequence[str] | None = None,
        output_names: Sequence[str] | None = None,
        delay_s: ArrayLike | float | int = 0.0,
        lag_s: ArrayLike | float | int = 0.0,
        offset: ArrayLike | None = None,
        is_delayed: bool | None = None,
        is_lagged: bool | None = None,
        projection: Float[Array | np.ndarray, "first node"] | None = None,
    ):
        with settings_for(A, B, C, D, delay_s, lag_s):
            self.A, self.B, self.C, self.D, self.delay_s, self.lag_s = (
                _array(value)
                for value in (A, B, C, D, _time("delay_s", delay_s), _time("lag_s", lag_s))
            )
            states, inputs, outputs = _sizes(self.A, self.B, self.C, self.D)
            self.offset = None if offset is None else _offset(offset, states)
            self.operating_point = operating_point or OperatingPoint(
                np.zeros(inputs), np.zeros(states), np.zeros(outputs), np.zeros(())
            )
        _check_point(self.operating_point, inputs, outputs)
        self.sample_time_s = None
        if sample_time_s is not None:
            where = "StateSpace: sample_time_s"
            self.sample_time_s = finite_number(
                where, sample_time_s, ControlError, above=0, unit="s"
            )
        self.projection = projection
        self.state_names = _names("state_names", state_names, "x", states)
        self.input_names = _names("input_names", input_names, "u", inputs)
        self.output_names = _names("output_names", output_names, "y", outputs)
        self.is_delayed = _has("delay", delay_s, is_delayed)
        self.is_lagged = _has("lag", lag_s, is_lagged)
        if self.is_discrete and (self.is_delayed or self.is_lagged):
            raise ControlError(
                "StateSpace: delay_s, lag_s: expected 0 s with a sample time, as a discrete model "
                "has them among its states"
            )

    @property
    def is_discrete(self) -> bool:
        """Whether the model is one at sample times."""
        return self.sample_time_s is not None

    @property
    def nyquist_frequency(self) -> float:
        """Half the sample rate, above which the response repeats itself, rad/s; infinite in
        continuous time."""
        return np.inf if self.sample_time_s is None else np.pi / self.sample_time_s

    @property
    def steady_states(self) -> Float[Array | np.ndarray, "state input"]:
        """The steady change of the states, K per unit of duty.

        **Raises:** `ControlError` if the model has an integrator.
        """
        if is_traced(self):
            with settings_for(self):
                A, B = jnp.asarray(self.A), jnp.asarray(self.B)
                return solve(jnp.eye(len(A)) - A if self.is_discrete else -A, B)
        A, B = np.asarray(self.A), np.asarray(self.B)
        try:
            return np.linalg.solve(np.eye(len(A)) - A if self.is_discrete else -A, B)
        except np.linalg.LinAlgError:
            raise ControlError(
                "steady_states: expected a model that comes to rest under a constant duty, got an "
                "integrator"
            ) from None

    @property
    def dcgain(self) -> Float[Array | np.ndarray, "output input"]:
        """The DC gain: the steady change of the outputs, K per unit of duty.

        **Raises:** `ControlError` if the model has an integrator.
        """
        if is_traced(self):
            with settings_for(self):
                return self.D + self.C @ self.steady_states
        return np.asarray(self.D) + np.asarray(self.C) @ self.steady_states

    def discretise(
        self, sample_time_s: float | int, *, longest_delay: float | int | None = None
    ) -> "StateSpace":
        r"""Discretises the model under commands that are held between the sample times.

        The result is exact for any sample time, also if the delay is not a multiple of it. The lag
        adds a state for each input, the duty that reaches the cells. A delay $\theta = (n + r) T_s$
        adds the $n + 1$ commands that are in transit, or $n$ if $r = 0$. These states follow those
        of the model.

        **Arguments:**

        - `sample_time_s`: $T_s$, s.
        - `longest_delay`: the delay for which the model has states. None for its own delay. It
          must be given if the delay is traced by JAX.

        **Raises:** `ControlError` if the sample time is not positive or below a thousandth of the
        delay, if the delay is longer than `longest_delay`, or is traced and `longest_delay` is
        missing, or if the model is discrete.
        """
        self._check_continuous("discretise")
        where = "discretise: sample_time_s"
        sample_time = finite_number(where, sample_time_s, ControlError, above=0, unit="s")
        shifts = self._shifts(sample_time, longest_delay)
        with settings_for(self):
            time = jnp.asarray(sample_time, self.A.dtype)
            lag = self.lag_s if self.is_lagged else None
            matrices = self.A, self.B, self.C, self.D
            A, B, C, D = to_numpy(zero_order_hold(matrices, self.delay_s, lag, time, shifts))
            offset = None
            if self.offset is not None:
                moved = integrated_rates(jnp.asarray(self.A), jnp.asarray(self.offset), time)
                offset = jnp.pad(moved, (0, len(A) - len(moved)))
            lagged = [f"duty {name}" for name in self.input_names] if self.is_lagged else []
            waiting = [f"{name} {n + 1} ago" for n in range(shifts) for name in self.input_names]
            return StateSpace(
                A,
                B,
                C,
                D,
                sample_time_s=sample_time,
                operating_point=self.operating_point,
                state_names=(*self.state_names, *lagged, *waiting),
                input_names=self.input_names,
                output_names=self.output_names,
                offset=offset,
                projection=self.projection,
            )

    def at_rest(self) -> "StateSpace":
        """The same model about its own equilibrium under the duty of the operating point, which may
        differ from the equilibrium of the nonlinear twin. Its `offset` is None.

        Models for a design (`reduce`, `design_lqi`, `design_mpc`), for python-control and for
        `export_c` are about a rest.

        **Raises:** `ControlError` if the model is not stable, and so has no such point, or is
        discrete.
        """
        if self.offset is None:
            return self
        self._check_continuous("at_rest")
        if not np.all(np.real(self.poles) < 0):
            raise ControlError("at_rest: expected a stable model, got a pole that does not decay")
        moved = -np.linalg.solve(np.asarray(self.A), np.asarray(self.offset))
        point = self.operating_point
        rest = replace(
            point,
            nodes=np.asarray(point.nodes) + moved,
            outputs=np.asarray(point.outputs) + np.asarray(self.C) @ moved,
        )
        return replace(self, offset=None, operating_point=rest)

    def with_outputs(
        self, weights: Float[np.ndarray, "new output"], names: Sequence[str]
    ) -> "StateSpace":
        """The same model with other outputs, each a weighted sum of its own, such as a mean.

        **Arguments:**

        - `weights`: the weight of each output of the model in each new one.
        - `names`: the names of the new outputs.

        **Raises:** `ControlError` for another number of names.
        """
        point = self.operating_point
        outputs = replace(
            point,
            outputs=weights @ np.asarray(point.outputs),
            channel_names=tuple(names) if point.channel_names else (),
        )
        C, D = weights @ np.asarray(self.C), weights @ np.asarray(self.D)
        return replace(self, C=C, D=D, operating_point=outputs, output_names=tuple(names))

    def with_states_as_outputs(self, names: Sequence[str]) -> "StateSpace":
        """The same model with the temperatures of some states as further outputs, such as elements
        of the plate, which no channel reads alone.

        **Raises:** `ControlError` for an unknown state, or for a model whose states are not the
        temperatures of the rig, such as a discrete or a reduced one.
        """
        self._check_continuous("with_states_as_outputs")
        if self.operating_point.node_names not in ((), self.state_names):
            raise ControlError(
                "with_states_as_outputs: expected a model whose states are the temperatures of the "
                "rig, got a reduced one; call it before reduce"
            )
        for name in names:
            if name not in self.state_names:
                unknown = unknown_name("state", name, self.state_names)
                raise ControlError(f"with_states_as_outputs: {unknown}")
        rows = [self.state_names.index(name) for name in names]
        inputs, point = self.B.shape[1], self.operating_point
        more = np.eye(len(self.state_names))[rows], np.zeros((len(rows), inputs))
        C, D = (np.vstack([of, own]) for of, own in zip((self.C, self.D), more, strict=True))
        outputs = np.concatenate([point.outputs, np.asarray(point.nodes)[rows]])
        known = (*point.channel_names, *names) if point.channel_names else ()
        return replace(
            self,
            C=C,
            D=D,
            operating_point=replace(point, outputs=outputs, channel_names=known),
            output_names=(*self.output_names, *names),
        )

    def without_feedthrough(self) -> "StateSpace":
        """The same discrete model with the last command among its states, so that `D` is 0, unless
        it was 0 before.

        A model of reduced order has fast states that are always at rest: its outputs follow the
        command at once. A reading that is taken just before a new command still follows the last
        command, which is therefore a state.

        **Raises:** `ControlError` if the model is not discrete.
        """
        self._check_discrete("without_feedthrough")
        A, B, C, D = (np.asarray(matrix) for matrix in (self.A, self.B, self.C, self.D))
        if not D.any():
            return self
        states, inputs = B.shape
        return replace(
            self,
            A=np.block([[A, np.zeros((states, inputs))], [np.zeros((inputs, states + inputs))]]),
            B=np.vstack([B, np.eye(inputs)]),
            C=np.hstack([C, D]),
            D=np.zeros_like(D),
            state_names=(*self.state_names, *(f"last {name}" for name in self.input_names)),
        )

    def frequency_response(
        self, omega: ArrayLike | float | int
    ) -> Complex[Array | np.ndarray, "*frequency output input"]:
        r"""The frequency response with exact delay and lag, K per unit of duty: $G(j \omega)$, or
        $G(e^{j \omega T_s})$ in discrete time.

        **Arguments:**

        - `omega`: one or several frequencies, rad/s.
        """
        if is_traced(self, omega):
            with settings_for(self, omega):
                frequencies = jnp.asarray(omega, float)
                response = traced_response(self, frequencies.reshape(-1))
        else:
            frequencies = np.asarray(omega, float)
            response = frequency_response(self, frequencies.reshape(-1))
        return response.reshape(*frequencies.shape, *response.shape[1:])

    @property
    def poles(self) -> Complex[np.ndarray, " state"]:
        """The eigenvalues of `A`, slowest first: 1/s in continuous time, where the pole of the lag
        is at `-1 / lag_s`, without unit in discrete time."""
        poles = np.linalg.eigvals(np.asarray(self.A)).astype(complex)
        return poles[np.argsort(self._decay_rates(poles))]

    @property
    def time_constants_s(self) -> Float[np.ndarray, " state"]:
        """The reciprocals of the decay rates of the poles, s, slowest first; infinite for poles
        that do not decay."""
        decay = np.maximum(self._decay_rates(self.poles), 0.0)
        return np.divide(1.0, decay, out=np.full(decay.shape, np.inf), where=decay > 0)

    @property
    def relative_gain_array(self) -> Float[np.ndarray, "output input"]:
        r"""$G \circ (G^+)^T$ of the DC gain (Bristol 1966). It shows by which channel each
        cell is best controlled, if each has its own loop. The rows sum to 1, or with more channels
        than cells the columns."""
        gain = np.asarray(self.dcgain)
        return gain * np.linalg.pinv(gain).T

    @property
    def directions(self) -> Directions:
        """The directions in which the duty moves the channels at rest: see `Directions`."""
        return directions(np.asarray(self.dcgain))

    @property
    def hankel_singular_values(self) -> Float[np.ndarray, " kept"]:
        """The Hankel singular values, largest first: the importance of each balanced state between
        inputs and outputs.

        Values that are rounding are left out.

        **Raises:** `ControlError` if the model is not stable, or is discrete.
        """
        return self._balanced().hankel

    def error_bound(self, order: int) -> float:
        """A bound on the error of the frequency response of `reduce(order)` at any frequency, K per
        unit of duty (the largest singular value of the difference)."""
        order = whole_number("error_bound: order", order, 0, ControlError)
        return 2 * float(self.hankel_singular_values[order:].sum())

    def reduce(self, order: int) -> "StateSpace":
        """Reduces a continuous model by balanced truncation, with the same DC gain.

        The states that matter least are assumed to be always at rest; their contribution becomes
        part of `D`. Delay, lag and operating point do not change.

        **Arguments:**

        - `order`: the number of states that are kept.

        **Raises:** `ControlError` if the model is not stable, is about a point that is not at rest,
        has fewer states that an input moves and the outputs show, or is discrete.
        """
        order = whole_number("reduce: order", order, 1, ControlError)
        check_at_rest("reduce", self)
        balanced = self._balanced()
        if order > len(balanced.hankel):
            raise ControlError(
                f"reduce: order: expected at most the {len(balanced.hankel)} states that a drive "
                f"moves and the outputs show, got {order}"
            )
        A, B, C, D = residualised(balanced, order)
        whole = self.projection
        # The states that were left out as rounding had a gain too.
        D = D + np.asarray(self.dcgain) - (D - C @ np.linalg.solve(A, B))
        return replace(
            self,
            A=A,
            B=B,
            C=C,
            D=D,
            state_names=[f"balanced {number + 1}" for number in range(order)],
            projection=None if whole is None else balanced.into[:order] @ whole,
        )

    def start(
        self, duty: ArrayLike | float | int | None = None
    ) -> Float[Array | np.ndarray, " state"]:
        """The steady state of a discrete model under a constant duty cycle; None for the operating
        point.

        **Arguments:**

        - `duty`: a value for each input, or a single value for all.
        """
        self._check_discrete("start")
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
        """The state of a discrete model one sample time later, under a command that is held until
        then.

        **Raises:** `ControlError` if the command does not fit the inputs of the model.
        """
        self._check_discrete("step")
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
        """Simulates a discrete model under a sequence of commands, and returns the outputs at the
        beginning of each step, degC.

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

    def to_control(self, *, pade_order: int | None = None) -> "control.StateSpace":
        """Converts the model to python-control (extra `control`), with the lag among its states.

        A continuous model of python-control has no delay. It is replaced by Padé's approximation if
        an order is given. `discretise(...).to_control()` contains it exactly.

        **Arguments:**

        - `pade_order`: the order of the approximation, at least 1.

        **Raises:** `ControlError` if the model has a delay and no order is given, if it is about a
        point that is not at rest, or if python-control is not installed.
        """
        check_at_rest("to_control", self)
        control = _python_control()
        if pade_order is not None:
            whole_number("to_control: pade_order", pade_order, 1, ControlError)
        if self.is_delayed and pade_order is None:
            raise ControlError(
                f"to_control: expected pade_order, because the driver's delay of "
                f"{float(self.delay_s):.3g} s cannot be in a StateSpace, got None; or take "
                "model.discretise(...).to_control(), which has it exactly"
            )
        time = () if self.sample_time_s is None else (self.sample_time_s,)
        system = control.ss(self.A, self.B, self.C, self.D, *time)
        states, inputs = list(self.state_names), len(self.input_names)
        unit, zero = np.eye(inputs), np.zeros((inputs, inputs))
        if self.is_lagged:
            system = system * control.ss(-unit / self.lag_s, unit / self.lag_s, unit, zero)
            states += [f"duty {name}" for name in self.input_names]
        if self.is_delayed:
            late = control.ss(control.tf(*control.pade(float(self.delay_s), pade_order)))
            system = system * control.append(*[late] * inputs)
            order = range(late.nstates)
            states += [f"delay {name} {n + 1}" for name in self.input_names for n in order]
        return control.ss(
            system.A,
            system.B,
            system.C,
            system.D,
            *time,
            states=states,
            inputs=list(self.input_names),
            outputs=list(self.output_names),
        )

    def to_xarray(self) -> "xarray.Dataset":
        """The matrices `A`, `B`, `C` and `D` as a dataset with names; delay and lag, or the sample
        time, are attributes, s.

        The columns of `A` and `C` have the dimension `from_state`.
        """
        of_rates = ("1/s", "K/s") if self.sample_time_s is None else ("1", "K")
        times = {"delay_s": float(self.delay_s), "lag_s": float(self.lag_s)}
        return dataset(
            {
                "A": ("state from_state", self.A, of_rates[0]),
                "B": ("state input", self.B, of_rates[1]),
                "C": ("output from_state", self.C, "1"),
                "D": ("output input", self.D, "K"),
            },
            times if self.sample_time_s is None else {"sample_time_s": self.sample_time_s},
            state=self.state_names,
            from_state=self.state_names,
            input=self.input_names,
            output=self.output_names,
        )

    def to_dataframe(self) -> "pandas.DataFrame":
        """The DC gain as a table, K per unit of duty: a row for each output, a column for each
        input."""
        gains = dict(zip(self.input_names, np.asarray(self.dcgain).T, strict=True))
        return table({"output": self.output_names, **gains}, "output").rename_axis(columns="input")

    def plot(self) -> "Figure":
        """Plots the Bode diagram: `jaxtwin.plots.plot_bode`."""
        return picture("plot_bode", self)

    def _balanced(self) -> Balanced:
        self._check_continuous("reduce, hankel_singular_values")
        return balanced(np.asarray(self.A), np.asarray(self.B), np.asarray(self.C))

    def _decay_rates(self, poles: Complex[np.ndarray, " state"]) -> Float[np.ndarray, " state"]:
        """The rates at which the modes of poles decay, 1/s."""
        if self.sample_time_s is None:
            return -np.real(poles)
        with np.errstate(divide="ignore"):  # a pole at 0 decays at once
            return -np.log(np.abs(poles)) / self.sample_time_s

    def _shifts(self, sample_time: float, longest_delay: float | int | None) -> int:
        """The number of commands that can be in transit."""
        if not self.is_delayed:
            return 0
        longest = checked_longest_delay(
            "discretise: longest_delay", longest_delay, self.delay_s, ControlError
        )
        if longest > MAX_COMMANDS * sample_time * (1 + 1e-9):
            raise ControlError(
                f"discretise: sample_time_s: expected at least {longest / MAX_COMMANDS:g} s, as "
                f"a delay of {longest:g} s has a state for each of at most {MAX_COMMANDS} "
                f"commands, got {sample_time:g}; is it in another unit?"
            )
        # Rounding must not make n + 1 commands of a delay of n steps.
        return int(np.ceil(longest / sample_time * (1 - 1e-9)))

    def _change(self, duty: ArrayLike | float | int) -> Float[Array | np.ndarray, " input"]:
        """A command as a deviation from the operating point."""
        command = jnp.asarray(duty) if is_traced(duty) else np.asarray(duty, float)
        inputs = len(self.input_names)
        if command.shape not in ((), (inputs,)):
            raise ControlError(
                f"StateSpace: duty: expected {inputs} numbers, or a single one, got an array "
                f"of shape {command.shape}"
            )
        return command - self.operating_point.duty

    def _check_continuous(self, where: str) -> None:
        if self.is_discrete:
            raise ControlError(
                f"{where}: expected a model in continuous time, got one with a sample time of "
                f"{self.sample_time_s:g} s; call it before discretise"
            )

    def _check_discrete(self, where: str) -> None:
        if not self.is_discrete:
            raise ControlError(
                f"{where}: expected a discrete model, such as linearize(...).discretise(1.0), got "
                "one in continuous time"
            )

    def __repr__(self) -> str:
        (outputs, states), inputs = self.C.shape[-2:], self.B.shape[-1]  # after one for draws
        times = f"delay {_text(self.delay_s)}, lag {_text(self.lag_s)}"
        if self.sample_time_s is not None:
            times = f"sample time {self.sample_time_s:g} s"
        return f"<StateSpace of {states} states, {inputs} inputs, {outputs} outputs, {times}>"

    def _overview(self) -> "pandas.DataFrame":
        try:
            gains = self.to_dataframe()
        except ControlError:  # of an integrator
            gains = table({"output": self.output_names}, "output")
        return gains.rename_axis("DC gain, K per unit of duty")


def check_at_rest(where: str, model: StateSpace) -> None:
    """Refuses a model that changes by itself at its operating point.

    **Raises:** `ControlError`.
    """
    if model.offset is not None:
        raise ControlError(
            f"{where}: expected a model about a rest, got one about a state of a run; take "
            "StateSpace.at_rest() first, before discretise"
        )


def checked_discrete_model(
    where: str,
    model: Any,
    expected: str = "a discrete model, such as linearize(...).reduce(4).discretise(1.0)",
) -> StateSpace:
    """A model as controllers and C are made from it: discrete, about a rest, and with numbers.

    **Raises:** `ControlError` if it is not; `expected` says what is allowed.
    """
    of_kind(where, model, StateSpace, expected, ControlError)
    if not model.is_discrete:
        raise ControlError(f"{where}: expected {expected}, got {model!r}")
    if is_traced(model):
        raise ControlError(
            f"{where}: expected numbers, got values that JAX traces; design outside of jax.jit, "
            "jax.vmap and jax.grad"
        )
    check_at_rest(where, model)
    return model


@jax.jit
def _outputs(model: StateSpace, start: Array, commands: Array) -> Array:
    def step(state: Array, duty: Array) -> tuple[Array, Array]:
        after, read = model.step(state, duty), model.outputs(state, duty)
        return jnp.asarray(after), jnp.asarray(read)

    return jax.lax.scan(step, start, commands)[1]


def _python_control() -> Any:
    try:
        import control
    except ImportError:
        raise ControlError(
            "to_control: expected python-control, which is not installed; pip install "
            "'jaxtwin[control]'"
        ) from None
    return control


def _array(value: Any) -> Any:
    # Not by way of JAX where nothing is traced: that takes ten times as long.
    return jnp.asarray(value, float) if is_traced(value) else np.asarray(value, float)


def _time(name: str, value: object) -> Any:
    if is_traced(value):
        return value
    return finite_number(f"StateSpace: {name}", value, ControlError, least=0, unit="s")


def _offset(offset: ArrayLike, states: int) -> Any:
    array = _array(offset)
    if array.shape != (states,):
        raise ControlError(
            f"StateSpace: offset: expected {states} numbers, got an array of shape {array.shape}"
        )
    return array


def _has(what: str, seconds: Any, given: bool | None) -> bool:
    """Whether a model has a delay, or a lag, as it was given; None for what its time says."""
    if given is None or is_traced(seconds):
        return is_traced(seconds) or float(seconds) > 0 if given is None else given
    # A delay of 0 s may have states for a longer one; a lag of 0 s has no rate.
    if given == (float(seconds) > 0) or (given and what == "delay"):
        return given
    raise ControlError(
        f"StateSpace: {what}_s: expected {'a time above 0 s' if given else '0 s'}, as the model is "
        f"said to have {'one' if given else 'none'}, got {float(seconds):g} s"
    )


def _text(time: Any) -> str:
    return "traced" if is_traced(time) else f"{float(time):.3g} s"


def _sizes(*matrices: Array | np.ndarray) -> tuple[int, int, int]:
    shapes = [matrix.shape for matrix in matrices]
    if all(len(shape) == 2 for shape in shapes):
        states, inputs, outputs = shapes[0][0], shapes[1][1], shapes[2][0]
        fit = [(states, states), (states, inputs), (outputs, states), (outputs, inputs)]
        if shapes == fit:
            return states, inputs, outputs
    raise ControlError(
        "StateSpace: expected A (state, state), B (state, input), C (output, state) and "
        f"D (output, input), got shapes {', '.join(map(str, shapes))}"
    )


def _check_point(point: OperatingPoint, inputs: int, outputs: int) -> None:
    of_kind("StateSpace: operating_point", point, OperatingPoint, "one of a rig", ControlError)
    for name, values, count in (("duty", point.duty, inputs), ("outputs", point.outputs, outputs)):
        if np.shape(values) != (count,):
            raise ControlError(
                f"StateSpace: operating_point: {name}: expected {count} numbers, got an array of "
                f"shape {np.shape(values)}"
            )


def _names(what: str, names: Sequence[str] | None, letter: str, count: int) -> tuple[str, ...]:
    if names is None:
        return tuple(f"{letter}{number}" for number in range(1, count + 1))
    if isinstance(names, str) or len(names) != count:
        got = repr(names) if isinstance(names, str) else len(names)
        raise ControlError(f"StateSpace: {what}: expected {count} names, got {got}")
    return tuple(names)
