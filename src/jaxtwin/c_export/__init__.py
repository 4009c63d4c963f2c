"""C for a microcontroller: models, observers and controllers as C99 sources.

`_export_c` is the entry. The C stands in C files (`controller.c`, `linear_model.c`, `twin.c` and
`observer.c`, which share `twin_steps.c`, with their headers); `_sources` puts the name of the
exported files into them, and writes the header with sizes and numbers, which `_controller_c`,
`_discrete_model_c`, `_observer_c` and `_stepper_c` (with `_input_tables`) compute. In
`parametric_twin.c`, which is for an FMU, C itself computes the numbers of a twin from its
parameters, by the tables of `_parametric_twin_c`. A controller's class gives its law, whose C is in
`control/controllers/laws/`. The laws of losses and heaters are generated, in `physics/laws/`.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
