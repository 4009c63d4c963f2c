"""Checks before a rig is switched on whether the closed loop is stable."""

import math

import numpy as np
from jaxtyping import Float

from ...errors import ControlError
from ...physics import Twin
from ...simulation._stepper import assembled
from ..controllers._controller import AbstractController
from ..controllers._controller_vector import ControllerVector
from ._references import representative_samples
from ._sampled_loop import ROUNDING, SampledLoops


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
