/* What the two versions of FMI share: an instance, its values and its clock. The values have the
   numbers of their variables: time, duty cycles, ambient, other inputs, channels, states, their
   derivatives and parameters.
   In co-simulation the twin takes steps itself. In model exchange a solver integrates the states; a
   command that changes enters a queue at an event, and leaves it at another event after the
   delay. */

#include "exported.h"

/* Numbers of the variables: 0 is the time. */
#define DUTY 1
#define AMBIENT (DUTY + MODEL_CELLS)
#define INPUT (AMBIENT + 1)
#define CHANNEL (INPUT + MODEL_INPUTS)
#define NODE (CHANNEL + MODEL_CHANNELS)
#define LAGGED (NODE + MODEL_NODES)
#define STATES (MODEL_NODES + MODEL_LAGGED)
#define SLOPE (NODE + STATES)
#define PARAMETER (SLOPE + STATES)
#define VARIABLES (PARAMETER + MODEL_PARAMETERS)

#include "refusals.c"

/* Commands that can be on their way in model exchange. */
#define QUEUE 1024

typedef struct {
    listener_t listener;
    double parameters[MODEL_PARAMETERS + 1]; /* C has no empty arrays */
    model_numbers numbers; /* that follow from the parameters, once is_prepared */
    model_state state;
    double start, time, ambient;
    double duty[MODEL_CELLS], nodes[MODEL_NODES];
    double lagged[MODEL_CELLS]; /* duty behind the lag */
    double steps; /* that have been taken */
    double inputs[MODEL_INPUTS + 1];
    /* Inputs of the step that has begun, if one has. */
    double held_duty[MODEL_CELLS], held_ambient, held_inputs[MODEL_INPUTS + 1];
    int is_held;
    int is_prepared, is_running, is_terminated, is_exchange;
    /* Of model exchange: the last command, that which has arrived, and those between. */
    double seen[MODEL_CELLS], arrived[MODEL_CELLS];
    double due[QUEUE], late[QUEUE][MODEL_CELLS];
    int waiting;
} instance_t;

static void reset(instance_t *self)
{
    const listener_t listener = self->listener;
    const int is_exchange = self->is_exchange;
    int i;
    memset(self, 0, sizeof *self);
    self->listener = listener;
    self->is_exchange = is_exchange;
    memcpy(self->parameters, model_parameters, sizeof self->parameters);
    self->ambient = MODEL_AMBIENT;
    memcpy(self->inputs, model_inputs, sizeof self->inputs);
    for (i = 0; i < MODEL_NODES; ++i) {
        self->nodes[i] = model_start[i];
    }
}

static instance_t *instantiate(const char *given, int is_exchange, const listener_t *listener)
{
    instance_t *self = NULL;
    if (given != NULL && strcmp(given, MODEL_TOKEN) == 0) {
        self = malloc(sizeof *self);
    }
    if (self != NULL) {
        self->listener = *listener;
        self->is_exchange = is_exchange;
        reset(self);
    }
    return self;
}

/* Computes the numbers of the twin after parameters were set. Returns whether they have meaning. */
static int prepare(instance_t *self)
{
    const char *problem = NULL;
    char message[300];
    if (self->is_prepared) {
        return 1;
    }
    problem = model_prepare(&self->numbers, self->parameters);
    if (problem == NULL && !self->is_exchange && !self->numbers.is_stable) {
        problem = "expected values with which the steps of the FMU are stable, got others; take "
                  "shorter steps in export_fmu, or model exchange";
    }
    if (problem != NULL) {
        snprintf(message, sizeof message, "parameters: %s", problem);
        tell(&self->listener, message);
    }
    self->is_prepared = problem == NULL;
    return self->is_prepared;
}

/* The twin's own state, from temperatures of the nodes; no command was given before. */
static void begin(const instance_t *self, model_state *state)
{
    static const double off[MODEL_CELLS] = {0.0};
    int i;
    state->numbers = &self->numbers;
    model_init(state, self->nodes, off);
    for (i = 0; i < MODEL_CELLS; ++i) {
        state->duty[i] = self->lagged[i];
    }
}

static int initialize(instance_t *self)
{
    if (!prepare(self)) {
        return 0;
    }
    begin(self, &self->state);
    self->is_running = 1;
    return 1;
}

