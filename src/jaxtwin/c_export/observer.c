/* An extended Kalman filter of a twin: the filter of jaxtwin.observers with a fixed sample time.
   The readings are taken in one after the other, which is the same as all at once, because their
   noise is independent. */

#include "model.h"
#include "model_numbers.h"
#include "real.h"

#include "twin_steps.c"

/* A command that was given before the start, s. */
#define MODEL_LONG_AGO ((model_real)1e9)

#define MODEL_WITHIN(value, low, high) model_fmin(model_fmax(value, low), high)

/* The duty that reaches a cell some time from now, by the commands on their way. */
static model_real model_reached(const model_state *state, int cell, model_real time)
{
    model_real end = MODEL_LONG_AGO;
    int i;
#ifdef MODEL_HAS_LAG
    model_real duty = model_exp(-time / MODEL_LAG) * state->x[MODEL_ROOM - MODEL_DUTY + cell];
#else
    model_real duty = 0;
#endif
    for (i = 0; i < MODEL_COMMANDS; ++i) {
#ifdef MODEL_DELAY
        model_real begin = MODEL_DELAY - state->age[i];
#else
        model_real begin = 0;
#endif
        if (i == MODEL_COMMANDS - 1) {
            begin = -MODEL_LONG_AGO;
        }
#ifdef MODEL_HAS_LAG
        duty += state->late[i][cell]
                * (model_exp(-(time - MODEL_WITHIN(end, 0, time)) / MODEL_LAG)
                   - model_exp(-(time - MODEL_WITHIN(begin, 0, time)) / MODEL_LAG));
#else
        if (begin <= time && time < end) {
            duty += state->late[i][cell];
        }
#endif
        end = begin;
    }
    return duty;
}

/* Takes a command in. One that is not new, or follows the last one too fast to be told apart,
   replaces it. */
static void model_given(model_state *state, const model_real *duty)
{
    int i, j, is_held = 1;
    for (i = 0; i < MODEL_CELLS; ++i) {
        is_held = is_held && duty[i] <= state->late[0][i] && duty[i] >= state->late[0][i];
    }
    if (!is_held && !(state->age[0] < MODEL_SPACING)) {
        for (j = MODEL_COMMANDS - 1; j > 0; --j) {
            for (i = 0; i < MODEL_CELLS; ++i) {
                state->late[j][i] = state->late[j - 1][i];
            }
            state->age[j] = state->age[j - 1];
        }
        state->age[0] = 0;
    }
    for (i = 0; i < MODEL_CELLS; ++i) {
        state->late[0][i] = duty[i];
    }
}

/* The derivatives of model_heat by duty, cold and hot side: of the heat into the cold side, and of
   that into the hot side. */
