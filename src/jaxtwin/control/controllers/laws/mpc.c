/* The law of an MPC: its Kalman filter, the duty at rest that comes nearest to a reference, and the
   plan of the next samples. Duty and temperatures are counted from the operating point, model_duty
   and model_at. With MODEL_POINTS there are temperatures that are to be even: with MODEL_BANDS each
   plan keeps them together, with MODEL_CENTRES about a centre that is free. */

#if defined(MODEL_LIMITED) || defined(MODEL_BANDS)
#define MODEL_SOFT
#endif

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

/* What the estimated states miss of the readings of the filter, K. */
static void model_missed(const model_state *state, const model_real *reading, model_real *missed)
{
    int i;
    for (i = 0; i < MODEL_READ; ++i) {
        model_real expected = 0;
        model_add(&expected, model_C + i * MODEL_STATES, state->x, 1, MODEL_STATES);
#ifdef MODEL_POINTS
        missed[i] = reading[MODEL_OUTPUTS + i] - model_watched_at[i] - expected;
#else
        missed[i] = reading[i] - model_at[i] - expected;
#endif
    }
}

#ifdef MODEL_ERRORS
/* What the estimated states miss of the readings of the watched channels, K; with MODEL_POINTS,
   what of it no disturbance explains. */
static void model_watched_missed(const model_state *state, const model_real *reading,
                                 model_real *missed)
{
#ifdef MODEL_POINTS
    model_real all[MODEL_ERRORS];
    int i;
    model_missed(state, reading, all);
    for (i = 0; i < MODEL_ERRORS; ++i) {
        missed[i] = 0;
    }
    model_add(missed, model_unexplained, all, MODEL_ERRORS, MODEL_ERRORS);
#else
    enum { PLANT_STATES = MODEL_STATES - MODEL_DISTURBANCES };
    int i;
    for (i = 0; i < MODEL_ERRORS; ++i) {
        model_real expected = 0;
        model_add(&expected, model_watched_C + i * PLANT_STATES, state->x, 1, PLANT_STATES);
        missed[i] = reading[MODEL_OUTPUTS + i] - model_watched_at[i] - expected;
    }
#endif
}
#endif

static void model_box(model_state *state, int size)
{
    int i;
    for (i = 0; i < size; ++i) {
        state->slope[i] = 0;
        state->lowest[i] = model_lowest_duty[i % MODEL_CELLS] - model_duty[i % MODEL_CELLS];
        state->highest[i] = model_highest_duty[i % MODEL_CELLS] - model_duty[i % MODEL_CELLS];
    }
}

#ifdef MODEL_LIMITED
/* The limits of temperatures, less what these will be without any duty. */
static void model_soft_limits(model_state *state, int first, int rows, const model_real *by,
                              const model_real *vector, int columns, const model_real *error)
{
    int i;
    for (i = 0; i < rows; ++i) {
        model_real coming = error[i % MODEL_LIMITED];
        model_add(&coming, by + i * columns, vector, 1, columns);
        state->lowest[first + i] = model_lowest[i % MODEL_LIMITED] - coming;
        state->highest[first + i] = model_highest[i % MODEL_LIMITED] - coming;
    }
}
#endif

#ifdef MODEL_POINTS
/* A point without any duty, from the mean of the outputs at the operating point on. */
static model_real model_point(int row, const model_real *by, const model_real *vector, int columns,
                              const model_real *error)
{
    const int point = row % MODEL_POINTS;
    model_real coming = model_points_at[point];
    model_add(&coming, model_points_by_errors + point * MODEL_ERRORS, error, 1, MODEL_ERRORS);
    model_add(&coming, by + row * columns, vector, 1, columns);
    return coming;
}

/* The mean of references, from that of the operating point on. */
static model_real model_centre(const model_real *reference)
{
    model_real sum = 0;
    int i;
    for (i = 0; i < MODEL_OUTPUTS; ++i) {
        sum += reference[i] - model_at[i];
    }
    return sum / MODEL_OUTPUTS;
}
#endif

#ifdef MODEL_LIMITED
enum { MODEL_SOFT_CHANNELS = MODEL_LIMITED };
#else
enum { MODEL_SOFT_CHANNELS = 0 };
#endif

#ifdef MODEL_BANDS
enum { MODEL_REST_SIZE = MODEL_CELLS + 1 };
#else
enum { MODEL_REST_SIZE = MODEL_CELLS };
#endif

/* The duty at rest that comes nearest to a reference; with MODEL_BANDS, the largest deviation of a
   point from the centre follows it. */
