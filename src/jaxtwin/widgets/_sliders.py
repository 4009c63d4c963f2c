"""Sliders for the parameters and the duty of a twin."""

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, NamedTuple, TypeVar, final

import numpy as np
import traitlets

from .._name_suggestions import unknown_name
from ..errors import ParameterError
from ..io import Experiment
from ..matching import Fit
from ..physics import Twin
from ..rig import Parameter
from ..serve._contents import rounded
from ..serve._rig_layout import rig_layout
from ..simulation import Run, simulate, twin_of_experiment
from ._notebook_widget import NotebookWidget

Request = TypeVar("Request")


@final
class NewestRequest(Generic[Request]):
    """Answers requests in a thread of its own. Of those that come while it is at work only the
    newest is answered: a slider that moves asks more often than anybody can compute.

    **Arguments:**

    - `answer`: called with a request.
    """

    def __init__(self, answer: Callable[[Request], None]):
        self._answer = answer
        self._waiting: list[Request] = []
        self._changed = threading.Condition()
        self._is_open = True
        # A thread that ends with the process.
        self._thread = threading.Thread(target=self._work, name="jaxtwin sliders", daemon=True)
        self._thread.start()

    def ask(self, request: Request) -> None:
        """Leaves a request, in the place of one that waits."""
        with self._changed:
            self._waiting = [request]
            self._changed.notify()

    def close(self) -> None:
        """Ends the thread after the request at which it works."""
        with self._changed:
            self._is_open = False
            self._changed.notify()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or not self._is_open)
                if not self._is_open:
                    return
                request = self._waiting.pop()
            self._answer(request)


# How far a slider goes from the given value, unless the bounds are nearer.
RANGE_FACTOR = 4.0

# The largest number of samples that are drawn, and that of a run at held duty.
MAX_POINTS = 501

# The duty at which its sliders begin.
HELD_DUTY = 0.5


class SliderRequest(NamedTuple):
    """What the sliders say: values of parameters in their own units, and duty, -1 to 1."""

    values: Mapping[str, float]
    duty: Sequence[float]


