/* Quadratic programs, solved by a primal-dual interior point method with a single factorisation in
   each step (Nocedal and Wright, Numerical Optimization, 2006, chapter 16.6): the algorithm of
   jaxtwin.control. They are scaled to a Hessian of about 1; all memory is in the state. */

/* A cost z'Hz / 2 + slope'z, with limits of z, with a rate also of its change from
   sample to sample, and then soft and hard ones of sums: lowest <= value <= highest. The soft sums
   are the limited ones, once in each turn, and others; softness has one number for each limited one
   and a last one for the others. The last sums can form bands of equal size, around a
   free centre each; the centres follow z. */
typedef struct {
    const model_real *hessian;
    const model_real *sums;
    const model_real *softness;
    int limited;
    int turns;
    int size;
    int has_rate;
    int soft;
    int hard;
    int bands;
    int members;
} model_program;

static int model_sums(const model_program *program)
{
    return program->soft + program->hard;
}

static int model_limits(const model_program *program)
{
    return program->size * (1 + program->has_rate) + model_sums(program);
}

static model_real model_softness(const model_program *program, int i)
{
    const int soft = i - program->size * (1 + program->has_rate), limited = program->limited;
    if (soft < 0 || soft >= program->soft) {
        return 0;
    }
    return program->softness[soft < limited * program->turns ? soft % limited : limited];
}

/* The first sum of a band. */
static int model_band(const model_program *program, int band)
{
    return model_sums(program) - (program->bands - band) * program->members;
}

/* What is limited. */
static void model_values(const model_program *program, const model_real *z, model_real *value)
{
    const model_real *sum = program->sums;
    int i, j, row = program->size;
    for (i = 0; i < program->size; ++i) {
        value[i] = z[i];
    }
    for (i = 0; program->has_rate && i < program->size; ++i) {
        value[row++] = i < MODEL_CELLS ? z[i] : z[i] - z[i - MODEL_CELLS];
    }
    for (i = 0; i < model_sums(program); ++i, ++row) {
        value[row] = 0;
        for (j = 0; j < program->size; ++j) {
            value[row] += *sum++ * z[j];
        }
    }
    row -= model_sums(program);
    for (i = 0; i < program->bands; ++i) {
        for (j = 0; j < program->members; ++j) {
            value[row + model_band(program, i) + j] -= z[program->size + i];
        }
    }
}

/* Subtracts what is limited, transposed. */
static void model_pull(const model_program *program, const model_real *force, model_real *z)
{
    const model_real *sum = program->sums;
    int i, j, row = program->size;
    for (i = 0; i < program->size; ++i) {
        z[i] -= force[i];
    }
    for (i = 0; program->has_rate && i < program->size; ++i, ++row) {
        z[i] -= force[row];
        if (i >= MODEL_CELLS) {
            z[i - MODEL_CELLS] += force[row];
        }
    }
    for (i = 0; i < model_sums(program); ++i, ++row) {
        for (j = 0; j < program->size; ++j) {
            z[j] -= *sum++ * force[row];
        }
    }
    row -= model_sums(program);
    for (i = 0; i < program->bands; ++i) {
        for (j = 0; j < program->members; ++j) {
            z[program->size + i] += force[row + model_band(program, i) + j];
        }
    }
}

/* Row i of a lower triangle. */
static model_real *model_row(model_real *triangle, int i)
{
    return triangle + i * (i + 1) / 2;
}

/* The matrix of a step: the Hessian, and the weights of the limits. */
static void model_assemble(model_state *state, const model_program *program)
{
    const model_real *sum = program->sums, *weight = state->weight + program->size;
    int i, j, k;
    for (i = 0; i < program->size; ++i) {
        model_real *row = model_row(state->factor, i);
        for (j = 0; j <= i; ++j) {
            row[j] = program->hessian[i * program->size + j];
        }
        row[i] += state->weight[i];
    }
    for (i = 0; program->has_rate && i < program->size; ++i, ++weight) {
        model_row(state->factor, i)[i] += *weight;
        if (i >= MODEL_CELLS) {
            j = i - MODEL_CELLS;
            model_row(state->factor, i)[j] -= *weight;
            model_row(state->factor, j)[j] += *weight;
        }
    }
    for (k = 0; k < model_sums(program); ++k, ++weight, sum += program->size) {
        for (i = 0; i < program->size; ++i) {
            model_real *row = model_row(state->factor, i);
            const model_real part = *weight * sum[i];
            for (j = 0; j <= i && part != 0; ++j) { /* 0 of moves that come later */
                row[j] += part * sum[j];
            }
        }
    }
}

