r"""Time-proportional output: a controller whose heaters are only on or off.

A relay, solid-state relay or contactor is on for a share of each window of $N$ samples. With the
duty $u$ at its beginning and what the windows before have left over, $c$,

$$w = u N + c, \quad n = \arg\min_{m \in M} |m - w|, \quad c \leftarrow w - n,$$

the relay is on for $n$ samples, where $M$ holds 0, $N$, and all whole numbers between that leave it
on and off for its minimum times. The mean over many windows is thus the duty (first-order
sigma-delta modulation), and a duty of 0 or 1 is never on or off.
"""

import copy
import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, PyTree

from ..._arguments import finite_number, of_kind
from ...errors import ControlError
from ...rig import Rig
from ._controller import AbstractController, Law, TemperatureLimit, bundled_law
from ._controller_fields import REQUIRED_OWN, ControllerField, FileContents, field_arguments

# Of two on times that are as near as this, in samples, the shorter one is taken, in Python as in C,
# where numbers differ by rounding.
TIE = 1e-6


class TimeProportionalState(NamedTuple):
    """The state of a `TimeProportional`.

    - `controller`: that of its controller.
    - `sample`: the number of the sample in the window.
    - `on`: the number of samples for which each relay is on in this window.
    - `carried`: the samples that are carried to the next window.
    """

    controller: PyTree
    sample: Float[Array, ""]
    on: Float[Array, " cells"]
    carried: Float[Array, " cells"]


