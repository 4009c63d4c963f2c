"""The monitor of a rig: tests of what an observer says at each sample."""

import math
from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..observers import ExtendedKalmanFilter
from ..observers._augmented_model import AugmentedModel
from ._channel_tests import ChannelState, ChannelTests
from ._evidence import Evidences, Seen
from ._innovation_tests import RESET_SCORE, InnovationState, InnovationTests
from ._response import Response
from ._shift_test import ShiftState, ShiftTest
from ._state_test import SlowState, StateTest, main_parameters
from ._thresholds import FAMILIES, MonitorCalibration

# An observer needs this time to find the rig, s; of innovations and states nothing is said before.
SETTLE = 120.0


@final
class MonitorState(eqx.Module):
    """Where a monitor is between two samples.

    - `elapsed`: the time since the first sample, s. The others: where its tests are.
    """

    elapsed: Float[Array, ""]
    innovations: InnovationState
    slow: SlowState
    channels: ChannelState
    shift: ShiftState


@final
class Monitor(eqx.Module):
    """Tests each sample of an observed rig. `init` and `step` are pure functions of arrays, and run
    under `jit`, `vmap` and `scan`; `jaxtwin.monitor` runs them over a recording, and `LiveMonitor`
    beside a rig.

    **Arguments:**

    - `observer`: the filter that observes the rig.
    - `calibration`: what is healthy.
    - `response`: how a driven cell shows in the channels.
    - `seconds`: the mean time between two false alarms, s; None: all thresholds are 1, so that
      scores are the statistics themselves.
    """

    innovations: InnovationTests
    states: StateTest
    channels: ChannelTests
    shift: ShiftTest

    def __repr__(self) -> str:
        return f"<Monitor of {len(self.innovations.scales)} channels>"

    def __init__(
        self,
        observer: ExtendedKalmanFilter,
        calibration: MonitorCalibration,
        response: Response,
        seconds: float | int | None,
    ):
        model, names = observer.model, channels_of(observer.model)
        table = {} if seconds is None else calibration.for_seconds(seconds)
        limits = np.array([table.get(family, 1.0) for family in FAMILIES])
        self.innovations = InnovationTests(
            scales=np.array([calibration.scales.get(name, 1.0) for name in names]),
            memory=np.array([calibration.memory.get(name, 0.0) for name in names]),
            thresholds=limits[:4],
            enough=np.array(math.inf if seconds is None else RESET_SCORE),
            interval=model.interval,
        )
        self.states = StateTest(model, np.array(main_parameters(model), int), limits[4:])
        still = np.array([calibration.still.get(name, math.inf) for name in names])
        self.channels = ChannelTests(model, response, still)
        self.shift = ShiftTest(model, calibration.references)

    @property
    def model(self) -> AugmentedModel:
        """The model of the observer."""
        return self.states.model

    @property
    def thresholds(self) -> dict[str, float]:
        """Family -> threshold."""
        both = np.concatenate([self.innovations.thresholds, self.states.thresholds])
        return dict(zip(FAMILIES, both.tolist(), strict=True))

    def init(self) -> MonitorState:
        """The state before the first sample."""
        return MonitorState(
            elapsed=jnp.zeros(()),
            innovations=self.innovations.init(),
            slow=self.states.init(),
            channels=self.channels.init(),
            shift=self.shift.init(),
        )

    def step(self, state: MonitorState, seen: Seen) -> tuple[MonitorState, Evidences]:
        """The state after a sample, and what all tests say of it."""
        dt = jnp.asarray(seen.dt, state.elapsed.dtype)
        elapsed = state.elapsed + dt
        settled = elapsed >= SETTLE
        innovations, of_innovations = self.innovations.step(state.innovations, seen, dt, settled)
        slow, of_states = self.states.step(state.slow, seen, dt, settled)
        channels, of_channels = self.channels.step(state.channels, seen, dt)
        shift, of_shift = self.shift.step(state.shift, seen, dt, settled)
        after = MonitorState(elapsed, innovations, slow, channels, shift)
        return after, Evidences(*of_innovations, *of_states, *of_channels, of_shift)


def channels_of(model: AugmentedModel) -> tuple[str, ...]:
    """The names of the channels that are read."""
    return tuple(model.twin.channels[column] for column in np.asarray(model.columns))
