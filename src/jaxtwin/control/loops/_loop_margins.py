"""The margins of a controller on a twin: how far from instability its loop is."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import ArrayLike

from ..._display import picture
from ..._jax_settings import own_settings
from ...errors import ControlError
from ...matching import Fit, nominal_twin
from ...physics import Twin
from ...simulation import assembled
from ..controllers._controller import AbstractController
from ..controllers._design_vector import ControllerVector
from ..linear._margins import (
    DiskMargin,
    Margins,
    disk_margin,
    margins,
    margins_text,
    sensitivity_peak,
)
from ._loop_checks import check_cells
from ._references import reference_samples, representative_samples
from ._sampled_loop import ROUNDING, SampledLoops
from ._simulate_closed_loops import longest_delay, twin_at_medians

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def check_stability(
    twin: Twin,
    controller: AbstractController,
    weights: Float[np.ndarray, "outputs channels"],
    references: Float[np.ndarray, "samples outputs"],
) -> None:
    """Refuses a controller whose loop with the twin is not stable at one of its references.

    A class that is not linear about a steady state (`is_linear`) is not checked. The check uses the
    linear loop at the sample time of the controller, with the driver's delay and
    lag. Of many references, it uses the lowest, the highest and some between them.

    **Raises:** `ControlError` that names the reference and the growth of deviations there.
    """
    controller = controller.averaged
    if not controller.is_linear:
        return
    delay = assembled(twin).delay
    for reference in references[representative_samples(references)]:
        loops = SampledLoops(
            twin,
            {},
            ControllerVector(controller, ()),
            weights,
            reference,
            longest_delay=0.0 if delay is None else float(delay),
            sensor_delay=0.0,
        )
        growth = loops.growth()
        if not growth < 1 + ROUNDING:
            seconds = controller.sample_time_s / math.log(growth)
            at = "/".join(f"{value:g}" for value in reference)
            raise ControlError(
                f"controller: expected one with which {twin.rig.name} is stable, got deviations "
                f"from {at} degC that grow e-fold in {seconds:.3g} s, by the twin linearised "
                "there; use smaller gains, or the parameters of a match if the rig is another"
            )


Response: TypeAlias = Complex[np.ndarray, "frequency outputs outputs"]

# The number of frequencies of a Nyquist plot.
PLOT_FREQUENCIES = 1000


class LoopMargins(NamedTuple):
    """The margins of the loop of a controller, at its sample time, with the delay and the lag of
    the driver.

    - `is_stable`: whether the closed loop is stable; if it is not, the other numbers mean nothing.
    - `sensitivity_peak`, `sensitivity_omega`: the factor by which the loop amplifies a disturbance
      at worst, and the frequency at which it does so, rad/s.
    - `complementary_peak`, `complementary_omega`: the same for the noise of readings.
    - `disk`: the changes of gain and phase of all channels together that the loop tolerates.
    - `channel`: gain and phase margin of a loop with a single output; None for several.
    - `sensitivity_peaks`: the sensitivity peak of each draw of the twin; that of the twin alone
      where there are no draws.
    - `omega`, `response`: frequencies up to half the sample rate, rad/s, and the response of the
      loop, plant times controller without the minus sign of the feedback.
    """

    is_stable: bool
    sensitivity_peak: float
    sensitivity_omega: float
    complementary_peak: float
    complementary_omega: float
    disk: DiskMargin
    channel: Margins | None
    sensitivity_peaks: Float[np.ndarray, " draws"]
    omega: Float[np.ndarray, " frequency"]
    response: Response

    def plot(self) -> "Figure":
        """Plots the loop in the complex plane, with the disk of its disk margin:
        `jaxtwin.plots.plot_nyquist`."""
        return picture("plot_nyquist", self)

    def summary(self) -> str:
        """Returns the margins in one line of words, with a warning if the loop is fragile."""
        if not self.is_stable:
            return "the loop is not stable"
        return margins_text(self.sensitivity_peak, self.sensitivity_omega, self.disk)

    def __repr__(self) -> str:
        return f"<LoopMargins: {self.summary()}>"


def loop_margins(
    twin: Twin | Fit,
    controller: AbstractController,
    reference: float | int | ArrayLike,
    *,
    draws: Mapping[str, Float[np.ndarray, " draws"]] | None = None,
) -> LoopMargins:
    """Computes the margins of a controller on a twin.

    The loop is linearised where the outputs rest at their references. The plant under a held duty
    is exact at the samples, with the driver's delay and lag; the controller is the derivative of
    its `step`, so that it may be any that is linear within its limits, a user's own too.

    ```python
    jaxtwin.control.loop_margins(twin, lqi, 40.0).summary()
    ```

    **Arguments:**

    - `twin`: the twin; or a fit.
    - `controller`: the controller.
    - `reference`: that of all outputs, or one for each, degC.
    - `draws`: draws of parameters, as `Fit.posterior` gives them: name -> values; for
      `sensitivity_peaks`, and `is_stable` then holds for all of them.

    **Raises:** `ControlError` for a controller that is not linear, or references that do not fit
    it.
    """
    where = "loop_margins"
    plant = nominal_twin(f"{where}: twin", twin, ControlError)
    controller = controller.for_rig(plant.rig).averaged
    if not controller.is_linear:
        raise ControlError(
            f"{where}: controller: expected one that is linear within its limits, got a "
            f"{type(controller).__name__}"
        )
    weights = np.asarray(controller.output_weights(plant.channels), float)
    outputs = reference_samples(f"{where}: reference", reference, np.zeros(1), len(weights))[0]
    drawn = {name: np.asarray(values, float) for name, values in (draws or {}).items()}
    with own_settings():
        check_cells(where, controller, plant.rig, len(weights))
        loops = sampled_loops(plant, {}, controller, weights, outputs)
        of_draws = sampled_loops(plant, drawn, controller, weights, outputs) if drawn else loops
        growth = of_draws.growth()

        def loop(omega: Float[np.ndarray, " frequency"]) -> Response:
            return loops.loop(omega)[0]

        def inverse(omega: Float[np.ndarray, " frequency"]) -> Response:
            return np.linalg.inv(loop(omega))  # T = (I + L^-1)^-1

        omega = loops.omega
        plot_omega = np.geomspace(omega[0], omega[-1], PLOT_FREQUENCIES)
        return LoopMargins(
            growth < 1 + ROUNDING,
            *sensitivity_peak(loop, omega=omega),
            *sensitivity_peak(inverse, omega=omega),
            disk=disk_margin(loop, omega=omega),
            channel=margins(loop, omega=omega) if len(weights) == 1 else None,
            sensitivity_peaks=of_draws.peaks(),
            omega=plot_omega,
            response=loop(plot_omega),
        )


def sampled_loops(
    twin: Twin,
    draws: dict[str, Float[np.ndarray, " draws"]],
    controller: AbstractController,
    weights: Float[np.ndarray, "outputs channels"],
    outputs: Float[np.ndarray, " outputs"],
) -> SampledLoops:
    """Makes the loops of a controller with a plant, or with draws of it, that rests where the
    outputs have some values, degC."""
    return SampledLoops(
        twin_at_medians(twin, draws),
        draws,
        ControllerVector(controller, ()),
        weights,
        outputs,
        longest_delay=longest_delay(twin, draws),
        sensor_delay=0.0,
    )
