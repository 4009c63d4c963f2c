/* The functions of FMI 3.0 for model exchange and co-simulation, declared as in the standard, so
   that the sources need only the headers of C. Those that a twin does not support return an
   error. */

#define RESET "fmi3Reset"
#include "instance.c"

#include <stdbool.h>

typedef void *component_t;
typedef const char *string_t;
typedef int status_t; /* 0 OK, 1 warning, 2 discard, 3 error, 4 fatal */

#define OK 0
#define ERROR 3

typedef void (*logger_t)(void *environment, status_t status, string_t category, string_t message);

static void tell(const listener_t *listener, const char *message)
{
    if (listener->logger != NULL) {
        ((logger_t)listener->logger)(listener->environment, ERROR, "logStatusError", message);
    }
}

/* Values of kinds that a twin does not have: a success only where none is asked for. */
#define NO_VALUES(kind, type) \
    EXPORTED status_t fmi3Get##kind(component_t c, const uint32_t v[], size_t n, type values[], \
                                    size_t count) \
    { \
        (void)c, (void)v, (void)values, (void)count; \
        return n == 0 ? OK : ERROR; \
    } \
    EXPORTED status_t fmi3Set##kind(component_t c, const uint32_t v[], size_t n, \
                                    const type values[], size_t count) \
    { \
        (void)c, (void)v, (void)values, (void)count; \
        return n == 0 ? OK : ERROR; \
    }

NO_VALUES(Float32, float)
NO_VALUES(Int8, int8_t)
NO_VALUES(UInt8, uint8_t)
NO_VALUES(Int16, int16_t)
NO_VALUES(UInt16, uint16_t)
NO_VALUES(Int32, int32_t)
NO_VALUES(UInt32, uint32_t)
NO_VALUES(UInt64, uint64_t)
NO_VALUES(Boolean, bool)
NO_VALUES(String, string_t)

EXPORTED status_t fmi3GetBinary(component_t c, const uint32_t v[], size_t n, size_t sizes[],
                                const uint8_t * values[], size_t count)
{
    (void)c, (void)v, (void)sizes, (void)values, (void)count;
    return n == 0 ? OK : ERROR;
}

EXPORTED status_t fmi3SetBinary(component_t c, const uint32_t v[], size_t n, const size_t sizes[],
                                const uint8_t *const values[], size_t count)
{
    (void)c, (void)v, (void)sizes, (void)values, (void)count;
    return n == 0 ? OK : ERROR;
}

EXPORTED status_t fmi3GetClock(component_t c, const uint32_t v[], size_t n, bool values[])
{
    (void)c, (void)v, (void)values;
    return n == 0 ? OK : ERROR;
}

EXPORTED status_t fmi3SetClock(component_t c, const uint32_t v[], size_t n, const bool values[])
{
    (void)c, (void)v, (void)values;
    return n == 0 ? OK : ERROR;
}

EXPORTED status_t fmi3GetEventIndicators(component_t c, double values[], size_t n)
{
    (void)c, (void)values;
    return n == 0 ? OK : ERROR;
}

EXPORTED status_t fmi3GetNumberOfVariableDependencies(component_t c, uint32_t v, size_t *a)
{
    (void)c, (void)v, (void)a;
    return ERROR;
}

EXPORTED status_t fmi3GetVariableDependencies(component_t c, uint32_t v, size_t a[], uint32_t b[],
                                              size_t d[], int e[], size_t n)
{
    (void)c, (void)v, (void)a, (void)b, (void)d, (void)e, (void)n;
    return ERROR;
}

EXPORTED status_t fmi3GetDirectionalDerivative(component_t c, const uint32_t v[], size_t n,
                                               const uint32_t a[], size_t b, const double d[],
                                               size_t e, double f[], size_t g)
{
    (void)c, (void)v, (void)n, (void)a, (void)b, (void)d, (void)e, (void)f, (void)g;
    return ERROR;
}

EXPORTED status_t fmi3GetAdjointDerivative(component_t c, const uint32_t v[], size_t n,
                                           const uint32_t a[], size_t b, const double d[], size_t e,
                                           double f[], size_t g)
{
    (void)c, (void)v, (void)n, (void)a, (void)b, (void)d, (void)e, (void)f, (void)g;
    return ERROR;
}

EXPORTED status_t fmi3EnterConfigurationMode(component_t c)
{
    (void)c;
    return ERROR;
}

EXPORTED status_t fmi3ExitConfigurationMode(component_t c)
{
    (void)c;
    return ERROR;
}

EXPORTED status_t fmi3GetIntervalDecimal(component_t c, const uint32_t v[], size_t n, double a[],
                                         int b[])
{
    (void)c, (void)v, (void)n, (void)a, (void)b;
    return ERROR;
}

EXPORTED status_t fmi3GetIntervalFraction(component_t c, const uint32_t v[], size_t n, uint64_t a[],
                                          uint64_t b[], int d[])
{
    (void)c, (void)v, (void)n, (void)a, (void)b, (void)d;
    return ERROR;
}

EXPORTED status_t fmi3GetShiftDecimal(component_t c, const uint32_t v[], size_t n, double a[])
{
    (void)c, (void)v, (void)n, (void)a;
    return ERROR;
}

EXPORTED status_t fmi3GetShiftFraction(component_t c, const uint32_t v[], size_t n, uint64_t a[],
                                       uint64_t b[])
{
    (void)c, (void)v, (void)n, (void)a, (void)b;
    return ERROR;
}

