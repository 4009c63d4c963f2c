"""What the two versions of FMI have in common, as C: an instance, its values and its clock.

The value references are those of `_variables`: time, duty cycles, ambient, channels, nodes.
"""


def instance_c(name: str, token: str) -> str:
    """The beginning of the source that is compiled beside the twin's."""
    upper = name.upper()
    return f"""#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "{name}.h"

#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORTED __attribute__((visibility("default")))
#else
#define EXPORTED
#endif

static const char token[] = "{token}";

/* Numbers of the variables: 0 is the time. */
#define DUTY 1
#define AMBIENT (DUTY + {upper}_CELLS)
#define CHANNEL (AMBIENT + 1)
#define NODE (CHANNEL + {upper}_CHANNELS)
#define VARIABLES (NODE + {upper}_NODES)

typedef struct {{
    {name}_state state;
    double start, time, ambient;
    double duty[{upper}_CELLS], nodes[{upper}_NODES];
    double steps; /* that have been taken */
    int is_running;
}} instance_t;

static void reset(instance_t *self)
{{
    int i;
    memset(self, 0, sizeof *self);
    self->ambient = {upper}_AMBIENT;
    for (i = 0; i < {upper}_NODES; ++i) {{
        self->nodes[i] = {name}_start[i];
    }}
}}

static instance_t *instantiate(const char *given)
{{
    instance_t *self = NULL;
    if (given != NULL && strcmp(given, token) == 0) {{
        self = malloc(sizeof *self);
    }}
    if (self != NULL) {{
        reset(self);
    }}
    return self;
}}

static void initialize(instance_t *self)
{{
    static const double off[{upper}_CELLS] = {{0.0}};
    {name}_init(&self->state, self->nodes, off);
    self->is_running = 1;
}}

static int get(const instance_t *self, const uint32_t *numbers, size_t count, double *values)
{{
    double channels[{upper}_CHANNELS], nodes[{upper}_NODES];
    {name}_state state = self->state;
    size_t k;
    if (!self->is_running) {{
        static const double off[{upper}_CELLS] = {{0.0}};
        {name}_init(&state, self->nodes, off);
    }}
    {name}_output(&state, self->ambient, channels);
    {name}_nodes(&state, nodes);
    for (k = 0; k < count; ++k) {{
        const uint32_t number = numbers[k];
        if (number == 0) {{
            values[k] = self->time;
        }} else if (number < AMBIENT) {{
            values[k] = self->duty[number - DUTY];
        }} else if (number == AMBIENT) {{
            values[k] = self->ambient;
        }} else if (number < NODE) {{
            values[k] = channels[number - CHANNEL];
        }} else if (number < VARIABLES) {{
            values[k] = nodes[number - NODE];
        }} else {{
            return 0;
        }}
    }}
    return 1;
}}

/* Refuses what is no number, duty cycles beyond full duty, and nodes of a twin that runs. */
static int set(instance_t *self, const uint32_t *numbers, size_t count, const double *values)
{{
    size_t k;
    for (k = 0; k < count; ++k) {{
        const uint32_t number = numbers[k];
        if (!isfinite(values[k])) {{
            return 0;
        }}
        if (number >= DUTY && number < AMBIENT) {{
            if (values[k] < -1.0 || values[k] > 1.0) {{
                return 0;
            }}
            self->duty[number - DUTY] = values[k];
        }} else if (number == AMBIENT) {{
            self->ambient = values[k];
        }} else if (number >= NODE && number < VARIABLES && !self->is_running) {{
            self->nodes[number - NODE] = values[k];
        }} else {{
            return 0;
        }}
    }}
    return 1;
}}

/* Takes the twin's own steps that end until then, under the inputs of now. */
static int advance(instance_t *self, double time, double size)
{{
    double until;
    if (!self->is_running || !isfinite(time) || !isfinite(size) || size < 0.0) {{
        return 0;
    }}
    until = floor((time + size - self->start) / {upper}_SAMPLE_TIME_S + 1e-6);
    while (self->steps < until) {{
        {name}_step(&self->state, self->duty, self->ambient);
        self->steps += 1.0;
    }}
    self->time = time + size;
    return 1;
}}

static void *copied(const instance_t *self)
{{
    instance_t *copy = malloc(sizeof *copy);
    if (copy != NULL) {{
        *copy = *self;
    }}
    return copy;
}}

"""
