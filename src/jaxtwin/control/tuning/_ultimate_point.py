r"""Computes the critical point of a plant from an oscillation under relay feedback, and a
controller.

The fundamental waves of duty and output over whole periods give the response of the plant at the
frequency of the oscillation, $G(j \omega) = Y / U$. Other harmonics do not enter, and noise is
averaged out. With a small hysteresis the phase of $G$ is -180 degrees, and $1 / |G|$ is the
ultimate gain, the proportional gain at which the loop would oscillate.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, final, get_args

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from ..._arguments import true_or_false, whole_number
from ..._result import AbstractResult, dataset, table
from ...errors import ControlError
from ..controllers._pid import PID
from ..loops._closed_loop_run import ClosedLoopRun
from ..loops._control import Decision

if TYPE_CHECKING:
    import pandas
    import xarray

Rule: TypeAlias = Literal["tyreus-luyben", "ziegler-nichols"]

# (Rule, with derivative) -> Kp per ultimate gain, and integral and derivative time per ultimate
# period (Tyreus and Luyben, Ind. Eng. Chem. Res. 31 (1992) 2625; Luyben and Luyben, *Essentials of
# Process Control*, 1997; Ziegler and Nichols, Trans. ASME 64 (1942) 759).
_RULES: dict[tuple[str, bool], tuple[float, float, float]] = {
    ("tyreus-luyben", False): (1 / 3.2, 2.2, 0.0),
    ("tyreus-luyben", True): (1 / 2.2, 2.2, 1 / 6.3),
    ("ziegler-nichols", False): (0.45, 1 / 1.2, 0.0),
    ("ziegler-nichols", True): (0.6, 0.5, 0.125),
}

# Field of an `UltimatePoint` -> unit.
_UNITS = {"gain": "1/K", "period_s": "s", "phase_deg": "deg", "amplitude": "K", "cycles": "1"}

# The time constant of the derivative's filter per derivative time.
FILTER_RATIO = 1 / 8

# The relative difference that periods may have; two samples more are always allowed.
PERIOD_TOLERANCE = 0.15

# The longest time without a sample, in periods.
MAX_GAP = 0.25

# The change of the mean from period to period that is allowed, relative to the oscillation's
# height.
LEVEL_TOLERANCE = 0.15


@final
@dataclass(frozen=True)
class UltimatePoint(AbstractResult):
    """The response of a plant at its critical frequency.

    - `gain`: the ultimate gain, 1/K. `period_s`: the period of the oscillation, s.
    - `phase_deg`: the phase of the plant, degrees; -180 without hysteresis.
    - `amplitude`: the amplitude of the output's fundamental wave, K.
    - `cycles`: the number of periods that were evaluated.
    """

    gain: float
    period_s: float
    phase_deg: float
    amplitude: float
    cycles: int

    def to_dataframe(self) -> "pandas.DataFrame":
        """A table with a row for each number: its name as index, value and unit."""
        rows = [(name, getattr(self, name), unit) for name, unit in _UNITS.items()]
        return table(rows, "name", columns=["name", "value", "unit"])

    def to_xarray(self) -> "xarray.Dataset":
        """Returns a dataset with a variable for each number, and its unit in the attributes."""
        return dataset({name: ("", getattr(self, name), unit) for name, unit in _UNITS.items()}, {})

    def pid(self, rule: Rule = "tyreus-luyben", *, derivative: bool = True, **settings: Any) -> PID:
        """Makes a PID by a tuning rule.

        **Arguments:**

        - `rule`: the rule of Tyreus and Luyben, which is cautious, or that of Ziegler and Nichols,
          whose loops overshoot by half.
        - `derivative`: whether the controller has a derivative part.
        - `settings`: the further keywords of `PID`, such as `limits` and `measured`.

        **Raises:** `ControlError` for another rule.
        """
        if rule not in get_args(Rule):
            raise ControlError(
                f"UltimatePoint.pid: rule: expected one of {', '.join(get_args(Rule))}, got "
                f"{rule!r}"
            )
        has_derivative = true_or_false("UltimatePoint.pid: derivative", derivative, ControlError)
        gain, integral, lead = _RULES[rule, has_derivative]
        Kp, Td = gain * self.gain, lead * self.period_s
        Ki = Kp / (integral * self.period_s)
        return PID(Kp=Kp, Ki=Ki, Kd=Kp * Td, Tf=FILTER_RATIO * Td, **settings)


def ultimate_point(
    run: ClosedLoopRun | Sequence[Decision] | tuple[ArrayLike, ArrayLike, ArrayLike],
    *,
    cycles: int = 3,
) -> UltimatePoint:
    """Computes the critical frequency and gain of a plant from a run with a `Relay`.

    **Arguments:**

    - `run`: the result of `simulate_closed_loop` with a `Relay`; or the decisions of
      `jaxtwin.control.control`; or times (s, `(times,)`), measured outputs (degC, `(times,)` or
      `(times, 1)`) and duty cycles (`(times,)` or `(times, cells)`). On a rig, samples come late or
      are left out; each counts for the time until the next one.
    - `cycles`: the number of periods, from the end, that are evaluated.

    **Raises:** `ControlError` if the run has fewer periods, if the oscillation still drifts, or if
    samples are missing in it for more than a quarter of a period.
    """
    count = whole_number("ultimate_point: cycles", cycles, 1, ControlError)
    time, output, duty = _arrays(run)
    changes = np.diff(duty)
    ups = 1 + np.flatnonzero(changes > 0.5 * np.abs(changes).max()) if changes.any() else []
    if len(ups) < count + 1:
        raise ControlError(
            f"ultimate_point: run: expected at least {count} whole periods of the relay, got "
            f"{max(len(ups) - 1, 0)}; {_advice(time, duty)}"
        )
    ups = ups[-count - 1 :]
    periods = np.diff(time[ups])
    whole = slice(ups[0], ups[-1])
    steps = np.diff(time[ups[0] : ups[-1] + 1])
    usual = float(np.median(steps))
    if steps.max() > max(MAX_GAP * periods.mean(), 1.5 * usual):
        raise ControlError(
            "ultimate_point: run: expected samples through the whole oscillation, got none for "
            f"{steps.max():.3g} s of a period of {periods.mean():.3g} s"
        )
    pieces = [slice(a, b) for a, b in pairwise(ups)]
    levels = np.array(
        [np.average(output[p], weights=np.diff(time[p.start : p.stop + 1])) for p in pieces]
    )
    height = float(np.mean([np.ptp(output[piece]) for piece in pieces]))
    _check_drift(periods, levels, height, usual)
    omega = 2 * np.pi / periods.mean()
    wave = np.exp(-1j * omega * time[whole])

    def fundamental(values: Float[np.ndarray, " times"]) -> complex:
        # The mean is subtracted, because with unequal steps it would contribute to each wave.
        swing = values[whole] - np.average(values[whole], weights=steps)
        return complex(2 * np.average(swing * wave, weights=steps))

    Y, U = fundamental(output), fundamental(duty)
    response = Y / U
    phase = float(np.degrees(np.angle(response)))
    return UltimatePoint(
        gain=float(1 / abs(response)),
        period_s=float(periods.mean()),
        phase_deg=phase - 360 if phase > 0 else phase,
        amplitude=float(abs(Y)),
        cycles=count,
    )


def _advice(time: Float[np.ndarray, " times"], duty: Float[np.ndarray, " times"]) -> str:
    """What to do about a relay that hardly switches: if it has stayed in one state for half of the
    run, its bias is too far from what holds the reference."""
    (switches,) = np.nonzero(np.diff(duty))
    falls = np.diff(duty)[switches] < 0
    if len(falls) and duty[-1] == 0:  # the end of the relay's patience, not a state of it
        time, switches, falls = time[: switches[-1] + 1], switches[:-1], falls[:-1]
    since = time[switches[-1] + 1] if len(switches) else time[0]
    if time[-1] - since < 0.5 * (time[-1] - time[0]):
        return "let it run for longer, or take less hysteresis"
    level = duty[len(time) - 1]
    if np.sum(falls) > np.sum(~falls):
        return (
            f"it stayed above the reference at its lower duty, {level:.3g}, from {since:g} s on: "
            "take a lower bias, or a larger amplitude"
        )
    return (
        f"it stayed below the reference at its higher duty, {level:.3g}, from {since:g} s on: let "
        "it run for longer, or take a higher bias"
    )


def _arrays(run: Any) -> tuple[Float[np.ndarray, " times"], ...]:
    try:
        if isinstance(run, ClosedLoopRun):
            run = run.time, run.measurement, run.duty
        elif run and isinstance(run[0], Decision):
            run = tuple(zip(*((d.time, d.measurement, d.duty) for d in run), strict=True))
        time, output, duty = run
        time, output, duty = (np.asarray(values, float) for values in (time, output, duty))
    except (TypeError, ValueError):
        raise ControlError(
            "ultimate_point: run: expected a ClosedLoopRun, decisions, or (time, output, duty), "
            f"got {type(run).__name__}"
        ) from None
    rows = time.size
    has_shapes = all(v.shape[:1] == (rows,) and v.ndim <= 2 and v.size for v in (output, duty))
    is_finite = all(np.isfinite(values).all() for values in (time, output, duty))
    if not (time.ndim == 1 and rows > 2 and has_shapes and is_finite):
        raise ControlError(
            "ultimate_point: run: expected finite times, output and duty of one length, got shapes "
            f"{time.shape}, {output.shape} and {duty.shape}"
        )
    output, duty = output.reshape(rows, -1), duty.reshape(rows, -1)
    if output.shape[1] != 1:
        raise ControlError(
            "ultimate_point: run: expected one with a Relay, which has a single output, got "
            f"{output.shape[1]} outputs"
        )
    if not np.all(np.diff(time) > 0):
        first = int(np.argmax(np.diff(time) <= 0))
        raise ControlError(
            f"ultimate_point: run: expected times that increase, got {time[first + 1]:g} s after "
            f"{time[first]:g} s"
        )
    switching = int(np.argmax(np.ptp(duty, axis=0)))
    return time, output[:, 0], duty[:, switching]


def _check_drift(
    periods: Float[np.ndarray, " cycles"],
    levels: Float[np.ndarray, " cycles"],
    height: float,
    step: float,
) -> None:
    """Refuses an oscillation that is not periodic yet.

    **Raises:** `ControlError` if the periods or the level still change.
    """
    if np.ptp(periods) > PERIOD_TOLERANCE * periods.mean() + 2 * step:
        raise ControlError(
            "ultimate_point: run: expected periods that do not change, got "
            f"{', '.join(f'{period:.3g}' for period in periods)} s; let it run for longer"
        )
    if len(levels) > 1 and np.abs(np.diff(levels)).max() > LEVEL_TOLERANCE * height:
        raise ControlError(
            "ultimate_point: run: expected an oscillation about one level, got means of "
            f"{', '.join(f'{level:.2f}' for level in levels)} degC at a height of {height:.2f} K; "
            "let it run for longer, or take a bias nearer to what holds the reference"
        )
