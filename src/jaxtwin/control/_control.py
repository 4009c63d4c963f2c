"""A controller on a live rig, behind all interlocks."""

import threading
from collections.abc import Callable, Mapping
from typing import Any, Literal, final

import jax
import numpy as np
from jaxtyping import Array, Float, PyTree

from .._compilation import persistent_jit
from .._errors import SafetyStop
from .._jax_settings import own_settings
from ..live import Bench, Document, Moment, operate
from ..physics import Twin
from ._controller import AbstractController
from ._reach import check_reach, check_sample_time
from ._references import reference_samples, references_ahead, sample_times
from ._stability import check_stability

NEXT_SAMPLE = 1e-6
"""A moment so short before a sample counts as the sample, s."""


def control(
    bench: Bench,
    twin: Twin,
    controller: AbstractController,
    references: object,
    *,
    duration_s: float | int,
    silence: float | int = 3.0,
    reset: bool = False,
    about: Mapping[str, Any] | None = None,
    stop: threading.Event | None = None,
    on_progress: Callable[[float, tuple[int, ...]], None] | None = None,
) -> Literal["completed", "stopped"]:
    """Runs a controller on a live rig; the cells are off when it returns, however it returns.

    The controller takes its samples in the time of the rig. Its decisions are in the recording,
    beside the readings: a document of the kind `decision` for each sample, with time, references,
    measurements and duty.

    **Arguments:**

    - `bench`: its links, started.
    - `twin`: of the rig, whose file must state `limits.temperature`; its interlocks ask it.
    - `controller`: what commands the cells.
    - `references`: as in `simulate_closed_loop`.
    - `duration_s`: after which it ends, s of the rig: a multiple of the sample time.
    - `silence`, `reset`, `about`, `stop`, `on_progress`: as in `jaxtwin.live.operate`.

    **Returns:** whether it came to its end, or was stopped.

    **Raises:** `SafetyStop` when an interlock trips, the rig does not come up, or the controller
    asks for something that is no duty; `ControlError`, before anything is sent, for references
    that are none or are out of reach, a sample time above the rig's time constants, and a PID, a
    `DecoupledPI`, an `LQI` or an `MPC` whose loop with the twin is not stable.
    """
    loop = LiveLoop(
        bench, twin, controller, references, duration_s=duration_s, silence_s=float(silence)
    )
    plan = {"references": loop.text, "duration_s": float(duration_s)}
    return operate(
        bench,
        twin,
        loop,
        silence=silence,
        reset=reset,
        about={"control": plan, **(about or {})},
        stop=stop,
        on_progress=on_progress,
    )


def checked_loop(
    twin: Twin, controller: AbstractController, references: Any, duration_s: float | int
) -> Float[np.ndarray, "samples outputs"]:
    """The references at the samples of a loop that may run on a rig, degC.

    **Raises:** `ControlError` for references that are none or are out of reach, a sample time above
    the rig's time constants, a duration that is no multiple of it, or a loop that is not stable.
    """
    weights = np.asarray(controller.output_weights(twin.channels), float)
    times = sample_times("control", duration_s, controller.sample_time_s)
    samples = reference_samples("control: references", references, times, len(weights))
    with own_settings():
        system = twin.system()
        room = float(system.ambient_temperature) - 273.15
        check_sample_time(twin, controller.sample_time_s)
        limits = getattr(controller, "limits", (-1.0, 1.0))
        check_reach(system, weights, samples, times, np.full((1, 1), room), limits)
        check_stability(twin, controller, weights, samples)
    return samples


@final
class LiveLoop:
    """A controller as what `operate` asks for the duty.

    Between two samples the duty stands; where the rig was not asked for longer than that, the
    samples in between are left out. A channel without a number never reaches the controller: the
    last reading stands for it, and after `silence_s` without any the run is stopped, as in
    `simulate_closed_loop`. Before the first reading the cells stay off. (The interlocks of
    `operate` do not wait: a channel that says that it has failed stops a rig at the next frame.)

    **Arguments:** those of `control`, and

    - `silence_s`: longest time without a reading, s of the rig.
    """

    def __init__(
        self,
        bench: Bench,
        twin: Twin,
        controller: AbstractController,
        references: object,
        *,
        duration_s: float | int,
        silence_s: float = 3.0,
    ):
        self.text = references if isinstance(references, str) else np.asarray(references).tolist()
        self._bench, self._controller = bench, controller
        self._duration = float(duration_s)
        self._weights = np.asarray(controller.output_weights(twin.channels), float)
        self._references = checked_loop(twin, controller, references, duration_s)
        self._ahead = references_ahead(self._references, controller.preview_samples)
        with own_settings():
            # Compiled now: a rig that is connected sends, and nobody would listen.
            off = np.zeros(len(twin.rig.cells))
            still = self._references[0]
            self._state: Any = jax.tree.map(np.asarray, controller.init(off, still))
            _step(controller, self._state, self._ahead[0], still)
        self._silence = silence_s
        self._sample: int | None = None
        self._seen: tuple[float, Float[np.ndarray, " outputs"]] | None = None
        self._duty = np.zeros(len(twin.rig.cells))

    def __call__(self, moment: Moment) -> Float[np.ndarray, " cells"] | None:
        """The duty now; None at the end."""
        if moment.time >= self._duration - NEXT_SAMPLE:
            return None
        sample = int((moment.time + NEXT_SAMPLE) / self._controller.sample_time_s)
        if self._sample is not None and sample <= self._sample:
            return self._duty
        measurement = self._measured(moment)
        if measurement is None:
            return self._duty
        with own_settings():
            if self._sample is None:
                begun = self._controller.init(np.asarray(moment.duty, float), measurement)
                self._state = jax.tree.map(np.asarray, begun)
            asked, state = _step(self._controller, self._state, self._ahead[sample], measurement)
            self._state = jax.tree.map(np.asarray, state)
        duty = np.asarray(asked, float)
        if duty.shape != self._duty.shape or not np.isfinite(duty).all():
            raise SafetyStop(f"stopped: the controller asked for duty {duty}", "controller")
        self._sample, self._duty = sample, np.clip(duty, -1.0, 1.0)
        content = {
            "time": moment.time,
            "reference": self._references[sample].tolist(),
            "measurement": measurement.tolist(),
            "duty": self._duty.tolist(),
        }
        bench = self._bench
        bench.note(Document(bench.clock.now(), "decision", "control", content))
        return self._duty

    def _measured(self, moment: Moment) -> Float[np.ndarray, " outputs"] | None:
        """The outputs now, or as they were last read; None where nothing was read yet.

        **Raises:** `SafetyStop` after too long without a reading.
        """
        temperatures = np.asarray(moment.temperatures, float)
        if np.isfinite(temperatures).all():
            self._seen = moment.time, self._weights @ temperatures
        last, measurement = (0.0, None) if self._seen is None else self._seen
        if moment.time - last > self._silence:
            raise SafetyStop(
                "stopped: the controller has had no reading of what it controls for "
                f"{moment.time - last:.1f} s",
                "controller",
            )
        return measurement


@persistent_jit
def _step(
    controller: AbstractController,
    state: PyTree,
    reference: Float[Array | np.ndarray, "*preview outputs"],
    measurement: Float[Array | np.ndarray, " outputs"],
) -> tuple[Float[Array, " cells"], PyTree]:
    return controller.step(state, reference, measurement)