static void model_heat_slopes(int cell, model_real duty, model_real cold, model_real hot,
                              model_real of_cold[3], model_real of_hot[3])
{
    const model_real alpha = model_alpha[cell], loop = model_R[cell] + MODEL_RON;
    const model_real emf = alpha * (hot - cold);
    const model_real share = MODEL_IS_HEATER(cell) ? duty : model_fabs(duty);
    /* At 0 that for a duty that heats. */
    const model_real more = duty < 0 && !MODEL_IS_HEATER(cell) ? -1 : 1;
    model_real current, current_duty, current_emf, square_duty, square_emf;
    model_real joule_duty, joule_emf, peltier, by_emf;
#ifdef MODEL_MEAN_VOLTAGE
    const model_real whole = loop + share * MODEL_RS;
    const model_real raw = (-duty * MODEL_VS - emf) / whole;
    current = MODEL_LIMITED(raw);
    current_duty = -(MODEL_VS + raw * more * MODEL_RS) / whole;
    current_emf = -1 / whole;
    if (current < raw || current > raw) {
        current_duty = 0;
        current_emf = 0;
    }
    square_duty = 2 * current * current_duty;
    square_emf = 2 * current * current_emf;
#else
    const model_real cools = duty < 0 ? MODEL_VS : 0;
    const model_real drive = duty > 0 || MODEL_IS_HEATER(cell) ? -MODEL_VS : cools;
    const model_real raw = (drive - emf) / (loop + MODEL_RS);
    const model_real on = MODEL_LIMITED(raw);
    const model_real on_emf = on < raw || on > raw ? 0 : -1 / (loop + MODEL_RS);
#ifdef MODEL_BRAKES
    const model_real off = -emf / loop, off_emf = -1 / loop;
#else
    const model_real off = 0, off_emf = 0;
#endif
    current = share * on + (1 - share) * off;
    current_duty = more * (on - off);
    current_emf = share * on_emf + (1 - share) * off_emf;
    square_duty = more * (on * on - off * off);
    square_emf = 2 * (share * on * on_emf + (1 - share) * off * off_emf);
#endif
    joule_duty = (model_real)0.5 * model_R[cell] * square_duty;
    joule_emf = (model_real)0.5 * model_R[cell] * square_emf;
#ifdef MODEL_HAS_POWERS
    if (model_power[cell] > 0) {
        joule_duty = (model_real)0.5 * more * model_power[cell];
        joule_emf = 0;
    }
#endif
    peltier = alpha * current;
    of_cold[0] = joule_duty - alpha * current_duty * cold;
    of_hot[0] = joule_duty + alpha * current_duty * hot;
    by_emf = joule_emf - alpha * current_emf * cold;
    of_cold[1] = -alpha * by_emf - peltier;
    of_cold[2] = alpha * by_emf;
    by_emf = joule_emf + alpha * current_emf * hot;
    of_hot[1] = -alpha * by_emf;
    of_hot[2] = alpha * by_emf + peltier;
}

/* The temperatures of the sides of the cells above those that deviations are counted from, K. */
static void model_sides(const model_real *z, model_real *at)
{
    int i, m;
    for (i = 0; i < 2 * MODEL_CELLS; ++i) {
        at[i] = 0;
        for (m = 0; m < MODEL_MODES; ++m) {
            at[i] += model_shape[model_side[i]][m] * z[m];
        }
    }
}

#ifdef MODEL_LOSSES
#include "../physics/laws/lost_heat_slopes.c"
#endif

/* The equations linearised at the temperatures of the start and the duty of the middle: the forces
   on the modes by the modes, to_modes, by the duty of each cell, and by the room. */
static void model_linearise(model_state *state, const model_real *duty,
                            model_real by_duty[MODEL_CELLS][MODEL_MODES], model_real *by_room)
{
    model_real at[2 * MODEL_CELLS], flow[2 * MODEL_CELLS][2 * MODEL_CELLS], of[2][3];
    int i, j, m, n;
    model_sides(state->x, at);
    for (i = 0; i < 2 * MODEL_CELLS; ++i) {
        for (j = 0; j < 2 * MODEL_CELLS; ++j) {
            flow[i][j] = model_linearised_conductance[i][j];
        }
    }
    for (i = 0; i < MODEL_CELLS; ++i) {
        const int hot = MODEL_CELLS + i;
        model_heat_slopes(i, duty[i], MODEL_T0 + at[i], MODEL_T0 + at[hot], of[0], of[1]);
        flow[i][i] += of[0][1];
        flow[i][hot] += of[0][2];
        flow[hot][i] += of[1][1];
        flow[hot][hot] += of[1][2];
        for (m = 0; m < MODEL_MODES; ++m) {
            by_duty[i][m] = model_shape[model_side[i]][m] * of[0][0]
                            + model_shape[model_side[hot]][m] * of[1][0];
        }
    }
    for (m = 0; m < MODEL_MODES; ++m) {
        by_room[m] = model_surroundings[m];
        for (n = 0; n < MODEL_MODES; ++n) {
            state->to_modes[m][n] = 0;
        }
    }
    for (i = 0; i < 2 * MODEL_CELLS; ++i) {
        for (n = 0; n < MODEL_MODES; ++n) {
            model_real sum = 0;
            for (j = 0; j < 2 * MODEL_CELLS; ++j) {
                sum += flow[i][j] * model_shape[model_side[j]][n];
            }
            for (m = 0; m < MODEL_MODES; ++m) {
                state->to_modes[m][n] += model_shape[model_side[i]][m] * sum;
            }
        }
    }
#ifdef MODEL_LOSSES
    for (i = 0; i < MODEL_LOSSES; ++i) {
        const model_real ambient = state->x[MODEL_ROOM];
        model_real rise = -ambient, left, by_near, by_far;
        for (m = 0; m < MODEL_MODES; ++m) {
            rise += model_shape[i][m] * state->x[m];
        }
        model_lost_heat_slopes(rise, MODEL_T0 + ambient, MODEL_LOSS(i), &by_near, &by_far);
        left = model_linearised_loss[i] - by_near;
        for (m = 0; m < MODEL_MODES; ++m) {
            by_room[m] -= model_shape[i][m] * by_far;
            for (n = 0; n < MODEL_MODES; ++n) {
                state->to_modes[m][n] += model_shape[i][m] * left * model_shape[i][n];
            }
        }
    }
#endif
}