#ifdef MODEL_CENTRES
/* Eliminates the centres of the bands from the matrix of a step. */
static void model_eliminate(model_state *state, const model_program *program)
{
    const int size = program->size;
    int band, i, j;
    for (band = 0; band < program->bands; ++band) {
        const int first = model_band(program, band);
        const model_real *sum = program->sums + first * size;
        const model_real *weight = state->weight + size * (1 + program->has_rate) + first;
        model_real *pull = state->pull + band * size;
        state->total[band] = 0;
        for (i = 0; i < size; ++i) {
            pull[i] = 0;
        }
        for (j = 0; j < program->members; ++j) {
            state->total[band] += weight[j];
            for (i = 0; i < size; ++i) {
                pull[i] += weight[j] * *sum++;
            }
        }
        for (i = 0; i < size; ++i) {
            model_real *row = model_row(state->factor, i);
            const model_real part = pull[i] / state->total[band];
            state->dz[i] += part * state->dz[size + band];
            for (j = 0; j <= i; ++j) {
                row[j] -= part * pull[j];
            }
        }
    }
}

/* The changes of the centres, from that of z. */
static void model_move_centres(model_state *state, const model_program *program)
{
    const int size = program->size;
    int band, i;
    for (band = 0; band < program->bands; ++band) {
        const model_real *pull = state->pull + band * size;
        for (i = 0; i < size; ++i) {
            state->dz[size + band] += pull[i] * state->dz[i];
        }
        state->dz[size + band] /= state->total[band];
    }
}
#endif

/* Cholesky's factor in place of the matrix; 0 where rounding left none. */
static int model_factorise(model_real *triangle, int size)
{
    int i, j, k;
    for (i = 0; i < size; ++i) {
        model_real *row = model_row(triangle, i);
        for (j = 0; j <= i; ++j) {
            const model_real *other = model_row(triangle, j);
            model_real rest = row[j];
            for (k = 0; k < j; ++k) {
                rest -= row[k] * other[k];
            }
            if (j < i) {
                row[j] = rest / other[j];
            } else if (rest > 0) {
                row[i] = model_sqrt(rest);
            } else {
                return 0;
            }
        }
    }
    return 1;
}

static void model_solve(model_real *triangle, model_real *x, int size)
{
    int i, j;
    for (i = 0; i < size; ++i) {
        const model_real *row = model_row(triangle, i);
        for (j = 0; j < i; ++j) {
            x[i] -= row[j] * x[j];
        }
        x[i] /= row[i];
    }
    for (i = size - 1; i >= 0; --i) {
        const model_real *row = model_row(triangle, i);
        x[i] /= row[i];
        for (j = 0; j < i; ++j) {
            x[j] -= row[j] * x[i];
        }
    }
}

static model_real model_gap(const model_state *state, int count)
{
    model_real sum = 0;
    int k;
    for (k = 0; k < count; ++k) {
        sum += state->slack[k] * state->multiplier[k];
    }
    return sum / (model_real)count;
}

/* The part of a step after which the first of these is nearly 0. */
static model_real model_reach(const model_real *of, const model_real *change, int count,
                              model_real reach)
{
    int k;
    for (k = 0; k < count; ++k) {
        if (change[k] < 0) {
            const model_real until = MODEL_TO_BOUNDARY * (-of[k] / change[k]);
            reach = until < reach ? until : reach;
        }
    }
    return reach;
}

