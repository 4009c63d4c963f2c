r"""Gain scheduling: a PI or PID controller whose parameters follow the temperature.

Between two operating points the parameters are interpolated along the scheduling variable, the mean
of the outputs or of their references. When they change, the integral takes over what the
proportional part asks less or more at rest, so that the duty at rest does not change (bumpless
transfer):

$$I \leftarrow I + K_p^-\,(b^- - 1)\,y - K_p\,(b - 1)\,y.$$

The gain of an error changes at once. If the integral took this over too, a large step through
several gains would wind it up. About a steady state the loop is that of the controller with the
parameters of this state (Kaminer, Pascoal, Khargonekar and Coleman, Automatica 31, 1995; Åström and
Hägglund, *Advanced PID Control*, 2006, chapters 9.3 and 13).
"""

import copy
import json
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, NamedTuple, NoReturn, TypeAlias, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PyTree

from ..._name_suggestions import unknown_name
from ...errors import ControlError
from ...rig import Rig
from ._controller import AbstractChannelGroupController, AbstractController, DutyLimits
from ._controller_fields import OWN, REQUIRED_OWN, ControllerField, FileContents
from ._decoupled_pi import DecoupledPI
from ._model_file import as_celsius, temperatures_of
from ._pid import PID

Schedulable: TypeAlias = PID | DecoupledPI

_KINDS: Mapping[str, type[Schedulable]] = {kind.kind: kind for kind in (PID, DecoupledPI)}


# What the scheduling variable may be.
SCHEDULING_VARIABLES = ("measurement", "reference")


class GainScheduledState(NamedTuple):
    """The state of a `GainScheduled`: that of its controller, and the scheduling variable of the
    last sample, degC."""

    controller: PyTree
    at: Float[Array, ""]


