/* The law of a PID for each cell. All cells follow one output, or each its own. */

#if MODEL_OUTPUTS > 1
#define MODEL_OUTPUT(cell) (cell)
#else
#define MODEL_OUTPUT(cell) 0
#endif

static void model_law_init(model_state *state, const model_real *duty,
                           const model_real *measurement)
{
    int i;
    for (i = 0; i < MODEL_CELLS; ++i) {
        const model_real y = measurement[MODEL_OUTPUT(i)];
        state->integral[i] = duty[i] - model_Kp[i] * (model_b[i] * y - y);
#ifdef MODEL_HAS_DERIVATIVE
        state->last[i] = model_c[i] * y - y;
        state->derivative[i] = 0;
#endif
    }
}

static void model_law(model_state *state, const model_real *reference, int samples,
                      model_real *duty)
{
    int i;
    (void)samples;
    for (i = 0; i < MODEL_CELLS; ++i) {
        const model_real r = reference[MODEL_OUTPUT(i)], y = state->seen[MODEL_OUTPUT(i)];
        const model_real proportional = model_Kp[i] * (model_b[i] * r - y);
        model_real asked = proportional + state->integral[i];
#ifdef MODEL_HAS_DERIVATIVE
        const model_real d = model_c[i] * r - y;
        const model_real change = model_Kd_h[i] * (d - state->last[i]);
        state->derivative[i] = model_decay[i] * state->derivative[i] + change;
        state->last[i] = d;
        asked += state->derivative[i];
#endif
        duty[i] = model_limited(i, asked);
        {
            const model_real more = model_Ki_h[i] * (r - y), beyond = asked - duty[i];
#ifdef MODEL_CLAMPS
            model_integrate(state, i, more * beyond > 0 ? 0 : more);
#else
            model_integrate(state, i, more - model_back[i] * beyond);
#endif
        }
    }
}
