r"""Stability margins of a loop, from its frequency response.

A loop $L(j \omega)$ is the product of plant and controller, without the minus sign of the feedback.
All numbers are valid for loops that are stable when closed; they do not show whether the closed
loop is stable. Delays are exact, because no rational function is needed.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Complex, Float

from ...errors import ControlError
from ._state_space import StateSpace

# The default frequencies, rad/s.
OMEGA = np.geomspace(1e-6, 1e3, 6000)

# The sensitivity peak above which a loop is called fragile.
USUAL_PEAK = 2.0

# A function from frequencies, rad/s, to the response of the loop, `(frequency,)` or `(frequency, n,
# n)`.
Loop: TypeAlias = Callable[[Float[np.ndarray, " frequency"]], Complex[np.ndarray, "..."]]


class Margins(NamedTuple):
    """Gain and phase margin, in the order of `control.margin` of python-control.

    - `gm`: the factor by which the gain may grow, or fall if it is below 1.
    - `pm`: the number of degrees by which the phase may fall.
    - `wcg`: the frequency with a phase of -180 degrees, rad/s. `wcp`: the frequency with a gain of
      1, rad/s.

    A margin is infinite, and its frequency NaN, if no frequency has that phase or gain.
    """

    gm: float
    pm: float
    wcg: float
    wcp: float

    @property
    def delay_s(self) -> float:
        """The further delay that the loop tolerates, s, if its gain is 1 at a single frequency."""
        return float(np.radians(self.pm % 360) / self.wcp) if np.isfinite(self.pm) else np.inf


class DiskMargin(NamedTuple):
    """The changes of gain and phase of all channels at the same time that keep the loop stable.

    - `margin`: the size of the disk in which they may change.
    - `gain`: the smallest and the largest factor of the gain if the phase does not change.
    - `phase_deg`: the change of the phase in either direction if the gain does not change.
    - `omega`: the frequency at which the loop is nearest to instability, rad/s.
    """

    margin: float
    gain: tuple[float, float]
    phase_deg: float
    omega: float


def margins_text(peak: float, omega: float, disk: DiskMargin) -> str:
    """A sensitivity peak, its frequency and a disk margin in a line of words, with a warning if the
    loop is fragile."""
    low, high = disk.gain
    text = (
        f"sensitivity peak {peak:.2f} at {omega:.2g} rad/s; tolerates gains of {low:.2f} to "
        f"{high:.2f} times, or a phase of {disk.phase_deg:.0f} degrees"
    )
    if peak > USUAL_PEAK:
        text += f": fragile, a usual limit of the peak is {USUAL_PEAK:g}"
    return text


def margins(
    loop: StateSpace | Loop, *, omega: Float[np.ndarray, " frequency"] | None = None
) -> Margins:
    """Computes gain and phase margin of a loop with a single channel: the smallest of each.

    ```python
    model = jt.linearize(jt.Twin("single-cell"), duty=0.3)
    gm, pm, wcg, wcp = margins(lambda w: 0.1 * model.frequency_response(w)[:, 0, 0])
    ```

    **Arguments:**

    - `loop`: a function from frequencies, rad/s, to the response of plant times controller; or a
      model with a single input and output.
    - `omega`: increasing frequencies between which crossings are searched, rad/s; None for 1e-6 to
      1e3, of a discrete model to half the sample rate.

    **Raises:** `ControlError` if the loop has several channels or is not finite.
    """
    response, omega = _scalar(loop), _frequencies(loop, omega)
    values = response(omega)
    gains = np.log(np.maximum(np.abs(values), 1e-300))
    crossings = _zeros(lambda w: np.log(np.abs(response(w))), omega, gains)
    reversals = _zeros(lambda w: np.imag(response(w)), omega, np.imag(values))
    # At half the sample rate z is -1 and the response real, up to rounding.
    if np.isclose(omega[-1], highest := _highest(loop)) and highest not in reversals:
        reversals.append(highest)
    at_unity = response(np.array(crossings)) if crossings else np.zeros(0, complex)
    at_reversal = response(np.array(reversals)) if reversals else np.zeros(0, complex)
    gm, pm, wcg, wcp = np.inf, np.inf, np.nan, np.nan
    phases = np.mod(np.degrees(np.angle(at_unity)) + 180 + 180, 360) - 180
    if len(phases):
        worst = int(np.argmin(np.abs(phases)))
        pm, wcp = float(phases[worst]), crossings[worst]
    factors = [(-1 / v.real, w) for v, w in zip(at_reversal, reversals, strict=True) if v.real < 0]
    if factors:
        gm, wcg = min(factors, key=lambda pair: abs(np.log(pair[0])))
        gm = float(gm)
    return Margins(gm, pm, wcg, wcp)


def sensitivity_peak(
    loop: StateSpace | Loop, *, omega: Float[np.ndarray, " frequency"] | None = None
) -> tuple[float, float]:
    """Computes the peak of the sensitivity, and its frequency, rad/s.

    It is the largest singular value of $(I + L)^{-1}$ over all frequencies: the factor by which the
    loop amplifies a disturbance at worst. For a single channel it is the reciprocal of the smallest
    distance of the loop from -1. A usual limit is 2.

    **Arguments:**

    - `loop`, `omega`: as in `margins`; several channels are a square matrix at each frequency.
    """
    return _peak(_square(loop), _frequencies(loop, omega), 0.0)


def disk_margin(
    loop: StateSpace | Loop,
    *,
    skew: float = 0.0,
    omega: Float[np.ndarray, " frequency"] | None = None,
) -> DiskMargin:
    r"""Computes the disk margin (Seiler, Packard and Gahinet, IEEE Control Systems 40, 2020).

    $$\alpha = 1 / \max_\omega \lVert S + \tfrac{\sigma - 1}{2} I \rVert$$

    With several channels it is valid for any changes of gain and phase in all of them, also if they
    interact. It is then conservative for changes of each channel by itself.

    **Arguments:**

    - `loop`, `omega`: as in `sensitivity_peak`.
    - `skew`: $\sigma$; 0 for gains that may fall as much as rise, 1 for the reciprocal of the
      sensitivity's peak.
    """
    peak, at = _peak(_square(loop), _frequencies(loop, omega), (skew - 1) / 2)
    margin = 1 / peak
    low = (2 - margin * (1 - skew)) / (2 + margin * (1 + skew))
    above = 2 - margin * (1 + skew)
    high = (2 + margin * (1 - skew)) / above if above > 0 else np.inf
    cosine = low if np.isinf(high) else (1 + low * high) / (low + high)
    return DiskMargin(margin, (low, high), float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))), at)


def _peak(response: Loop, omega: np.ndarray, shift: float) -> tuple[float, float]:
    """The peak over frequency of the largest singular value of $(I + L)^{-1}$ plus `shift` times
    $I$, and its frequency, rad/s."""
    from scipy.optimize import minimize_scalar  # which takes a third of a second to import

    def sizes(frequencies: np.ndarray) -> np.ndarray:
        values = response(frequencies)
        unit = np.eye(values.shape[-1])
        return np.linalg.norm(np.linalg.inv(unit + values) + shift * unit, 2, axis=(1, 2))

    result = sizes(omega)
    top = int(np.argmax(result))
    between = np.log(omega[max(top - 1, 0)]), np.log(omega[min(top + 1, len(omega) - 1)])
    finer = minimize_scalar(
        lambda w: -float(sizes(np.exp([w]))[0]), bounds=between, method="bounded",
        options={"xatol": 1e-10},
    )  # fmt: skip
    if -finer.fun > result[top]:
        return float(-finer.fun), float(np.exp(finer.x))
    return float(result[top]), float(omega[top])


def _zeros(
    function: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]],
    omega: Float[np.ndarray, " frequency"],
    values: Float[np.ndarray, " frequency"],
) -> list[float]:
    """The frequencies at which a function is 0: those among `omega`, and one between each two
    neighbours at which its values have different signs."""
    between = np.flatnonzero(np.sign(values[1:]) * np.sign(values[:-1]) < 0)
    result = [
        _zero(lambda w: float(function(np.array([w]))[0]), omega[n], omega[n + 1]) for n in between
    ]
    return sorted([*omega[values == 0].tolist(), *result])


def _zero(function: Callable[[float], float], low: float, high: float) -> float:
    from scipy.optimize import brentq

    return float(brentq(function, low, high, xtol=1e-300, rtol=1e-13))  # pyright: ignore


def _frequencies(
    loop: StateSpace | Loop, omega: Float[np.ndarray, " frequency"] | None
) -> Float[np.ndarray, " frequency"]:
    if omega is None:
        return np.geomspace(OMEGA[0], min(_highest(loop), OMEGA[-1]), len(OMEGA))
    omega = np.asarray(omega, float)
    if omega.ndim != 1 or len(omega) < 2 or not (omega[0] > 0 and np.all(np.diff(omega) > 0)):
        raise ControlError(
            "omega: expected at least two increasing frequencies above 0, in rad/s, got "
            f"an array of shape {omega.shape}"
        )
    if omega[-1] > _highest(loop) * (1 + 1e-9):
        raise ControlError(
            f"omega: expected frequencies up to half the sample rate, {_highest(loop):.6g} rad/s, "
            f"got {omega[-1]:.6g}"
        )
    return omega


def _highest(loop: StateSpace | Loop) -> float:
    """The highest frequency at which a loop is evaluated, rad/s."""
    return loop.nyquist_frequency if isinstance(loop, StateSpace) else np.inf


def _square(loop: StateSpace | Loop) -> Loop:
    def response(omega: np.ndarray) -> np.ndarray:
        source = loop.frequency_response if isinstance(loop, StateSpace) else loop
        values = np.asarray(source(omega))
        if values.ndim == 1:
            values = values[:, None, None]
        if values.ndim != 3 or len(values) != len(omega) or values.shape[1] != values.shape[2]:
            raise ControlError(
                "loop: expected a response (frequency,) or (frequency, n, n), got shape "
                f"{values.shape} for {len(omega)} frequencies"
            )
        if not np.isfinite(values).all():
            raise ControlError("loop: expected a finite response, got infinite numbers or NaN")
        return values

    return response


def _scalar(loop: StateSpace | Loop) -> Loop:
    square = _square(loop)

    def response(omega: np.ndarray) -> np.ndarray:
        values = square(omega)
        if values.shape[1] != 1:
            raise ControlError(
                f"margins: expected a loop with a single channel, got {values.shape[1]}; "
                "disk_margin takes several"
            )
        return values[:, 0, 0]

    return response
