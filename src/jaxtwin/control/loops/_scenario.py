"""The scenario of a closed loop: references, disturbances, and the errors of its readings."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy.typing import ArrayLike

from ..._arguments import finite_number, mapping_of, of_kind, true_or_false, whole_number
from ..._celsius import ZERO_CELSIUS
from ..._jax_settings import own_settings
from ..._name_suggestions import unknown_name
from ...errors import ControlError
from ...matching import Fit, nominal_twin
from ...physics import SHUTTER_SECONDS, Faults, Recalibrations, Twin, pixel_weights
from ...rig import Rig
from ...simulation import assembled, check_celsius
from ..controllers._controller import AbstractController
from ..controllers._function_controller import ControlFunction, as_controller
from ._disturbances import Disturbance, Draught, HeatInput, disturbance_tables
from ._loop_checks import check_cells, check_reach, check_sample_time
from ._references import reference_samples, sample_times

# Begin and end of each span, s. A span contains its begin, and not its end.
Spans = Float[np.ndarray, "_spans 2"]


def periodic_spans(every: float, length: float, until: float) -> Spans:
    """The spans of a length that begin at multiples of an interval, s; none if this is 0."""
    if every == 0:
        return np.zeros((0, 2))
    begins = every * np.arange(1, int(until / every) + 1)
    return np.column_stack([begins, begins + length])


def is_within(times: Float[np.ndarray, " times"], spans: Spans) -> Bool[np.ndarray, " times"]:
    """Whether each time is in one of the spans."""
    spans = _merged(spans, 0.0)
    return times < _last_span(times, spans)[:, 1]


def longest_silence(
    times: Float[np.ndarray, " samples"], spans: Spans, period: float
) -> Float[np.ndarray, " samples"]:
    """The longest time between two readings since the sample before, or until now if none has
    arrived, s.

    **Arguments:**

    - `times`: the times of the samples, s.
    - `spans`: the spans without a reading. `period`: the time between two readings outside of them,
      s.
    """
    spans = _merged(spans, period)
    last = _last_span(times, spans)
    silence = np.where(times < last[:, 1], times - last[:, 0] + period, 0.0)
    over = spans[spans[:, 1] <= times[-1]]
    np.maximum.at(silence, np.searchsorted(times, over[:, 1]), over[:, 1] - over[:, 0] + period)
    return silence


def _merged(spans: Spans, gap: float) -> Spans:
    """The spans in order, without overlaps. Those that are closer together than `gap` are one."""
    spans = spans[np.argsort(spans[:, 0])]
    ends = np.maximum.accumulate(spans[:, 1])
    is_apart = spans[1:, 0] >= ends[:-1] + gap * (1 - 1e-9)
    first = np.append(True, is_apart)[: len(spans)]
    last = np.append(is_apart, True)[: len(spans)]
    return np.column_stack([spans[first, 0], ends[last]])


def _last_span(times: Float[np.ndarray, " times"], spans: Spans) -> Float[np.ndarray, "times 2"]:
    """The last span that has begun at each time; an empty one before the first."""
    padded = np.concatenate([[[-np.inf, -np.inf]], spans])
    return padded[np.searchsorted(padded[:, 0], times, side="right") - 1]


# The frame rate of the camera, as in the virtual rig.
FRAMES_PER_SECOND = 9.0


class ReadingErrors(NamedTuple):
    """Errors of the channels at each sample.

    - `error`: `(samples, channels)`, K; NaN after a channel has failed.
    - `arrives`: whether a new reading arrives, `(samples,)`.
    - `silence`: the longest time between two complete frames since the sample before, or until now
      if none has arrived, `(samples,)`, s.
    """

    error: Float[np.ndarray, "samples channels"]
    arrives: Bool[np.ndarray, " samples"]
    silence: Float[np.ndarray, " samples"]


def reading_errors(
    where: str,
    rig: Rig,
    times: Float[np.ndarray, " samples"],
    *,
    noise: bool,
    faults: Faults,
    failed_channels: Mapping[str, float],
    seed: int,
) -> ReadingErrors:
    """Makes the errors of a camera, or of point sensors, like those of the virtual rig.

    **Arguments:**

    - `times`: times of the controller's samples, s.
    - `noise`: whether readings have the noise that the rig file states.
    - `faults`: faults of a virtual rig, of which `drop`, `jumps` and `stall` are used.
    - `failed_channels`: channel -> time from which it gives no reading, s.

    **Raises:** `ControlError` for a channel that the rig does not have, and for faults that a
    simulated loop cannot have.
    """
    names = tuple(channel.name for channel in rig.channels)
    if faults.rig or faults.corrupt or faults.disconnect:
        raise ControlError(
            f"{where}: faults: expected drop, jumps and stall, which a simulated loop has, got "
            f"{faults}; the others are those of jaxtwin virtual-rig"
        )
    if faults.jumps and rig.camera is None:
        raise ControlError(
            f"{where}: faults: jumps: expected a rig with a camera, got {rig.name}, which has "
            "none; leave out jumps"
        )
    random = np.random.default_rng(seed)
    error = np.zeros((len(times), len(names)))
    if noise:
        error += random.normal(size=error.shape) @ _noise_factor(rig).T
    interval = times[1] - times[0] if len(times) > 1 else 1.0
    frames = 1 if rig.camera is None else max(1, int(interval * FRAMES_PER_SECOND))
    # The newest of several frames counts, so that a reading is missing only if all are lost.
    lost = random.random(len(times)) < faults.drop**frames
    recalibrations = Recalibrations(faults.jumps, seed, rig.common_error)
    for sample, time in enumerate(times.tolist()):
        recalibrations.advance(time)
        error[sample] += recalibrations.offset(time)
    mapping_of(f"{where}: failed_channels", failed_channels, "channel -> time", ControlError)
    for name, start in failed_channels.items():
        if name not in names:
            raise ControlError(f"{where}: failed_channels: {unknown_name('channel', name, names)}")
        begin = finite_number(f"{where}: failed_channels: {name}", start, ControlError)
        error[times >= begin, names.index(name)] = np.nan
    stalls = periodic_spans(*(faults.stall or (0.0, 0.0)), times[-1])
    closings = periodic_spans(faults.jumps, SHUTTER_SECONDS, times[-1])
    silent = np.concatenate([stalls, closings])
    # The frames between the sample before and a sample whose frames are all lost, and all after the
    # failure of a channel.
    period = 1 / FRAMES_PER_SECOND
    missed = np.column_stack([np.append(0.0, times[:-1]), times])[lost] + period
    failed = np.array([[float(start), np.inf] for start in failed_channels.values()])
    incomplete = np.concatenate([silent, missed, failed.reshape(-1, 2)])
    return ReadingErrors(
        error=error,
        arrives=~lost & ~is_within(times, silent),
        silence=longest_silence(times, incomplete, period),
    )


def _noise_factor(rig: Rig) -> Float[np.ndarray, "channels channels"]:
    """F with F F^T the covariance of the channels' noise, K^2; zones share noise by pixels."""
    if rig.camera is None:
        return rig.noise * np.eye(len(rig.channels))
    weights = pixel_weights(rig).reshape(len(rig.channels), -1)
    values, vectors = np.linalg.eigh(weights @ weights.T)
    return rig.noise * vectors * np.sqrt(np.maximum(values, 0.0))


