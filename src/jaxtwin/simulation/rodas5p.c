/* Many draws of a thermal network at once: Rodas5P, with a draw in each lane of a vector.

   The equations are those of physics/_system.py, C dx/dt = -G x + g_amb a + q(x, u, a), and the
   method is that of _rosenbrock_step.py. With the heat capacities on the left side, a stage is

       (C / (gamma h) + G - dq/dx) k_i = heat(u_i, t + c_i h) + C sum_j C_ij k_j / h
                                         + h d_i d(heat)/dt.

   The network is compiled in: `network.h`, which _native_network.py writes, holds its sizes and the
   patterns of its matrices, so that the compiler unrolls the loops over them, and the coefficients
   of the method. Nodes are numbered in the order of their elimination. */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifdef __AVX512F__
#include <immintrin.h>
#endif

#include "network.h"

#ifndef LANES /* benchmarks/ways.py takes one */
#ifdef __AVX512F__
#define LANES 8
#else
#define LANES 4
#endif
#endif
#define STAGES 8
#define ROUNDING 1e-7 /* of sums of step sizes, s */
#define POWERS 6 /* a temperature within a step is a polynomial of fifth order */

/* The loops over a small network become straight code. */
#if NODES <= 64 && !defined(__SANITIZE_ADDRESS__)
#define UNROLLED _Pragma("GCC unroll 1024")
#else
#define UNROLLED
#endif

typedef double lanes __attribute__((vector_size(8 * LANES)));
typedef int64_t mask __attribute__((vector_size(8 * LANES)));
typedef float lanes_32 __attribute__((vector_size(4 * LANES)));
/* Two numbers of each draw in single precision. */
typedef float pairs __attribute__((vector_size(8 * LANES), may_alias));
typedef int32_t pairs_of_int __attribute__((vector_size(8 * LANES)));

/* A recording to which draws are compared: sample by sample, or by rows of weights for the powers
   of the part of a step that has passed, of which a few stand for many samples (_compressed.py). */
struct recording {
    int is_by_sample, rows;
    const int *step;       /* of each row */
    const double *weight;  /* rows x POWERS */
    const double *target;  /* rows, or samples, x channels, degC */
    const double *counted; /* the same shape: 1, or 0 for a missing sample */
    const double *number;  /* of each channel: how many samples there are */
    const double *beyond;  /* of each channel: what no solution can reduce, K^2 */
};

/* What all draws of a run share. The sizes of the first `waiting` steps, before the first command
   arrives, are fractions of each draw's delay. */
struct run {
    int steps, waiting, times, channels, outputs, weights;
    double duration, largest_span; /* the span of the rates of a draw that does not fail */
    const double *size;            /* of each step, s */
    const double *ambient; /* steps x 3: its deviation from the reference, K, as coefficients of
                              powers of the part of the step that has passed */
    const double *duty;       /* steps x cells: the command that is held, -1 to 1 */
    const double *first_duty; /* of each cell at the start */
    const double *input;      /* steps x TERMS: factors of what the other inputs change */
    const double *time;       /* of each sample, s */
    const double *ambient_at; /* at each sample: deviation from the reference, K */
    /* Of each output, the channels first: where its weights begin; and the node of each weight. */
    const int *output_row, *output_node;
    int first_read, first_written; /* the first sample that is needed, that is written */
    struct recording recording;
};

/* Where the results of the draws go; each but the last two may be NULL. */
struct results {
    size_t rows;          /* of each draw in the next two: at least as many as are written */
    double *temperatures; /* draws x rows x channels, degC; or in single precision: */
    float *temperatures_32;
    double *cost;                /* draws x channels: mean squared errors, K^2 */
    double *minimum, *maximum;   /* draws x channels: over the samples, degC */
    double *energy, *peak_power; /* of each draw: what all cells draw from the supply, J and W */
    double *others;              /* draws x outputs that are no channels: last deviations, K */
    double *error_estimates;     /* of each draw, K */
    unsigned char *failed;       /* of each draw: 1 if it failed */
};

/* The numbers of LANES draws, in the order in which they are packed (_native_network.py). */
struct numbers {
    lanes *is_valid, *reference, *lag, *delay, *drift;
    lanes *conductance, *capacitance, *to_ambient;
    lanes *held, *to_held; /* bodies of a given temperature: above the reference, K; W/K */
    lanes *start;
    lanes *seebeck, *resistance, *supply_voltage, *supply_resistance, *on_resistance,
        *current_limit, *own_voltage, *drive_exponent;
    lanes *film, *exponent, *radiating, *linear_radiation;
    lanes *input; /* TERMS: factors of what the other inputs change */
    lanes *gain, *shift, *ambient_gain, *weight;
    lanes *loop_conductance, *held_heat; /* follow from them */
};

/* The losses on two paths: from elements of the plate to the surroundings, or between any ends. They
   are a small part of the heat, and computed in single precision, as in ModalField. */
struct loss {
    pairs film, half_exponent, radiating;
#if HAS_FAR_ENDS
    pairs linear_radiation; /* what G contains of the radiation, K^3 */
#endif
};

struct workspace {
    struct numbers of;
    size_t numbers; /* how many there are */
    struct loss *loss;
    lanes_32 *rises; /* at the paths of losses, then what is lost */
    lanes *changed;  /* EFFECTS: what the inputs have changed so far */
    lanes estimate;  /* of the error so far, K */
    lanes *state, *at_stage, *right, *time_heat, *factors, *errors, *stages[STAGES];
    lanes *duty, *before, *duty_slope; /* of each cell: now, at the start of the step, its rate */
    struct drive *driven;              /* STAGES x cells */
    lanes *of_node;     /* nodes x POWERS: the polynomials of a step */
    lanes *polynomials; /* POWERS x outputs: those of a step */
    int *output_row, *output_node; /* of the weights that are not 0 in all of these draws */
    lanes *staged;   /* the temperatures of a draw in a step */
    lanes *squares;  /* of the errors so far: LANES draws x vectors of channels */
    lanes *lowest, *highest;  /* of the samples so far, likewise */
    lanes energy, peak_power; /* so far, J and W */
    double *reading; /* (POWERS + 1) x channels, filled up to whole vectors: a step of a draw */
};

