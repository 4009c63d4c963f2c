#include "model.h"
#include "model_numbers.h"
#include "real.h"

#include "twin_steps.c"

/* A part of a step under a command. */
static void model_part(MODEL_OF_INSTANCE model_state *state, int part, const model_real *command,
                       const model_real *first, const model_real *slope,
                       const model_real *effects)
{
#ifdef MODEL_HAS_LAG
    model_real middle[MODEL_CELLS], end[MODEL_CELLS];
    const model_real *start = state->duty;
#else
    const model_real *start = command, *middle = command, *end = command;
#endif
    int i;
#ifdef MODEL_HAS_LAG
    for (i = 0; i < MODEL_CELLS; ++i) {
        const model_real away = state->duty[i] - command[i];
        middle[i] = command[i] + away * model_lag[part][0];
        end[i] = command[i] + away * model_lag[part][1];
    }
#endif
    model_advance(MODEL_ITS_NUMBERS state->z, part, start, middle, end, first, slope, effects);
    for (i = 0; i < MODEL_CELLS; ++i) {
        state->duty[i] = end[i];
    }
}

void model_init(model_state *state, const model_real nodes[MODEL_NODES],
                const model_real duty[MODEL_CELLS])
{
    MODEL_FIND_NUMBERS(state)
    int i, m;
    for (m = 0; m < MODEL_MODES; ++m) {
        state->z[m] = 0;
        for (i = 0; i < MODEL_NODES; ++i) {
            const model_real rise = nodes[i] + MODEL_ZERO_CELSIUS - MODEL_T0;
            state->z[m] += model_shape[i][m] * model_capacitance[i] * rise;
        }
    }
    for (i = 0; i < MODEL_CELLS; ++i) {
        state->duty[i] = duty[i];
#if MODEL_QUEUE > 0
        for (m = 0; m < MODEL_QUEUE; ++m) {
            state->late[m][i] = duty[i];
        }
#endif
    }
#if MODEL_INPUTS > 0
    for (i = 0; i < MODEL_INPUTS; ++i) {
        state->inputs[i] = model_input_start[i];
    }
#endif
}

#ifndef MODEL_WAITING
#define MODEL_WAITING MODEL_QUEUE /* commands on their way */
#endif

/* The command that acts in a part of a step. Of those on their way, the first was given a step
   ago. */
static const model_real *model_command(const model_state *state, const model_real *duty, int part)
{
#if MODEL_QUEUE > 0
    if (part < MODEL_WAITING) {
        return state->late[MODEL_WAITING - 1 - part];
    }
#else
    (void)state;
    (void)part;
#endif
    return duty;
}

void model_step(model_state *state, const model_real duty[MODEL_CELLS], model_real ambient)
{
    MODEL_FIND_NUMBERS(state)
    const model_real deviation = ambient + MODEL_ZERO_CELSIUS - MODEL_T0;
    model_real first[MODEL_MODES], slope[MODEL_MODES];
    int part;
#if MODEL_QUEUE > 0
    int m;
#endif
#if MODEL_INPUTS > 0
    model_real effects[MODEL_EFFECTS];
    model_effects(MODEL_ITS_NUMBERS state->inputs, effects);
#else
    const model_real *effects = 0;
#endif
    model_losses(MODEL_ITS_NUMBERS state->z, deviation, effects, first);
#ifdef MODEL_LOSSES
#ifdef MODEL_HAS_LAG
    model_loss_slope(MODEL_ITS_NUMBERS state->z, state->duty, deviation, effects, first, 0, slope);
#else
    model_loss_slope(MODEL_ITS_NUMBERS state->z, model_command(state, duty, 0), deviation, effects,
                     first, 0, slope);
#endif
#endif
    for (part = 0; part < MODEL_PARTS; ++part) {
        model_part(MODEL_ITS_NUMBERS state, part, model_command(state, duty, part), first, slope,
                   effects);
    }
#if MODEL_QUEUE > 0
    {
        int i;
        for (m = MODEL_QUEUE - 1; m > 0; --m) {
            for (i = 0; i < MODEL_CELLS; ++i) {
                state->late[m][i] = state->late[m - 1][i];
            }
        }
        for (i = 0; i < MODEL_CELLS; ++i) {
            state->late[0][i] = duty[i];
        }
    }
#endif
}

void model_output(const model_state *state, model_real ambient,
                  model_real temperatures[MODEL_CHANNELS])
{
    MODEL_FIND_NUMBERS(state)
    const model_real deviation = ambient + MODEL_ZERO_CELSIUS - MODEL_T0;
    int i, m;
    for (i = 0; i < MODEL_CHANNELS; ++i) {
        model_real sum = model_by_ambient[i] * deviation;
        for (m = 0; m < MODEL_MODES; ++m) {
            sum += model_by_modes[i][m] * state->z[m];
        }
        temperatures[i] = sum + (MODEL_T0 - MODEL_ZERO_CELSIUS);
    }
}

void model_nodes(const model_state *state, model_real nodes[MODEL_NODES])
{
    MODEL_FIND_NUMBERS(state)
    int i, m;
    for (i = 0; i < MODEL_NODES; ++i) {
        model_real sum = 0;
        for (m = 0; m < MODEL_MODES; ++m) {
            sum += model_shape[i][m] * state->z[m];
        }
        nodes[i] = sum + (MODEL_T0 - MODEL_ZERO_CELSIUS);
    }
}