# The longest step of the plant, s. With a step of 1 s the error of the channels is some
# millikelvins.
MAX_STEP = 1.0


@final
class Scenario(eqx.Module):
    """The inputs of a closed loop, made by `jaxtwin.control.scenario`.

    A sample of the controller is followed by `substeps` steps of the plant. If a table has two
    leading axes, they are the samples and the steps in each sample.

    **Arguments:**

    - `time`: times of the samples, s. `reference`: references of the outputs, degC.
    - `output_weights`, `reading_weights`: weights of the channels in the controller's outputs, and
      in its measurement.
    - `initial`: initial temperatures of the nodes, degC.
    - `ambient`: ambient temperature, degC. `heat`, `conductance`: heat (W) and additional
      conductance (W/K) of disturbances; None for none.
    - `error`, `arrives`: errors of the readings, K, and whether a reading arrives. `silence`: the
      longest time without one since the sample before, s.
    - `step`: step of the plant, s. `longest_delay`: the longest delay of the driver, s.
    - `sensor_delay_steps`: the delay of the readings in steps.
    - `counts`: full duty in counts; None for a duty that is not quantised.
    - `silence_limit`: the cells are switched off for good after this time without a reading, s.
    - `room_is_measured`: whether a controller that reads the room gets the ambient temperature.
    """

    time: Float[Array | np.ndarray, " samples"]
    reference: Float[Array | np.ndarray, "samples outputs"]
    output_weights: Float[Array | np.ndarray, "outputs channels"]
    reading_weights: Float[Array | np.ndarray, "readings channels"]
    initial: Float[Array | np.ndarray, " nodes"] | None
    ambient: Float[Array | np.ndarray, "samples substeps"]
    heat: Float[Array | np.ndarray, "samples substeps nodes"] | None
    conductance: Float[Array | np.ndarray, "samples substeps nodes"] | None
    error: Float[Array | np.ndarray, "samples channels"]
    arrives: Bool[Array | np.ndarray, " samples"]
    silence: Float[Array | np.ndarray, " samples"]
    step: float = eqx.field(static=True)
    longest_delay: float = eqx.field(static=True)
    sensor_delay_steps: int = eqx.field(static=True)
    counts: int | None = eqx.field(static=True)
    silence_limit: float = eqx.field(static=True)
    room_is_measured: bool = eqx.field(static=True)

    @property
    def switched_off(self) -> float | None:
        """The time from which the cells are off for good, because no reading came for longer than
        the silence limit, s; None if they are controlled to the end."""
        silent = np.asarray(self.silence) > self.silence_limit
        return float(np.asarray(self.time)[np.argmax(silent)]) if silent.any() else None