/* What drives a cell at a stage: the share of a period during which it is connected, the sign of
   its voltage, or of a heater the derivative of the share by the duty, the voltage, and the
   conductance of its circuit while it is connected. */
struct drive {
    lanes share, sign, voltage, conductance;
};

/* The mean current of a cell and the mean of its square, with their derivatives by the
   electromotive force and by the duty. */
struct current {
    lanes mean, square, mean_by_emf, square_by_emf, mean_by_duty, square_by_duty;
};

static inline lanes choose(mask where, lanes one, lanes other)
{
    return (lanes)((where & (mask)one) | (~where & (mask)other));
}

static inline lanes broadcast(double x)
{
    return x - (lanes){0};
}

static lanes exponential(lanes x)
{
    for (int l = 0; l < LANES; ++l) {
        x[l] = exp(x[l]);
    }
    return x;
}

static inline pairs pair(lanes one, lanes two)
{
    const lanes_32 both[2] = {__builtin_convertvector(one, lanes_32),
                              __builtin_convertvector(two, lanes_32)};
    pairs joined;
    memcpy(&joined, both, sizeof joined);
    return joined;
}

static inline lanes of_pair(pairs joined, int number)
{
    lanes_32 both[2];
    memcpy(both, &joined, sizeof joined);
    return __builtin_convertvector(both[number], lanes);
}

/* base^exponent for a positive normal base, to a few units in the last place: 2 to the power of the
   exponent times the logarithm to base 2. */
static inline pairs power(pairs base, pairs exponent)
{
    const int32_t root = 0x3f3504f3; /* sqrt(1/2) */
    const pairs_of_int bits = (pairs_of_int)base - root;
    const pairs m = (pairs)((bits & 0x007fffff) + root);
    const pairs s = (m - 1) / (m + 1), z = s * s;
    const pairs log2_m =
        s * (2.885390082f + z * (0.961796694f + z * (0.577078016f + z * 0.412198583f)));
    const pairs y = exponent * (__builtin_convertvector(bits >> 23, pairs) + log2_m);
    const pairs shifted = y + 12582912.0f; /* rounds to a whole number, which is in its bits */
    const pairs f = y - (shifted - 12582912.0f);
    const pairs part =
        1 + f * (0.693147181f +
                 f * (0.240226507f +
                      f * (0.0555041087f +
                           f * (0.00961812911f + f * (0.00133335581f + f * 0.000154035304f)))));
    return (pairs)((pairs_of_int)part + (((pairs_of_int)shifted) << 23));
}

#if HAS_DRIVE_LAW
static lanes power_of_each(lanes base, lanes exponent)
{
    for (int l = 0; l < LANES; ++l) {
        base[l] = pow(base[l], exponent[l]);
    }
    return base;
}

#define model_real lanes
#define model_number (double)
#define model_raised power_of_each
#include "../physics/laws/share_of_duty.c"
#include "../physics/laws/share_of_duty_slopes.c"
#undef model_real
#undef model_number
#undef model_raised
#endif

static struct drive drive_of(const struct numbers *of, int cell,
                             lanes duty)
{
    const lanes one = broadcast(1), none = broadcast(0);
    const lanes loop = of->resistance[cell] + of->on_resistance[cell];
    struct drive by;
    by.share = network_is_heater[cell] ? duty : choose(duty < 0, -duty, duty);
    by.sign = network_is_heater[cell] ? one : choose(duty > 0, one, choose(duty < 0, -one, none));
    if (network_has_own_supply[cell]) {
#if HAS_DRIVE_LAW
        by.share = model_share_of_duty(duty, of->drive_exponent[cell]);
        model_share_of_duty_slopes(duty, of->drive_exponent[cell], &by.sign);
#endif
        by.voltage = of->own_voltage[cell];
        by.conductance = 1 / of->resistance[cell];
    } else if (ON_OFF) {
        by.voltage = -by.sign * of->supply_voltage[cell];
        by.conductance = 1 / (loop + of->supply_resistance[cell]);
    } else {
        by.voltage = -duty * of->supply_voltage[cell];
        by.conductance = 1 / (loop + by.share * of->supply_resistance[cell]);
    }
    return by;
}

/* The current through a connected cell, within what the controller allows; its derivative by the
   electromotive force is 0 at the limit. */
static inline lanes limited(lanes current, lanes limit, lanes *slope)
{
    *slope = choose((current > limit) | (current < -limit), broadcast(0), *slope);
    return choose(current > limit, limit, choose(current < -limit, -limit, current));
}

/* The currents of a cell as a bridge drives it (physics/_driver.py). */
static inline struct current current_of(const struct numbers *of,
                                        int cell, const struct drive *by, lanes emf)
{
    const lanes limit = of->current_limit[cell];
    lanes slope = -by->conductance;
    struct current is;
    if (network_has_own_supply[cell]) {
        const lanes alone = by->voltage * by->conductance;
        is.mean = -by->share * alone;
        is.square = by->share * alone * alone;
        is.mean_by_duty = -by->sign * alone;
        is.square_by_duty = by->sign * alone * alone;
        is.mean_by_emf = is.square_by_emf = broadcast(0);
    } else if (ON_OFF) {
        const lanes off_slope = BRAKE ? -of->loop_conductance[cell] : broadcast(0);
        const lanes on = limited((by->voltage - emf) * by->conductance, limit, &slope);
        const lanes off = off_slope * emf, rest = 1 - by->share;
        is.mean = by->share * on + rest * off;
        is.square = by->share * on * on + rest * off * off;
        is.mean_by_emf = by->share * slope + rest * off_slope;
        is.square_by_emf = 2 * (by->share * on * slope + rest * off * off_slope);
        is.mean_by_duty = by->sign * (on - off);
        is.square_by_duty = by->sign * (on * on - off * off);
    } else {
        const lanes free = (by->voltage - emf) * by->conductance;
        is.mean = limited(free, limit, &slope);
        is.square = is.mean * is.mean;
        is.mean_by_emf = slope;
        is.square_by_emf = 2 * is.mean * slope;
        /* At the limit the derivative by the duty is 0, as is that by the electromotive force. */
        is.mean_by_duty =
            slope * (of->supply_voltage[cell] + free * by->sign * of->supply_resistance[cell]);
        is.square_by_duty = 2 * is.mean * is.mean_by_duty;
    }
    return is;
}

