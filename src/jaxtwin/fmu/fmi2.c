/* The functions of FMI 2.0 for model exchange and co-simulation, declared as in the standard, so
   that the sources need only the headers of C. Those that a twin does not support return an
   error. */

#define RESET "fmi2Reset"
#include "instance.c"

typedef void *component_t;
typedef int bool_t;
typedef const char *string_t;
typedef int status_t; /* 0 OK, 1 warning, 2 discard, 3 error, 4 fatal */

#define OK 0
#define ERROR 3

typedef struct {
    bool_t is_needed_again, terminate, nominals_changed, states_changed, is_next;
    double next;
} event_t;

/* What the simulator offers, of which an instance uses the logger. */
typedef struct {
    void (*logger)(void);
    void (*others[3])(void);
    void *environment;
} callbacks_t;

typedef void (*logger_t)(void *environment, string_t name, status_t status, string_t category,
                         string_t message, ...);

static void tell(const listener_t *listener, const char *message)
{
    if (listener->logger != NULL) {
        ((logger_t)listener->logger)(listener->environment, listener->name, ERROR,
                                     "logStatusError", message);
    }
}

/* Values of kinds that a twin does not have: a success only where none is asked for. */
#define NO_VALUES(kind, type) \
    EXPORTED status_t fmi2Get##kind(component_t c, const uint32_t v[], size_t n, type values[]) \
    { \
        (void)c, (void)v, (void)values; \
        return n == 0 ? OK : ERROR; \
    } \
    EXPORTED status_t fmi2Set##kind(component_t c, const uint32_t v[], size_t n, \
                                    const type values[]) \
    { \
        (void)c, (void)v, (void)values; \
        return n == 0 ? OK : ERROR; \
    }

NO_VALUES(Boolean, bool_t)
NO_VALUES(String, string_t)

#define NO_STATUS(function, type) \
    EXPORTED status_t function(component_t c, int kind, type *value) \
    { \
        (void)c, (void)kind, (void)value; \
        return ERROR; \
    }

NO_STATUS(fmi2GetStatus, int)
NO_STATUS(fmi2GetRealStatus, double)
NO_STATUS(fmi2GetIntegerStatus, int)
NO_STATUS(fmi2GetBooleanStatus, bool_t)
NO_STATUS(fmi2GetStringStatus, string_t)

EXPORTED status_t fmi2SetRealInputDerivatives(component_t c, const uint32_t v[], size_t n,
                                              const int order[], const double values[])
{
    (void)c, (void)v, (void)order, (void)values;
    return n == 0 ? OK : ERROR;
}

EXPORTED status_t fmi2GetRealOutputDerivatives(component_t c, const uint32_t v[], size_t n,
                                               const int order[], double values[])
{
    (void)c, (void)v, (void)order, (void)values;
    return n == 0 ? OK : ERROR;
}

EXPORTED status_t fmi2GetEventIndicators(component_t c, double values[], size_t n)
{
    (void)c, (void)values;
    return n == 0 ? OK : ERROR;
}

EXPORTED status_t fmi2CancelStep(component_t c)
{
    (void)c;
    return ERROR;
}

EXPORTED status_t fmi2GetDirectionalDerivative(component_t c, const uint32_t z[], size_t nz,
                                               const uint32_t v[], size_t nv, const double dv[],
                                               double dz[])
{
    (void)c, (void)z, (void)nz, (void)v, (void)nv, (void)dv, (void)dz;
    return ERROR;
}

EXPORTED const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

EXPORTED const char *fmi2GetVersion(void)
{
    return "2.0";
}

EXPORTED status_t fmi2SetDebugLogging(component_t c, bool_t on, size_t n, const char *const names[])
{
    (void)c, (void)on, (void)n, (void)names;
    return OK;
}

/* Of the two types of FMUs, 0 is for model exchange, 1 for co-simulation. */

EXPORTED component_t fmi2Instantiate(const char *name, int type, const char *guid,
                                     const char *resources, const callbacks_t *callbacks,
                                     bool_t visible, bool_t logging)
{
    listener_t listener = {NULL, NULL, ""};
    (void)resources, (void)visible, (void)logging;
    if (callbacks != NULL) {
        listener.logger = callbacks->logger;
        listener.environment = callbacks->environment;
    }
    snprintf(listener.name, sizeof listener.name, "%s", name == NULL ? "" : name);
    return type == 0 || type == 1 ? instantiate(guid, type == 0, &listener) : NULL;
}

EXPORTED void fmi2FreeInstance(component_t c)
{
    free(c);
}

EXPORTED status_t fmi2SetupExperiment(component_t c, bool_t has_tolerance, double tolerance,
                                      double start, bool_t has_stop, double stop)
{
    instance_t *self = c;
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    if (!may_begin(&self->listener, self->is_running)) {
        return ERROR;
    }
    self->start = self->time = start;
    return isfinite(start) ? OK : ERROR;
}

EXPORTED status_t fmi2EnterInitializationMode(component_t c)
{
    const instance_t *self = c;
    return may_begin(&self->listener, self->is_running) ? OK : ERROR;
}

EXPORTED status_t fmi2ExitInitializationMode(component_t c)
{
    return initialize(c) ? OK : ERROR;
}

EXPORTED status_t fmi2Terminate(component_t c)
{
    ((instance_t *)c)->is_terminated = 1;
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

/* Enumerations: the states of an input. */
EXPORTED status_t fmi2GetInteger(component_t c, const uint32_t v[], size_t n, int values[])
{
    size_t k;
    for (k = 0; k < n; ++k) {
        int64_t state;
        if (!get_choice(c, v[k], &state)) {
            return ERROR;
        }
        values[k] = (int)state;
    }
    return OK;
}

EXPORTED status_t fmi2SetInteger(component_t c, const uint32_t v[], size_t n, const int values[])
{
    size_t k;
    for (k = 0; k < n; ++k) {
        if (!set_choice(c, v[k], values[k])) {
            return ERROR;
        }
    }
    return OK;
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
    return pass_event(c, &event->is_next, &event->next) ? OK : ERROR;
}

EXPORTED status_t fmi2EnterContinuousTimeMode(component_t c)
{
    (void)c;
    return OK;
}

EXPORTED status_t fmi2CompletedIntegratorStep(component_t c, bool_t never_back,
                                              bool_t *enter_events, bool_t *terminate)
{
    (void)c, (void)never_back;
    *enter_events = *terminate = 0;
    return OK;
}

#define SET_TIME fmi2SetTime
#define SET_STATES fmi2SetContinuousStates
#define GET_STATES fmi2GetContinuousStates
#define GET_DERIVATIVES fmi2GetDerivatives
#define GET_NOMINALS fmi2GetNominalsOfContinuousStates
#define GET_FMU_STATE fmi2GetFMUstate
#define SET_FMU_STATE fmi2SetFMUstate
#define FREE_FMU_STATE fmi2FreeFMUstate
#define SERIALIZED_SIZE fmi2SerializedFMUstateSize
#define SERIALIZE fmi2SerializeFMUstate
#define DESERIALIZE fmi2DeSerializeFMUstate
#define BYTE char
#include "states.c"
