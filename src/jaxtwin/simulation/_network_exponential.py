"""The exponential step as a diffrax solver."""

from collections.abc import Callable
from typing import Any, ClassVar, TypeAlias, final

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..physics import Conditions, System
from ._drive import lagged_duty
from ._exponential import ModalField, StepFactors, StepInputs, exponential_step, step_factors
from ._modes import Modes, network_modes

RealScalarLike: TypeAlias = float | int | Float[Array | np.ndarray, ""]

_State: TypeAlias = Modes


@final
class HeldInputs(eqx.Module):
    """Inputs that are held during spans of time: time -> `StepInputs`.

    - `starts`: the start of each span, `(spans,)`, s.
    - `duty`: the duty in each span, `(spans, cells)`.
    - `ambient`: the ambient temperature's deviation in each span, `(spans,)`, K.
    - `drift`: the additional drift of the ambient temperature, K/s, or None.
    - `lag`, `delay`, `steady_start`: the driver's lag and delay, see `lagged_duty`.
    - `conditions`: what the rig's other inputs change in each span; None for a rig without any.
    """

    starts: Float[Array, " spans"]
    duty: Float[Array, "spans cells"]
    ambient: Float[Array, " spans"]
    lag: Float[Array, ""] | None = None
    delay: Float[Array, ""] | None = None
    steady_start: bool = eqx.field(static=True, default=False)
    drift: Float[Array, ""] | None = None
    conditions: Conditions | None = None

    def __call__(self, t: RealScalarLike) -> StepInputs:
        """The inputs at a time."""
        now = jnp.searchsorted(self.starts, t, side="right") - 1
        duty, ambient = self._duty(jnp.asarray(t), now), self._ambient(t, now)
        return StepInputs(duty, ambient, conditions=self._conditions(now))

    def over(self, t: RealScalarLike, size: RealScalarLike) -> StepInputs:
        """The inputs during a step."""
        now = jnp.searchsorted(self.starts, t, side="right") - 1
        stages = jnp.asarray(t + size * jnp.array([0.0, 0.5, 1.0]))
        duty = self.duty[now] if self.lag is None else self._duty(stages, now)
        return StepInputs(duty, self._ambient(stages, now), conditions=self._conditions(now))

    def _conditions(self, now: Int[Array, ""]) -> Conditions | None:
        return jax.tree.map(lambda table: table[now], self.conditions)

    def _ambient(
        self, t: RealScalarLike | Float[Array, "*times"], now: Int[Array, ""]
    ) -> Float[Array, "*times_or_none"]:
        held = self.ambient[now]
        return held if self.drift is None else held + self.drift * t

    def _duty(self, t: Float[Array, "*times"], now: Int[Array, ""]) -> Float[Array, "*times cells"]:
        if self.lag is None:
            return self.duty[now]
        return lagged_duty(self.lag, self.delay, self.starts, self.duty, t, self.steady_start)


@final
class NetworkProblem(eqx.Module):
    """The equations of a twin: the `args` of a diffrax solve of `network_field`.

    The state is the nodes' deviation from the `reference` temperature (K).
    """

    system: System
    inputs: HeldInputs
    reference: Float[Array, ""]


def network_field(
    t: RealScalarLike, deviation: Float[Array, " nodes"], problem: NetworkProblem
) -> Float[Array, " nodes"]:
    """The vector field of a twin for `diffrax.ODETerm`, K/s."""
    now, system = problem.inputs(t), problem.system
    if now.conditions is not None:
        system = system.under(now.conditions)
    heat = system.heat_into_nodes(deviation, now.duty, problem.reference, now.ambient)
    return heat / system.capacitance