/* The power that the bridge of a cell draws from the supply, W. */
static inline lanes supply_power(const struct numbers *of, int cell, const struct drive *by,
                                 lanes emf)
{
    lanes slope = broadcast(0), current = (by->voltage - emf) * by->conductance;
    if (network_has_own_supply[cell]) {
        return by->share * by->voltage * by->voltage * by->conductance;
    }
    current = limited(current, of->current_limit[cell], &slope);
    const lanes power = current * (emf + current / by->conductance);
    return ON_OFF ? by->share * power : power;
}

/* The law of the losses, two paths of all draws at once. */
#define model_real pairs
#define model_number (float)
#define model_raised power
#include "../physics/laws/lost_heat.c"
#include "../physics/laws/lost_heat_slopes.c"

/* The last arguments of the law: the constants of two paths. */
#if HAS_FAR_ENDS
#define LAW_OF(loss) (loss).film, (loss).half_exponent, (loss).radiating, (loss).linear_radiation
#else
#define LAW_OF(loss) (loss).film, (loss).half_exponent, (loss).radiating, (pairs){0}
#endif

/* The deviation of the far end of a path from the reference, K. */
static inline lanes far_end(const struct numbers *of, int path, const lanes *x, lanes ambient)
{
    const int far = network_loss_far[path];
    return far >= 0 ? x[far] : far == -1 ? ambient : of->held[-2 - far];
}

/* Brings the inputs besides the duty into the equations (physics/_input_effects.py). Each effect is
   a sum of products of a number of the draw and a factor of the step. It changes some of the
   numbers of the draw: conductances, the temperature of a body or the voltage at a cell. The heat
   of bodies into the nodes follows from them. */
static void apply_inputs(struct workspace *w, const double *input)
{
    const struct numbers *of = &w->of;
    for (int k = 0; k < EFFECTS; ++k) {
        lanes change = -w->changed[k];
        for (int t = network_effect_term[k]; t < network_effect_term[k + 1]; ++t) {
            change += of->input[t] * input[t];
        }
        w->changed[k] += change;
        for (int p = network_effect_number[k]; p < network_effect_number[k + 1]; ++p) {
            of->is_valid[network_changed_number[p]] += network_changed_sign[p] * change;
        }
    }
    for (int i = 0; i < NODES; ++i) {
        of->held_heat[i] = broadcast(0);
        for (int body = 0; body < BODIES; ++body) {
            of->held_heat[i] += of->to_held[body * NODES + i] * of->held[body];
        }
    }
}

/* The heat into each node, W: the right-hand side of the equations. */
static void heat_into_nodes(const struct workspace *w, const lanes *x,
                            const struct drive *driven, lanes ambient, lanes *heat)
{
    const struct numbers *of = &w->of;
    const lanes reference = of->reference[0], absolute = reference + ambient;
    UNROLLED
    for (int i = 0; i < NODES; ++i) {
        lanes sum = of->to_ambient[i] * ambient + of->held_heat[i];
        UNROLLED
        for (int p = network_row[i]; p < network_row[i + 1]; ++p) {
            sum -= of->conductance[p] * x[network_column[p]];
        }
        heat[i] = sum;
    }
    lanes_32 *const rises = w->rises;
#if HAS_FAR_ENDS
    for (int k = 0; k < LOSSES; k += 2) {
        const lanes one = far_end(of, k, x, ambient), two = far_end(of, k + 1, x, ambient);
        const pairs rise =
            pair(x[network_loss_node[k]] - one, x[network_loss_node[k + 1]] - two);
        const pairs ends = pair(reference + one, reference + two);
        *(pairs *)(rises + k) = model_lost_heat(rise, ends, LAW_OF(w->loss[k / 2]));
    }
#else
    const pairs room = pair(absolute, absolute);
    for (int k = 0; k < LOSSES; ++k) {
        rises[k] = __builtin_convertvector(x[network_loss_node[k]] - ambient, lanes_32);
    }
    for (int k = 0; k < LOSSES; k += 2) {
        pairs *const rise = (pairs *)(rises + k);
        *rise = model_lost_heat(*rise, room, LAW_OF(w->loss[k / 2]));
    }
#endif
    for (int k = 0; k < LOSSES; ++k) {
        const lanes flow = __builtin_convertvector(rises[k], lanes);
        heat[network_loss_node[k]] -= flow;
        if (HAS_FAR_ENDS && network_loss_far[k] >= 0) {
            heat[network_loss_far[k]] += flow;
        }
    }
    for (int k = 0; k < CELLS; ++k) {
        const int c = network_cold[k], h = network_hot[k];
        const lanes cold = x[c] + reference, hot = x[h] + reference, seebeck = of->seebeck[k];
        const struct current is = current_of(of, k, &driven[k], seebeck * (hot - cold));
        const lanes joule = 0.5 * of->resistance[k] * is.square;
        heat[c] -= seebeck * is.mean * cold - joule;
        heat[h] += seebeck * is.mean * hot + joule;
    }
}

/* Puts G in the place of the factors. */
static void load_conductance(struct workspace *w)
{
    memset(w->factors, 0, FACTORS * sizeof(lanes));
    for (int p = 0; p < ENTRIES; ++p) {
        w->factors[network_factor_of[p]] = w->of.conductance[p];
    }
}

/* The matrix C / (gamma h) + G - dq/dx of a step, and the change of the heat with the inputs.
   `drift` is the rate of the ambient at the start of the step. */