/* The force on the modes by the modes, and from outside. */
static void model_linear_force(const model_state *state, const model_real *z,
                               const model_real *outside, model_real factor, model_real *force)
{
    int m, n;
    for (m = 0; m < MODEL_MODES; ++m) {
        force[m] = outside == 0 ? 0 : factor * outside[m];
        for (n = 0; n < MODEL_MODES; ++n) {
            force[m] += state->to_modes[m][n] * z[n];
        }
    }
}

/* A step of the linearised equations, as model_advance: from unit amplitude of a mode, or from rest
   under a force of the given size at the start, in the middle and at the end. */
static void model_column(model_state *state, int column, const model_real *outside,
                         const model_real factor[3])
{
    model_real z[MODEL_MODES], b[MODEL_MODES];
    model_real f0[MODEL_MODES], fa[MODEL_MODES], fb[MODEL_MODES], fc[MODEL_MODES];
    int m;
    for (m = 0; m < MODEL_MODES; ++m) {
        z[m] = m == column ? 1 : 0;
    }
    model_linear_force(state, z, outside, factor[0], f0);
    for (m = 0; m < MODEL_MODES; ++m) {
        b[m] = z[m] + model_half_decay[0][m] * z[m] + model_half[0][m] * f0[m];
    }
    model_linear_force(state, b, outside, factor[1], fa);
    for (m = 0; m < MODEL_MODES; ++m) {
        b[m] = z[m] + model_half_decay[0][m] * z[m] + model_half_start[0][m] * f0[m]
               + model_half_middle[0][m] * fa[m];
    }
    model_linear_force(state, b, outside, factor[1], fb);
    for (m = 0; m < MODEL_MODES; ++m) {
        b[m] = z[m] + model_decay[0][m] * z[m] + model_whole_start[0][m] * f0[m]
               + model_whole_middle[0][m] * fb[m];
    }
    model_linear_force(state, b, outside, factor[2], fc);
    for (m = 0; m < MODEL_MODES; ++m) {
        state->by_driven[m][column] = z[m] + model_decay[0][m] * z[m] + model_first[0][m] * f0[m]
                                      + model_middle[0][m] * (fa[m] + fb[m])
                                      + model_last[0][m] * fc[m];
    }
}

