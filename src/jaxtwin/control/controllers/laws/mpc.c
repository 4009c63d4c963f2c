/* The law of an MPC: its Kalman filter, the duty at rest that comes nearest to a reference, and the
   plan of the next samples. Duty and temperatures are counted from the operating point, model_duty
   and model_at. */

#include "quadratic_program.c"

/* Adds a matrix times a vector. */
static void model_add(model_real *to, const model_real *matrix, const model_real *vector, int rows,
                      int columns)
{
    int i, j;
    for (i = 0; i < rows; ++i) {
        for (j = 0; j < columns; ++j) {
            to[i] += *matrix++ * vector[j];
        }
    }
}

/* What the estimated states miss of a reading, K. */
static void model_missed(const model_state *state, const model_real *reading, model_real *missed)
{
    int i;
    for (i = 0; i < MODEL_OUTPUTS; ++i) {
        model_real expected = 0;
        model_add(&expected, model_C + i * MODEL_STATES, state->x, 1, MODEL_STATES);
        missed[i] = reading[i] - model_at[i] - expected;
    }
}

#ifdef MODEL_WATCHED
/* What the estimated states miss of the reading of a channel with limits, K. */
static model_real model_watched_missed(const model_state *state, const model_real *reading, int i)
{
    enum { PLANT_STATES = MODEL_STATES - MODEL_OUTPUTS };
    model_real expected = 0;
    model_add(&expected, model_watched_C + i * PLANT_STATES, state->x, 1, PLANT_STATES);
    return reading[MODEL_OUTPUTS + i] - model_watched_at[i] - expected;
}
#endif

static void model_box(model_state *state, int size)
{
    int i;
    for (i = 0; i < size; ++i) {
        state->slope[i] = 0;
        state->lowest[i] = MODEL_LOWEST - model_duty[i % MODEL_CELLS];
        state->highest[i] = MODEL_HIGHEST - model_duty[i % MODEL_CELLS];
    }
}

#ifdef MODEL_WATCHED
/* The limits of temperatures, less what these will be without any duty. */
static void model_soft_limits(model_state *state, int first, int rows, const model_real *by,
                              const model_real *vector, int columns)
{
    int i;
    for (i = 0; i < rows; ++i) {
        model_real coming = state->error[i % MODEL_WATCHED];
        model_add(&coming, by + i * columns, vector, 1, columns);
        state->lowest[first + i] = model_lowest[i % MODEL_WATCHED] - coming;
        state->highest[first + i] = model_highest[i % MODEL_WATCHED] - coming;
    }
}
#endif

/* The duty at rest that comes nearest to a reference. */
static void model_target(model_state *state, const model_real *reference)
{
#ifdef MODEL_WATCHED
    static const model_program program = {
        model_rest_hessian, model_soft_at_rest, MODEL_REST_SOFTNESS, MODEL_CELLS, 0, MODEL_WATCHED};
#else
    static const model_program program = {model_rest_hessian, 0, 0, MODEL_CELLS, 0, 0};
#endif
    const model_real *disturbance = state->x + MODEL_STATES - MODEL_OUTPUTS;
    model_real missing[MODEL_OUTPUTS];
    int i;
    for (i = 0; i < MODEL_OUTPUTS; ++i) {
        missing[i] = reference[i] - model_at[i] - disturbance[i];
    }
    model_box(state, MODEL_CELLS);
#ifdef MODEL_WATCHED
    model_soft_limits(state, MODEL_CELLS, MODEL_WATCHED, model_soft_by_rest, disturbance,
                      MODEL_OUTPUTS);
#endif
    model_add(state->slope, model_by_missing, missing, MODEL_CELLS, MODEL_OUTPUTS);
    model_minimise(state, &program);
}