static void step_matrix(struct workspace *w, lanes size, lanes ambient, lanes drift)
{
    const struct numbers *of = &w->of;
    const lanes reference = of->reference[0];
    const lanes diagonal = 1 / (METHOD_GAMMA * size);
    lanes *factors = w->factors, *time_heat = w->time_heat;
    load_conductance(w);
    for (int i = 0; i < NODES; ++i) {
        factors[network_diagonal[i]] += of->capacitance[i] * diagonal;
        time_heat[i] = of->to_ambient[i] * drift;
    }
    for (int k = 0; k < LOSSES; k += 2) {
        const int *node = network_loss_node + k;
        const lanes first = far_end(of, k, w->state, ambient);
        const lanes second = far_end(of, k + 1, w->state, ambient);
        const pairs rise = pair(w->state[node[0]] - first, w->state[node[1]] - second);
        const pairs ends = pair(reference + first, reference + second);
        pairs by_near, by_far;
        model_lost_heat_slopes(rise, ends, LAW_OF(w->loss[k / 2]), &by_near, &by_far);
        for (int one = 0; one < 2; ++one) {
            const int far = HAS_FAR_ENDS ? network_loss_far[k + one] : -1;
            factors[network_diagonal[node[one]]] += of_pair(by_near, one);
            if (far == -1) {
                time_heat[node[one]] -= of_pair(by_far, one) * drift;
            } else if (far >= 0) {
                const int *place = network_loss_factors + 2 * (k + one);
                factors[place[0]] += of_pair(by_far, one);
                factors[place[1]] -= of_pair(by_near, one);
                factors[network_diagonal[far]] -= of_pair(by_far, one);
            }
        }
    }
    for (int k = 0; k < CELLS; ++k) {
        const int c = network_cold[k], h = network_hot[k], *place = network_cell_factors + 4 * k;
        const lanes cold = w->state[c] + reference, hot = w->state[h] + reference;
        const lanes seebeck = of->seebeck[k], half = 0.5 * of->resistance[k];
        const struct current is = current_of(of, k, &w->driven[k], seebeck * (hot - cold));
        const lanes mean = seebeck * seebeck * is.mean_by_emf;
        const lanes square = half * seebeck * is.square_by_emf;
        const lanes peltier = seebeck * is.mean, slope = w->duty_slope[k];
        factors[place[0]] += peltier - mean * cold + square;
        factors[place[1]] += mean * cold - square;
        factors[place[2]] += mean * hot + square;
        factors[place[3]] -= peltier + mean * hot + square;
        time_heat[c] -= (seebeck * is.mean_by_duty * cold - half * is.square_by_duty) * slope;
        time_heat[h] += (seebeck * is.mean_by_duty * hot + half * is.square_by_duty) * slope;
    }
}

/* The factors L U of the matrix, in its place, with the inverse of each pivot. */
static void factorise(lanes *f)
{
    NETWORK_FACTORISE
}

static void solve(const lanes *f, const lanes *b, lanes *x)
{
    NETWORK_SOLVE
}

/* The sum of the first stages with weights. */
static inline __attribute__((always_inline)) lanes
combined(const struct workspace *w, const double *weight, int stages, int node)
{
    lanes sum = weight[0] * w->stages[0][node];
#pragma GCC unroll 8
    for (int j = 1; j < stages; ++j) {
        sum += weight[j] * w->stages[j][node];
    }
    return sum;
}

/* A stage: its state, the heat there, and the solution of its equations. Called with a constant
   number, so that its sums are unrolled; `moves` says whether inputs change during the step. */
static inline __attribute__((always_inline)) void stage(struct workspace *w, int number, int moves,
                                                        lanes size, lanes ambient)
{
    const lanes per_size = 1 / size, of_time = method_time[number] * size;
    const struct drive *driven = w->driven + (HAS_LAG ? number * CELLS : 0);
    if (number >= STAGES - 2) { /* the weights of the stage before, and 1 */
        for (int i = 0; i < NODES; ++i) {
            w->at_stage[i] += w->stages[number - 1][i];
        }
    } else if (number) {
        for (int i = 0; i < NODES; ++i) {
            w->at_stage[i] = w->state[i] + combined(w, method_state[number], number, i);
        }
    }
    heat_into_nodes(w, number ? w->at_stage : w->state, driven, ambient, w->right);
    if (number) {
        for (int i = 0; i < NODES; ++i) {
            const lanes before = combined(w, method_slope[number], number, i);
            w->right[i] += w->of.capacitance[i] * before * per_size;
        }
    }
    if (moves) {
        for (int i = 0; i < NODES; ++i) {
            w->right[i] += of_time * w->time_heat[i];
        }
    }
    solve(w->factors, w->right, w->stages[number]);
}

/* What drives the cells at the stages of a step, their duty at its end, and its rate at the start.
   Without a lag the stages share what the command gives. */
static void drive(struct workspace *w, const double *command, lanes size)
{
    lanes left = broadcast(0);
    for (int k = 0; k < CELLS; ++k) {
        w->before[k] = HAS_LAG ? w->duty[k] : broadcast(command[k]);
        w->duty_slope[k] = HAS_LAG ? (command[k] - w->duty[k]) / w->of.lag[0] : broadcast(0);
    }
    for (int number = 0; number < (HAS_LAG ? STAGES : 1); ++number) {
        const int is_new = number == 0 || method_node[number] != method_node[number - 1];
        if (HAS_LAG && is_new) {
            left = exponential(-method_node[number] * size / w->of.lag[0]);
        }
        for (int k = 0; k < CELLS; ++k) {
            w->duty[k] = command[k] + (w->before[k] - command[k]) * left;
            w->driven[number * CELLS + k] = drive_of(&w->of, k, w->duty[k]);
        }
    }
}

/* The polynomial of a node within a step that begins at `w->state` and ends at `w->at_stage`, in
   powers of the part of the step that has passed. */
static inline void interpolate_node(const struct workspace *w, int i, lanes *of_node)
{
    const lanes two = combined(w, method_dense[0], STAGES, i);
    const lanes three = combined(w, method_dense[1], STAGES, i);
    const lanes four = combined(w, method_dense[2], STAGES, i);
    const lanes error = w->errors[i];
    of_node[0] = w->state[i];
    of_node[1] = w->at_stage[i] - w->state[i] + two + method_correction[1] * error;
    of_node[2] = three - two + method_correction[2] * error;
    of_node[3] = four - three + method_correction[3] * error;
    of_node[4] = method_correction[4] * error - four;
    of_node[5] = method_correction[5] * error;
}

/* Adds the energy that all cells draw from the supply in a step, up to the last sample, and raises
   their largest power (_power.py): Simpson's rule over both halves of the step. */