@final
class Sliders(NotebookWidget):
    """Sliders for the parameters of a twin. Its channels, its plate and what remains of a recording
    follow while one moves.

    **Arguments:**

    - `twin`: the twin; or a fit, whose twin for the experiment is taken.
    - `experiment`: what is simulated, and compared with its recording if it has one. None: a run
      from the start of the rig file, with a slider for the duty of each cell and heater.
    - `names`: the parameters that get sliders; None: those that a match may change.
    - `duration`: that of a run without an experiment, s.

    `values` are those of the sliders, in the units of the rig file, and may be set. So may `duty`,
    -1 to 1, which is empty where an experiment says it. `twin` is the twin with these values, for
    example as the start of a match.

    **Raises:** `ParameterError` for a parameter that the rig does not have; `SimulationError` or
    `RecordingError` if experiment and rig do not match; `JaxtwinError` without anywidget.
    """

    _newest: NewestRequest[SliderRequest] | None = None  # None: the constructor has raised
    about = traitlets.Dict().tag(sync=True)
    values = traitlets.Dict().tag(sync=True)
    duty = traitlets.List().tag(sync=True)

    def __init__(
        self,
        twin: Twin | Fit,
        experiment: Experiment | None = None,
        names: Sequence[str] | None = None,
        *,
        duration: float | int = 1000.0,
    ):
        rig = twin.twin.rig if isinstance(twin, Fit) else twin.rig
        held = [] if experiment is not None else [HELD_DUTY] * len(rig.driven)
        time = np.linspace(0.0, float(duration), MAX_POINTS)
        ran = (experiment or Experiment(time, np.tile(held, (MAX_POINTS, 1)))).for_rig(rig)
        chosen_twin = twin_of_experiment(twin, ran)
        first = simulate(chosen_twin, ran)  # compiles, and refuses what does not fit
        rows = rig.parameters
        chosen = [name for name, row in rows.items() if row.free] if names is None else list(names)
        for name in chosen:
            if name not in rows:
                raise ParameterError(f"{rig.name}: {unknown_name('parameter', name, rows)}")
        given = {name: float(chosen_twin.values[name]) for name in chosen}
        layout = rig_layout(chosen_twin)
        super().__init__("sliders")
        self._experiment, self._given = ran, chosen_twin
        self.about = {
            **layout,
            "channels": [
                channel for channel in layout["channels"] if channel["name"] in first.channels
            ],
            "parameters": [_slider(rows[name], value) for name, value in given.items()],
            "recorded": self._experiment.temperatures is not None,
            "duration": float(self._experiment.time[-1] - self._experiment.time[0]),
        }
        self.values, self.duty = given, held
        self._newest = NewestRequest(self._answer)
        self.observe(lambda _: self._ask(), ["values", "duty"])

    @property
    def twin(self) -> Twin:
        """The twin with the values of the sliders."""
        return self._given.with_values(self.values)

    def on_request(self, content: Mapping[str, Any]) -> None:
        """Draws everything for a view that begins."""
        recorded = self._experiment.temperatures
        at = self._drawn
        rows = None if recorded is None else rounded(recorded[at].T)
        self.show("recording", {"time": rounded(self._experiment.time[at]), "measured": rows})
        self._ask()

    def close(self) -> None:
        """Ends the thread, and removes the views."""
        if self._newest is not None:
            self._newest.close()
        super().close()

    @traitlets.validate("values")
    def _checked_values(self, proposal: Any) -> dict[str, float]:
        values = {name: float(value) for name, value in proposal["value"].items()}
        self._given.with_values(values)
        return {**self.values, **values}  # those that are not named stay

    @property
    def _drawn(self) -> np.ndarray:
        """The samples that are drawn."""
        count = len(self._experiment.time)
        return np.unique(np.linspace(0, count - 1, min(count, MAX_POINTS)).round().astype(int))

    def _ask(self) -> None:
        assert self._newest is not None
        self._newest.ask(SliderRequest(dict(self.values), list(self.duty)))

    def _answer(self, request: SliderRequest) -> None:
        """Simulates the newest values, in the thread of `NewestRequest`."""
        experiment = self._experiment
        try:
            if request.duty:
                duty = np.tile(np.asarray(request.duty, float), (len(experiment.time), 1))
                experiment = Experiment(experiment.time, duty)
            run = simulate(self._given.with_values(request.values), experiment)
        except Exception as error:  # the thread has to go on, and nobody else would say it
            self.show("problem", str(error))
            return
        self._draw(run)

    def _draw(self, run: Run) -> None:
        at = self._drawn
        tables = [run.temperatures[at].T, run.experiment.duty[at].T, run.states[at, : run.elements]]
        has_recording = run.experiment.temperatures is not None
        self.show(
            "run",
            {
                "samples": len(at),
                "rmse": run.rmse if has_recording else None,
                "fit": {k: round(v, 1) for k, v in run.fit_percent.items()}
                if has_recording
                else {},
            },
            [np.ascontiguousarray(table, np.float32).tobytes() for table in tables],
        )


def _slider(parameter: Parameter, value: float) -> dict[str, Any]:
    """A slider's range: of the logarithm, a factor to both sides, or of the value itself."""
    middle = parameter.to_entry(value)
    if parameter.is_logarithmic:
        reach = math.log(RANGE_FACTOR)
    else:
        spread = parameter.standard_deviation
        reach = 3 * spread if spread else max(abs(value), 1.0)
    low, high = (
        parameter.to_entry(bound) if math.isfinite(bound) else bound
        for bound in (parameter.lower, parameter.upper)
    )
    return {
        "name": parameter.name,
        "description": parameter.description,
        "unit": parameter.unit,
        "value": value,
        "logarithmic": parameter.is_logarithmic,
        "low": max(middle - reach, low),
        "high": min(middle + reach, high),
    }
