/* What the steps of a twin need in its modes, as simulation/_step_preparation.py computes it. */

/* The functions phi_1, phi_2 and phi_3 of the decay by x, from expm1(-x); small arguments cancel,
   and have a series. */
static void model_phi(double x, double *phi)
{
    static const double inverse_factorials[10] = {
        1.0 / 6.0, 1.0 / 24.0, 1.0 / 120.0, 1.0 / 720.0, 1.0 / 5040.0, 1.0 / 40320.0,
        1.0 / 362880.0, 1.0 / 3628800.0, 1.0 / 39916800.0, 1.0 / 479001600.0,
    };
    int k;
    if (fabs(x) < 0.3) {
        phi[2] = 0.0;
        for (k = 9; k >= 0; --k) {
            phi[2] = inverse_factorials[k] - x * phi[2];
        }
        phi[1] = 0.5 - x * phi[2];
        phi[0] = 1.0 - x * phi[1];
        return;
    }
    phi[0] = -expm1(-x) / x;
    phi[1] = (1.0 - phi[0]) / x;
    phi[2] = (0.5 - phi[1]) / x;
}

/* The coefficients of a part of a step, as StepFactors. */
static void model_set_part(model_numbers *numbers, int part, double size)
{
    int m;
    for (m = 0; m < MODEL_MODES; ++m) {
        const double x = numbers->rate[m] * size / 2.0, both = 2.0 + expm1(-x);
        double phi[3], both_1, both_2, both_3;
        model_phi(x, phi);
        phi[0] *= size;
        phi[1] *= size;
        phi[2] *= size;
        both_1 = both * phi[0];
        both_2 = both * phi[1];
        both_3 = both * phi[2];
        numbers->half_decay[part][m] = expm1(-x);
        numbers->decay[part][m] = expm1(-2.0 * x);
        numbers->half[part][m] = phi[0] / 2.0;
        numbers->half_start[part][m] = phi[0] / 2.0 - phi[1];
        numbers->half_middle[part][m] = phi[1];
        numbers->whole_start[part][m] = (both_1 - both_2 - phi[0]) / 2.0;
        numbers->whole_middle[part][m] = (phi[0] + both_2) / 2.0;
        numbers->first[part][m] = (both_1 + both_3 + phi[1] - phi[0]) / 2.0 - 0.75 * both_2;
        numbers->middle[part][m] = phi[0] / 4.0 - phi[1] / 2.0 + (both_2 - both_3) / 2.0;
        numbers->last[part][m] = (phi[1] + both_3) / 2.0 - both_2 / 4.0;
    }
#ifdef MODEL_HAS_LAG
    numbers->lag[part][0] = exp(-size / 2.0 / numbers->lag_s);
    numbers->lag[part][1] = exp(-size / numbers->lag_s);
#endif
}

/* The parts of a step, which the delay of the commands divides. Returns whether the queue is long
   enough. */
static int model_set_parts(model_numbers *numbers, double *sizes)
{
    const double step = MODEL_SAMPLE_TIME_S, steps = numbers->delay_s / step;
    double whole = floor(steps + 0.5);
    numbers->parts = 1;
    sizes[0] = step;
    if (fabs(steps - whole) > MODEL_WHOLE * fmax(steps, 1.0)) {
        whole = floor(steps * (1.0 + MODEL_WHOLE));
        numbers->parts = 2;
        sizes[0] = fmax(numbers->delay_s - whole * step, 0.0);
        sizes[1] = step - sizes[0];
    }
    numbers->waiting = (int)fmin(whole, MODEL_QUEUE + 1) + numbers->parts - 1;
    return numbers->waiting <= MODEL_QUEUE;
}

/* The norm of the explicit part of a step, as remainder_gain: steps with more than
   MODEL_STABILITY_LIMIT are not safe. */
static double model_gain(const model_numbers *numbers)
{
    double response[MODEL_SIDES][MODEL_SIDES], slope[MODEL_SIDES][MODEL_SIDES], largest = 0.0;
    int i, j, k, m, level;
    for (i = 0; i < MODEL_SIDES; ++i) {
        for (j = 0; j < MODEL_SIDES; ++j) {
            double sum = 0.0;
            for (m = 0; m < MODEL_MODES; ++m) {
                const double x = numbers->rate[m] * MODEL_SAMPLE_TIME_S;
                const double gain = MODEL_SAMPLE_TIME_S * (fabs(x) < 1e-6 ? 1.0 : -expm1(-x) / x);
                sum += numbers->shape[model_side[i]][m] * gain * numbers->shape[model_side[j]][m];
            }
            response[i][j] = fabs(sum);
        }
    }
    for (level = -1; level <= 1; ++level) {
        model_heat_slope(numbers, (double)level, slope);
        for (i = 0; i < MODEL_SIDES; ++i) {
            double sum = 0.0;
            for (j = 0; j < MODEL_SIDES; ++j) {
                for (k = 0; k < MODEL_SIDES; ++k) {
                    const double rest = numbers->linearised_conductance[k][j] + slope[k][j];
                    sum += response[i][k] * fabs(rest);
                }
            }
            largest = fmax(largest, sum);
        }
    }
    return largest;
}