static void add_power(const struct run *run, struct workspace *w, const double *command,
                      lanes begin, lanes size)
{
    static const double weight[] = {1, 4, 2, 4, 1};
    const struct numbers *of = &w->of;
    const lanes none = broadcast(0), rest = run->time[run->times - 1] - begin;
    const lanes length = choose(rest < none, none, choose(rest < size, rest, size));
    for (int k = 0; k < CELLS; ++k) {
        interpolate_node(w, network_cold[k], w->of_node + 2 * k * POWERS);
        interpolate_node(w, network_hot[k], w->of_node + (2 * k + 1) * POWERS);
    }
    for (int n = 0; n < 5; ++n) {
        const lanes passed = 0.25 * n * length, part = passed / size;
        const lanes left = HAS_LAG ? exponential(-passed / of->lag[0]) : none;
        lanes power = none;
        for (int k = 0; k < CELLS; ++k) {
            const lanes *cold = w->of_node + 2 * k * POWERS, *hot = cold + POWERS;
            const struct drive by =
                drive_of(of, k, command[k] + (w->before[k] - command[k]) * left);
            lanes difference = none;
            for (int order = POWERS - 1; order >= 0; --order) {
                difference = difference * part + hot[order] - cold[order];
            }
            power += supply_power(of, k, &by, of->seebeck[k] * difference);
        }
        w->energy += weight[n] / 12 * length * power;
        const mask is_larger = (length > 0) & (power > w->peak_power);
        w->peak_power = choose(is_larger, power, w->peak_power);
    }
}

/* The polynomials of the outputs within a step; where only its end is read, the values there. */
static void interpolate(const struct run *run, const struct workspace *w, int is_end_alone)
{
    const int powers = is_end_alone ? 1 : POWERS;
    lanes *of_node = w->of_node;
    for (int i = 0; i < NODES; ++i) {
        if (is_end_alone) {
            of_node[i * POWERS] = w->at_stage[i];
        } else {
            interpolate_node(w, i, of_node + i * POWERS);
        }
    }
    for (int o = 0; o < run->outputs; ++o) {
        lanes sum[POWERS] = {{0}};
        for (int p = w->output_row[o]; p < w->output_row[o + 1]; ++p) {
            of_node = w->of_node + w->output_node[p] * POWERS;
            for (int k = 0; k < powers; ++k) {
                sum[k] += w->of.weight[p] * of_node[k];
            }
        }
        for (int k = 0; k < POWERS; ++k) {
            w->polynomials[k * run->outputs + o] = sum[k];
        }
    }
}

/* The range of the rates that a draw spans (_resolution.py): the fastest of a single node, times
   the duration or the longest time constant. That is found by inverse iteration with G. */
static lanes spanned(const struct run *run, struct workspace *w)
{
    const struct numbers *of = &w->of;
    lanes fastest = broadcast(0), before = broadcast(1), after = broadcast(1);
    load_conductance(w);
    for (int i = 0; i < NODES; ++i) {
        const lanes rate = w->factors[network_diagonal[i]] / of->capacitance[i];
        fastest = choose(rate > fastest, rate, fastest);
        w->at_stage[i] = broadcast(1);
    }
    factorise(w->factors);
    for (int repeat = 0; repeat < 4; ++repeat) {
        for (int i = 0; i < NODES; ++i) {
            w->right[i] = of->capacitance[i] * w->at_stage[i];
        }
        solve(w->factors, w->right, w->at_stage);
        before = after;
        after = broadcast(0);
        for (int i = 0; i < NODES; ++i) {
            after += of->capacitance[i] * w->at_stage[i];
        }
    }
    const lanes longest = after / before, duration = broadcast(run->duration);
    return fastest * choose((longest > 0) & (longest < duration), longest, duration);
}

/* Where the samples of LANES draws are in a step: the first in it and the first behind it. */
struct place {
    int first[LANES], stop[LANES];
};

/* Moves on to the samples of a step. */
static void place_samples(const struct run *run, struct place *at, lanes end, int is_last)
{
    for (int l = 0; l < LANES; ++l) {
        int t = at->first[l] = at->stop[l];
        while (t < run->times && (is_last || run->time[t] <= end[l] + ROUNDING)) {
            ++t;
        }
        at->stop[l] = t;
    }
}

/* Raises the error estimates of the draws to that of a step where it holds samples, other than one
   at its start: the largest of any channel. */
static void estimate(const struct run *run, struct workspace *w, const struct place *at,
                     lanes begin)
{
    mask holds_samples = {0};
    for (int l = 0; l < LANES; ++l) {
        if (at->stop[l] > at->first[l] && run->time[at->stop[l] - 1] > begin[l] + ROUNDING) {
            holds_samples[l] = -1;
        }
    }
    for (int o = 0; o < run->channels; ++o) {
        lanes error = broadcast(0);
        for (int p = w->output_row[o]; p < w->output_row[o + 1]; ++p) {
            error += w->of.weight[p] * w->errors[w->output_node[p]];
        }
        error = choose(error < 0, -error, error);
        w->estimate = choose(holds_samples & (error > w->estimate), error, w->estimate);
    }
}

/* The polynomials of a draw in a step as readings of the channels, degC, with the weight of the
   ambient's deviation as the last row: all rows of a vector of channels, then all of the next. */
static void read_step(const struct run *run, const struct workspace *w, int lane)
{
    const struct numbers *of = &w->of;
    for (int o = 0; o < run->channels; ++o) {
        double *const at = w->reading + o / LANES * LANES * (POWERS + 1) + o % LANES;
        const double gain = of->gain[o][lane];
        at[0] = gain * w->polynomials[o][lane] + of->shift[o][lane];
        for (int k = 1; k < POWERS; ++k) {
            at[k * LANES] = gain * w->polynomials[k * run->outputs + o][lane];
        }
        at[POWERS * LANES] = of->ambient_gain[o][lane];
    }
}

/* Copies numbers past the cache, which is left to those of the next step. */
static void stream(char *to, const char *from, size_t size)
{
#ifdef __AVX512F__
    const size_t line = 64, head = -(uintptr_t)to % line;
    if (size >= 16 * line) {
        memcpy(to, from, head);
        for (to += head, from += head, size -= head; size >= line; size -= line) {
            _mm512_stream_si512((void *)to, _mm512_loadu_si512(from));
            to += line;
            from += line;
        }
    }
#endif
    memcpy(to, from, size);
}