@final
class NetworkExponential(diffrax.AbstractAdaptiveSolver):
    r"""Exponential Runge-Kutta steps in the modes of a thermal network, as a diffrax solver.

    The linear network is integrated exactly, the cells' heat flows to fourth order (see
    `jaxtwin.simulation`, whose own loop drives the same step on a grid known beforehand). Dense
    output is cubic Hermite interpolation. The error estimate is the difference to the second-order
    ETD2 step from the same stages, so that a step size controller takes shorter steps than
    necessary.

    Pass it to `simulate(..., solver=NetworkExponential())`, or to `diffrax.diffeqsolve` with
    `ODETerm(network_field)` and a `NetworkProblem` as `args`.

    **Not suitable** for cells with a strong feedback beyond their linearisation at the steady state
    under the mean duty, that is, for a `stability_number` above about 1 (cells of very low
    resistance far from that point, steps of many seconds), because the step is explicit in that
    part. An adaptive controller then shortens the steps; a stiff solver such as `diffrax.Kvaerno5`
    needs fewer. `simulate` and `simulate_batch` check the number, halve their steps, and use the
    stiff solver if that does not help.
    """

    term_structure: ClassVar = diffrax.ODETerm
    interpolation_cls: ClassVar[Callable[..., Any]] = (
        diffrax.ThirdOrderHermitePolynomialInterpolation
    )

    def order(self, terms: diffrax.AbstractTerm) -> int:
        """Four."""
        del terms
        return 4

    def error_order(self, terms: diffrax.AbstractTerm) -> int:
        """The order of the error estimate: that of the embedded second-order step plus one."""
        del terms
        return 3

    def init(
        self,
        terms: diffrax.AbstractTerm,
        t0: RealScalarLike,
        t1: RealScalarLike,
        y0: Float[Array, " nodes"],
        args: NetworkProblem,
    ) -> _State:
        """Computes the modes of the network, which are kept for all steps."""
        del terms, y0
        inputs = args.inputs
        ends = jnp.append(inputs.starts[1:], t1)
        lengths = jnp.clip(ends, t0, t1) - jnp.clip(inputs.starts, t0, t1)
        return network_modes(args.system, lengths @ inputs.duty / lengths.sum(), args.reference)

    def step(
        self,
        terms: diffrax.AbstractTerm,
        t0: RealScalarLike,
        t1: RealScalarLike,
        y0: Float[Array, " nodes"],
        args: NetworkProblem,
        solver_state: _State,
        made_jump: object,
    ) -> tuple[Any, Any, dict[str, Any], _State, Any]:
        """Takes a step. The command and the recorded ambient keep the values that they have at the
        start of the step, while lag and drift continue."""
        del terms, made_jump
        modes = solver_state
        size = jnp.asarray(t1) - t0
        amplitudes = modes.amplitudes(y0)
        factors = step_factors(modes.rates, size)
        inputs = args.inputs.over(t0, size)
        field = ModalField.of(args.system, modes, args.reference)
        force_0 = field.force(amplitudes, inputs.at(0))
        end = exponential_step(amplitudes, force_0, factors, field, inputs).amplitudes
        force_1 = field.force(end, inputs.at(2))
        lower = _second_order(amplitudes, force_0, force_1, factors)
        y1 = modes.shapes @ end
        dense = {
            "y0": y0,
            "y1": y1,
            "k0": size * (modes.shapes @ (force_0 - modes.rates * amplitudes)),
            "k1": size * (modes.shapes @ (force_1 - modes.rates * end)),
        }
        return y1, modes.shapes @ (end - lower), dense, solver_state, diffrax.RESULTS.successful

    def func(
        self,
        terms: diffrax.AbstractTerm,
        t0: RealScalarLike,
        y0: Float[Array, " nodes"],
        args: NetworkProblem,
    ) -> Float[Array, " nodes"]:
        """The vector field."""
        return terms.vf(t0, y0, args)


def _second_order(
    amplitudes: Float[Array, " modes"],
    force_0: Float[Array, " modes"],
    force_1: Float[Array, " modes"],
    factors: StepFactors,
) -> Float[Array, " modes"]:
    """The ETD2 step: the force is linear between its values at both ends."""
    # The functions phi of exponential integrators, times the step h.
    phi_1 = factors.first + 2 * factors.middle + factors.last
    phi_2 = factors.middle + factors.last
    return factors.decay * amplitudes + phi_1 * force_0 + phi_2 * (force_1 - force_0)
