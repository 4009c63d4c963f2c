"""A twin as an FMU, the Functional Mock-up Unit of other simulators.

`_export_fmu` puts it together: the C of a twin and of its parameters
(`c_export/_parametric_twin_c`), an instance of it (`instance.c`, `refusals.c`, `states.c`), the
functions of FMI 2 or 3 (`fmi2.c`, `fmi3.c`), and the variables with their description in XML
(`_model_description`).
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