/* A step of Newton's method towards the central path; 0 where there is none. */
static int model_newton(model_state *state, const model_program *program, int is_last)
{
    const int size = program->size, limits = model_limits(program);
    const model_real gap = model_gap(state, 2 * limits);
    model_real length = 1;
    int i, j, k;
    model_values(program, state->z, state->value);
    for (i = 0; i < limits; ++i) {
        const model_real softness = model_softness(program, i);
        state->weight[i] = 0;
        for (k = i; k < 2 * limits; k += limits) {
            const model_real slack = state->slack[k], multiplier = state->multiplier[k];
            const model_real aim = is_last ? slack * multiplier : MODEL_CENTERING * gap;
            const model_real stiffness = slack + multiplier * softness;
            const model_real room = k < limits ? state->highest[i] - state->value[i]
                                           : state->value[i] - state->lowest[i];
            state->weight[i] += multiplier / stiffness;
            state->dslack[k] = slack - room - softness * multiplier;
            state->dmultiplier[k] = multiplier * state->dslack[k] - (slack * multiplier - aim);
            state->dmultiplier[k] /= stiffness;
        }
        k = i + limits;
        state->value[i] = state->multiplier[i] - state->multiplier[k];
        state->value[i] += state->dmultiplier[i] - state->dmultiplier[k];
    }
    for (i = 0; i < size; ++i) {
        state->dz[i] = -state->slope[i];
        for (j = 0; j < size; ++j) {
            state->dz[i] -= program->hessian[i * size + j] * state->z[j];
        }
    }
    for (i = 0; i < program->bands; ++i) {
        state->dz[size + i] = 0;
    }
    model_pull(program, state->value, state->dz);
    model_assemble(state, program);
#ifdef MODEL_CENTRES
    model_eliminate(state, program);
#endif
    if (!model_factorise(state->factor, size)) {
        return 0;
    }
    model_solve(state->factor, state->dz, size);
#ifdef MODEL_CENTRES
    model_move_centres(state, program);
#endif
    model_values(program, state->dz, state->value);
    for (k = 0; k < 2 * limits; ++k) {
        const model_real moved = k < limits ? state->value[k] : -state->value[k - limits];
        const model_real softness = model_softness(program, k % limits);
        const model_real stiffness = state->slack[k] + state->multiplier[k] * softness;
        state->dmultiplier[k] += state->multiplier[k] / stiffness * moved;
        state->dslack[k] = softness * state->dmultiplier[k] - state->dslack[k] - moved;
    }
    if (!is_last) {
        length = model_reach(state->slack, state->dslack, 2 * limits, length);
        length = model_reach(state->multiplier, state->dmultiplier, 2 * limits, length);
    }
    for (i = 0; i < size + program->bands; ++i) {
        state->z[i] += length * state->dz[i];
    }
    for (k = 0; k < 2 * limits; ++k) {
        state->slack[k] += length * state->dslack[k];
        state->multiplier[k] += length * state->dmultiplier[k];
    }
    return 1;
}

/* Leaves in z what minimises the cost, after at most MODEL_STEPS + 1 steps. */
static void model_minimise(model_state *state, const model_program *program)
{
    const model_real largest_gap = (model_real)1e-4 * model_sqrt(MODEL_EPSILON);
    const int limits = model_limits(program);
    int i, steps, goes_on = 1;
    for (i = 0; i < program->size + program->bands; ++i) {
        state->z[i] = 0;
    }
    for (i = 0; i < limits; ++i) {
        const model_real middle = (model_real)0.5 * (state->highest[i] - state->lowest[i]);
        state->slack[i] = state->highest[i] > middle ? state->highest[i] : middle;
        state->slack[i + limits] = -state->lowest[i] > middle ? -state->lowest[i] : middle;
        state->multiplier[i] = 1;
        state->multiplier[i + limits] = 1;
    }
    for (steps = 0; goes_on && steps < MODEL_STEPS; ++steps) {
        if (!(model_gap(state, 2 * limits) > largest_gap)) {
            break;
        }
        goes_on = model_newton(state, program, 0);
    }
    if (goes_on) {
        model_newton(state, program, 1);
    }
}
