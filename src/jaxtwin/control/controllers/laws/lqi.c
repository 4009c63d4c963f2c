/* The law of an LQI: state feedback with integrals, and a Kalman filter. Duty and temperatures are
   counted from the operating point, model_duty and model_at. */

/* What the estimated states miss of a reading, K. */
static void model_missed(const model_state *state, const model_real *reading, model_real *missed)
{
    int i, j;
    for (i = 0; i < MODEL_OUTPUTS; ++i) {
        missed[i] = reading[i] - model_at[i];
        for (j = 0; j < MODEL_STATES; ++j) {
            missed[i] -= model_C[i][j] * state->x[j];
        }
    }
}

static void model_law_init(model_state *state, const model_real *duty,
                           const model_real *measurement)
{
    model_real y[MODEL_OUTPUTS];
    int i, j;
    for (i = 0; i < MODEL_STATES; ++i) {
        state->x[i] = 0;
        for (j = 0; j < MODEL_CELLS; ++j) {
            state->x[i] += model_by_duty[i][j] * (duty[j] - model_duty[j]);
        }
    }
    model_missed(state, measurement, y);
    for (i = 0; i < MODEL_STATES; ++i) {
        for (j = 0; j < MODEL_OUTPUTS; ++j) {
            state->x[i] += model_by_rest[i][j] * y[j];
        }
    }
    for (i = 0; i < MODEL_CELLS; ++i) {
        state->duty_offset[i] = duty[i] - model_duty[i];
        for (j = 0; j < MODEL_OUTPUTS; ++j) {
            state->duty_offset[i] -= model_bN[i][j] * (measurement[j] - model_at[j]);
        }
        for (j = 0; j < MODEL_PLANT_STATES; ++j) {
            state->duty_offset[i] += model_Kx[i][j] * state->x[j];
        }
    }
    for (i = 0; i < MODEL_OUTPUTS; ++i) {
        state->integral[i] = 0;
        for (j = 0; j < MODEL_CELLS; ++j) {
            state->integral[i] += model_Kt[i][j] * state->duty_offset[j];
        }
    }
    for (i = 0; i < MODEL_CELLS; ++i) {
        for (j = 0; j < MODEL_OUTPUTS; ++j) {
            state->duty_offset[i] -= model_Ki[i][j] * state->integral[j];
        }
    }
}

static void model_law(model_state *state, const model_real *reference, int samples,
                      model_real *duty)
{
    model_real y[MODEL_OUTPUTS], asked[MODEL_CELLS], change[MODEL_STATES];
    int i, j;
    (void)samples;
    model_missed(state, state->seen, y);
    for (i = 0; i < MODEL_STATES; ++i) {
        for (j = 0; j < MODEL_OUTPUTS; ++j) {
            state->x[i] += model_L[i][j] * y[j];
        }
    }
    for (i = 0; i < MODEL_CELLS; ++i) {
        asked[i] = model_duty[i] + state->duty_offset[i];
        for (j = 0; j < MODEL_OUTPUTS; ++j) {
            asked[i] += model_bN[i][j] * (reference[j] - model_at[j]);
        }
        for (j = 0; j < MODEL_PLANT_STATES; ++j) {
            asked[i] -= model_Kx[i][j] * state->x[j];
        }
        for (j = 0; j < MODEL_OUTPUTS; ++j) {
            asked[i] += model_Ki[i][j] * state->integral[j];
        }
        duty[i] = model_limited(i, asked[i]);
    }
    for (i = 0; i < MODEL_OUTPUTS; ++i) {
        change[i] = MODEL_SAMPLE_TIME_S * (reference[i] - state->seen[i]);
        for (j = 0; j < MODEL_CELLS; ++j) {
            change[i] += model_Kt[i][j] * (duty[j] - asked[j]);
        }
        model_integrate(state, i, change[i]);
    }
    /* The change of the states is added, because slow poles lie near 1. */
    for (i = 0; i < MODEL_STATES; ++i) {
        change[i] = 0;
        for (j = 0; j < MODEL_STATES; ++j) {
            change[i] += model_A[i][j] * state->x[j];
        }
        for (j = 0; j < MODEL_CELLS; ++j) {
            change[i] += model_B[i][j] * (duty[j] - model_duty[j]);
        }
    }
    for (i = 0; i < MODEL_STATES; ++i) {
        state->x[i] += change[i];
    }
}
