#include "model.h"
#include "model_numbers.h"
#include "real.h"

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "-ffast-math takes NaN for a reading: compile without it"
#endif

static int model_all_finite(const model_real *values, int count)
{
    int i;
    for (i = 0; i < count; ++i) {
        if (!isfinite(values[i])) {
            return 0;
        }
    }
    return 1;
}

static model_real model_limited(int cell, model_real duty)
{
    if (duty < model_lowest_duty[cell]) {
        return model_lowest_duty[cell];
    }
    return duty > model_highest_duty[cell] ? model_highest_duty[cell] : duty;
}

#ifdef MODEL_INTEGRALS
/* In float a compensated sum (Kahan 1965): the increment of a few millikelvins in a tenth of a
   second would be lost in rounding. */
static void model_integrate(model_state *state, int i, model_real change)
{
#if MODEL_IS_FLOAT
    const model_real rest = change - state->lost[i];
    const model_real sum = state->integral[i] + rest;
    state->lost[i] = (sum - state->integral[i]) - rest;
    state->integral[i] = sum;
#else
    state->integral[i] += change;
#endif
}
#endif

static void model_stop(model_state *state)
{
    state->missing_s = MODEL_SILENCE_S + MODEL_SAMPLE_TIME_S;
}

#include "law.c"

void model_init(model_state *state, const model_real duty[MODEL_CELLS],
                const model_real measurement[MODEL_READINGS])
{
    int i;
    for (i = 0; i < MODEL_READINGS; ++i) {
        state->seen[i] = measurement[i];
    }
    model_law_init(state, duty, measurement);
#if defined(MODEL_INTEGRALS) && MODEL_IS_FLOAT
    for (i = 0; i < MODEL_INTEGRALS; ++i) {
        state->lost[i] = 0;
    }
#endif
    state->missing_s = 0;
    if (!model_all_finite(duty, MODEL_CELLS) || !model_all_finite(measurement, MODEL_READINGS)) {
        model_stop(state);
    }
}

/* A sample, with the references of the next `samples` samples. */
static void model_sample(model_state *state, const model_real *references, int samples,
                         const model_real *measurement, model_real *duty)
{
    int i;
    if (state->missing_s <= MODEL_SILENCE_S) {
        if (model_all_finite(measurement, MODEL_READINGS)) {
            for (i = 0; i < MODEL_READINGS; ++i) {
                state->seen[i] = measurement[i];
            }
            state->missing_s = 0;
        } else {
            state->missing_s += MODEL_SAMPLE_TIME_S;
        }
    }
    if (state->missing_s <= MODEL_SILENCE_S) {
        model_law(state, references, samples, duty);
        if (model_all_finite(references, samples * MODEL_OUTPUTS)
            && model_all_finite(duty, MODEL_CELLS)) {
            return;
        }
        model_stop(state);
    }
    for (i = 0; i < MODEL_CELLS; ++i) {
        duty[i] = 0;
    }
}

void model_step(model_state *state, const model_real reference[MODEL_OUTPUTS],
                const model_real measurement[MODEL_READINGS], model_real duty[MODEL_CELLS])
{
    model_sample(state, reference, 1, measurement, duty);
}

#ifdef MODEL_HORIZON
void model_step_ahead(model_state *state,
                      const model_real references[MODEL_HORIZON * MODEL_OUTPUTS],
                      const model_real measurement[MODEL_READINGS], model_real duty[MODEL_CELLS])
{
    model_sample(state, references, MODEL_HORIZON, measurement, duty);
}
#endif