/* The derivatives of amplitudes and duty after a step by what drives them before it. */
static void model_transition(model_state *state, const model_real *middle)
{
    static const model_real same[3] = {1, 1, 1};
    model_real by_duty[MODEL_CELLS][MODEL_MODES], by_room[MODEL_MODES], by_heat[MODEL_MODES];
    int i, m;
    model_linearise(state, middle, by_duty, by_room);
    for (m = 0; m < MODEL_MODES; ++m) {
        model_column(state, m, 0, same);
    }
#ifdef MODEL_HAS_LAG
    for (i = 0; i < MODEL_CELLS; ++i) {
        const model_real left[3] = {1, model_exp(-MODEL_SAMPLE_TIME_S / 2 / MODEL_LAG),
                                    model_exp(-MODEL_SAMPLE_TIME_S / MODEL_LAG)};
        model_column(state, MODEL_MODES + i, by_duty[i], left);
        for (m = 0; m < MODEL_DRIVEN; ++m) {
            state->by_driven[MODEL_MODES + i][m] = m == MODEL_MODES + i ? left[2] : 0;
        }
    }
#endif
    model_column(state, MODEL_ROOM, by_room, same);
    for (i = 0; i < MODEL_CELLS; ++i) {
        for (m = 0; m < MODEL_MODES; ++m) {
            by_heat[m] = model_shape[model_side[i]][m];
        }
        model_column(state, MODEL_HEATS + i, by_heat, same);
    }
}

/* The covariance after a step. */
static void model_move_covariance(model_state *state)
{
    int i, j, k;
    for (i = 0; i < MODEL_ROWS; ++i) {
        for (j = 0; j < MODEL_STATES; ++j) {
            model_real sum = 0;
            for (k = 0; k < MODEL_DRIVEN; ++k) {
                sum += state->by_driven[i][k] * state->P[k][j];
            }
            state->moved[i][j] = sum;
        }
    }
    for (i = MODEL_ROWS; i < MODEL_STATES; ++i) {
        for (j = MODEL_ROWS; j < MODEL_STATES; ++j) {
            state->P[i][j] *= model_kept[i] * model_kept[j];
        }
        state->P[i][i] += model_walk[i];
        for (k = 0; k < MODEL_ROWS; ++k) {
            state->P[k][i] = state->moved[k][i] * model_kept[i];
            state->P[i][k] = state->P[k][i];
        }
    }
    for (i = 0; i < MODEL_ROWS; ++i) {
        for (j = 0; j <= i; ++j) {
            model_real sum = 0;
            for (k = 0; k < MODEL_DRIVEN; ++k) {
                sum += state->moved[i][k] * state->by_driven[j][k];
            }
            state->P[i][j] = sum;
            state->P[j][i] = sum;
        }
    }
}

/* Adds a root of a covariance of the modes, times its transpose. */
static void model_add_root(model_state *state, const model_real *root)
{
    int m, n;
    for (m = 0; m < MODEL_MODES; ++m) {
        for (n = 0; n < MODEL_MODES; ++n) {
            state->P[m][n] += root[m] * root[n];
        }
    }
}

/* Adds what a step adds to the covariance of the modes: random heat, which is held during the step,
   and that of commands whose times are wrong. */
static void model_add_noise(model_state *state, const model_real *at, const model_real *middle,
                            const model_real *change)
{
    model_real root[MODEL_MODES], of[2][3];
    int i, m;
    for (i = 0; i < MODEL_CELLS; ++i) {
        const int hot = MODEL_CELLS + i;
        model_heat_slopes(i, middle[i], MODEL_T0 + at[i], MODEL_T0 + at[hot], of[0], of[1]);
        for (m = 0; m < MODEL_MODES; ++m) {
            root[m] = (of[0][0] * model_faded[i][m] + of[1][0] * model_faded[hot][m]) * change[i]
                      * MODEL_COMMAND_TIME;
        }
        model_add_root(state, root);
    }
    for (i = 0; i < 2 * MODEL_CELLS; ++i) {
        for (m = 0; m < MODEL_MODES; ++m) {
            root[m] = model_faded[i][m] * MODEL_RANDOM_HEAT;
        }
        model_add_root(state, root);
    }
}

/* The reading of a channel by the modes, K. */
static model_real model_seen(const model_real *z, int channel)
{
    model_real sum = 0;
    int m;
    for (m = 0; m < MODEL_MODES; ++m) {
        sum += model_by_modes[channel][m] * z[m];
    }
    return sum;
}

