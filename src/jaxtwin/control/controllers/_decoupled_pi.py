r"""PI control of the mean and of the differences of several outputs.

With the mean error $\bar e$ and the differences $e_i - \bar e$,

$$w_i = (P + I)_{mean}(\bar e) + (P + I)_{diff}(e_i - \bar e), \quad u = \mathrm{sat}(D w).$$

Two cells on a plate warm each other: a duty that is meant for the difference also moves the mean.
The matrix $D$, the inverse of the plate's gain, compensates for this.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, ArrayLike, Float, PyTree

from ..._jax_settings import own_settings
from ...errors import ControlError
from ._controller import (
    AbstractController,
    DutyLimits,
    Law,
    Numbers,
    bundled_law,
    check_non_negative,
    checked_measured,
    checked_sample_time,
    of_cells,
    parameter_text,
)
from ._controller_fields import OWN, REQUIRED_OWN, ControllerField, FileContents, numbers
from ._duty_limits import AbstractDutyLimitedController, GivenLimits, checked_limits
from ._pid import INTEGRAL, PROPORTIONAL, WEIGHT, Parameter, as_parameter, tracking_share


class DecoupledPIState(NamedTuple):
    """The state of a `DecoupledPI`: the integral parts, before the decoupling."""

    integral: Float[Array, " cells"]


@final
class DecoupledPI(AbstractDutyLimitedController):
    """A multivariable PI controller: one pair of gains for the mean of the outputs, another for
    their differences.

    There are as many outputs as cells; output i is the one on which cell i acts most.

    **Arguments:**

    - `Kp_mean`, `Kp_difference`: proportional gains, 1/K. `Ki_mean`, `Ki_difference`: integral
      gains, 1/(K s).
    - `measured`: the outputs, each a channel or a group of channels that is averaged.
    - `decoupling`: D, `(cells, cells)`; None for the unit matrix. `decoupling_of` computes it.
    - `setpoint_weight`, `limits`, `sample_time_s`: as in `PID`.

    **Raises:** `ControlError` if a gain is not a finite number of at least 0, the decoupling is
    singular or has another shape, the limits are not within -1 to 1, or the sample time is not
    positive.
    """

    kind: ClassVar[str] = "decoupled-pi"
    fields: ClassVar[Mapping[str, ControllerField]] = {
        "Kp_mean": PROPORTIONAL,
        "Ki_mean": replace(INTEGRAL, is_required=True),
        "Kp_difference": PROPORTIONAL,
        "Ki_difference": replace(INTEGRAL, is_required=True),
        "setpoint_weight": WEIGHT,
        "measured": REQUIRED_OWN,
        "decoupling": OWN,
    }

    Kp_mean: Parameter
    Ki_mean: Parameter
    Kp_difference: Parameter
    Ki_difference: Parameter
    decoupling: Parameter
    setpoint_weight: Parameter
    limits: DutyLimits = eqx.field(static=True)
    has_own_limits: bool = eqx.field(static=True, repr=False)
    sample_time_s: float = eqx.field(static=True)
    measured: tuple[tuple[str, ...], ...] = eqx.field(static=True)

    def __init__(
        self,
        Kp_mean: Numbers,
        Ki_mean: Numbers,
        Kp_difference: Numbers,
        Ki_difference: Numbers,
        *,
        measured: Sequence[str | Sequence[str]],
        decoupling: Numbers | None = None,
        setpoint_weight: Numbers = 1.0,
        limits: GivenLimits | None = None,
        sample_time_s: float | int = 1.0,
    ):
        self.check_parameters(
            Kp_mean=Kp_mean,
            Ki_mean=Ki_mean,
            Kp_difference=Kp_difference,
            Ki_difference=Ki_difference,
            setpoint_weight=setpoint_weight,
        )
        self.Kp_mean, self.Ki_mean = as_parameter(Kp_mean), as_parameter(Ki_mean)
        self.Kp_difference = as_parameter(Kp_difference)
        self.Ki_difference = as_parameter(Ki_difference)
        self.setpoint_weight = as_parameter(setpoint_weight)
        groups = checked_measured("DecoupledPI", measured)
        if groups is None:
            raise ControlError(
                "DecoupledPI: measured: expected an output for each cell, got None; name the "
                "channels of each output"
            )
        # Narrower than in the base class, which is sound: a module never changes.
        self.measured = groups  # pyright: ignore[reportIncompatibleVariableOverride]
        self.decoupling = as_parameter(np.eye(len(groups)) if decoupling is None else decoupling)
        if isinstance(self.decoupling, np.ndarray):
            check_decoupling("DecoupledPI", self.decoupling, len(groups))
        self.limits = checked_limits("DecoupledPI", limits)
        self.has_own_limits = limits is not None
        self.sample_time_s = checked_sample_time("DecoupledPI", sample_time_s)

    @classmethod
    def check_parameters(cls, **values: Any) -> None:
        """Refuses gains and set-point weights that are not finite numbers of at least 0, and a
        decoupling that cannot be inverted."""
        decoupling = as_parameter(values.pop("decoupling", 1.0))
        if isinstance(decoupling, np.ndarray) and decoupling.ndim:
            check_decoupling("DecoupledPI", decoupling, len(decoupling))
        check_non_negative("DecoupledPI", **values)

    @property
    def is_linear(self) -> bool:
        """True within the limits."""
        return True

    @classmethod
    def fits_outputs(cls, outputs: int, cells: int) -> bool:
        """Each cell has an output."""
        return outputs == cells

    @classmethod
    def from_file(cls, contents: FileContents) -> AbstractController:
        """Makes a controller from its file, whose decoupling is a list of rows."""
        if "decoupling" in contents.data:
            result = contents.data["decoupling"]
            rows = result if isinstance(result, list) else [result]
            matrix = [numbers(row, "decoupling", contents.refuse) for row in rows]
            contents = contents._replace(common={**contents.common, "decoupling": matrix})
        return super().from_file(contents)

    def file_lines(self) -> list[str]:
        """Returns the lines of the gains and of the decoupling."""
        rows = json.dumps(np.asarray(self.decoupling).tolist())
        return [*super().file_lines(), f"decoupling = {rows}"]

    def law(self, cells: int) -> Law:
        r"""The law, in which each pair of gains, for the mean and for the differences, is a matrix
        $K_{mean} \frac{1}{n} + K_{diff} (I - \frac{1}{n})$ of the errors."""
        h = self.sample_time_s
        with own_settings():
            of_mean = tracking_share(self.Kp_mean, self.Ki_mean, None, h)
            of_difference = tracking_share(self.Kp_difference, self.Ki_difference, None, h)
            back = _gain_matrix("share", np.asarray(of_mean), np.asarray(of_difference), cells)
        D = np.asarray(self.decoupling, float)
        check_decoupling("export_c", D, cells)
        undo = np.linalg.inv(D)
        Kp = _gain_matrix("Kp", self.Kp_mean, self.Kp_difference, cells)
        Ki = _gain_matrix("Ki", self.Ki_mean, self.Ki_difference, cells)
        b = of_cells("setpoint_weight", self.setpoint_weight, cells)
        tables = {
            "Kp": (Kp, "duty before the decoupling by the errors, 1/K"),
            "b": (b, "set-point weight"),
            "Ki_h": (Ki * h, "what a sample adds to the integral, 1/K"),
            "D": (D, "decoupling"),
            "undo": (undo, "its inverse"),
            "back": (back @ undo, "what the limits cut off, out of the integral"),
        }
        parameters = [
            parameter_text("Kp of the mean", self.Kp_mean, "1/K"),
            parameter_text("Ki of the mean", self.Ki_mean, "1/(K s)"),
            parameter_text("Kp of the differences", self.Kp_difference, "1/K"),
            parameter_text("Ki of the differences", self.Ki_difference, "1/(K s)"),
            parameter_text("set-point weight", self.setpoint_weight, ""),
            parameter_text("decoupling", D, ""),
        ]
        return Law(
            bundled_law("decoupled_pi.c"),
            "a PI on the mean and the differences of the outputs",
            tables,
            parameters=parameters,
            integrals=cells,
        )

    def init(
        self, duty: Float[ArrayLike, " cells"], measurement: Float[ArrayLike, " outputs"]
    ) -> PyTree:
        """The state with which the duty stays where it is while the reference equals the
        measurement."""
        return DecoupledPIState(self._undo(jnp.asarray(duty)) - self._at_rest(measurement))

    def taken_over(
        self, before: "DecoupledPI", state: PyTree, measurement: Float[ArrayLike, " outputs"]
    ) -> PyTree:
        """The state with which this controller asks for the duty that another one asks for from its
        state, if the reference equals the measurement."""
        y = jnp.asarray(measurement)
        asked = jnp.asarray(before.decoupling) @ (before._at_rest(y) + state.integral)
        return DecoupledPIState(self._undo(asked) - self._at_rest(y))

    def step(
        self,
        state: PyTree,
        reference: Float[ArrayLike, " outputs"],
        measurement: Float[ArrayLike, " outputs"],
    ) -> tuple[Float[Array, " cells"], PyTree]:
        """Computes the duty of a sample and the next state."""
        r, y, h = jnp.asarray(reference), jnp.asarray(measurement), self.sample_time_s
        weighted_error = jnp.asarray(self.setpoint_weight) * r - y
        asked = self._gained(weighted_error, self.Kp_mean, self.Kp_difference) + state.integral
        wanted = jnp.asarray(self.decoupling) @ asked
        duty = self.limited(wanted)
        cut = self._undo(duty - wanted)
        integral = (
            state.integral
            + h * self._gained(r - y, self.Ki_mean, self.Ki_difference)
            + self._gained(
                cut,
                tracking_share(self.Kp_mean, self.Ki_mean, None, h),
                tracking_share(self.Kp_difference, self.Ki_difference, None, h),
            )
        )
        return duty, DecoupledPIState(integral)

    def _at_rest(self, measurement: Float[ArrayLike, " outputs"]) -> Float[Array, " cells"]:
        """The proportional part if the reference equals the measurement."""
        weighted = (jnp.asarray(self.setpoint_weight) - 1) * jnp.asarray(measurement)
        return self._gained(weighted, self.Kp_mean, self.Kp_difference)

    def _gained(
        self,
        values: Float[Array, " cells"],
        mean_gain: Parameter,
        difference_gain: Parameter,
    ) -> Float[Array, " cells"]:
        mean = values.mean()
        return jnp.asarray(mean_gain) * mean + difference_gain * (values - mean)

    def _undo(self, duty: Float[Array, " cells"]) -> Float[Array, " cells"]:
        return inverse(jnp.asarray(self.decoupling, duty.dtype)) @ duty


def _gain_matrix(
    name: str, mean: object, difference: object, cells: int
) -> Float[np.ndarray, "cells cells"]:
    """The matrix of the two gains, from the errors to the cells."""
    of_mean = np.full((cells, cells), 1 / cells)
    return of_cells(f"{name}_mean", mean, cells)[:, None] * of_mean + of_cells(
        f"{name}_difference", difference, cells
    )[:, None] * (np.eye(cells) - of_mean)


def decoupling_of(gain: npt.ArrayLike) -> Float[np.ndarray, "cells cells"]:
    """Computes the decoupling with which a plate responds as if its cells did not warm each other.

    D = g G⁻¹, where G is the steady gain from duty to outputs, K, and g is the change of the mean
    output under equal duty. An equal duty thus stays about the same, and gains keep their meaning.

    **Arguments:**

    - `gain`: G, `(cells, cells)`, such as `jaxtwin.linearize(...).dcgain` of the outputs.

    **Raises:** `ControlError` if the gain is not square or is singular.
    """
    G = np.asarray(gain, float)
    if G.ndim != 2 or G.shape[0] != G.shape[1] or not np.isfinite(G).all():
        raise ControlError(f"decoupling_of: gain: expected a square matrix, got {gain!r}")
    if np.linalg.cond(G) > 1e6:
        raise ControlError(
            "decoupling_of: gain: expected outputs that the cells move differently, got a matrix "
            f"with condition number {np.linalg.cond(G):.3g}; measure nearer to the cells"
        )
    return float(G.sum(axis=1).mean()) * np.linalg.inv(G)


def check_decoupling(where: str, decoupling: np.ndarray, cells: int) -> None:
    """Refuses a decoupling that is not an invertible, finite matrix.

    **Raises:** `ControlError`.
    """
    size = (cells, cells)
    if (
        decoupling.shape != size
        or not np.isfinite(decoupling).all()
        or np.linalg.matrix_rank(decoupling) < cells
    ):
        raise ControlError(
            f"{where}: decoupling: expected an invertible matrix {size}, got {decoupling.tolist()}"
        )


def inverse(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """The inverse of a small matrix by Gauss-Jordan elimination, in plain operations.

    LAPACK calls inside batches wait for each other, see `_lapack`; a matrix with a row and column
    for each cell needs only a few multiplications. The pivot is the largest number of a column,
    because a decoupling may have zeros on its diagonal.
    """
    size = matrix.shape[0]
    rows = jnp.arange(size)
    both = jnp.concatenate([matrix, jnp.eye(size, dtype=matrix.dtype)], axis=1)
    for pivot in range(size):
        best = pivot + jnp.argmax(jnp.abs(both[pivot:, pivot]))
        both = both[jnp.where(rows == pivot, best, jnp.where(rows == best, pivot, rows))]
        row = both[pivot] / both[pivot, pivot]
        both = (both - jnp.outer(both[:, pivot], row)).at[pivot].set(row)
    return both[:, size:]
