#include "model.h"
#include "model_numbers.h"

void model_init(model_state *state)
{
    int i;
    for (i = 0; i < MODEL_STATES; ++i) {
        state->x[i] = 0;
    }
}

/* Of the states, the last are commands in the delay, which move on. Of the others the change is
   computed and added, because slow poles lie near 1. */
void model_step(model_state *state, const model_real duty[MODEL_INPUTS])
{
    model_real u[MODEL_INPUTS];
    model_real change[MODEL_MULTIPLIED];
    int i, j;
    for (i = 0; i < MODEL_INPUTS; ++i) {
        u[i] = duty[i] - model_duty[i];
    }
    for (i = 0; i < MODEL_MULTIPLIED; ++i) {
        model_real sum = 0;
        for (j = 0; j < MODEL_STATES; ++j) {
            sum += model_A[i][j] * state->x[j];
        }
        for (j = 0; j < MODEL_INPUTS; ++j) {
            sum += model_B[i][j] * u[j];
        }
        change[i] = sum;
    }
    for (i = 0; i < MODEL_MULTIPLIED; ++i) {
        state->x[i] += change[i];
    }
#if MODEL_MULTIPLIED < MODEL_STATES
    for (i = MODEL_STATES - 1; i >= MODEL_MULTIPLIED + MODEL_INPUTS; --i) {
        state->x[i] = state->x[i - MODEL_INPUTS];
    }
    for (i = 0; i < MODEL_INPUTS; ++i) {
        state->x[MODEL_MULTIPLIED + i] = u[i];
    }
#endif
}

void model_output(const model_state *state, const model_real duty[MODEL_INPUTS],
                  model_real temperatures[MODEL_OUTPUTS])
{
    int i, j;
    (void)duty;
    for (i = 0; i < MODEL_OUTPUTS; ++i) {
        model_real sum = model_at[i];
        for (j = 0; j < MODEL_STATES; ++j) {
            sum += model_C[i][j] * state->x[j];
        }
#ifdef MODEL_HAS_DIRECT_GAIN
        for (j = 0; j < MODEL_INPUTS; ++j) {
            sum += model_D[i][j] * (duty[j] - model_duty[j]);
        }
#endif
        temperatures[i] = sum;
    }
}
