"""The functions of FMI 2.0 for model exchange and co-simulation, as C.

They are declared here as in the standard, so that the sources need only the headers of C.
"""

from collections.abc import Iterator

from ._c_functions import NOTHING_AT_ALL, of_integration, of_state, refused


def fmi2_c() -> str:
    """Returns the functions of FMI 2, which follow the instance in the source."""
    integration = of_integration("fmi2", "Derivatives")
    return _TYPES + "".join(_refused()) + _FUNCTIONS + integration + of_state("fmi2", "FMUstate")


_TYPES = """typedef void *component_t;
typedef int bool_t;
typedef int status_t; /* 0 OK, 1 warning, 2 discard, 3 error, 4 fatal */

#define OK 0
#define ERROR 3

typedef struct {
    bool_t is_needed_again, terminate, nominals_changed, states_changed, is_next;
    double next;
} event_t;

"""

_FUNCTIONS = """EXPORTED const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

EXPORTED const char *fmi2GetVersion(void)
{
    return "2.0";
}

EXPORTED status_t fmi2SetDebugLogging(component_t c, bool_t on, size_t n, const char *const names[])
{
    (void)c;
    (void)on;
    (void)n;
    (void)names;
    return OK;
}

/* Of the two types of FMUs, 0 is for model exchange, 1 for co-simulation. */
EXPORTED component_t fmi2Instantiate(const char *name, int type, const char *guid,
                                     const char *resources, const void *callbacks, bool_t visible,
                                     bool_t logging)
{
    (void)name;
    (void)resources;
    (void)callbacks;
    (void)visible;
    (void)logging;
    return type == 0 || type == 1 ? instantiate(guid, type == 0) : NULL;
}

EXPORTED void fmi2FreeInstance(component_t c)
{
    free(c);
}

EXPORTED status_t fmi2SetupExperiment(component_t c, bool_t has_tolerance, double tolerance,
                                      double start, bool_t has_stop, double stop)
{
    instance_t *self = c;
    (void)has_tolerance;
    (void)tolerance;
    (void)has_stop;
    (void)stop;
    self->start = self->time = start;
    return isfinite(start) ? OK : ERROR;
}

EXPORTED status_t fmi2EnterInitializationMode(component_t c)
{
    (void)c;
    return OK;
}

EXPORTED status_t fmi2ExitInitializationMode(component_t c)
{
    initialize(c);
    return OK;
}

EXPORTED status_t fmi2Terminate(component_t c)
{
    (void)c;
    return OK;
}

EXPORTED status_t fmi2Reset(component_t c)
{
    reset(c);
    return OK;
}

EXPORTED status_t fmi2GetReal(component_t c, const uint32_t v[], size_t n, double values[])
{
    return get(c, v, n, values) ? OK : ERROR;
}

EXPORTED status_t fmi2SetReal(component_t c, const uint32_t v[], size_t n, const double values[])
{
    return set(c, v, n, values) ? OK : ERROR;
}

EXPORTED status_t fmi2DoStep(component_t c, double time, double size, bool_t is_final)
{
    (void)is_final;
    return advance(c, time, size) ? OK : ERROR;
}

EXPORTED status_t fmi2EnterEventMode(component_t c)
{
    (void)c;
    return OK;
}

EXPORTED status_t fmi2NewDiscreteStates(component_t c, event_t *event)
{
    event->is_needed_again = event->terminate = 0;
    event->nominals_changed = event->states_changed = 0;
    return update(c, &event->is_next, &event->next) ? OK : ERROR;
}

EXPORTED status_t fmi2EnterContinuousTimeMode(component_t c)
{
    (void)c;
    return OK;
}

EXPORTED status_t fmi2CompletedIntegratorStep(component_t c, bool_t never_back,
                                              bool_t *enter_events, bool_t *terminate)
{
    (void)c;
    (void)never_back;
    *enter_events = *terminate = 0;
    return OK;
}
"""


def _refused() -> Iterator[str]:
    """Writes functions for values and abilities that a twin does not have. They return an error,
    unless no value is asked for."""
    for kind, value in (("Integer", "int"), ("Boolean", "bool_t"), ("String", "char *")):
        constant = "const char *const" if kind == "String" else f"const {value}"
        got = "const char *" if kind == "String" else f"{value} "
        yield refused(f"fmi2Get{kind}", f"{_SOME}, {got}values[]", NOTHING_AT_ALL)
        yield refused(f"fmi2Set{kind}", f"{_SOME}, {constant} values[]", NOTHING_AT_ALL)
    for name, values in (
        ("fmi2SetRealInputDerivatives", "const double values[]"),
        ("fmi2GetRealOutputDerivatives", "double values[]"),
    ):
        yield refused(name, f"{_SOME}, const int order[], {values}", NOTHING_AT_ALL)
    yield refused("fmi2GetEventIndicators", "double values[], size_t n", NOTHING_AT_ALL)
    yield refused("fmi2CancelStep", "", "ERROR")
    for kind, value in (
        ("", "int"),
        ("Real", "double"),
        ("Integer", "int"),
        ("Boolean", "bool_t"),
        ("String", "const char *"),
    ):
        yield refused(f"fmi2Get{kind}Status", f"int kind, {value} *value", "ERROR")
    for name, arguments in _OTHERS.items():
        yield refused(name, arguments, "ERROR")


_SOME = "const uint32_t v[], size_t n"

_OTHERS = {
    "fmi2SerializedFMUstateSize": "void *state, size_t *size",
    "fmi2SerializeFMUstate": "void *state, char bytes[], size_t size",
    "fmi2DeSerializeFMUstate": "const char bytes[], size_t size, void **state",
    "fmi2GetDirectionalDerivative": (
        "const uint32_t z[], size_t nz, const uint32_t v[], size_t nv, const double dv[], "
        "double dz[]"
    ),
}
"""Functions for states as bytes and for derivatives."""
