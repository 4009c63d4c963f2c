/* The law of a PID for each cell. Cells that all follow one output have one integral, of the demand
   that they share; otherwise each follows its own. */

#if MODEL_OUTPUTS < MODEL_CELLS
#define MODEL_SHARES 1
#define MODEL_OUTPUT(cell) 0
#else
#define MODEL_OUTPUT(cell) (cell)
#endif

#ifdef MODEL_SHARES
/* The demand whose shares are nearest to a duty, by least squares over the counted cells. */
static model_real model_demand(const model_real *rest, const int *counted)
{
    model_real sum = 0, size = 0;
    int i;
    for (i = 0; i < MODEL_CELLS; ++i) {
        if (counted[i]) {
            sum += model_share[i] * rest[i];
            size += model_share[i] * model_share[i];
        }
    }
    return size > 0 ? sum / size : sum;
}

/* What a sample takes back from the demand: nothing while one of the cells follows it, then the
   excess of the farthest, but never more than leads back to the limit of the nearest. */
static model_real model_excess_of_all(const model_real *beyond)
{
    model_real smallest = 0, largest = 0;
    int i, counted = 0;
    for (i = 0; i < MODEL_CELLS; ++i) {
        if (model_share[i] > 0) {
            const model_real excess = beyond[i] / model_share[i];
            smallest = !counted || excess < smallest ? excess : smallest;
            largest = !counted || excess > largest ? excess : largest;
            ++counted;
        }
    }
    if (smallest > 0) {
        const model_real back = model_tracking_gain[0] * largest;
        return back < smallest ? back : smallest;
    }
    if (largest < 0) {
        const model_real back = model_tracking_gain[0] * smallest;
        return back > largest ? back : largest;
    }
    return 0;
}
#endif

static void model_integrate_within(model_state *state, int i, model_real more, model_real excess)
{
#ifdef MODEL_CLAMPS
    model_integrate(state, i, more * excess > 0 ? 0 : more);
#else
    model_integrate(state, i, more - excess);
#endif
}

static void model_law_init(model_state *state, const model_real *duty,
                           const model_real *measurement)
{
    int i;
#ifdef MODEL_SHARES
    model_real rest[MODEL_CELLS];
    int counted[MODEL_CELLS], within = 0;
    for (i = 0; i < MODEL_CELLS; ++i) {
        rest[i] = duty[i] - model_reference_gain[i] * measurement[0];
        counted[i] = duty[i] > model_lowest_duty[i] && duty[i] < model_highest_duty[i];
        within += counted[i];
    }
    for (i = 0; i < MODEL_CELLS; ++i) {
        counted[i] = counted[i] || !within;
    }
    state->integral[0] = model_demand(rest, counted);
    for (i = 0; i < MODEL_CELLS; ++i) {
        const model_real asked =
            model_reference_gain[i] * measurement[0] + model_share[i] * state->integral[0];
        state->offset[i] = model_limited(i, asked) == duty[i] ? 0 : duty[i] - asked;
    }
#endif
    for (i = 0; i < MODEL_CELLS; ++i) {
#ifndef MODEL_SHARES
        state->integral[i] = duty[i] - model_reference_gain[i] * measurement[i];
#endif
#ifdef MODEL_HAS_DERIVATIVE
        const model_real y = measurement[MODEL_OUTPUT(i)];
        state->last[i] = model_c[i] * y - y;
        state->derivative[i] = 0;
#endif
    }
}

static void model_law(model_state *state, const model_real *reference, int samples,
                      model_real *duty)
{
    int i;
#ifdef MODEL_SHARES
    model_real beyond[MODEL_CELLS];
#endif
    (void)samples;
    for (i = 0; i < MODEL_CELLS; ++i) {
        const model_real r = reference[MODEL_OUTPUT(i)], y = state->seen[MODEL_OUTPUT(i)];
        const model_real proportional = model_Kp[i] * (r - y) + model_reference_gain[i] * r;
#ifdef MODEL_SHARES
        model_real asked = proportional + model_share[i] * state->integral[0] + state->offset[i];
#else
        model_real asked = proportional + state->integral[i];
#endif
#ifdef MODEL_HAS_DERIVATIVE
        const model_real d = model_c[i] * r - y;
        const model_real change = model_Kd_h[i] * (d - state->last[i]);
        state->derivative[i] = model_decay[i] * state->derivative[i] + change;
        state->last[i] = d;
        asked += state->derivative[i];
#endif
        duty[i] = model_limited(i, asked);
#ifdef MODEL_SHARES
        beyond[i] = asked - duty[i];
        state->offset[i] -= model_tracking_gain[i] * state->offset[i];
#else
        model_integrate_within(state, i, model_Ki_h[i] * (r - y),
                               model_tracking_gain[i] * (asked - duty[i]));
#endif
    }
#ifdef MODEL_SHARES
    model_integrate_within(state, 0, model_Ki_h[0] * (reference[0] - state->seen[0]),
                           model_excess_of_all(beyond));
#endif
}