static void model_target(model_state *state, const model_real *reference,
                         const model_real *disturbance, const model_real *error)
{
    static const model_program program = {
        model_rest_hessian,
#ifdef MODEL_SOFT
        model_rest_sums,
        model_rest_softness,
#else
        0,
        0,
#endif
        MODEL_SOFT_CHANNELS,
        1,
        MODEL_REST_SIZE,
        0,
        MODEL_SOFT_CHANNELS,
#ifdef MODEL_BANDS
        2 * MODEL_POINTS,
        MODEL_CENTRES_AT_REST,
        2 * MODEL_POINTS,
#else
        0,
        0,
        0,
#endif
    };
    model_real missing[MODEL_OUTPUTS];
    int i;
    for (i = 0; i < MODEL_OUTPUTS; ++i) {
        missing[i] = reference[i] - model_at[i];
#ifdef MODEL_POINTS
        {
            model_real known = 0;
            model_add(&known, model_output_by_rest + i * MODEL_DISTURBANCES, disturbance, 1,
                      MODEL_DISTURBANCES);
            model_add(&known, model_output_by_errors + i * MODEL_ERRORS, error, 1, MODEL_ERRORS);
            missing[i] -= known;
        }
#else
        missing[i] -= disturbance[i];
#endif
    }
    model_box(state, MODEL_CELLS);
#ifdef MODEL_LIMITED
    model_soft_limits(state, MODEL_REST_SIZE, MODEL_LIMITED, model_soft_by_rest, disturbance,
                      MODEL_DISTURBANCES, error);
#endif
#ifdef MODEL_POINTS
    {
        const model_real centre = model_centre(reference);
#ifdef MODEL_BANDS
        const int first = model_limits(&program) - 2 * MODEL_POINTS;
        state->slope[MODEL_CELLS] = MODEL_DEVIATION_PRICE;
        state->lowest[MODEL_CELLS] = 0;
        state->highest[MODEL_CELLS] = MODEL_WIDEST;
#endif
        for (i = 0; i < MODEL_CELLS; ++i) {
            state->slope[i] = MODEL_DUTY_PRICE;
        }
        for (i = 0; i < MODEL_POINTS; ++i) {
            model_real coming = model_point(i, model_points_by_rest, disturbance,
                                            MODEL_DISTURBANCES, error);
#ifndef MODEL_CENTRES
            coming -= centre;
#endif
#ifdef MODEL_BANDS
            state->lowest[first + i] = -MODEL_WIDEST;
            state->highest[first + i] = -coming;
            state->lowest[first + MODEL_POINTS + i] = -coming;
            state->highest[first + MODEL_POINTS + i] = MODEL_WIDEST;
#else
            model_add(state->slope, model_by_point + i * MODEL_CELLS, &coming, MODEL_CELLS, 1);
#endif
        }
        (void)centre;
    }
#else
    (void)error;
#endif
    model_add(state->slope, model_by_missing, missing, MODEL_CELLS, MODEL_OUTPUTS);
    model_minimise(state, &program);
}

/* The duty of the next samples. */
static void model_plan(model_state *state)
{
#ifdef MODEL_REACH
    enum { HAS_RATE = 1 };
#else
    enum { HAS_RATE = 0 };
#endif
    static const model_program program = {
        model_hessian,
#ifdef MODEL_SOFT
        model_plan_sums,
        model_plan_softness,
#else
        0,
        0,
#endif
        MODEL_SOFT_CHANNELS,
        MODEL_HORIZON,
        MODEL_MOVES,
        HAS_RATE,
        MODEL_SOFT_ROWS,
        0,
#ifdef MODEL_CENTRES
        MODEL_HORIZON,
        MODEL_POINTS,
#else
        0,
        0,
#endif
    };
#if defined(MODEL_REACH) || defined(MODEL_BANDS)
    int i;
#endif
    model_box(state, MODEL_MOVES);
#ifdef MODEL_REACH
    for (i = 0; i < MODEL_MOVES; ++i) {
        const model_real last = i < MODEL_CELLS ? state->moved[i] : 0;
        state->lowest[MODEL_MOVES + i] = last - MODEL_REACH;
        state->highest[MODEL_MOVES + i] = last + MODEL_REACH;
    }
#endif
#ifdef MODEL_LIMITED
    model_soft_limits(state, MODEL_MOVES * (1 + HAS_RATE), MODEL_HORIZON * MODEL_LIMITED,
                      model_soft_by_states, state->x, MODEL_STATES, state->error);
#endif
#ifdef MODEL_BANDS
    for (i = 0; i < MODEL_HORIZON * MODEL_POINTS; ++i) {
        const int row = model_limits(&program) - MODEL_HORIZON * MODEL_POINTS + i;
        const int sample = i / MODEL_POINTS;
        model_real coming
            = model_point(i, model_points_by_states, state->x, MODEL_STATES, state->error);
        model_real wide = state->deviation[sample];
        wide = wide > MODEL_NARROWEST ? wide : MODEL_NARROWEST;
#ifndef MODEL_CENTRES
        coming -= state->centre[sample];
#endif
        state->lowest[row] = -wide - coming;
        state->highest[row] = wide - coming;
    }
#endif
    model_add(state->slope, model_by_states, state->x, MODEL_MOVES, MODEL_STATES);
    model_add(state->slope, model_by_last, state->moved, MODEL_CELLS, MODEL_CELLS);
    model_add(state->slope, model_by_target, state->targets, MODEL_MOVES,
              MODEL_HORIZON * MODEL_CELLS);
    model_minimise(state, &program);
}