def scenario(
    twin: Twin | Fit,
    controller: AbstractController | ControlFunction,
    references: float | int | str | ArrayLike,
    *,
    duration: float | int,
    initial: float | int | ArrayLike | None = None,
    ambient: float | int | str | ArrayLike | None = None,
    disturbances: Sequence[Disturbance] = (),
    noise: bool = True,
    faults: Faults | str = "",
    failed_channels: Mapping[str, float] | None = None,
    seed: int = 0,
    quantised: bool = True,
    sensor_delay: float | int = 0.0,
    silence: float | int = 3.0,
    room_is_measured: bool = False,
) -> Scenario:
    """Makes the scenario of a closed loop, for `closed_loop` and `simulate_closed_loop`.

    **Arguments:**

    - `twin`, `controller`, `references`, `duration`: as in `simulate_closed_loop`.
    - `initial`: the temperatures at the start, degC: a number for all nodes, or `(nodes,)`; None
      for those of the rig file.
    - `ambient`: the ambient temperature, degC: a number, text such as `"0:16,600:22"`, or
      `(samples,)`; None for that of the rig.
    - `disturbances`: each a `Draught` or a `HeatInput`.
    - `noise`: whether readings have the noise that the rig file states, the same in all draws.
    - `faults`: faults of camera and link in the words of `jaxtwin virtual-rig`, such as
      `"drop=0.01,jumps=164"` or `"stall=30/5"`. The same seed gives the same jumps.
    - `failed_channels`: channel -> time from which it reads NaN, s.
    - `seed`: the seed of noise and faults.
    - `quantised`: whether the duty is rounded to the driver's counts.
    - `sensor_delay`: the delay of the readings, s.
    - `silence`: the cells are switched off for the rest of the run after this time without a
      reading, s.
    - `room_is_measured`: whether a sensor without error gives the ambient temperature to a
      controller that reads it, such as an `MPC` with an observer.

    **Raises:** `ControlError` for an invalid argument, for a controller whose outputs or gains do
    not belong to the cells of the rig, for a reference out of reach, and for a sample time above
    the time constants of the plant.
    """
    where = "scenario"
    plant = nominal_twin(f"{where}: twin", twin, ControlError)
    chosen = as_controller(f"{where}: controller", controller, plant.rig)
    interval = chosen.sample_time_s
    times = sample_times(where, duration, interval)
    weights = np.asarray(chosen.output_weights(plant.channels), float)
    reference = reference_samples(f"{where}: references", references, times, len(weights))
    silence = finite_number(f"{where}: silence", silence, ControlError, least=0, unit="s")
    if isinstance(disturbances, Draught | HeatInput) or not isinstance(disturbances, Iterable):
        raise ControlError(
            f"{where}: disturbances: expected a list of Draught and HeatInput, got {disturbances!r}"
        )
    is_quantised = true_or_false(f"{where}: quantised", quantised, ControlError)
    is_measured = true_or_false(f"{where}: room_is_measured", room_is_measured, ControlError)
    if is_measured and not chosen.reads_room:
        raise ControlError(
            f"{where}: room_is_measured: expected a controller that reads the room, such as an MPC "
            "or an LQI with an observer, design_mpc(..., "
            f"observer=jaxtwin.observers.live_observer(twin)), got {chosen}"
        )
    if isinstance(faults, str):
        faults = Faults.parse(faults)
    expected = "text such as 'drop=0.01,jumps=164', or Faults"
    of_kind(f"{where}: faults", faults, Faults, expected, ControlError)
    # Rounding must not add a step to a whole number of steps.
    substeps = max(1, math.ceil(interval / MAX_STEP * (1 - 1e-9)))
    step = interval / substeps
    with own_settings():
        system = assembled(plant)
        room = float(system.ambient_temperature) - ZERO_CELSIUS
        delay = 0.0 if system.delay is None else float(system.delay)
        rows = (times[:, None] + step * np.arange(substeps)).reshape(-1)
        if isinstance(ambient, str):  # its times need not be those of the samples
            surroundings = reference_samples(f"{where}: ambient", ambient, rows, 1)
        else:
            held = room if ambient is None else ambient
            at_samples = reference_samples(f"{where}: ambient", held, times, 1)
            surroundings = np.repeat(at_samples, substeps, axis=0)
        surroundings = surroundings.reshape(len(times), substeps)
        _check_above_absolute_zero(f"{where}: ambient", surroundings)
        check_cells(where, chosen, plant.rig, len(weights))
        check_sample_time(system, interval)
        check_reach(system, weights, reference, times, surroundings, chosen.limits)
    late = finite_number(f"{where}: sensor_delay", sensor_delay, ControlError)
    late_steps = round(late / step)
    if late < 0 or not math.isclose(late_steps * step, late, abs_tol=1e-9):
        raise ControlError(
            f"{where}: sensor_delay: expected a multiple of the step of the plant, {step:g} s, "
            f"of at least 0, got {late:g} s"
        )
    errors = reading_errors(
        where,
        plant.rig,
        times,
        noise=true_or_false(f"{where}: noise", noise, ControlError),
        faults=faults,
        failed_channels={} if failed_channels is None else failed_channels,
        seed=whole_number(f"{where}: seed", seed, 0, ControlError),
    )
    heat = conductance = None
    if disturbances:
        tables = disturbance_tables(where, plant, disturbances, rows)
        heat, conductance = (table.reshape(len(times), substeps, -1) for table in tables)
    return Scenario(
        time=times,
        reference=reference,
        output_weights=weights,
        reading_weights=np.asarray(chosen.reading_weights(plant.channels), float),
        initial=_initial(where, plant, initial),
        ambient=surroundings,
        heat=heat,
        conductance=conductance,
        error=errors.error,
        arrives=errors.arrives,
        silence=errors.silence,
        step=step,
        longest_delay=delay,
        sensor_delay_steps=late_steps,
        counts=plant.rig.driver.counts if is_quantised else None,
        silence_limit=silence,
        room_is_measured=is_measured,
    )


def _initial(where: str, twin: Twin, initial: object) -> Float[np.ndarray, " nodes"] | None:
    if initial is None:
        return None
    count = len(twin.netlist.nodes)
    try:
        values = np.broadcast_to(np.asarray(initial, float), (count,)).copy()
        if not np.isfinite(values).all():
            raise ValueError
    except (TypeError, ValueError):
        raise ControlError(
            f"{where}: initial: expected a temperature, or one for each of the {count} nodes, in "
            f"degC, got {initial!r}"
        ) from None
    _check_above_absolute_zero(f"{where}: initial", values)
    check_celsius(f"{where}: initial", values, twin, ControlError)
    return values


def _check_above_absolute_zero(where: str, temperatures: Float[np.ndarray, "..."]) -> None:
    if temperatures.min() < -ZERO_CELSIUS:
        raise ControlError(
            f"{where}: expected {-ZERO_CELSIUS:g} degC and above, got {temperatures.min():g} degC"
        )
