/* What the two versions of FMI share for a controller, in the place of instance.c: an instance, its
   values and its clock. The values have the numbers of their variables: time, references, channels,
   duty cycles, and the duty cycles that it takes over.
   A sample is taken at the beginning of the communication step in which it is due. */

#include "exported.h"

/* Numbers of the variables: 0 is the time. */
#define REFERENCE 1
#define CHANNEL (REFERENCE + MODEL_OUTPUTS)
#define DUTY (CHANNEL + MODEL_CHANNELS)
#define BEFORE (DUTY + MODEL_CELLS)
#define VARIABLES (BEFORE + MODEL_CELLS)
#define STATES 0

#include "refusals.c"

typedef struct {
    listener_t listener;
    model_state state;
    double start, time;
    double references[MODEL_OUTPUTS], channels[MODEL_CHANNELS];
    double duty[MODEL_CELLS], before[MODEL_CELLS];
    double samples; /* that have been taken */
    int is_running, is_terminated, is_exchange;
} instance_t;

static void reset(instance_t *self)
{
    const listener_t listener = self->listener;
    int i;
    memset(self, 0, sizeof *self);
    self->listener = listener;
    for (i = 0; i < MODEL_OUTPUTS; ++i) {
        self->references[i] = MODEL_ROOM;
    }
    for (i = 0; i < MODEL_CHANNELS; ++i) {
        self->channels[i] = MODEL_ROOM;
    }
}

static instance_t *instantiate(const char *given, int is_exchange, const listener_t *listener)
{
    instance_t *self = NULL;
    if (given != NULL && strcmp(given, MODEL_TOKEN) == 0 && !is_exchange) {
        self = malloc(sizeof *self);
    }
    if (self != NULL) {
        self->listener = *listener;
        reset(self);
    }
    return self;
}

/* A channel without a reading leaves alone the measurements that do not contain it. */
static void measure(const instance_t *self, double *measurement)
{
    int i, k;
    for (i = 0; i < MODEL_READINGS; ++i) {
        measurement[i] = 0.0;
        for (k = 0; k < MODEL_CHANNELS; ++k) {
            const double weight = model_weights[i][k];
            if (weight != 0.0) {
                measurement[i] += weight * self->channels[k];
            }
        }
    }
}

static int initialize(instance_t *self)
{
    double measurement[MODEL_READINGS];
    measure(self, measurement);
    memcpy(self->duty, self->before, sizeof self->duty);
    model_init(&self->state, self->duty, measurement);
    self->is_running = 1;
    return 1;
}

static int get(instance_t *self, const uint32_t *numbers, size_t count, double *values)
{
    size_t k;
    for (k = 0; k < count; ++k) {
        const uint32_t number = numbers[k];
        if (number == 0) {
            values[k] = self->time;
        } else if (number < CHANNEL) {
            values[k] = self->references[number - REFERENCE];
        } else if (number < DUTY) {
            values[k] = self->channels[number - CHANNEL];
        } else if (number < BEFORE) {
            values[k] = self->is_running ? self->duty[number - DUTY] : self->before[number - DUTY];
        } else if (number < VARIABLES) {
            values[k] = self->before[number - BEFORE];
        } else {
            return refuse(&self->listener, number, "expected one of the model");
        }
    }
    return 1;
}

/* Refuses references and duty cycles that are no numbers, duty cycles beyond full duty, and those
   that are taken over of a controller that runs. A channel may be NaN, a missing reading. */
static int set(instance_t *self, const uint32_t *numbers, size_t count, const double *values)
{
    const listener_t *listener = &self->listener;
    size_t k;
    for (k = 0; k < count; ++k) {
        const uint32_t number = numbers[k];
        if (number >= CHANNEL && number < DUTY) {
            self->channels[number - CHANNEL] = values[k];
        } else if (number >= REFERENCE && number < CHANNEL) {
            if (!accepts(listener, number, values[k], ABSOLUTE_ZERO, HUGE_VAL)) {
                return 0;
            }
            self->references[number - REFERENCE] = values[k];
        } else if (number >= BEFORE && number < VARIABLES) {
            if (self->is_running) {
                return refuse(listener, number,
                              "expected to be set before the end of the initialisation, not after");
            }
            if (!accepts(listener, number, values[k], -1.0, 1.0)) {
                return 0;
            }
            self->before[number - BEFORE] = values[k];
        } else {
            return refuse(listener, number,
                          "expected an input or a parameter, got another variable");
        }
    }
    return 1;
}

static int advance(instance_t *self, double time, double size)
{
    double measurement[MODEL_READINGS], due;
    if (!may_step(&self->listener, self->is_running, self->is_terminated, self->time, time,
                  size)) {
        return 0;
    }
    due = ceil((time + size - self->start) / MODEL_SAMPLE_TIME_S - 1e-6);
    measure(self, measurement);
    while (self->samples < due) {
        model_step(&self->state, self->references, measurement, self->duty);
        self->samples += 1.0;
    }
    self->time = time + size;
    return 1;
}

/* Goes back to a stored state, which may be that of another instance. */
static void restore(instance_t *self, const instance_t *stored)
{
    const listener_t listener = self->listener;
    memcpy(self, stored, sizeof *self);
    self->listener = listener;
}

static void *copied(const instance_t *self)
{
    instance_t *copy = malloc(sizeof *copy);
    if (copy != NULL) {
        *copy = *self;
    }
    return copy;
}

/* A controller has no states for a solver from outside, no enumerations and no events. */

static int get_choice(const instance_t *self, uint32_t number, int64_t *state)
{
    (void)self, (void)number, (void)state;
    return 0;
}

static int set_choice(instance_t *self, uint32_t number, int64_t state)
{
    (void)self, (void)number, (void)state;
    return 0;
}

static int get_states(const instance_t *self, double *values, size_t count)
{
    (void)self, (void)values;
    return count == 0;
}

static int set_states(instance_t *self, const double *values, size_t count)
{
    (void)self, (void)values;
    return count == 0;
}

static int get_slopes(instance_t *self, double *values, size_t count)
{
    (void)self, (void)values;
    return count == 0;
}

static int get_nominals(double *values, size_t count)
{
    (void)values;
    return count == 0;
}

static int pass_event(instance_t *self, int *is_next, double *next)
{
    (void)self;
    *is_next = 0;
    *next = 0.0;
    return 1;
}