#ifdef MODEL_INTERVAL
/* Adds the correction of the camera that is expected within a step. */
static void model_expect_correction(model_state *state)
{
    const model_real middle = state->since + MODEL_SAMPLE_TIME_S / 2;
    const model_real number = model_fmax(1, model_floor(middle / MODEL_INTERVAL + (model_real)0.5));
    const model_real scale = MODEL_INTERVAL_SPREAD * model_sqrt(2);
    const model_real before = (state->since / MODEL_INTERVAL - number) / scale;
    const model_real after =
        ((state->since + MODEL_SAMPLE_TIME_S) / MODEL_INTERVAL - number) / scale;
    const model_real probability = (model_erf(after) - model_erf(before)) / 2;
    const model_real mean = probability * MODEL_JUMP_MEAN;
    int i;
    if (state->since < 0) {
        return;
    }
    for (i = MODEL_COMMON + 1; i < MODEL_COMMON + MODEL_COMMONS; ++i) {
        state->x[i] += mean;
        state->P[i][i] += probability * (MODEL_JUMP_VARIANCE + MODEL_JUMP_MEAN * MODEL_JUMP_MEAN)
                          - mean * mean;
    }
    state->since += MODEL_SAMPLE_TIME_S;
}
#endif

void model_predict(model_state *state, const model_real duty[MODEL_CELLS])
{
    model_real start[MODEL_CELLS], middle[MODEL_CELLS], end[MODEL_CELLS], change[MODEL_CELLS];
    model_real first[MODEL_MODES], slope[MODEL_MODES], heat[MODEL_MODES], at[2 * MODEL_CELLS];
    const model_real *effects = 0;
    int i, m;
    model_given(state, duty);
    for (i = 0; i < MODEL_CELLS; ++i) {
        start[i] = model_reached(state, i, 0);
        middle[i] = model_reached(state, i, MODEL_SAMPLE_TIME_S / 2);
        end[i] = model_reached(state, i, MODEL_SAMPLE_TIME_S);
        change[i] = end[i] - state->duty[i];
    }
    model_transition(state, middle);
    model_move_covariance(state);
    model_sides(state->x, at);
    model_add_noise(state, at, middle, change);
    for (i = 0; i < MODEL_CHANNELS; ++i) {
        state->slope[i] = -model_seen(state->x, i);
    }
    model_losses(state->x, state->x[MODEL_ROOM], effects, first);
    for (m = 0; m < MODEL_MODES; ++m) {
        heat[m] = 0;
        for (i = 0; i < MODEL_CELLS; ++i) {
            heat[m] += model_shape[model_side[i]][m] * state->x[MODEL_HEATS + i];
        }
        first[m] += heat[m];
        slope[m] = 0;
    }
#ifdef MODEL_LOSSES
    model_loss_slope(state->x, start, state->x[MODEL_ROOM], effects, first, heat, slope);
#endif
    model_advance(state->x, 0, start, middle, end, first, slope, effects);
    for (i = MODEL_ROOM; i < MODEL_STATES; ++i) {
        state->x[i] *= model_kept[i];
    }
#ifdef MODEL_INTERVAL
    model_expect_correction(state);
#endif
    for (i = 0; i < MODEL_CELLS; ++i) {
        state->duty[i] = end[i];
#ifdef MODEL_HAS_LAG
        state->x[MODEL_MODES + i] = end[i];
#endif
    }
    for (i = 0; i < MODEL_COMMANDS; ++i) {
        state->age[i] += MODEL_SAMPLE_TIME_S;
    }
    for (i = 0; i < MODEL_CHANNELS; ++i) {
        state->slope[i] = (state->slope[i] + model_seen(state->x, i)) / MODEL_SAMPLE_TIME_S;
    }
}

