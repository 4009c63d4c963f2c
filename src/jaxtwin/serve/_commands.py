"""What commands the rig in a run of the page: a held duty, or a controller at held references."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, final

import numpy as np

from ..control import AbstractController, bounds_of
from ..errors import ControlError
from ..io import Experiment
from ..live import Moment, RigConnection
from ..physics import Twin
from ..simulation import simulate
from ._desk import DriveOrder, HoldOrder, RunOrder

if TYPE_CHECKING:
    from ..control import Decision

# The longest time without a reading for a controller, s of the host. To a virtual rig that is ten
# times as fast an order takes seconds to check, and that must not look like a silence.
MAX_SILENCE_SECONDS = 3.0

Command: TypeAlias = Callable[[Moment], Sequence[float] | np.ndarray | None]
"""The duty at a moment since the order, -1 to 1; None ends the run."""


@final
class HeldDuty(NamedTuple):
    """A duty that is held for some seconds of the rig."""

    duty: tuple[float, ...]
    seconds: float

    def __call__(self, moment: Moment) -> Sequence[float] | None:
        return None if moment.time >= self.seconds else self.duty

    def simulated_plan(self) -> Experiment:
        """The duty that is held."""
        return Experiment([0.0, self.seconds], [self.duty, self.duty])


def compile_loop(twin: Twin, controller: AbstractController) -> None:
    """Compiles what an order to hold references needs, before a rig waits for it."""
    from ..control import LiveLoop  # which a page without a controller does not import

    # Where the middle of the allowed duty leads to is a point that can be held.
    lowest, highest = bounds_of(controller.for_rig(twin.rig).limits)
    middle = np.maximum((lowest + highest) / 2, twin.rig.lowest_duty)
    held = Experiment([0.0, controller.sample_time_s], np.tile(middle, (2, 1)))
    rest = simulate(twin, held, initial="steady").temperatures[-1]
    references = np.asarray(controller.output_weights(twin.channels)) @ rest
    LiveLoop(twin, controller, references, duration=controller.sample_time_s).simulated_plan()


@final
class HeldReferences:
    """A controller at the references of an order. It takes over from the command before it: from
    its own state if that was the same controller, otherwise from the duty that it finds. Its
    decisions are recorded.

    **Arguments:**

    - `connection`: the connection to the rig.
    - `twin`: the twin, for which the loop is checked.
    - `controller`: the controller; None: there is none.
    - `order`: the order.
    - `before`: the command until now.
    - `rate`: the seconds of the rig in one of the host.
    - `on_decision`: called with each sample of the controller.

    **Raises:** `ControlError` without a controller, and for references out of reach; the errors of
    `LiveLoop`.
    """

    def __init__(
        self,
        connection: RigConnection,
        twin: Twin,
        controller: AbstractController | None,
        order: HoldOrder,
        before: Command,
        rate: float,
        on_decision: "Callable[[Decision], None] | None" = None,
    ):
        if controller is None:
            raise ControlError("references: expected a server with --controller")
        from ..control import LiveLoop

        samples = max(round(order.seconds / controller.sample_time_s), 1)
        duration = samples * controller.sample_time_s
        silence = MAX_SILENCE_SECONDS * max(rate, 1.0)
        self._loop = LiveLoop(
            twin, controller, order.references, duration=duration, silence=silence
        )
        if isinstance(before, HeldReferences):
            self._loop.continue_from(before._loop)
        self.order = order
        """The order."""
        self._command = self._loop.recorded(connection, on_decision)

    def __call__(self, moment: Moment) -> np.ndarray | None:
        return self._command(moment)

    def simulated_plan(self) -> Experiment:
        """As that of its `LiveLoop`."""
        return self._loop.simulated_plan()


def plan_of(order: RunOrder) -> dict[str, Any]:
    """An order as a recording and the page keep it."""
    if isinstance(order, DriveOrder):
        return {"duty": order.duty, "duration_s": order.seconds}
    return {"references": order.references, "duration_s": order.seconds}


def described(order: RunOrder) -> str:
    """An order in words, behind "the rig is"."""
    if isinstance(order, DriveOrder):
        return f"driven with a duty of {', '.join(f'{100 * part:.0f} %' for part in order.duty)}"
    return f"held at {', '.join(f'{reference:g} °C' for reference in order.references)}"