/* The derivatives of the states, under the duty that has passed the delay. */
static void slopes(const instance_t *self, const double *nodes, const double *lagged,
                   const double *delayed, double *values)
{
    int i;
    model_slopes(&self->numbers, nodes, MODEL_LAGGED > 0 ? lagged : delayed, self->ambient,
                 self->inputs, values);
    for (i = MODEL_NODES; i < STATES; ++i) {
        values[i] = (delayed[i - MODEL_NODES] - lagged[i - MODEL_NODES]) / self->numbers.lag_s;
    }
}

static const double *delayed_duty(const instance_t *self)
{
    return self->numbers.delay_s > 0.0 ? self->arrived : self->duty;
}

/* What follows from the state and the inputs: readings of the channels, states and derivatives. */
static void compute(const instance_t *self, double *channels, double *states, double *changes)
{
    model_state state = self->state;
    if (!self->is_running || self->is_exchange) {
        begin(self, &state);
    }
    model_output(&state, self->ambient, channels);
    model_nodes(&state, states);
    memcpy(states + MODEL_NODES, state.duty, (size_t)MODEL_LAGGED * sizeof(double));
    slopes(self, states, state.duty, self->is_exchange ? delayed_duty(self) : self->duty, changes);
}

static int get(instance_t *self, const uint32_t *numbers, size_t count, double *values)
{
    double channels[MODEL_CHANNELS], states[STATES], changes[STATES];
    int is_computed = 0;
    size_t k;
    for (k = 0; k < count; ++k) {
        const uint32_t number = numbers[k];
        if (number >= CHANNEL && number < PARAMETER && !is_computed) {
            if (!prepare(self)) {
                return 0;
            }
            compute(self, channels, states, changes);
            is_computed = 1;
        }
        if (number == 0) {
            values[k] = self->time;
        } else if (number < AMBIENT) {
            values[k] = self->duty[number - DUTY];
        } else if (number == AMBIENT) {
            values[k] = self->ambient;
        } else if (number < CHANNEL) {
            values[k] = self->inputs[number - INPUT];
        } else if (number < NODE) {
            values[k] = channels[number - CHANNEL];
        } else if (number < SLOPE) {
            values[k] = states[number - NODE];
        } else if (number < PARAMETER) {
            values[k] = changes[number - SLOPE];
        } else if (number < VARIABLES) {
            values[k] = self->parameters[number - PARAMETER];
        } else {
            return refuse(&self->listener, number, "expected one of the model");
        }
    }
    return 1;
}

/* Refuses values outside their range, such as duty cycles beyond full duty, heaters that are to
   cool and states that an input does not have, and start values and parameters of a twin that
   runs. */
static int set(instance_t *self, const uint32_t *numbers, size_t count, const double *values)
{
    size_t k;
    for (k = 0; k < count; ++k) {
        const uint32_t number = numbers[k];
        double lowest = -HUGE_VAL, highest = HUGE_VAL, *place;
        if (number >= DUTY && number < AMBIENT) {
            place = &self->duty[number - DUTY];
            lowest = model_lowest[number - DUTY];
            highest = 1.0;
        } else if (number == AMBIENT) {
            place = &self->ambient;
            lowest = ABSOLUTE_ZERO;
        } else if (number >= INPUT && number < CHANNEL) {
            place = &self->inputs[number - INPUT];
            if (model_states[number - INPUT] > 0.0) {
                lowest = 0.0;
                highest = model_states[number - INPUT] - 1.0;
            }
        } else if (number >= NODE && number < LAGGED) {
            place = &self->nodes[number - NODE];
            lowest = ABSOLUTE_ZERO;
        } else if (number >= LAGGED && number < SLOPE) {
            place = &self->lagged[number - LAGGED];
            lowest = model_lowest[number - LAGGED];
            highest = 1.0;
        } else if (number >= PARAMETER && number < VARIABLES) {
            place = &self->parameters[number - PARAMETER];
            lowest = model_lower[number - PARAMETER];
            highest = model_upper[number - PARAMETER];
        } else {
            return refuse(&self->listener, number,
                          "expected an input, a start value or a parameter, got another variable");
        }
        if (number >= NODE && self->is_running) {
            return refuse(&self->listener, number,
                          "expected to be set before the end of the initialisation, not after it");
        }
        if (!accepts(&self->listener, number, values[k], lowest, highest)) {
            return 0;
        }
        *place = values[k];
        self->is_prepared = self->is_prepared && number < PARAMETER;
    }
    return 1;
}