/* What a channel reads above the temperature that deviations are counted from, K. */
static model_real model_expected(const model_state *state, int channel)
{
    model_real sum = model_seen(state->x, channel);
    int i;
    sum += model_by_ambient[channel] * state->x[MODEL_ROOM];
    for (i = MODEL_COMMON; i < MODEL_COMMON + MODEL_COMMONS; ++i) {
        sum += state->x[i];
    }
#ifdef MODEL_OWN
    sum += state->x[MODEL_OWN + channel];
#endif
    return sum;
}

/* The covariance of all states with what a channel reads. */
static void model_across_of(const model_state *state, int channel, model_real *across)
{
    int i, m;
    for (i = 0; i < MODEL_STATES; ++i) {
        across[i] = model_seen(state->P[i], channel);
        across[i] += model_by_ambient[channel] * state->P[i][MODEL_ROOM];
        for (m = MODEL_COMMON; m < MODEL_COMMON + MODEL_COMMONS; ++m) {
            across[i] += state->P[i][m];
        }
#ifdef MODEL_OWN
        across[i] += state->P[i][MODEL_OWN + channel];
#endif
    }
}

/* The same of a channel with the reading of another. */
static model_real model_row(const model_real *across, int channel)
{
    model_real sum = model_seen(across, channel) + model_by_ambient[channel] * across[MODEL_ROOM];
    int i;
    for (i = MODEL_COMMON; i < MODEL_COMMON + MODEL_COMMONS; ++i) {
        sum += across[i];
    }
#ifdef MODEL_OWN
    sum += across[MODEL_OWN + channel];
#endif
    return sum;
}

static model_real model_noise_of(const model_state *state, int channel)
{
    const model_real late = MODEL_READING_TIME * state->slope[channel];
    return MODEL_READING_VARIANCE + late * late;
}

static void model_taken_in(model_state *state, const model_real *across, model_real variance,
                           model_real innovation)
{
    int i, j;
    for (i = 0; i < MODEL_STATES; ++i) {
        const model_real gain = across[i] / variance;
        state->x[i] += gain * innovation;
        for (j = 0; j <= i; ++j) {
            state->P[i][j] -= gain * across[j];
            state->P[j][i] = state->P[i][j];
        }
    }
}

/* If all readings have jumped, the camera has corrected itself: its error is unknown again, by the
   variance that is returned. */
static model_real model_opened(const model_state *state, const model_real *measured,
                               int *is_certain)
{
#if MODEL_COMMONS > 1
    model_real across[MODEL_STATES], row[MODEL_STATES];
    model_real common = 0, spread = 0;
    int c, i, count = 0;
    *is_certain = 0;
    for (i = 0; i < MODEL_STATES; ++i) {
        row[i] = 0;
    }
    for (c = 0; c < MODEL_CHANNELS; ++c) {
        if (isfinite(measured[c])) {
            ++count;
            common += measured[c] - model_expected(state, c);
            spread += model_noise_of(state, c);
            model_across_of(state, c, across);
            for (i = 0; i < MODEL_STATES; ++i) {
                row[i] += across[i];
            }
        }
    }
    if (count == 0) {
        return 0;
    }
    for (c = 0; c < MODEL_CHANNELS; ++c) {
        spread += isfinite(measured[c]) ? model_row(row, c) : 0;
    }
    common /= (model_real)count;
    spread /= (model_real)count * (model_real)count;
    *is_certain = common * common > MODEL_CERTAIN_AT * MODEL_CERTAIN_AT * spread;
    return MODEL_WITHIN(common * common - MODEL_OPENED_AT * MODEL_OPENED_AT * spread, 0,
                        MODEL_JUMP_VARIANCE);
#else
    (void)state;
    (void)measured;
    *is_certain = 0;
    return 0;
#endif
}

static void model_open(model_state *state, model_real opened)
{
    int i;
    for (i = MODEL_COMMON + 1; i < MODEL_COMMON + MODEL_COMMONS; ++i) {
        state->P[i][i] += opened;
    }
}

/* Which readings are used: those that are there and inside of the gate, or have been outside of it
   for too long. Returns their number. */