/* The duty of the next samples. */
static void model_plan(model_state *state)
{
#ifdef MODEL_REACH
    enum { HAS_RATE = 1 };
    int i;
#else
    enum { HAS_RATE = 0 };
#endif
#ifdef MODEL_WATCHED
    static const model_program program = {model_hessian,      model_soft_by_moves,
                                          MODEL_PLAN_SOFTNESS, MODEL_MOVES,
                                          HAS_RATE,           MODEL_HORIZON * MODEL_WATCHED};
#else
    static const model_program program = {model_hessian, 0, 0, MODEL_MOVES, HAS_RATE, 0};
#endif
    model_box(state, MODEL_MOVES);
#ifdef MODEL_REACH
    for (i = 0; i < MODEL_MOVES; ++i) {
        const model_real last = i < MODEL_CELLS ? state->moved[i] : 0;
        state->lowest[MODEL_MOVES + i] = last - MODEL_REACH;
        state->highest[MODEL_MOVES + i] = last + MODEL_REACH;
    }
#endif
#ifdef MODEL_WATCHED
    model_soft_limits(state, MODEL_MOVES * (1 + HAS_RATE), MODEL_HORIZON * MODEL_WATCHED,
                      model_soft_by_states, state->x, MODEL_STATES);
#endif
    model_add(state->slope, model_by_states, state->x, MODEL_MOVES, MODEL_STATES);
    model_add(state->slope, model_by_last, state->moved, MODEL_CELLS, MODEL_CELLS);
    model_add(state->slope, model_by_target, state->targets, MODEL_MOVES, MODEL_MOVES);
    model_minimise(state, &program);
}

static void model_law_init(model_state *state, const model_real *duty,
                           const model_real *measurement)
{
    model_real y[MODEL_OUTPUTS];
    int i;
    for (i = 0; i < MODEL_CELLS; ++i) {
        state->moved[i] = duty[i] - model_duty[i];
    }
    for (i = 0; i < MODEL_STATES; ++i) {
        state->x[i] = 0;
    }
    model_add(state->x, model_by_duty, state->moved, MODEL_STATES, MODEL_CELLS);
    model_missed(state, measurement, y);
    model_add(state->x, model_by_rest, y, MODEL_STATES, MODEL_OUTPUTS);
#ifdef MODEL_WATCHED
    for (i = 0; i < MODEL_WATCHED; ++i) {
        state->error[i] = model_watched_missed(state, measurement, i);
    }
#endif
}

/* The last of the references that are known holds for the rest of the horizon. */
static void model_law(model_state *state, const model_real *reference, int samples,
                      model_real *duty)
{
    model_real y[MODEL_OUTPUTS], change[MODEL_STATES];
    int i, k;
    model_missed(state, state->seen, y);
    model_add(state->x, model_L, y, MODEL_STATES, MODEL_OUTPUTS);
#ifdef MODEL_WATCHED
    for (i = 0; i < MODEL_WATCHED; ++i) {
        const model_real missed = model_watched_missed(state, state->seen, i);
        state->error[i] += model_watched_L[i] * (missed - state->error[i]);
    }
#endif
    for (k = 0; k < MODEL_HORIZON; ++k) {
        if (k < samples) {
            model_target(state, reference + k * MODEL_OUTPUTS);
        }
        for (i = 0; i < MODEL_CELLS; ++i) {
            state->targets[k * MODEL_CELLS + i] = state->z[i];
        }
    }
    model_plan(state);
    for (i = 0; i < MODEL_CELLS; ++i) {
        model_real now = state->z[i];
#ifdef MODEL_REACH
        if (now < state->moved[i] - MODEL_REACH) {
            now = state->moved[i] - MODEL_REACH;
        }
        if (now > state->moved[i] + MODEL_REACH) {
            now = state->moved[i] + MODEL_REACH;
        }
#endif
        duty[i] = model_limited(now + model_duty[i]);
        state->moved[i] = duty[i] - model_duty[i];
    }
    /* The change of the states is added, because slow poles lie near 1. */
    for (i = 0; i < MODEL_STATES; ++i) {
        change[i] = 0;
    }
    model_add(change, model_A, state->x, MODEL_STATES, MODEL_STATES);
    model_add(change, model_B, state->moved, MODEL_STATES, MODEL_CELLS);
    for (i = 0; i < MODEL_STATES; ++i) {
        state->x[i] += change[i];
    }
}