EXPORTED status_t fmi3SetIntervalDecimal(component_t c, const uint32_t v[], size_t n,
                                         const double a[])
{
    (void)c, (void)v, (void)n, (void)a;
    return ERROR;
}

EXPORTED status_t fmi3SetIntervalFraction(component_t c, const uint32_t v[], size_t n,
                                          const uint64_t a[], const uint64_t b[])
{
    (void)c, (void)v, (void)n, (void)a, (void)b;
    return ERROR;
}

EXPORTED status_t fmi3SetShiftDecimal(component_t c, const uint32_t v[], size_t n, const double a[])
{
    (void)c, (void)v, (void)n, (void)a;
    return ERROR;
}

EXPORTED status_t fmi3SetShiftFraction(component_t c, const uint32_t v[], size_t n,
                                       const uint64_t a[], const uint64_t b[])
{
    (void)c, (void)v, (void)n, (void)a, (void)b;
    return ERROR;
}

EXPORTED status_t fmi3EvaluateDiscreteStates(component_t c)
{
    (void)c;
    return ERROR;
}

EXPORTED status_t fmi3GetOutputDerivatives(component_t c, const uint32_t v[], size_t n,
                                           const int32_t a[], double b[], size_t d)
{
    (void)c, (void)v, (void)n, (void)a, (void)b, (void)d;
    return ERROR;
}

EXPORTED status_t fmi3ActivateModelPartition(component_t c, uint32_t v, double a)
{
    (void)c, (void)v, (void)a;
    return ERROR;
}

EXPORTED const char *fmi3GetVersion(void)
{
    return "3.0";
}

EXPORTED status_t fmi3SetDebugLogging(component_t c, bool on, size_t n, const char *const names[])
{
    (void)c, (void)on, (void)n, (void)names;
    return OK;
}

EXPORTED component_t fmi3InstantiateModelExchange(const char *name, const char *given,
                                                  const char *resources, bool visible,
                                                  bool logging, void *environment,
                                                  void (*message)(void))
{
    const listener_t listener = {message, environment, ""};
    (void)name, (void)resources, (void)visible, (void)logging;
    return instantiate(given, 1, &listener);
}

EXPORTED component_t fmi3InstantiateScheduledExecution(const char *name, const char *given,
                                                       const char *resources, bool visible,
                                                       bool logging, void *environment,
                                                       void (*message)(void),
                                                       void (*update)(void), void (*lock)(void),
                                                       void (*unlock)(void))
{
    (void)name, (void)given, (void)resources, (void)visible, (void)logging, (void)environment,
        (void)message, (void)update, (void)lock, (void)unlock;
    return NULL;
}

EXPORTED component_t fmi3InstantiateCoSimulation(
    const char *name, const char *given, const char *resources, bool visible, bool logging,
    bool has_events, bool may_return_early, const uint32_t intermediate[], size_t n,
    void *environment, void (*message)(void), void (*update)(void))
{
    const listener_t listener = {message, environment, ""};
    (void)name, (void)resources, (void)visible, (void)logging, (void)has_events,
        (void)may_return_early, (void)intermediate, (void)n, (void)update;
    return instantiate(given, 0, &listener);
}

EXPORTED void fmi3FreeInstance(component_t c)
{
    free(c);
}

EXPORTED status_t fmi3EnterInitializationMode(component_t c, bool has_tolerance, double tolerance,
                                              double start, bool has_stop, double stop)
{
    instance_t *self = c;
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    if (!may_begin(&self->listener, self->is_running)) {
        return ERROR;
    }
    self->start = self->time = start;
    return isfinite(start) ? OK : ERROR;
}

EXPORTED status_t fmi3ExitInitializationMode(component_t c)
{
    return initialize(c) ? OK : ERROR;
}

EXPORTED status_t fmi3Terminate(component_t c)
{
    ((instance_t *)c)->is_terminated = 1;
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

/* Enumerations: the states of an input. */
EXPORTED status_t fmi3GetInt64(component_t c, const uint32_t v[], size_t n, int64_t values[],
                               size_t count)
{
    size_t k;
    for (k = 0; k < n; ++k) {
        if (count != n || !get_choice(c, v[k], &values[k])) {
            return ERROR;
        }
    }
    return OK;
}

EXPORTED status_t fmi3SetInt64(component_t c, const uint32_t v[], size_t n,
                               const int64_t values[], size_t count)
{
    size_t k;
    for (k = 0; k < n; ++k) {
        if (count != n || !set_choice(c, v[k], values[k])) {
            return ERROR;
        }
    }
    return OK;
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
    const int is_updated = pass_event(c, &found, next);
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
    (void)c, (void)never_back;
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

#define SET_TIME fmi3SetTime
#define SET_STATES fmi3SetContinuousStates
#define GET_STATES fmi3GetContinuousStates
#define GET_DERIVATIVES fmi3GetContinuousStateDerivatives
#define GET_NOMINALS fmi3GetNominalsOfContinuousStates
#define GET_FMU_STATE fmi3GetFMUState
#define SET_FMU_STATE fmi3SetFMUState
#define FREE_FMU_STATE fmi3FreeFMUState
#define SERIALIZED_SIZE fmi3SerializedFMUStateSize
#define SERIALIZE fmi3SerializeFMUState
#define DESERIALIZE fmi3DeserializeFMUState
#define BYTE uint8_t
#include "states.c"
