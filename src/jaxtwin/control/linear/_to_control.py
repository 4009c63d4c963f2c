"""Converts linear models to those of python-control."""

from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import ControlError

if TYPE_CHECKING:
    from ._discrete_model import DiscreteModel
    from ._linear_model import LinearModel


def continuous(model: "LinearModel", pade_order: int | None) -> Any:
    """Converts a continuous model to a `control.StateSpace` with the lag among its states."""
    control = _library()
    if model.is_delayed and pade_order is None:
        raise ControlError(
            f"to_control: expected pade_order, because the driver's delay of "
            f"{float(model.delay_s):.3g} s cannot be in a StateSpace, got None; or take "
            "model.discretise(...).to_control(), which has it exactly"
        )
    names = {"inputs": list(model.input_names), "outputs": list(model.output_names)}
    states = list(model.state_names)
    system = control.ss(model.A, model.B, model.C, model.D)
    inputs = len(model.input_names)
    unit, zero = np.eye(inputs), np.zeros((inputs, inputs))
    if model.is_lagged:
        system = control.ss(-unit / model.lag_s, unit / model.lag_s, unit, zero)
        system = control.ss(model.A, model.B, model.C, model.D) * system
        states = states + [f"duty {name}" for name in model.input_names]
    if model.is_delayed:
        late = control.ss(control.tf(*control.pade(float(model.delay_s), pade_order)))
        order = late.nstates
        system = system * control.append(*[late] * inputs)
        states = states + [
            f"delay {name} {n + 1}" for name in names["inputs"] for n in range(order)
        ]
    return control.ss(system.A, system.B, system.C, system.D, states=states, **names)


def discrete(model: "DiscreteModel") -> Any:
    """Converts a discrete model to a discrete `control.StateSpace`."""
    return _library().ss(
        model.A,
        model.B,
        model.C,
        model.D,
        model.sample_time_s,
        states=list(model.state_names),
        inputs=list(model.input_names),
        outputs=list(model.output_names),
    )


def _library() -> Any:
    try:
        import control
    except ImportError:
        raise ControlError(
            "to_control: expected python-control, which is not installed; pip install "
            "'jaxtwin[control]'"
        ) from None
    return control