@final
class GainScheduled(AbstractChannelGroupController):
    """Controllers for several operating points, in one: their parameters are interpolated.

    ```python
    GainScheduled([PID(Kp=0.10, Ki=0.001), PID(Kp=0.16, Ki=0.002)], at=[30.0, 60.0])
    ```

    `loop_margins` at a reference gives the margins with the parameters of this reference.

    **Arguments:**

    - `controllers`: a `PID` for each operating point, or a `DecoupledPI` for each, with the same
      outputs, sample time and limits.
    - `at`: the temperatures of these points, in rising order, degC. Beyond the first and the last
      of them the parameters stay.
    - `by`: the scheduling variable, the mean of all outputs: `"measurement"`, or `"reference"`
      for those that are asked for, which has no noise, and changes the gains before the plate is
      there.

    **Raises:** `ControlError` for fewer than two controllers, or if they do not fit each other or
    the temperatures.
    """

    kind: ClassVar[str] = "gain-scheduled"
    fields: ClassVar[Mapping[str, ControllerField]] = {
        "of": REQUIRED_OWN,
        "by": OWN,
        "points": REQUIRED_OWN,
    }

    stacked: Schedulable
    """The controllers as one, whose parameters have a leading axis for the points."""
    at: Float[Array | np.ndarray, " points"]
    by: Literal["measurement", "reference"] = eqx.field(static=True)
    limits: DutyLimits = eqx.field(static=True)
    sample_time_s: float = eqx.field(static=True)
    measured: tuple[tuple[str, ...], ...] | None = eqx.field(static=True)

    def __init__(
        self,
        controllers: Sequence[Schedulable],
        *,
        at: Sequence[float | int],
        by: Literal["measurement", "reference"] = "measurement",
    ):
        where = "GainScheduled"
        kinds = {type(controller) for controller in controllers}
        if len(kinds) != 1 or not kinds <= set(_KINDS.values()):
            known = ", ".join(sorted(kind.__name__ for kind in kinds)) or "none"
            raise ControlError(
                f"{where}: controllers: expected a PID for each point, or a DecoupledPI for each, "
                f"got {known}"
            )
        try:
            self.at = np.asarray(at, float)
            is_rising = self.at.ndim == 1 and bool(np.all(np.diff(self.at) > 0))
        except (TypeError, ValueError):
            is_rising = False
        if not is_rising or len(self.at) != len(controllers) or len(controllers) < 2:
            raise ControlError(
                f"{where}: at: expected a temperature for each of at least two controllers, in "
                f"rising order, degC, got {at!r} for {len(controllers)}"
            )
        if by not in SCHEDULING_VARIABLES:
            raise ControlError(f"{where}: by: expected 'measurement' or 'reference', got {by!r}")
        self.by = by
        structures = [jax.tree.structure(one) for one in controllers]
        if any(other != structures[0] for other in structures):
            raise ControlError(
                f"{where}: controllers: expected the same outputs, sample time, limits and kinds "
                "of parameters for all points, got different ones"
            )
        self.stacked = jax.tree.map(
            lambda *parts: np.stack(np.broadcast_arrays(*parts)), *controllers
        )
        self.limits, self.measured = self.stacked.limits, self.stacked.measured
        self.sample_time_s = self.stacked.sample_time_s

    @property
    def controllers(self) -> tuple[Schedulable, ...]:
        """The controllers of the points."""
        return tuple(
            jax.tree.map(lambda part, n=n: part[n], self.stacked) for n in range(len(self.at))
        )

    def for_rig(self, rig: Rig) -> "GainScheduled":
        """Returns the controller with the limits of a rig."""
        limited = copy.copy(self)
        stacked = self.stacked.for_rig(rig)
        object.__setattr__(limited, "stacked", stacked)
        object.__setattr__(limited, "limits", stacked.limits)
        return limited

    @property
    def is_linear(self) -> bool:
        """True about a steady state within the limits."""
        return True

    def controller_at(self, temperature: Float[ArrayLike, ""]) -> Any:
        """Returns the controller with the parameters of a temperature, degC."""
        at = jnp.asarray(self.at)
        place = jnp.clip(jnp.searchsorted(at, temperature) - 1, 0, len(self.at) - 2)
        share = jnp.clip((temperature - at[place]) / (at[place + 1] - at[place]), 0.0, 1.0)

        def between(part: Any) -> Array:
            rows = jnp.asarray(part)
            return rows[place] + share * (rows[place + 1] - rows[place])

        return jax.tree.map(between, self.stacked)

    def init(
        self, duty: Float[ArrayLike, " cells"], measurement: Float[ArrayLike, " outputs"]
    ) -> PyTree:
        """The state with which the duty stays where it is while the reference equals the
        measurement."""
        at = jnp.mean(jnp.asarray(measurement))
        return GainScheduledState(self.controller_at(at).init(duty, measurement), at)

    def step(
        self,
        state: PyTree,
        reference: Float[ArrayLike, " outputs"],
        measurement: Float[ArrayLike, " outputs"],
    ) -> tuple[Float[Array, " cells"], PyTree]:
        """Computes the duty of a sample and the next state."""
        followed = measurement if self.by == "measurement" else reference
        at = jnp.mean(jnp.asarray(followed, state.at.dtype))
        before, now = self.controller_at(state.at), self.controller_at(at)
        taken = now.taken_over(before, state.controller, measurement)
        duty, later = now.step(taken, reference, measurement)
        return duty, GainScheduledState(later, at)

    @classmethod
    def from_file(cls, contents: FileContents) -> AbstractController:
        """Makes a controller from its file: a table for each point."""
        data, refuse = contents.data, contents.refuse
        kind = data["of"]
        if not isinstance(kind, str) or kind not in _KINDS:
            refuse("of", f"expected one of {', '.join(_KINDS)}, got {kind!r}")
        rows = data["points"]
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            refuse("points", "expected tables, [[points]], one for each operating point")
        controllers, temperatures = [], []
        for number, row in enumerate(rows):
            controllers.append(_of_point(_KINDS[kind], number, row, contents))
            at = [row.get("at")]
            temperatures += temperatures_of(at, f"points[{number}].at", 1, refuse)
        by: Any = data.get("by", "measurement")
        if by not in SCHEDULING_VARIABLES:
            refuse("by", f"expected 'measurement' or 'reference', got {by!r}")
        try:
            return cls(controllers, at=temperatures, by=by)
        except ControlError as error:
            refuse("", str(error))

    def file_lines(self) -> list[str]:
        """Returns the lines of the kind of controllers, and a table for each point."""
        lines = [f"of = {json.dumps(self.stacked.kind)}", f"by = {json.dumps(self.by)}"]
        for at, controller in zip(np.asarray(self.at, float), self.controllers, strict=True):
            (temperature,) = json.loads(as_celsius([at]))
            own = controller.file_lines()
            lines += ["", "[[points]]", f"at = {json.dumps(temperature)}", *own]
        return lines

    def __repr__(self) -> str:
        points = ", ".join(f"{at:g}" for at in np.asarray(self.at, float))
        return (
            f"<GainScheduled {type(self.stacked).__name__} by the {self.by}: at {points} degC, "
            f"sample time {self.sample_time_s:g} s>"
        )


def _of_point(
    kind: type[Schedulable], number: int, row: Mapping[str, Any], contents: FileContents
) -> Any:
    """Makes the controller of a table of a file."""

    def refuse(field: str, message: str) -> NoReturn:
        contents.refuse(f"points[{number}]{'.' * bool(field)}{field}", message)

    known = ["at", *(name for name in kind.fields if name != "measured")]
    for name in row:
        if name not in known:
            refuse(name, unknown_name("field", name, known))
    for name in known:
        is_required = name == "at" or kind.fields[name].is_required
        if is_required and name not in row:
            refuse(name, "expected this field, got none")
    if "measured" in kind.fields and "measured" not in contents.common:
        contents.refuse("measured", "expected this field, got none")
    return kind.from_file(contents._replace(data=row, refuse=refuse))
