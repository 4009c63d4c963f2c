/* Relays behind the law of a controller: each is on for a share of a window, and what the minimum
   times do not allow is carried to the next window. */

static model_real model_distance(model_real a, model_real b)
{
    return a > b ? a - b : b - a;
}

static void model_law_init(model_state *state, const model_real *duty,
                           const model_real *measurement)
{
    int i;
    model_asked_init(state, duty, measurement);
    state->sample[0] = 0;
    for (i = 0; i < MODEL_CELLS; ++i) {
        state->on[i] = 0;
        state->carried[i] = 0;
    }
}

static void model_begin_window(model_state *state, int i, model_real asked)
{
    const model_real wanted = asked * MODEL_WINDOW + state->carried[i];
    model_real on = 0;
    if (!(asked > 0 && asked < 1)) {
        state->on[i] = asked >= 1 ? MODEL_WINDOW : 0;
        return;
    }
#if MODEL_SHORTEST_ON <= MODEL_LONGEST_ON
    {
        const model_real half = (model_real)0.5;
        model_real between = (model_real)floor((double)(wanted + (half - MODEL_TIE)));
        between = between < MODEL_SHORTEST_ON ? MODEL_SHORTEST_ON : between;
        between = between > MODEL_LONGEST_ON ? MODEL_LONGEST_ON : between;
        if (model_distance(between, wanted) < model_distance(on, wanted) - MODEL_TIE) {
            on = between;
        }
    }
#endif
    if (model_distance(MODEL_WINDOW, wanted) < model_distance(on, wanted) - MODEL_TIE) {
        on = MODEL_WINDOW;
    }
    state->on[i] = on;
    state->carried[i] = wanted - on;
}

static void model_law(model_state *state, const model_real *reference, int samples,
                      model_real *duty)
{
    int i;
    model_asked(state, reference, samples, duty);
    for (i = 0; i < MODEL_CELLS; ++i) {
        if (model_switched[i] > 0 && isfinite(duty[i])) {
            if (!(state->sample[0] > 0)) {
                model_begin_window(state, i, duty[i]);
            }
            duty[i] = state->sample[0] < state->on[i] ? 1 : 0;
        }
    }
    state->sample[0] = state->sample[0] + 1 >= MODEL_WINDOW ? 0 : state->sample[0] + 1;
}