/* Readings, and the forces by the surroundings and by bodies of given temperatures. */
static void model_set_ends(model_numbers *numbers, const model_network *network)
{
    int i, m, n;
    for (i = 0; i < MODEL_CHANNELS; ++i) {
        const double gain = network->sums[MODEL_SUM_GAIN + i];
        numbers->by_ambient[i] = 1.0 - gain * model_on_plate[i];
        for (m = 0; m < MODEL_MODES; ++m) {
            double sum = 0.0;
            for (n = 0; n < MODEL_NODES; ++n) {
                sum += model_weights[i][n] * numbers->shape[n][m];
            }
            numbers->by_modes[i][m] = gain * sum;
        }
    }
    memset(numbers->surroundings, 0, sizeof numbers->surroundings);
#ifdef MODEL_HAS_RESERVOIRS
    memset(numbers->reservoirs, 0, sizeof numbers->reservoirs);
#if MODEL_INPUTS > 0 && MODEL_BODIES > 0
    memset(numbers->by_body, 0, sizeof numbers->by_body);
#endif
#endif
    for (i = 0; i < MODEL_BRANCHES; ++i) {
        const double *shape = numbers->shape[model_branch_from[i]];
        const int body = model_branch_to[i] - MODEL_NODES - 1;
        if (body < -1) {
            continue;
        }
        for (m = 0; m < MODEL_MODES; ++m) {
            const double force = shape[m] * network->branch[i];
            if (body < 0) {
                numbers->surroundings[m] += force;
            }
#ifdef MODEL_HAS_RESERVOIRS
            else {
                numbers->reservoirs[m] +=
                    force * (network->sums[MODEL_SUM_RESERVOIR + body] - MODEL_T0);
#if MODEL_INPUTS > 0 && MODEL_BODIES > 0
                numbers->by_body[m][body] += force;
#endif
            }
#endif
        }
    }
#ifdef MODEL_LINKS
    for (i = 0; i < MODEL_LINKS; ++i) {
        const int branch = model_link_branch[i], to = model_branch_to[branch];
        numbers->link_held[i] = 0.0;
#ifdef MODEL_HAS_RESERVOIRS
        if (to > MODEL_NODES) {
            numbers->link_held[i] =
                network->sums[MODEL_SUM_RESERVOIR + to - MODEL_NODES - 1] - MODEL_T0;
        }
#endif
        for (m = 0; m < MODEL_MODES; ++m) {
            numbers->across[i][m] = -numbers->shape[model_branch_from[branch]][m];
            if (to < MODEL_NODES) {
                numbers->across[i][m] += numbers->shape[to][m];
            }
        }
    }
#endif
}

/* Returns 0, or why there are no steps. */
static const char *model_set_steps(model_numbers *numbers, const model_network *network)
{
    double sizes[2];
    int part;
#ifdef MODEL_LOSSES
    double begin = 0.0;
    int m;
#endif
    numbers->delay_s = numbers->lag_s = 0.0;
#ifdef MODEL_SUM_DELAY
    numbers->delay_s = network->sums[MODEL_SUM_DELAY];
    if (!(numbers->delay_s > 0.0)) {
        return "expected values with which the delay of the driver is above 0, got others";
    }
#endif
#ifdef MODEL_HAS_LAG
    numbers->lag_s = network->sums[MODEL_SUM_LAG];
    if (!(numbers->lag_s > 0.0)) {
        return "expected values with which the lag of the driver is above 0, got others";
    }
#endif
    if (!model_set_parts(numbers, sizes)) {
        return "expected values with which the delay is within its bounds, got others";
    }
    for (part = 0; part < numbers->parts; ++part) {
        model_set_part(numbers, part, sizes[part]);
#ifdef MODEL_LOSSES
        numbers->at[part][0] = 2.0 * begin / MODEL_SAMPLE_TIME_S;
        numbers->at[part][1] = 2.0 * (begin + sizes[part] / 2.0) / MODEL_SAMPLE_TIME_S;
        numbers->at[part][2] = 2.0 * (begin + sizes[part]) / MODEL_SAMPLE_TIME_S;
        begin += sizes[part];
#endif
    }
#ifdef MODEL_LOSSES
    for (m = 0; m < MODEL_MODES; ++m) {
        const double x = numbers->rate[m] * MODEL_SAMPLE_TIME_S / 2.0;
        double phi[3];
        model_phi(x, phi);
        numbers->to_half_decay[m] = expm1(-x);
        numbers->to_half[m] = MODEL_SAMPLE_TIME_S * phi[0] / 2.0;
    }
#endif
    model_set_ends(numbers, network);
    numbers->is_stable = model_gain(numbers) <= MODEL_STABILITY_LIMIT;
    return NULL;
}