static void model_law_init(model_state *state, const model_real *duty,
                           const model_real *measurement)
{
    model_real y[MODEL_READ];
    int i;
    for (i = 0; i < MODEL_CELLS; ++i) {
        state->moved[i] = duty[i] - model_duty[i];
    }
    for (i = 0; i < MODEL_STATES; ++i) {
        state->x[i] = 0;
    }
    model_add(state->x, model_by_duty, state->moved, MODEL_STATES, MODEL_CELLS);
    model_missed(state, measurement, y);
    model_add(state->x, model_by_rest, y, MODEL_STATES, MODEL_READ);
#ifdef MODEL_ERRORS
    model_watched_missed(state, measurement, state->error);
#endif
#ifdef MODEL_BANDS
    state->allowance[0] = 0;
#endif
}

#ifdef MODEL_BANDS
/* How far the points may be from their centre: as far as the model expects at rest without
   disturbances, and by what lasts of these. */
static void model_deviations(model_state *state, const model_real *reference, int samples)
{
    static const model_real nothing[MODEL_DISTURBANCES + MODEL_ERRORS] = {0};
    int k;
    for (k = 0; k < MODEL_HORIZON; ++k) {
        if (k < samples) {
            model_target(state, reference + k * MODEL_OUTPUTS, nothing, nothing);
            if (k == 0) {
                const model_real more = state->deviation[0] - state->z[MODEL_CELLS];
                state->allowance[0] += MODEL_ADAPTATION * (more - state->allowance[0]);
            }
            state->centre[k] = model_centre(reference + k * MODEL_OUTPUTS);
            state->deviation[k] = state->z[MODEL_CELLS] + state->allowance[0];
            state->deviation[k] *= MODEL_ROOM_ON_THE_WAY;
        } else {
            state->centre[k] = state->centre[k - 1];
            state->deviation[k] = state->deviation[k - 1];
        }
    }
}
#endif

/* The last of the references that are known holds for the rest of the horizon. */
static void model_law(model_state *state, const model_real *reference, int samples,
                      model_real *duty)
{
    const model_real *disturbance = state->x + MODEL_STATES - MODEL_DISTURBANCES;
    model_real y[MODEL_READ], change[MODEL_STATES];
    int i, k;
#ifdef MODEL_ERRORS
    const model_real *error = state->error;
    model_real missed[MODEL_ERRORS];
#else
    const model_real *error = 0;
#endif
    model_missed(state, state->seen, y);
#ifdef MODEL_POINTS
    for (i = 0; i < MODEL_READ; ++i) {
        y[i] -= error[i];
    }
#endif
    model_add(state->x, model_L, y, MODEL_STATES, MODEL_READ);
#ifdef MODEL_ERRORS
    model_watched_missed(state, state->seen, missed);
    for (i = 0; i < MODEL_ERRORS; ++i) {
        state->error[i] += model_watched_L[i] * (missed[i] - state->error[i]);
    }
#endif
    for (k = 0; k < MODEL_HORIZON; ++k) {
        if (k < samples) {
            model_target(state, reference + k * MODEL_OUTPUTS, disturbance, error);
        }
#ifdef MODEL_BANDS
        if (k == 0) {
            state->deviation[0] = state->z[MODEL_CELLS];
        }
#endif
        for (i = 0; i < MODEL_CELLS; ++i) {
            state->targets[k * MODEL_CELLS + i] = state->z[i];
        }
    }
#ifdef MODEL_BANDS
    model_deviations(state, reference, samples);
#endif
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
        duty[i] = model_limited(i, now + model_duty[i]);
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
