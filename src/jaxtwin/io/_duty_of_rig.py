"""What an experiment drives of a rig: its columns of duty in the order of the rig, and checks that
they belong to its cells and heaters, that no heater is asked to cool, and that the rig has its
inputs."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..errors import JaxtwinError, RecordingError
from ..rig import RelayWindow, Rig
from ._experiment import Experiment
from ._schedule import MOST_SAMPLES


def of_rig(experiment: Experiment, rig: Rig, label: str, error: type[JaxtwinError]) -> Experiment:
    """The experiment with its columns of duty in the order of a rig, and with the names of its
    cells and heaters. One without names is in this order; one with another number of columns stays
    as it is.

    **Arguments:**

    - `label`: the experiment in messages.

    **Raises:** `error` if the rig has other cells and heaters.
    """
    driven = rig.driven
    if experiment.cells == driven or experiment.n_cells != len(driven):
        return experiment
    called = [rig.driven_called(name) for name in experiment.cells] or [*driven]
    if set(called) != set(driven):
        raise error(
            f"{label}: duty: expected columns of {', '.join(driven)}, as {rig.name} calls its "
            f"cells and heaters, got {', '.join(experiment.cells)}"
        )
    columns = [called.index(name) for name in driven]
    return replace(experiment, duty=experiment.duty[:, columns], cells=driven)


def check_duty_of_rig(
    experiment: Experiment, rig: Rig, label: str, error: type[JaxtwinError]
) -> None:
    """Refuses an experiment that does not drive what a rig has.

    **Arguments:**

    - `label`: the experiment in messages.

    **Raises:** `error` if it drives another number of cells and heaters, a heater is to cool, or it
    states an input that the rig does not have.
    """
    if experiment.n_cells != len(rig.driven):
        parts = [
            f"{len(group)} {name}{'s' * (len(group) != 1)}"
            for group, name in ((rig.cells, "cell"), (rig.heaters, "heater"))
            if group
        ]
        raise error(
            f"{label}: duty: expected the {' and '.join(parts)} of {rig.name}, got "
            f"{experiment.n_cells}; Experiment.schedule(..., cells={len(rig.driven)}) has a duty "
            "for each of them"
        )
    ordered = of_rig(experiment, rig, label, error)
    if not np.array_equal(ordered.duty, experiment.duty):
        raise error(
            f"{label}: duty: expected the order of {rig.name}, {', '.join(rig.driven)}, got "
            f"{', '.join(experiment.cells)}; Experiment.for_rig(rig) puts the columns in this order"
        )
    check_heats_only(experiment, rig, label, error)
    known = [rig_input.name for rig_input in rig.inputs]
    for name in experiment.inputs:
        if name not in known:
            raise error(
                f"{label}: inputs: expected those of {rig.name}, {', '.join(known) or 'none'}, got "
                f"{name!r}"
            )


def check_heats_only(
    experiment: Experiment, rig: Rig, label: str, error: type[JaxtwinError]
) -> None:
    """Refuses an experiment that asks a heater of a rig to cool.

    **Raises:** `error` that names the column and the time.
    """
    columns = zip(rig.driven, rig.lowest_duty, experiment.duty.T, strict=False)
    for name, lowest, duty in columns:
        (cools,) = np.nonzero(duty < lowest)
        if cools.size:
            first = cools[0]
            raise error(
                f"{label}: duty_{name}: expected 0 to 1, because the heater {name!r} cannot "
                f"cool, got {duty[first]:.10g} at {experiment.time[first]:.10g} s"
            )


# The switching of relays in an experiment: the duty of a heater as it is on and off.


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
