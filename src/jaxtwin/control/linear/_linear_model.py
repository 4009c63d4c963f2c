"""A linear model of a twin near an operating point."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float
from numpy.typing import ArrayLike

from ..._arguments import finite_number, whole_number
from ..._display import picture
from ..._jax_settings import is_traced, settings_for, to_numpy
from ..._lapack import solve
from ..._name_suggestions import unknown_name
from ..._result import AbstractResult, dataset, table
from ...errors import ControlError
from ...simulation import checked_longest_delay
from ._balanced_truncation import Balanced, balanced, residualised
from ._discrete_model import (
    DiscreteModel,
    check_at_rest,
    continuous,
    integrated_rates,
    zero_order_hold,
)
from ._frequency_response import Directions, directions, frequency_response, traced_response
from ._operating_point import OperatingPoint

if TYPE_CHECKING:
    import control
    import pandas
    import xarray
    from matplotlib.figure import Figure


# The most commands in transit that a discrete model has states for: each input has one for each,
# and matrices of thousands of states take minutes.
MAX_COMMANDS = 1000


@final
class LinearModel(eqx.Module, AbstractResult):
    r"""A linear model of deviations from an operating point, made by `linearize`.

    $$\dot x = r + A x + B v, \quad y = C x + D v$$

    $$\tau \dot v(t) = u(t - \theta) - v(t)$$

    $u$ is the commanded duty. The driver's delay $\theta$ and lag $\tau$ are not part of the
    matrices.

    A model is a PyTree whose leaves are its numbers. It can pass through `jax.jit`, `jax.vmap` and
    `jax.grad`.

    **Arguments:**

    - `A` (1/s), `B` (K/s per unit of duty), `C` (K/K), `D` (K per unit of duty): the matrices.
    - `operating_point`: the point from which deviations are counted; None for zeros.
    - `state_names`, `input_names`, `output_names`: names; None for numbers.
    - `delay_s`, `lag_s`: delay and lag between the command and the duty that reaches the cells, s;
      0 for none.
    - `rates`: $r$, the rates of change of the states at the operating point, K/s; None for a point
      at rest. Frequency response, poles and margins do not depend on it.
    - `is_delayed`, `is_lagged`: whether there are any, which determines the number of states of a
      discrete model. None: yes if they are positive or traced by JAX.
    - `projection`: the matrix that gives the states for deviations of the rig's node temperatures;
      None if the states are these deviations, or do not follow from them.

    **Raises:** `ControlError` if shapes or names do not agree, or if a delay or a lag is negative.
    """

    A: Float[Array | np.ndarray, "state state"]
    B: Float[Array | np.ndarray, "state input"]
    C: Float[Array | np.ndarray, "output state"]
    D: Float[Array | np.ndarray, "output input"]
    operating_point: OperatingPoint
    delay_s: Float[Array | np.ndarray, ""]
    lag_s: Float[Array | np.ndarray, ""]
    rates: Float[Array | np.ndarray, " state"] | None
    projection: Float[Array | np.ndarray, "state node"] | None
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
        operating_point: OperatingPoint | None = None,
        state_names: Sequence[str] | None = None,
        input_names: Sequence[str] | None = None,
        output_names: Sequence[str] | None = None,
        delay_s: ArrayLike | float | int = 0.0,
        lag_s: ArrayLike | float | int = 0.0,
        rates: ArrayLike | None = None,
        is_delayed: bool | None = None,
        is_lagged: bool | None = None,
        projection: Float[Array | np.ndarray, "state node"] | None = None,
    ):
        with settings_for(A, B, C, D, delay_s, lag_s):
            self.A, self.B, self.C, self.D, self.delay_s, self.lag_s = (
                to_numpy(jnp.asarray(value, float))
                for value in (A, B, C, D, _time("delay_s", delay_s), _time("lag_s", lag_s))
            )
            states, inputs, outputs = _sizes(self.A, self.B, self.C, self.D)
            self.rates = None if rates is None else _rates(rates, states)
            self.operating_point = operating_point or OperatingPoint(
                np.zeros(inputs), np.zeros(states), np.zeros(outputs), np.zeros(())
            )
        self.projection = projection
        self.state_names = _names("state_names", state_names, "x", states)
        self.input_names = _names("input_names", input_names, "u", inputs)
        self.output_names = _names("output_names", output_names, "y", outputs)
        self.is_delayed = _is_there(delay_s) if is_delayed is None else is_delayed
        self.is_lagged = _is_there(lag_s) if is_lagged is None else is_lagged

    @property
    def dcgain(self) -> Float[Array | np.ndarray, "output input"]:
        """The DC gain: the steady change of the outputs, K per unit of duty."""
        with settings_for(self):
            return to_numpy(self.D - self.C @ solve(jnp.asarray(self.A), jnp.asarray(self.B)))

    def discretise(
        self, sample_time_s: float | int, *, longest_delay: float | int | None = None
    ) -> DiscreteModel:
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
        delay, or if the delay is longer than `longest_delay`, or is traced and `longest_delay` is
        missing.
        """
        sample_time = finite_number("discretise: sample_time_s", sample_time_s, ControlError)
        if sample_time <= 0:
            raise ControlError(
                f"discretise: sample_time_s: expected a number above 0, in s, got {sample_time:g}"
            )
        shifts = self._shifts(sample_time, longest_delay)
        with settings_for(self):
            time = jnp.asarray(sample_time, self.A.dtype)
            lag = self.lag_s if self.is_lagged else None
            matrices = self.A, self.B, self.C, self.D
            A, B, C, D = to_numpy(zero_order_hold(matrices, self.delay_s, lag, time, shifts))
            offset = None
            if self.rates is not None:
                moved = integrated_rates(jnp.asarray(self.A), jnp.asarray(self.rates), time)
                offset = to_numpy(jnp.pad(moved, (0, len(A) - len(moved))))
        lagged = [f"duty {name}" for name in self.input_names] if self.is_lagged else []
        waiting = [f"{name} {n + 1} ago" for n in range(shifts) for name in self.input_names]
        return DiscreteModel(
            A,
            B,
            C,
            D,
            operating_point=self.operating_point,
            sample_time_s=sample_time,
            state_names=(*self.state_names, *lagged, *waiting),
            input_names=self.input_names,
            output_names=self.output_names,
            offset=offset,
            projection=self._projection,
        )

    def at_rest(self) -> "LinearModel":
        """The same model about its own equilibrium under the duty of the operating point, which may
        differ from the equilibrium of the nonlinear twin. Its `rates` are None.

        Models for a design (`reduce`, `LQI`, `MPC`), for python-control and for `export_c` are
        about a rest.

        **Raises:** `ControlError` if the model is not stable, and so has no such point.
        """
        if self.rates is None:
            return self
        if not np.all(np.real(self.poles) < 0):
            raise ControlError("at_rest: expected a stable model, got a pole that does not decay")
        moved = -np.linalg.solve(np.asarray(self.A), np.asarray(self.rates))
        point = self.operating_point
        rest = replace(
            point,
            nodes=np.asarray(point.nodes) + moved,
            outputs=np.asarray(point.outputs) + np.asarray(self.C) @ moved,
        )
        return eqx.tree_at(
            lambda m: (m.rates, m.operating_point), self, (None, rest), is_leaf=_is_none
        )

    def with_states_as_outputs(self, names: Sequence[str]) -> "LinearModel":
        """The same model with the temperatures of some states as further outputs, such as elements
        of the plate, which no channel reads alone.

        **Raises:** `ControlError` for an unknown state.
        """
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
        return LinearModel(
            self.A,
            self.B,
            C,
            D,
            operating_point=replace(point, outputs=outputs, channel_names=known),
            state_names=self.state_names,
            input_names=self.input_names,
            output_names=(*self.output_names, *names),
            delay_s=self.delay_s,
            lag_s=self.lag_s,
            rates=self.rates,
            is_delayed=self.is_delayed,
            is_lagged=self.is_lagged,
            projection=self.projection,
        )

    def frequency_response(
        self, omega: ArrayLike | float | int
    ) -> Complex[Array | np.ndarray, "*frequency output input"]:
        r"""The frequency response $G(j \omega)$ with exact delay and lag, K per unit of duty.

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
        """The eigenvalues of `A`, 1/s, slowest first; the pole of the lag is at `-1 / lag_s`."""
        poles = np.linalg.eigvals(np.asarray(self.A)).astype(complex)
        return poles[np.argsort(-np.real(poles))]

    @property
    def time_constants_s(self) -> Float[np.ndarray, " state"]:
        """The reciprocals of the decay rates of the poles, s, slowest first; infinite for poles
        that do not decay."""
        decay = np.maximum(-np.real(self.poles), 0.0)
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

        **Raises:** `ControlError` if the model is not stable.
        """
        return self._balanced().hankel

    def error_bound(self, order: int) -> float:
        """A bound on the error of the frequency response of `reduce(order)` at any frequency, K per
        unit of duty (the largest singular value of the difference)."""
        return 2 * float(self.hankel_singular_values[order:].sum())

    def reduce(self, order: int) -> "LinearModel":
        """Reduces the model by balanced truncation, with the same DC gain.

        The states that matter least are assumed to be always at rest; their contribution becomes
        part of `D`. Delay, lag and operating point do not change.

        **Arguments:**

        - `order`: the number of states that are kept.

        **Raises:** `ControlError` if the model is not stable, is about a point that is not at rest,
        or has fewer states that an input moves and the outputs show.
        """
        order = whole_number("reduce: order", order, 1, ControlError)
        check_at_rest("reduce", self.rates)
        balanced = self._balanced()
        if order > len(balanced.hankel):
            raise ControlError(
                f"reduce: order: expected at most the {len(balanced.hankel)} states that a drive "
                f"moves and the outputs show, got {order}"
            )
        A, B, C, D = residualised(balanced, order)
        whole = self._projection
        # The states that were left out as rounding had a gain too.
        D = D + np.asarray(self.dcgain) - (D - C @ np.linalg.solve(A, B))
        return LinearModel(
            A,
            B,
            C,
            D,
            operating_point=self.operating_point,
            state_names=[f"balanced {number + 1}" for number in range(order)],
            input_names=self.input_names,
            output_names=self.output_names,
            delay_s=self.delay_s,
            lag_s=self.lag_s,
            is_delayed=self.is_delayed,
            is_lagged=self.is_lagged,
            projection=None if whole is None else balanced.into[:order] @ whole,
        )

    def to_control(self, *, pade_order: int | None = None) -> "control.StateSpace":
        """Converts the model to python-control (extra `control`), with the lag among its states.

        A continuous model of python-control has no delay. It is replaced by Padé's approximation if
        an order is given. `discretise(...).to_control()` contains it exactly.

        **Arguments:**

        - `pade_order`: the order of the approximation.

        **Raises:** `ControlError` if the model has a delay and no order is given, if it is about a
        point that is not at rest, or if python-control is not installed.
        """
        check_at_rest("to_control", self.rates)
        return continuous(self, pade_order)

    def to_xarray(self) -> "xarray.Dataset":
        """The matrices `A`, `B`, `C` and `D` as a dataset with names; delay and lag are attributes,
        s.

        The columns of `A` and `C` have the dimension `from_state`.
        """
        return dataset(
            {
                "A": ("state from_state", self.A, "1/s"),
                "B": ("state input", self.B, "K/s"),
                "C": ("output from_state", self.C, "1"),
                "D": ("output input", self.D, "K"),
            },
            {"delay_s": float(self.delay_s), "lag_s": float(self.lag_s)},
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

    @property
    def _projection(self) -> Float[Array | np.ndarray, "state node"] | None:
        """The states by the deviations of the nodes, if these are known."""
        if self.projection is None and self.state_names == self.operating_point.node_names:
            return np.eye(len(self.state_names))
        return self.projection

    def _balanced(self) -> Balanced:
        return balanced(np.asarray(self.A), np.asarray(self.B), np.asarray(self.C))

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

    def __repr__(self) -> str:
        outputs, states = self.C.shape
        return (
            f"<LinearModel of {states} states, {self.B.shape[1]} inputs, {outputs} outputs, "
            f"delay {_text(self.delay_s)}, lag {_text(self.lag_s)}>"
        )

    def _overview(self) -> "pandas.DataFrame":
        return self.to_dataframe().rename_axis("DC gain, K per unit of duty")


def _time(name: str, value: object) -> Any:
    if is_traced(value):
        return value
    number = finite_number(f"LinearModel: {name}", value, ControlError)
    if number < 0:
        raise ControlError(f"LinearModel: {name}: expected 0 s or more, got {number:g} s")
    return number


def _rates(rates: ArrayLike, states: int) -> Any:
    array = to_numpy(jnp.asarray(rates, float))
    if array.shape != (states,):
        raise ControlError(
            f"LinearModel: rates: expected {states} numbers, K/s, got an array of shape "
            f"{array.shape}"
        )
    return array


def _is_none(leaf: object) -> bool:
    return leaf is None


def _is_there(value: Any) -> bool:
    return is_traced(value) or float(value) > 0


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
        "LinearModel: expected A (state, state), B (state, input), C (output, state) and "
        f"D (output, input), got shapes {', '.join(map(str, shapes))}"
    )


def _names(what: str, names: Sequence[str] | None, letter: str, count: int) -> tuple[str, ...]:
    if names is None:
        return tuple(f"{letter}{number}" for number in range(1, count + 1))
    if len(names) != count:
        raise ControlError(f"LinearModel: {what}: expected {count} names, got {len(names)}")
    return tuple(names)