static int model_gated(model_state *state, const model_real *measured, int used[MODEL_CHANNELS])
{
    model_real across[MODEL_STATES];
    int c, count = 0;
    for (c = 0; c < MODEL_CHANNELS; ++c) {
        used[c] = isfinite(measured[c]);
        if (used[c]) {
            const model_real innovation = measured[c] - model_expected(state, c);
            model_real gate;
            int is_far;
            model_across_of(state, c, across);
            gate = MODEL_GATE * MODEL_GATE * (model_row(across, c) + model_noise_of(state, c));
            is_far = innovation * innovation > model_fmax(gate, MODEL_MIN_GATE * MODEL_MIN_GATE);
            used[c] = !is_far || state->rejected[c] >= MODEL_MAX_REJECTED;
            if (is_far) {
                state->rejected[c] = used[c] ? MODEL_FOLLOWED : state->rejected[c] + 1;
            } else if (state->rejected[c] > MODEL_MAX_REJECTED) {
                --state->rejected[c];
            } else {
                state->rejected[c] = 0;
            }
            count += used[c];
        }
    }
    return count;
}

void model_correct(model_state *state, const model_real readings[MODEL_CHANNELS],
                   model_real ambient)
{
    model_real across[MODEL_STATES], measured[MODEL_CHANNELS];
    model_real opened;
    int c, i, used[MODEL_CHANNELS], is_certain;
    for (c = 0; c < MODEL_CHANNELS; ++c) {
        measured[c] = readings[c] + MODEL_ZERO_CELSIUS - MODEL_T0;
    }
    opened = model_opened(state, measured, &is_certain);
    model_open(state, opened);
    if (model_gated(state, measured, used) == 0) {
        model_open(state, -opened);
        is_certain = 0;
    }
#ifdef MODEL_INTERVAL
    if (is_certain) {
        state->since = 0;
    }
#endif
    if (isfinite(ambient)) {
        const model_real room = ambient + MODEL_ZERO_CELSIUS - MODEL_T0;
        for (i = 0; i < MODEL_STATES; ++i) {
            across[i] = state->P[i][MODEL_ROOM];
        }
        model_taken_in(state, across, across[MODEL_ROOM] + MODEL_AMBIENT_VARIANCE,
                       room - state->x[MODEL_ROOM]);
    }
    for (c = 0; c < MODEL_CHANNELS; ++c) {
        if (used[c]) {
            model_across_of(state, c, across);
            model_taken_in(state, across, model_row(across, c) + model_noise_of(state, c),
                           measured[c] - model_expected(state, c));
        }
    }
#ifdef MODEL_HAS_LAG
    for (i = 0; i < MODEL_CELLS; ++i) {
        state->duty[i] = state->x[MODEL_MODES + i];
    }
#endif
}

/* Mean and variance of the room given the first reading: rigs are often at rest, and sometimes far
   from it. */
static void model_room_at_start(model_real reading, model_real *mean, model_real *variance)
{
    const model_real low = model_fmin(0, reading) - 4 * MODEL_ROOM_SPREAD;
    const model_real high = model_fmax(0, reading) + 4 * MODEL_ROOM_SPREAD;
    model_real sum = 0, squares = 0, all = 0;
    int i, pass;
    *mean = 0;
    for (pass = 0; pass < 2; ++pass) {
        for (i = 0; i < MODEL_GRID; ++i) {
            const model_real part = 2 * (model_real)i / (MODEL_GRID - 1) - 1;
            const model_real room = (low + high) / 2 + (high - low) / 2 * part;
            const model_real away = room / MODEL_ROOM_SPREAD;
            const model_real warmer = (reading - room) / MODEL_REST_SCALE;
            const model_real density = model_exp((model_real)-0.5 * away * away)
                                       / (1 + warmer * warmer);
            if (pass == 0) {
                all += density;
                sum += density * room;
            } else {
                squares += density * (room - *mean) * (room - *mean);
            }
        }
        *mean = sum / all;
    }
    *variance = squares / all;
}

