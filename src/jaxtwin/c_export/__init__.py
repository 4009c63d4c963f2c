"""C for a microcontroller: models, observers and controllers as C99 sources.

`_export_c` is the entry. The C stands in C files (`controller.c`, `linear_model.c`, `twin.c` and
`observer.c`, which share `twin_steps.c`, with their headers); `_sources` puts the name of the
exported files into them, and writes the header with sizes and numbers, which `_controller_c`,
`_discrete_model_c`, `_observer_c` and `_stepper_c` (with `_stepper_tables` and `_input_tables`)
compute and `_text` writes as C. In `parametric_twin.c`, which is for an FMU, C itself computes the
numbers of a twin from its parameters, by `_parametric_twin_c` and `_parameter_tables`. A
controller's class gives its law, whose C is in `control/controllers/laws/`.

The public names stand in `__init__.pyi` and are imported when they are first used.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
