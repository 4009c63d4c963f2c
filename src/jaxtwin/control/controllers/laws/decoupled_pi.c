/* The law of a PI on the mean and on the differences of the outputs, as matrices. */

static void model_law_init(model_state *state, const model_real *duty,
                           const model_real *measurement)
{
    int i, j;
    for (i = 0; i < MODEL_CELLS; ++i) {
        model_real integral = 0;
        for (j = 0; j < MODEL_CELLS; ++j) {
            const model_real y = measurement[j];
            integral += model_undo[i][j] * duty[j] - model_Kp[i][j] * (model_b[j] * y - y);
        }
        state->integral[i] = integral;
    }
}

static void model_law(model_state *state, const model_real *reference, int samples,
                      model_real *duty)
{
    model_real asked[MODEL_CELLS], cut[MODEL_CELLS];
    int i, j;
    (void)samples;
    for (i = 0; i < MODEL_CELLS; ++i) {
        asked[i] = state->integral[i];
        for (j = 0; j < MODEL_CELLS; ++j) {
            asked[i] += model_Kp[i][j] * (model_b[j] * reference[j] - state->seen[j]);
        }
    }
    for (i = 0; i < MODEL_CELLS; ++i) {
        model_real wanted = 0;
        for (j = 0; j < MODEL_CELLS; ++j) {
            wanted += model_D[i][j] * asked[j];
        }
        duty[i] = model_limited(i, wanted);
        cut[i] = duty[i] - wanted;
    }
    for (i = 0; i < MODEL_CELLS; ++i) {
        model_real change = 0;
        for (j = 0; j < MODEL_CELLS; ++j) {
            change += model_Ki_h[i][j] * (reference[j] - state->seen[j]);
            change += model_back[i][j] * cut[j];
        }
        model_integrate(state, i, change);
    }
}
