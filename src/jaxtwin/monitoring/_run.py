"""A monitor over all samples of a recording."""

import jax
import numpy as np

from .._compilation import persistent_jit
from .._jax_settings import own_settings
from .._padded_rows import first_rows, padded_rows
from ..observers import Observed
from ._evidence import Evidences, Seen, seen
from ._monitor import Monitor, MonitorState


def evidences_of(monitor: Monitor, observed: Observed) -> Evidences:
    """What the tests say at each sample of an observed recording, in NumPy."""
    is_sample = np.asarray(observed.is_sample)
    states = jax.tree.map(lambda leaf: np.asarray(leaf)[is_sample], observed.filtered.states)
    expected = np.asarray(observed.filtered.expected)[is_sample]
    experiment = observed.experiment
    readings = np.asarray(experiment.temperatures)
    ambient = np.asarray(observed.samples.ambient)[is_sample]
    dt = np.diff(observed.time, prepend=observed.time[0])
    with own_settings():
        samples = seen(states, expected, readings, ambient, dt)
        return first_rows(_monitored(monitor, padded_rows(samples)), len(dt))


def run(monitor: Monitor, samples: Seen) -> Evidences:
    """What the tests say at each of several samples, as a function that can be transformed."""

    def take(state: MonitorState, sample: Seen) -> tuple[MonitorState, Evidences]:
        return monitor.step(state, sample)

    return jax.lax.scan(take, monitor.init(), samples)[1]


# The same as a program of its own.
_monitored = persistent_jit(run)