@final
class TimeProportional(AbstractController):
    """A controller that switches the heaters of its rig on and off, by relays with minimum times.

    ```python
    TimeProportional(PID(0.1, 0.001), period_s=20, minimum_on_s=2, minimum_off_s=2)
    ```

    Cells get their duty as it is. A loop is checked, and its margins are found, by the mean over a
    window, which is the duty of the controller; a window should be short beside the time constants
    of the loop. For a device that switches by itself, the heater of the rig file is
    `time_proportional`, and the controller is given alone.

    **Arguments:**

    - `controller`: the controller whose duty is the mean.
    - `period_s`: the period of the window, s, a multiple of the controller's sample time.
    - `minimum_on_s`, `minimum_off_s`: the shortest time for which a relay stays on, or off, s. They
      are rounded up to whole samples.

    **Raises:** `ControlError` if the period is shorter than two samples or no multiple of them, or
    a minimum time is below 0 or longer than the period.
    """

    kind: ClassVar[str] = "time-proportional"
    fields: ClassVar[Mapping[str, ControllerField]] = {
        "period": ControllerField("a time", "s", "20 s", is_required=True, is_single=True),
        "minimum_on": ControllerField("a time", "s", "2 s", "zero", is_single=True),
        "minimum_off": ControllerField("a time", "s", "2 s", "zero", is_single=True),
        "controller": REQUIRED_OWN,
    }

    controller: AbstractController
    period_s: float = eqx.field(static=True)
    minimum_on_s: float = eqx.field(static=True)
    minimum_off_s: float = eqx.field(static=True)
    limits: Any = eqx.field(static=True)
    sample_time_s: float = eqx.field(static=True)
    switched: tuple[bool, ...] = eqx.field(static=True, repr=False)
    """For each cell and heater whether it has a relay; empty before the rig is known."""

    def __init__(
        self,
        controller: AbstractController,
        *,
        period_s: float | int,
        minimum_on_s: float | int = 0.0,
        minimum_off_s: float | int = 0.0,
    ):
        where = "TimeProportional"
        self.controller = of_kind(
            f"{where}: controller", controller, AbstractController, "a controller", ControlError
        )
        self.limits, self.sample_time_s = controller.limits, controller.sample_time_s
        self.switched = ()
        self.period_s, self.minimum_on_s, self.minimum_off_s = (
            finite_number(f"{where}: {name}", value, ControlError)
            for name, value in (
                ("period_s", period_s),
                ("minimum_on_s", minimum_on_s),
                ("minimum_off_s", minimum_off_s),
            )
        )
        samples = self.period_s / self.sample_time_s
        if samples < 2 - 1e-9 or not math.isclose(samples, round(samples), rel_tol=1e-9):
            raise ControlError(
                f"{where}: period_s: expected a multiple of the sample time of "
                f"{self.sample_time_s:g} s, at least two of them, got {period_s!r}"
            )
        for name in ("minimum_on_s", "minimum_off_s"):
            finite_number(
                f"{where}: {name}",
                getattr(self, name),
                ControlError,
                least=0,
                most=self.period_s,
                unit="s",
            )

    def for_rig(self, rig: Rig) -> "TimeProportional":
        """Returns the controller with its controller's limits on a rig, whose heaters it switches.

        **Raises:** `ControlError` for a rig without heaters, or with one that its device switches.
        """
        if not rig.heaters:
            raise ControlError(
                f"TimeProportional: expected a rig with heaters, got {rig.name}; cells "
                "have a bridge, which a relay is not"
            )
        for heater in rig.heaters:
            if heater.time_proportional is not None:
                raise ControlError(
                    f"TimeProportional: expected heaters that the controller switches, "
                    f"got {heater.name} of {rig.name}, which its device switches "
                    "(time_proportional in the rig file); give the controller alone"
                )
        switching = copy.copy(self)
        controller = self.controller.for_rig(rig)
        switched = (False,) * len(rig.cells) + (True,) * len(rig.heaters)
        fields = {"controller": controller, "limits": controller.limits, "switched": switched}
        for name, value in fields.items():
            object.__setattr__(switching, name, value)
        return switching

    @property
    def averaged(self) -> AbstractController:
        """The controller whose duty is the mean."""
        return self.controller

    @property
    def is_linear(self) -> bool:
        """False: a relay switches."""
        return False

    @property
    def preview_samples(self) -> int:
        """That of its controller."""
        return self.controller.preview_samples

    @property
    def needs_one_thread(self) -> bool:
        """That of its controller."""
        return self.controller.needs_one_thread

    @property
    def reads_room(self) -> bool:
        """That of its controller."""
        return self.controller.reads_room

    def channel_limits(self) -> Mapping[str, TemperatureLimit]:
        """Those of its controller."""
        return self.controller.channel_limits()

    def output_weights(self, channels: Sequence[str]) -> Float[np.ndarray, "outputs channels"]:
        """Those of its controller."""
        return self.controller.output_weights(channels)

    def reading_weights(self, channels: Sequence[str]) -> Float[np.ndarray, "readings channels"]:
        """Those of its controller."""
        return self.controller.reading_weights(channels)

    @classmethod
    def from_file(cls, contents: FileContents) -> AbstractController:
        """Makes a controller from its file, which has a table for the controller of the mean."""
        from ._controller_file import controller_of_tables  # which imports this module

        table = contents.data["controller"]
        if not isinstance(table, dict):
            contents.refuse("controller", f"expected a table, [controller], got {table!r}")
        common = ("format", "rig", "sample_time", "limits")
        for name in common:
            if name in table:
                contents.refuse(
                    f"controller.{name}", "expected it before the tables of the file, got it here"
                )
        given = {name: contents.data[name] for name in common if name in contents.data}
        controller = controller_of_tables(
            {**given, **table},
            contents.rig,
            lambda field, message: contents.refuse(f"controller.{field}", message),
        )
        try:
            return cls(controller, **field_arguments(cls, cls.fields, contents))
        except ControlError as error:
            contents.refuse("", str(error))

    def file_lines(self) -> list[str]:
        """Returns the lines of the window, and the table of the controller."""
        measured = getattr(self.controller, "measured", None)
        lines = [
            f"kind = {json.dumps(self.controller.kind)}",
            *([] if measured is None else [f"measured = {json.dumps(measured)}"]),
            *self.controller.file_lines(),
        ]
        # The controller's own tables are inside this one.
        nested = [re.sub(r"^(\[+)", r"\1controller.", line) for line in lines]
        return [*super().file_lines(), "", "[controller]", *nested]

    def __repr__(self) -> str:
        return (
            f"<TimeProportional {self.controller!r}: window {self.period_s:g} s, at least "
            f"{self.minimum_on_s:g} s on and {self.minimum_off_s:g} s off>"
        )

    @property
    def _samples(self) -> tuple[int, int, int]:
        """The samples of a window, and the lowest and the highest number of them that a relay may
        be on for if it is neither on nor off for all of it; the highest may be below the lowest."""
        window = round(self.period_s / self.sample_time_s)
        on, off = (
            math.ceil(value / self.sample_time_s - 1e-9)
            for value in (self.minimum_on_s, self.minimum_off_s)
        )
        return window, on, window - off

    def law(self, cells: int) -> Law:
        """The law of its controller, and behind it that of the relays."""
        law = self.controller.law(cells)
        window, least, most = self._samples
        code = re.sub(r"\bmodel_law(?=_init\b|\b)", "model_asked", law.code)
        switched = np.array(self.switched or (True,) * cells, float)
        window_text = (
            f"relays: a window of {self.period_s!r} s, at least {self.minimum_on_s!r} s on and "
            f"{self.minimum_off_s!r} s off"
        )
        return law._replace(
            code=f"{code}\n{bundled_law('time_proportional.c')}",
            title=f"{law.title}, with relays,",
            tables={**law.tables, "switched": (switched, "1 for a relay")},
            state={**law.state, "sample": 1, "on": cells, "carried": cells},
            parameters=[*law.parameters, window_text],
            constants={
                **law.constants,
                "WINDOW": window,
                "SHORTEST_ON": least,
                "LONGEST_ON": most,
                "TIE": TIE,
            },
        )

    def init(
        self, duty: Float[ArrayLike, " cells"], measurement: Float[ArrayLike, " readings"]
    ) -> PyTree:
        """Returns the state at the beginning of a window."""
        none = jnp.zeros_like(jnp.asarray(duty))
        inner = self.controller.init(duty, measurement)
        return TimeProportionalState(inner, jnp.zeros((), none.dtype), none, none)

    def step(
        self,
        state: PyTree,
        reference: Float[ArrayLike, "*preview outputs"],
        measurement: Float[ArrayLike, " readings"],
    ) -> tuple[Float[Array, " cells"], PyTree]:
        """Computes the duty of a sample, 1 or 0 for a relay, and the next state."""
        asked, inner = self.controller.step(state.controller, reference, measurement)
        window, _, _ = self._samples
        on, carried = self._on_samples(asked, state.carried)
        begins = state.sample == 0
        on = jnp.where(begins, on, state.on)
        carried = jnp.where(begins, carried, state.carried)
        level = (state.sample < on).astype(asked.dtype)
        switched: Bool[np.ndarray, " cells"] = np.array(self.switched or (True,) * asked.size)
        # What is no number is for the loop to see, which switches off.
        duty = jnp.where(switched & jnp.isfinite(asked), level, asked)
        later = jnp.where(state.sample + 1 >= window, 0.0, state.sample + 1).astype(asked.dtype)
        return duty, TimeProportionalState(inner, later, on, carried)

    def _on_samples(
        self, duty: Float[Array, " cells"], carried: Float[Array, " cells"]
    ) -> tuple[Float[Array, " cells"], Float[Array, " cells"]]:
        """The samples of a window for which each relay is on, and what is carried to the next."""
        window, least, most = self._samples
        wanted = duty * window + carried
        between = jnp.clip(jnp.floor(wanted + (0.5 - TIE)), least, most)
        choices = [between] if least <= most else []
        on = jnp.zeros_like(wanted)
        for choice in (*choices, jnp.full_like(wanted, window)):
            is_nearer = jnp.abs(choice - wanted) < jnp.abs(on - wanted) - TIE
            on = jnp.where(is_nearer, choice, on)
        is_part = (duty > 0) & (duty < 1)
        whole = jnp.where(duty >= 1, float(window), 0.0)
        return (
            jnp.where(is_part, on, whole).astype(wanted.dtype),
            jnp.where(is_part, wanted - on, carried),
        )