/* The readings of a vector of channels at a sample of a step, degC. */
static inline lanes read_vector(const struct run *run, const lanes *r, int t, double drift,
                                double begin, double per_size)
{
    const double passed = (run->time[t] - begin) * per_size;
    const double part = passed < 0 ? 0 : passed > 1 ? 1 : passed;
    const double ambient = run->ambient_at[t] + drift * run->time[t];
    return r[0] + ambient * r[POWERS] +
           part * (r[1] + part * (r[2] + part * (r[3] + part * (r[4] + part * r[5]))));
}

/* Takes the samples of a draw in a step into its extremes, and into the squared errors of a
   recording that is compared sample by sample. */
static void summarise(const struct run *run, const struct workspace *w, int first, int stop,
                      int lane, double begin, double size)
{
    const struct recording *recording = &run->recording;
    const size_t channels = run->channels, vectors = (channels + LANES - 1) / LANES;
    const double drift = HAS_DRIFT ? w->of.drift[0][lane] : 0, per_size = 1 / size;
    for (size_t v = 0; v < vectors; ++v) {
        const lanes *r = (const lanes *)w->reading + v * (POWERS + 1);
        lanes *const lowest = w->lowest + lane * vectors + v;
        lanes *const highest = w->highest + lane * vectors + v;
        for (int t = first; t < stop; ++t) {
            const lanes value = read_vector(run, r, t, drift, begin, per_size);
            *lowest = choose(value < *lowest, value, *lowest);
            *highest = choose(value > *highest, value, *highest);
            if (recording->is_by_sample) {
                lanes target, counted;
                memcpy(&target, recording->target + t * channels + v * LANES, sizeof target);
                memcpy(&counted, recording->counted + t * channels + v * LANES, sizeof counted);
                w->squares[lane * vectors + v] += counted * (value - target) * (value - target);
            }
        }
    }
}

/* Writes the temperatures of a draw at the samples of a step. */
static void read_samples(const struct run *run, const struct workspace *w, int first, int stop,
                         int lane, double begin, double size, const struct results *to, size_t draw)
{
    const size_t channels = run->channels, row = (channels + LANES - 1) / LANES * LANES;
    const double drift = HAS_DRIFT ? w->of.drift[0][lane] : 0, per_size = 1 / size;
    double *const doubles = (double *)w->staged;
    float *const singles = (float *)w->staged;
    /* The last vector first, because the others write over what it writes too many. */
    for (size_t v = row; v > 0; v -= LANES) {
        lanes r[POWERS + 1];
        memcpy(r, w->reading + (v - LANES) * (POWERS + 1), sizeof r);
        for (int t = first; t < stop; ++t) {
            const lanes value = read_vector(run, r, t, drift, begin, per_size);
            const size_t at = (size_t)(t - first) * channels + v - LANES;
            if (to->temperatures) {
                memcpy(doubles + at, &value, sizeof value);
            } else {
                const lanes_32 rounded = __builtin_convertvector(value, lanes_32);
                memcpy(singles + at, &rounded, sizeof rounded);
            }
        }
    }
    const size_t at = draw * to->rows * channels + (first - run->first_written) * channels;
    const size_t count = (size_t)(stop - first) * channels;
    if (to->temperatures) {
        stream((char *)(to->temperatures + at), (char *)doubles, count * sizeof(double));
    } else {
        stream((char *)(to->temperatures_32 + at), (char *)singles, count * sizeof(float));
    }
}

/* Adds up the squared errors of a draw in some rows of the recording. */
static void compare(const struct run *run, const struct workspace *w, int first, int stop, int lane)
{
    const struct recording *recording = &run->recording;
    const size_t channels = run->channels, vectors = (channels + LANES - 1) / LANES;
    for (int t = first; t < stop; ++t) {
        const double *weight = recording->weight + (size_t)t * POWERS;
        for (size_t v = 0; v < vectors; ++v) {
            const lanes *r = (const lanes *)w->reading + v * (POWERS + 1);
            lanes value = broadcast(0), target, counted;
#pragma GCC unroll 8
            for (int k = 0; k < POWERS; ++k) {
                value += weight[k] * r[k];
            }
            memcpy(&target, recording->target + t * channels + v * LANES, sizeof target);
            memcpy(&counted, recording->counted + t * channels + v * LANES, sizeof counted);
            w->squares[lane * vectors + v] += counted * (value - target) * (value - target);
        }
    }
}

/* The outputs of a draw that are no channels at the last sample, which is in this step. */
static void read_others(const struct run *run, const struct workspace *w, int lane, double begin,
                        double size, double *values)
{
    const double passed = (run->time[run->times - 1] - begin) / size;
    for (int o = run->channels; o < run->outputs; ++o) {
        double power = 1, sum = 0;
        for (int k = 0; k < POWERS; ++k, power *= passed) {
            sum += power * w->polynomials[k * run->outputs + o][lane];
        }
        *values++ = sum;
    }
}

/* Reads what is wanted of the draws in a step; `row` is the first row of the recording that is not
   read, and moves on. */
static void read(const struct run *run, struct workspace *w, const struct place *at, int step,
                 int *row, lanes begin, lanes size, const struct results *to, size_t draw,
                 int count)
{
    const struct recording *recording = &run->recording;
    const int first_row = *row;
    int last = 0;
    while (*row < recording->rows && recording->step[*row] == step) {
        ++*row;
    }
    for (int l = 0; l < count; ++l) {
        last = at->stop[l] > last ? at->stop[l] : last;
    }
    if (*row == first_row && last <= run->first_read) {
        return;
    }
    int is_end_alone = 1;
    for (int l = 0; l < count; ++l) {
        is_end_alone &= at->stop[l] == at->first[l] ||
                        run->time[at->first[l]] >= begin[l] + size[l] - ROUNDING;
    }
    interpolate(run, w, is_end_alone);
    for (int l = 0; l < count; ++l) {
        const int first = at->first[l] > run->first_written ? at->first[l] : run->first_written;
        read_step(run, w, l);
        if (to->minimum || to->maximum || recording->is_by_sample) {
            summarise(run, w, at->first[l], at->stop[l], l, begin[l], size[l]);
        }
        if (at->stop[l] > first && (to->temperatures || to->temperatures_32)) {
            read_samples(run, w, first, at->stop[l], l, begin[l], size[l], to, draw + l);
        }
        compare(run, w, first_row, *row, l);
        if (to->others && at->stop[l] == run->times && at->first[l] < run->times) {
            const size_t others = run->outputs - run->channels;
            read_others(run, w, l, begin[l], size[l], to->others + (draw + l) * others);
        }
    }
}

