"""The functions of FMI 3.0 for model exchange and co-simulation, as C. Those that a twin does not
support return an error.

They are declared here as in the standard, so that the sources need only the headers of C.
"""

from collections.abc import Iterator

from ._c_functions import NOTHING_AT_ALL, of_integration, of_state, refused


def fmi3_c() -> str:
    """Returns the functions of FMI 3, which follow the instance in the source."""
    integration = of_integration("fmi3", "ContinuousStateDerivatives")
    return _TYPES + "".join(_refused()) + _FUNCTIONS + integration + of_state("fmi3", "FMUState")


_TYPES = """#include <stdbool.h>

typedef void *component_t;
typedef int status_t; /* 0 OK, 1 warning, 2 discard, 3 error, 4 fatal */

#define OK 0
#define ERROR 3

"""

_FUNCTIONS = """EXPORTED const char *fmi3GetVersion(void)
{
    return "3.0";
}

EXPORTED status_t fmi3SetDebugLogging(component_t c, bool on, size_t n, const char *const names[])
{
    (void)c;
    (void)on;
    (void)n;
    (void)names;
    return OK;
}

EXPORTED component_t fmi3InstantiateModelExchange(const char *name, const char *given,
                                                  const char *resources, bool visible,
                                                  bool logging, void *environment,
                                                  void (*message)(void))
{
    (void)name;
    (void)resources;
    (void)visible;
    (void)logging;
    (void)environment;
    (void)message;
    return instantiate(given, 1);
}

EXPORTED component_t fmi3InstantiateScheduledExecution(const char *name, const char *given,
                                                       const char *resources, bool visible,
                                                       bool logging, void *environment,
                                                       void (*message)(void),
                                                       void (*update)(void), void (*lock)(void),
                                                       void (*unlock)(void))
{
    (void)name;
    (void)given;
    (void)resources;
    (void)visible;
    (void)logging;
    (void)environment;
    (void)message;
    (void)update;
    (void)lock;
    (void)unlock;
    return NULL;
}

EXPORTED component_t fmi3InstantiateCoSimulation(
    const char *name, const char *given, const char *resources, bool visible, bool logging,
    bool has_events, bool may_return_early, const uint32_t intermediate[], size_t n,
    void *environment, void (*message)(void), void (*update)(void))
{
    (void)name;
    (void)resources;
    (void)visible;
    (void)logging;
    (void)has_events;
    (void)may_return_early;
    (void)intermediate;
    (void)n;
    (void)environment;
    (void)message;
    (void)update;
    return instantiate(given, 0);
}

EXPORTED void fmi3FreeInstance(component_t c)
{
    free(c);
}

EXPORTED status_t fmi3EnterInitializationMode(component_t c, bool has_tolerance, double tolerance,
                                              double start, bool has_stop, double stop)
{
    instance_t *self = c;
    (void)has_tolerance;
    (void)tolerance;
    (void)has_stop;
    (void)stop;
    self->start = self->time = start;
    return isfinite(start) ? OK : ERROR;
}

EXPORTED status_t fmi3ExitInitializationMode(component_t c)
{
    initialize(c);
    return OK;
}

EXPORTED status_t fmi3Terminate(component_t c)
{
    (void)c;
    return OK;
}

EXPORTED status_t fmi3EnterStepMode(component_t c)
{
    (void)c;
    return OK;
}

EXPORTED status_t fmi3Reset(component_t c)
{
    reset(c);
    return OK;
}

EXPORTED status_t fmi3GetFloat64(component_t c, const uint32_t v[], size_t n, double values[],
                                 size_t count)
{
    return count == n && get(c, v, n, values) ? OK : ERROR;
}

EXPORTED status_t fmi3SetFloat64(component_t c, const uint32_t v[], size_t n,
                                 const double values[], size_t count)
{
    return count == n && set(c, v, n, values) ? OK : ERROR;
}

EXPORTED status_t fmi3DoStep(component_t c, double time, double size, bool never_back,
                             bool *needs_events, bool *terminate, bool *early, double *last)
{
    (void)never_back;
    *needs_events = false;
    *terminate = false;
    *early = false;
    if (!advance(c, time, size)) {
        return ERROR;
    }
    *last = time + size;
    return OK;
}

EXPORTED status_t fmi3EnterEventMode(component_t c)
{
    return ((instance_t *)c)->is_exchange ? OK : ERROR;
}

EXPORTED status_t fmi3UpdateDiscreteStates(component_t c, bool *is_needed_again, bool *terminate,
                                           bool *nominals_changed, bool *states_changed,
                                           bool *is_next, double *next)
{
    int found = 0;
    const int is_updated = update(c, &found, next);
    *is_needed_again = *terminate = *nominals_changed = *states_changed = false;
    *is_next = found != 0;
    return is_updated ? OK : ERROR;
}

EXPORTED status_t fmi3EnterContinuousTimeMode(component_t c)
{
    return ((instance_t *)c)->is_exchange ? OK : ERROR;
}

EXPORTED status_t fmi3CompletedIntegratorStep(component_t c, bool never_back, bool *enter_events,
                                              bool *terminate)
{
    (void)c;
    (void)never_back;
    *enter_events = *terminate = false;
    return OK;
}

EXPORTED status_t fmi3GetNumberOfContinuousStates(component_t c, size_t *n)
{
    (void)c;
    *n = STATES;
    return OK;
}

EXPORTED status_t fmi3GetNumberOfEventIndicators(component_t c, size_t *n)
{
    (void)c;
    *n = 0;
    return OK;
}
"""

