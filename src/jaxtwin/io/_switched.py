"""The switching of relays in an experiment: the duty of a heater as it is on and off."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..errors import RecordingError
from ..rig import RelayWindow, Rig
from ._experiment import Experiment
from ._schedule import MOST_SAMPLES


def switched(experiment: Experiment, rig: Rig) -> Experiment:
    """The experiment as the relays of a rig switch it; see `Experiment.switched`."""
    experiment = experiment.for_rig(rig)
    elapsed, levels = experiment.elapsed, {}
    for column, relay in rig.relays.items():
        windows = elapsed[-1] / relay.period
        if 2 * windows > MOST_SAMPLES:
            raise RecordingError(
                f"{experiment.name or 'the experiment'}: switched: expected at most "
                f"{MOST_SAMPLES} switches of {rig.driven[column]}, got {2 * windows:.2g} in "
                f"{elapsed[-1]:g} s with windows of {relay.period:g} s"
            )
        levels[column] = _switches(relay, elapsed, experiment.duty[:, column])
    marks = [at[(at > 0) & (at < elapsed[-1])] for at, _ in levels.values()]
    every = np.union1d(elapsed, np.concatenate([np.zeros(0), *marks]))
    # A switch within rounding of a sample is at this sample.
    row = np.clip(np.searchsorted(elapsed, every, side="right") - 1, 0, len(elapsed) - 1)
    is_near = np.isclose(every, elapsed[row], rtol=0, atol=1e-9) & (every != elapsed[row])
    every, row = every[~is_near], row[~is_near]
    duty = experiment.duty[row]
    for column, (at, on) in levels.items():
        duty[:, column] = on[np.searchsorted(at, every + 1e-9, side="right") - 1]
    is_sample = every == elapsed[row]
    temperatures, ambient = experiment.temperatures, experiment.ambient
    return replace(
        experiment,
        time=experiment.time[row] + (every - elapsed[row]),
        duty=duty,
        temperatures=None
        if temperatures is None
        else np.where(is_sample[:, None], temperatures[row], np.nan),
        ambient=ambient[row] if isinstance(ambient, np.ndarray) else ambient,
        inputs={name: values[row] for name, values in experiment.inputs.items()},
    )


def _switches(
    relay: RelayWindow, elapsed: Float[np.ndarray, " times"], duty: Float[np.ndarray, " times"]
) -> tuple[Float[np.ndarray, " switches"], Float[np.ndarray, " switches"]]:
    """The times at which a relay may switch, and whether it is on from then, 1 or 0."""
    starts = relay.period * np.arange(np.floor(elapsed[-1] / relay.period) + 1)
    held = duty[np.searchsorted(elapsed, starts + 1e-9, side="right") - 1]
    carried, times, levels = 0.0, [], []
    for start, level in zip(starts.tolist(), held.tolist(), strict=True):
        on, carried = relay.on_time(level, carried)
        times += [start, start + on]
        levels += [1.0 if on > 0 else 0.0, 1.0 if on >= relay.period else 0.0]
    return np.array(times), np.array(levels)