/* The number of the state of an input that has states. */
static int get_choice(const instance_t *self, uint32_t number, int64_t *state)
{
    if (number < INPUT || number >= CHANNEL || !(model_states[number - INPUT] > 0.0)) {
        return 0;
    }
    *state = (int64_t)self->inputs[number - INPUT];
    return 1;
}

static int set_choice(instance_t *self, uint32_t number, int64_t state)
{
    const double value = (double)state;
    int64_t before;
    return get_choice(self, number, &before) && set(self, &number, 1, &value);
}

static void hold_inputs(instance_t *self)
{
    memcpy(self->held_inputs, self->inputs, sizeof self->held_inputs);
    memcpy(self->held_duty, self->duty, sizeof self->held_duty);
    self->held_ambient = self->ambient;
}

/* Takes the twin's own steps that end until then, each under the inputs with which it began. */
static int advance(instance_t *self, double time, double size)
{
    double begun, until;
    if (self->is_exchange || !may_step(&self->listener, self->is_running, self->is_terminated,
                                       self->time, time, size)) {
        return 0;
    }
    begun = (time + size - self->start) / MODEL_SAMPLE_TIME_S;
    until = floor(begun + 1e-6);
    if (!self->is_held) {
        hold_inputs(self);
    }
    while (self->steps < until) {
#if MODEL_INPUTS > 0
        memcpy(self->state.inputs, self->held_inputs, sizeof self->state.inputs);
#endif
        model_step(&self->state, self->held_duty, self->held_ambient);
        self->steps += 1.0;
        hold_inputs(self);
    }
    self->is_held = begun > until + 1e-6;
    self->time = time + size;
    return 1;
}

/* The states as the solver from outside has them. */
static int get_states(const instance_t *self, double *values, size_t count)
{
    if (count != STATES) {
        return 0;
    }
    memcpy(values, self->nodes, sizeof self->nodes);
    memcpy(values + MODEL_NODES, self->lagged, (size_t)(STATES - MODEL_NODES) * sizeof(double));
    return 1;
}

static int set_states(instance_t *self, const double *values, size_t count)
{
    if (count != STATES || !self->is_exchange) {
        return 0;
    }
    memcpy(self->nodes, values, sizeof self->nodes);
    memcpy(self->lagged, values + MODEL_NODES, (size_t)(STATES - MODEL_NODES) * sizeof(double));
    return 1;
}

static int get_slopes(instance_t *self, double *values, size_t count)
{
    if (count != STATES || !prepare(self)) {
        return 0;
    }
    slopes(self, self->nodes, self->lagged, delayed_duty(self), values);
    return 1;
}

static int get_nominals(double *values, size_t count)
{
    size_t k;
    if (count != STATES) {
        return 0;
    }
    for (k = 0; k < count; ++k) {
        values[k] = k < MODEL_NODES ? 10.0 : 1.0;
    }
    return 1;
}

/* What happens at an event: a new command is put into the queue, and those that are due arrive.
   Refused where too many are on their way. */
static int pass_event(instance_t *self, int *is_next, double *next)
{
    const double now = self->time + 1e-9 * (1.0 + fabs(self->time));
    int left = 0;
    *is_next = 0;
    *next = 0.0;
    if (!(self->numbers.delay_s > 0.0)) {
        return 1;
    }
    if (memcmp(self->seen, self->duty, sizeof self->seen) != 0) {
        if (self->waiting == QUEUE) {
            return 0;
        }
        self->due[self->waiting] = self->time + self->numbers.delay_s;
        memcpy(self->late[self->waiting], self->duty, sizeof self->duty);
        memcpy(self->seen, self->duty, sizeof self->seen);
        ++self->waiting;
    }
    while (left < self->waiting && self->due[left] <= now) {
        memcpy(self->arrived, self->late[left], sizeof self->arrived);
        ++left;
    }
    self->waiting -= left;
    memmove(self->due, self->due + left, (size_t)self->waiting * sizeof self->due[0]);
    memmove(self->late, self->late + left, (size_t)self->waiting * sizeof self->late[0]);
    if (self->waiting > 0) {
        *is_next = 1;
        *next = self->due[0];
    }
    return 1;
}

/* Goes back to a stored state, which may be that of another instance. */
static void restore(instance_t *self, const instance_t *stored)
{
    const listener_t listener = self->listener;
    memcpy(self, stored, sizeof *self);
    self->listener = listener;
    self->state.numbers = &self->numbers;
}

static void *copied(const instance_t *self)
{
    instance_t *copy = malloc(sizeof *copy);
    if (copy != NULL) {
        *copy = *self;
    }
    return copy;
}