/* Integrates LANES draws and reads the first of them. Returns NaN for those that do not stay
   finite, else 0. */
static lanes integrate(const struct run *run, struct workspace *w, const struct results *to,
                       size_t draw, int count)
{
    lanes begin = broadcast(0), check = broadcast(0);
    struct place at = {{0}, {0}};
    int row = 0;
    const size_t squares = LANES * ((run->channels + LANES - 1) / LANES);
    memset(w->squares, 0, squares * sizeof(lanes));
    for (size_t v = 0; v < squares; ++v) {
        w->lowest[v] = broadcast(INFINITY);
        w->highest[v] = broadcast(-INFINITY);
    }
    w->estimate = w->energy = broadcast(0);
    w->peak_power = broadcast(-INFINITY);
    for (int i = 0; i < NODES; ++i) {
        w->state[i] = w->of.start[i];
    }
    for (int k = 0; k < CELLS; ++k) {
        w->duty[k] = broadcast(run->first_duty[k]);
    }
    for (int n = 0; n < run->steps; ++n) {
        const lanes size =
            n < run->waiting ? run->size[n] * w->of.delay[0] : broadcast(run->size[n]);
        const lanes drift = HAS_DRIFT ? w->of.drift[0] : broadcast(0);
        const double *const room = run->ambient + (size_t)n * 3;
        const int moves = HAS_LAG || HAS_DRIFT || room[1] != 0 || room[2] != 0;
        const lanes ambient = room[0] + drift * begin;
        if (EFFECTS > 0) {
            apply_inputs(w, run->input + (size_t)n * TERMS);
        }
        drive(w, run->duty + (size_t)n * CELLS, size);
        step_matrix(w, size, ambient, drift + room[1] / size);
        factorise(w->factors);
#pragma GCC unroll 8
        for (int number = 0; number < STAGES; ++number) {
            const double passed = method_node[number];
            stage(w, number, moves, size,
                  ambient + drift * (passed * size) + passed * (room[1] + passed * room[2]));
        }
        /* The difference to the solution of fourth order does not decay with stiff rates, unless it
           passes through the equations of a stage (Hairer and Wanner II, sec. IV.8). */
        const lanes per_size = 1 / (METHOD_GAMMA * size);
        for (int i = 0; i < NODES; ++i) {
            const lanes error = w->stages[STAGES - 1][i];
            w->at_stage[i] += error;
            w->right[i] = w->of.capacitance[i] * error * per_size;
        }
        solve(w->factors, w->right, w->errors);
        place_samples(run, &at, begin + size, n + 1 == run->steps);
        estimate(run, w, &at, begin);
        read(run, w, &at, n, &row, begin, size, to, draw, count);
        if (to->energy || to->peak_power) {
            add_power(run, w, run->duty + (size_t)n * CELLS, begin, size);
        }
        for (int i = 0; i < NODES; ++i) {
            w->state[i] = w->at_stage[i];
            check += 0 * w->state[i];
        }
        begin += size;
    }
    return check;
}

/* Writes what is kept of the trajectory of a draw. */
static void write_reductions(const struct run *run, const struct workspace *w,
                             const struct results *to, size_t draw, int lane)
{
    const size_t channels = run->channels, vectors = (channels + LANES - 1) / LANES;
    for (size_t o = 0, at = draw * channels; o < channels; ++o, ++at) {
        const size_t vector = lane * vectors + o / LANES, place = o % LANES;
        if (to->cost) {
            to->cost[at] = w->squares[vector][place] / run->recording.number[o] +
                           run->recording.beyond[o];
        }
        if (to->minimum) {
            to->minimum[at] = w->lowest[vector][place];
        }
        if (to->maximum) {
            to->maximum[at] = w->highest[vector][place];
        }
    }
    if (to->energy) {
        to->energy[draw] = w->energy[lane];
    }
    if (to->peak_power) {
        to->peak_power[draw] = w->peak_power[lane];
    }
}

/* Writes NaN for all that is wanted of a failed draw. */
static void write_nan(const struct run *run, const struct results *to, size_t draw)
{
    const size_t channels = run->channels, temperatures = to->rows * channels;
    const struct {
        double *of;
        size_t count;
    } parts[] = {
        {to->temperatures, temperatures},
        {to->cost, channels},
        {to->minimum, channels},
        {to->maximum, channels},
        {to->energy, 1},
        {to->peak_power, 1},
        {to->others, run->outputs - channels},
    };
    for (size_t part = 0; part < sizeof parts / sizeof *parts; ++part) {
        for (size_t k = 0; parts[part].of && k < parts[part].count; ++k) {
            parts[part].of[draw * parts[part].count + k] = NAN;
        }
    }
    for (size_t k = 0; to->temperatures_32 && k < temperatures; ++k) {
        to->temperatures_32[draw * temperatures + k] = NAN;
    }
}

/* Memory of which parts are taken one after the other; without a begin they are only counted. */
struct memory {
    lanes *begin;
    size_t taken;
};

static lanes *take(struct memory *memory, size_t count)
{
    lanes *const part = memory->begin ? memory->begin + memory->taken : NULL;
    memory->taken += count;
    return part;
}