_KINDS = {
    "Float32": "float",
    "Int8": "int8_t",
    "UInt8": "uint8_t",
    "Int16": "int16_t",
    "UInt16": "uint16_t",
    "Int32": "int32_t",
    "UInt32": "uint32_t",
    "Int64": "int64_t",
    "UInt64": "uint64_t",
    "Boolean": "bool",
    "String": "const char *",
}
"""Functions for values that a twin does not have."""

_SOME = "const uint32_t v[], size_t n"

_OTHERS = {
    "fmi3GetNumberOfVariableDependencies": "uint32_t v, size_t *a",
    "fmi3GetVariableDependencies": (
        "uint32_t v, size_t a[], uint32_t b[], size_t d[], int e[], size_t n"
    ),
    "fmi3SerializedFMUStateSize": "void *a, size_t *b",
    "fmi3SerializeFMUState": "void *a, uint8_t b[], size_t n",
    "fmi3DeserializeFMUState": "const uint8_t a[], size_t n, void **b",
    "fmi3GetDirectionalDerivative": (
        f"{_SOME}, const uint32_t a[], size_t b, const double d[], size_t e, double f[], size_t g"
    ),
    "fmi3GetAdjointDerivative": (
        f"{_SOME}, const uint32_t a[], size_t b, const double d[], size_t e, double f[], size_t g"
    ),
    "fmi3EnterConfigurationMode": "",
    "fmi3ExitConfigurationMode": "",
    "fmi3GetIntervalDecimal": f"{_SOME}, double a[], int b[]",
    "fmi3GetIntervalFraction": f"{_SOME}, uint64_t a[], uint64_t b[], int d[]",
    "fmi3GetShiftDecimal": f"{_SOME}, double a[]",
    "fmi3GetShiftFraction": f"{_SOME}, uint64_t a[], uint64_t b[]",
    "fmi3SetIntervalDecimal": f"{_SOME}, const double a[]",
    "fmi3SetIntervalFraction": f"{_SOME}, const uint64_t a[], const uint64_t b[]",
    "fmi3SetShiftDecimal": f"{_SOME}, const double a[]",
    "fmi3SetShiftFraction": f"{_SOME}, const uint64_t a[], const uint64_t b[]",
    "fmi3EvaluateDiscreteStates": "",
    "fmi3GetOutputDerivatives": f"{_SOME}, const int32_t a[], double b[], size_t d",
    "fmi3ActivateModelPartition": "uint32_t v, double a",
}
"""Functions for clocks, for derivatives other than those of the states, and for states as bytes."""


def _refused() -> Iterator[str]:
    for kind, value in _KINDS.items():
        space = "" if value.endswith("*") else " "
        constant = "const char *const " if kind == "String" else f"const {value} "
        got = f"{_SOME}, {value}{space}values[], size_t count"
        yield refused(f"fmi3Get{kind}", got, NOTHING_AT_ALL)
        given = f"{_SOME}, {constant}values[], size_t count"
        yield refused(f"fmi3Set{kind}", given, NOTHING_AT_ALL)
    binary = f"{_SOME}, {{}} sizes[], {{}} values[], size_t count"
    got = binary.format("size_t", "const uint8_t *")
    yield refused("fmi3GetBinary", got, NOTHING_AT_ALL)
    given = binary.format("const size_t", "const uint8_t *const")
    yield refused("fmi3SetBinary", given, NOTHING_AT_ALL)
    yield refused("fmi3GetClock", f"{_SOME}, bool values[]", NOTHING_AT_ALL)
    yield refused("fmi3SetClock", f"{_SOME}, const bool values[]", NOTHING_AT_ALL)
    yield refused("fmi3GetEventIndicators", "double values[], size_t n", NOTHING_AT_ALL)
    for name, arguments in _OTHERS.items():
        yield refused(name, arguments, "ERROR")