void model_init(model_state *state, model_real reading, const model_real duty[MODEL_CELLS])
{
    const model_real given = reading + MODEL_ZERO_CELSIUS - MODEL_T0;
    model_real shared[MODEL_MODES], of_reading = 0, room, variance, away, size;
    int i, m, n;
    model_room_at_start(given, &room, &variance);
    for (m = 0; m < MODEL_STATES; ++m) {
        state->x[m] = 0;
        for (n = 0; n < MODEL_STATES; ++n) {
            state->P[m][n] = 0;
        }
        state->P[m][m] = model_start[m];
    }
    for (m = 0; m < MODEL_MODES; ++m) {
        shared[m] = 0;
        for (n = 0; n < MODEL_MODES; ++n) {
            /* What heat at random into the sides leaves. */
            model_real past = 0;
            for (i = 0; i < 2 * MODEL_CELLS; ++i) {
                past += model_shape[model_side[i]][m] * model_shape[model_side[i]][n];
            }
            state->P[m][n] = past / (model_rate[m] + model_rate[n]);
            shared[m] += state->P[m][n] * model_mean_reading[n];
        }
        of_reading += model_mean_reading[m] * shared[m];
    }
    away = given - room;
    size = (away * away + variance + MODEL_REST_SCALE * MODEL_REST_SCALE) / of_reading;
    for (m = 0; m < MODEL_MODES; ++m) {
        const model_real moved = model_everywhere[m] - shared[m] / of_reading;
        state->x[m] = model_everywhere[m] * room + shared[m] / of_reading * away;
        for (n = 0; n < MODEL_MODES; ++n) {
            const model_real other = model_everywhere[n] - shared[n] / of_reading;
            state->P[m][n] = (state->P[m][n] - shared[m] / of_reading * shared[n]) * size
                             + moved * other * variance
                             + model_everywhere[m] * model_everywhere[n] * MODEL_READ_VARIANCE;
        }
        state->P[m][MODEL_ROOM] = moved * variance;
        state->P[MODEL_ROOM][m] = moved * variance;
    }
    state->x[MODEL_ROOM] = room;
    state->P[MODEL_ROOM][MODEL_ROOM] += variance;
    for (i = 0; i < MODEL_CELLS; ++i) {
        state->duty[i] = duty[i];
#ifdef MODEL_HAS_LAG
        state->x[MODEL_MODES + i] = duty[i];
#endif
        for (n = 0; n < MODEL_COMMANDS; ++n) {
            state->late[n][i] = duty[i];
            state->age[n] = MODEL_LONG_AGO;
        }
    }
    for (i = 0; i < MODEL_CHANNELS; ++i) {
        state->slope[i] = 0;
        state->rejected[i] = 0;
    }
#ifdef MODEL_INTERVAL
    state->since = -1;
#endif
}

void model_output(const model_state *state, model_real temperatures[MODEL_CHANNELS])
{
    int i;
    for (i = 0; i < MODEL_CHANNELS; ++i) {
        temperatures[i] = model_expected(state, i) + (MODEL_T0 - MODEL_ZERO_CELSIUS);
    }
}

void model_nodes(const model_state *state, model_real nodes[MODEL_NODES])
{
    int i, m;
    for (i = 0; i < MODEL_NODES; ++i) {
        model_real sum = 0;
        for (m = 0; m < MODEL_MODES; ++m) {
            sum += model_shape[i][m] * state->x[m];
        }
        nodes[i] = sum + (MODEL_T0 - MODEL_ZERO_CELSIUS);
    }
}

void model_spreads(const model_state *state, model_real spreads[MODEL_NODES])
{
    int i, m, n;
    for (i = 0; i < MODEL_NODES; ++i) {
        model_real variance = 0;
        for (m = 0; m < MODEL_MODES; ++m) {
            for (n = 0; n < MODEL_MODES; ++n) {
                variance += model_shape[i][m] * state->P[m][n] * model_shape[i][n];
            }
        }
        spreads[i] = model_sqrt(model_fmax(variance, 0));
    }
}