static void divide(const struct run *run, struct workspace *w,
                   struct memory *memory)
{
    const size_t nodes = NODES, cells = CELLS, losses = LOSSES;
    const size_t channels = run->channels;
    struct numbers *of = &w->of;
    struct part {
        lanes **of;
        size_t count;
    } parts[] = {
        {&of->is_valid, 1},
        {&of->reference, 1},
        {&of->lag, 1},
        {&of->delay, 1},
        {&of->drift, 1},
        {&of->conductance, ENTRIES},
        {&of->capacitance, nodes},
        {&of->to_ambient, nodes},
        {&of->held, BODIES},
        {&of->to_held, BODIES * nodes},
        {&of->start, nodes},
        {&of->seebeck, cells},
        {&of->resistance, cells},
        {&of->supply_voltage, cells},
        {&of->supply_resistance, cells},
        {&of->on_resistance, cells},
        {&of->current_limit, cells},
        {&of->own_voltage, cells},
        {&of->drive_exponent, HAS_DRIVE_LAW ? cells : 0},
        {&of->film, losses},
        {&of->exponent, losses},
        {&of->radiating, losses},
        {&of->linear_radiation, HAS_FAR_ENDS ? losses : 0},
        {&of->input, TERMS},
        {&of->gain, channels},
        {&of->shift, channels},
        {&of->ambient_gain, channels},
        {&of->weight, run->weights},
    };
    for (size_t k = 0; k < sizeof parts / sizeof *parts; ++k) {
        *parts[k].of = take(memory, parts[k].count);
    }
    w->numbers = memory->taken;
    of->loop_conductance = take(memory, cells);
    of->held_heat = take(memory, nodes);
    w->changed = take(memory, EFFECTS);
    w->state = take(memory, nodes);
    w->at_stage = take(memory, nodes);
    w->right = take(memory, nodes);
    w->time_heat = take(memory, nodes);
    w->errors = take(memory, nodes);
    for (int number = 0; number < STAGES; ++number) {
        w->stages[number] = take(memory, nodes);
    }
    w->factors = take(memory, FACTORS);
    w->duty = take(memory, cells);
    w->duty_slope = take(memory, cells);
    w->before = take(memory, cells);
    w->driven = (struct drive *)take(memory, STAGES * cells * sizeof(struct drive) / sizeof(lanes));
    w->of_node = take(memory, POWERS * (nodes > 2 * cells ? nodes : 2 * cells));
    w->polynomials = take(memory, POWERS * run->outputs);
    w->output_row = (int *)take(memory, run->outputs * sizeof(int) / sizeof(lanes) + 1);
    w->output_node = (int *)take(memory, run->weights * sizeof(int) / sizeof(lanes) + 1);
    w->staged = take(memory, (run->times * channels + 2 * LANES) / LANES);
    w->squares = take(memory, LANES * ((channels + LANES - 1) / LANES));
    w->lowest = take(memory, LANES * ((channels + LANES - 1) / LANES));
    w->highest = take(memory, LANES * ((channels + LANES - 1) / LANES));
    w->reading = (double *)take(memory, (POWERS + 1) * ((channels + LANES - 1) / LANES));
    w->rises = (lanes_32 *)take(memory, (losses + 1) / 2);
    w->loss = (struct loss *)take(memory, losses / 2 * sizeof(struct loss) / sizeof(lanes));
}

/* Loads the numbers of LANES draws; further lanes repeat the last draw. */
static void load(const struct run *run, struct workspace *w, const double *numbers, size_t columns,
                 size_t draws, size_t first)
{
    lanes *row = w->of.is_valid;
    for (size_t k = 0; k < w->numbers; ++k) {
        const double *from = numbers + k * columns;
        for (size_t l = 0; l < LANES; ++l) {
            row[k][l] = from[first + l < draws ? first + l : draws - 1];
        }
    }
    const struct numbers *of = &w->of;
    for (int k = 0; k < LOSSES; k += 2) {
        w->loss[k / 2].film = pair(of->film[k], of->film[k + 1]);
        w->loss[k / 2].half_exponent = pair(0.5 * of->exponent[k], 0.5 * of->exponent[k + 1]);
        w->loss[k / 2].radiating = pair(of->radiating[k], of->radiating[k + 1]);
#if HAS_FAR_ENDS
        w->loss[k / 2].linear_radiation =
            pair(of->linear_radiation[k], of->linear_radiation[k + 1]);
#endif
    }
    for (int k = 0; k < CELLS; ++k) {
        of->loop_conductance[k] = 1 / (of->resistance[k] + of->on_resistance[k]);
    }
    memset(w->changed, 0, EFFECTS * sizeof(lanes));
    apply_inputs(w, run->input);
    int used = 0;
    for (int o = 0; o < run->outputs; ++o) {
        w->output_row[o] = used;
        for (int p = run->output_row[o]; p < run->output_row[o + 1]; ++p) {
            double largest = 0;
            for (int l = 0; l < LANES; ++l) {
                largest = fmax(largest, fabs(of->weight[p][l]));
            }
            if (largest > 0) {
                of->weight[used] = of->weight[p];
                w->output_node[used++] = run->output_node[p];
            }
        }
    }
    w->output_row[run->outputs] = used;
}

/* Solves some draws. `numbers` has a row for each number and a column for each draw, of which the
   first are solved. Returns 0, or 1 without memory. */
int jaxtwin_solve(const struct run *run, const double *numbers, size_t columns, size_t draws,
                  const struct results *to)
{
    struct workspace w;
    struct memory memory = {NULL, 0};
    divide(run, &w, &memory);
    memory.begin = aligned_alloc(sizeof(lanes), memory.taken * sizeof(lanes));
    if (!memory.begin) {
        return 1;
    }
    memset(memory.begin, 0, memory.taken * sizeof(lanes));
    memory.taken = 0;
    divide(run, &w, &memory);
    for (size_t first = 0; first < draws; first += LANES) {
        const int count = draws - first < LANES ? draws - first : LANES;
        load(run, &w, numbers, columns, draws, first);
        const lanes span = spanned(run, &w), check = integrate(run, &w, to, first, count);
        for (int l = 0; l < count; ++l) {
            /* Shorter steps help a draw that does not stay finite, but no invalid one, nor one
               whose rates double precision cannot resolve. */
            const int is_solvable = w.of.is_valid[0][l] > 0 && span[l] <= run->largest_span;
            to->failed[first + l] = !is_solvable || check[l] != 0;
            to->error_estimates[first + l] = !is_solvable ? 0 : check[l] != 0 ? NAN : w.estimate[l];
            write_reductions(run, &w, to, first + l, l);
            if (to->failed[first + l]) {
                write_nan(run, to, first + l);
            }
        }
    }
#ifdef __AVX512F__
    _mm_sfence(); /* other threads see what was written past the cache */
#endif
    free(memory.begin);
    return 0;
}
