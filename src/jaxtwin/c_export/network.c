/* The network of a twin from the values of its parameters, and its modes with the cells at rest, as
   simulation/_modes.py computes them. */

#define MODEL_SIDES (2 * MODEL_CELLS)

typedef struct {
    double sums[MODEL_SUMS]; /* of products of parameters */
    double branch[MODEL_BRANCHES]; /* conductances, W/K */
    double conductance[MODEL_NODES][MODEL_NODES]; /* W/K */
    double resistance[MODEL_NODES][MODEL_SIDES]; /* between nodes and sides of cells, K/W */
    double at[MODEL_NODES]; /* the operating point, a deviation, K */
    double matrix[MODEL_NODES][MODEL_NODES];
} model_network;

/* The values in SI units, their products, and the sums of these. */
static void model_sums(const double *values, double *sums)
{
    double products[MODEL_MONOMIALS];
    int i, k;
    for (i = 0; i < MODEL_MONOMIALS; ++i) {
        products[i] = 1.0;
        for (k = model_monomial_start[i]; k < model_monomial_start[i + 1]; ++k) {
            const int number = model_monomial_parameter[k];
            const double si = model_parameter_scale[number] * values[number]
                              + model_parameter_offset[number];
            products[i] *= pow(si, model_monomial_power[k]);
        }
    }
    for (i = 0; i < MODEL_SUMS; ++i) {
        sums[i] = 0.0;
        for (k = model_sum_start[i]; k < model_sum_start[i + 1]; ++k) {
            sums[i] += model_sum_factor[k] * products[model_sum_monomial[k]];
        }
    }
}

static int model_is_above_0(const double *values, int count)
{
    int i;
    for (i = 0; i < count; ++i) {
        if (!(values[i] > 0.0 && isfinite(values[i]))) {
            return 0;
        }
    }
    return 1;
}

/* The electrical values, the losses and the branches. Returns 0, or what is wrong with them. */
static const char *model_assemble(model_numbers *numbers, model_network *network)
{
    const double *sums = network->sums, *bridge = sums + MODEL_SUM_BRIDGE;
    int i;
    for (i = 0; i < MODEL_SUMS; ++i) {
        if (!isfinite(sums[i])) {
            return "expected values whose products are finite, got others";
        }
    }
    if (!model_is_above_0(sums + MODEL_SUM_CAPACITANCE, MODEL_NODES)) {
        return "expected values with which all heat capacities are above 0, got others";
    }
    if (!model_is_above_0(sums + MODEL_SUM_R, MODEL_CELLS)) {
        return "expected values with which all electrical resistances are above 0, got others";
    }
    memcpy(numbers->capacitance, sums + MODEL_SUM_CAPACITANCE, sizeof numbers->capacitance);
    memcpy(numbers->alpha, sums + MODEL_SUM_ALPHA, sizeof numbers->alpha);
    memcpy(numbers->R, sums + MODEL_SUM_R, sizeof numbers->R);
    numbers->VS = bridge[0];
    numbers->RS = bridge[1];
    numbers->RON = bridge[2];
#ifdef MODEL_HAS_POWERS
    for (i = 0; i < MODEL_CELLS; ++i) {
        numbers->power[i] = model_own_square[i] / numbers->R[i];
    }
#endif
#ifdef MODEL_IMAX
    numbers->IMAX = sums[MODEL_SUM_IMAX];
    if (!(numbers->IMAX > 0.0)) {
        return "expected values with which the current limit is above 0, got others";
    }
#endif
    for (i = 0; i < MODEL_BRANCHES; ++i) {
        const double sum = sums[MODEL_SUM_BRANCH + i];
        if (!(model_branch_conducts[i] ? sum >= 0.0 : sum > 0.0)) {
            return "expected values with which all thermal resistances are above 0, got others";
        }
        network->branch[i] = model_branch_conducts[i] ? sum : 1.0 / sum;
    }
#ifdef MODEL_ELEMENTS
    numbers->HALF_EXPONENT = sums[MODEL_SUM_EXPONENT] / 2.0;
    memset(numbers->film, 0, sizeof numbers->film);
    for (i = 0; i < MODEL_BRANCHES; ++i) {
        if (model_branch_is_film[i]) {
            numbers->film[model_branch_from[i]] += network->branch[i];
        }
    }
    for (i = 0; i < MODEL_ELEMENTS; ++i) {
        numbers->radiating[i] = MODEL_STEFAN_BOLTZMANN * sums[MODEL_SUM_RADIATING + i];
    }
#endif
#if MODEL_INPUTS > 0
    memcpy(numbers->by_product, sums + MODEL_SUM_BY_PRODUCT, sizeof numbers->by_product);
#endif
    return NULL;
}

/* The heat of the cells into their sides, W, and its derivative, W/K, by differences that are exact
   because the heat is quadratic. */
static void model_side_heat(const model_numbers *numbers, const double *at, double duty,
                            double *flow, double slope[MODEL_SIDES][MODEL_SIDES])
{
    int i, side;
    memset(slope, 0, sizeof(double) * MODEL_SIDES * MODEL_SIDES);
    for (i = 0; i < MODEL_CELLS; ++i) {
        const double cold = MODEL_T0 + at[i], hot = MODEL_T0 + at[MODEL_CELLS + i];
        double both[2], above[2], below[2];
        model_heat(numbers, i, duty, cold, hot, numbers->VS, both);
        flow[i] = both[0];
        flow[MODEL_CELLS + i] = both[1];
        for (side = 0; side < 2; ++side) {
            const int column = side * MODEL_CELLS + i;
            const double up = side == 0 ? 1.0 : 0.0;
            model_heat(numbers, i, duty, cold + up, hot + (1.0 - up), numbers->VS, above);
            model_heat(numbers, i, duty, cold - up, hot - (1.0 - up), numbers->VS, below);
            slope[i][column] = (above[0] - below[0]) / 2.0;
            slope[MODEL_CELLS + i][column] = (above[1] - below[1]) / 2.0;
        }
    }
}

static double model_believable(double deviation)
{
    return fmin(fmax(deviation, MODEL_COLDEST - MODEL_T0), MODEL_HOTTEST - MODEL_T0);
}

/* The steady state with idle cells by Newton's method for their sides. Returns whether there is
   one. */
static int model_find_rest(const model_numbers *numbers, model_network *network)
{
    double at[MODEL_SIDES], flow[MODEL_SIDES], change[MODEL_SIDES];
    double slope[MODEL_SIDES][MODEL_SIDES], matrix[MODEL_SIDES][MODEL_SIDES];
    int i, j, k, step;
    memcpy(network->matrix, network->conductance, sizeof network->matrix);
    memset(network->resistance, 0, sizeof network->resistance);
    for (i = 0; i < MODEL_SIDES; ++i) {
        at[i] = MODEL_TYPICAL - MODEL_T0;
        network->resistance[model_side[i]][i] = 1.0;
    }
    if (!model_solve(network->matrix[0], network->resistance[0], MODEL_NODES, MODEL_SIDES)) {
        return 0;
    }
    for (step = 0; step < MODEL_NEWTON_STEPS; ++step) {
        model_side_heat(numbers, at, 0.0, flow, slope);
        for (i = 0; i < MODEL_SIDES; ++i) {
            const double *row = network->resistance[model_side[i]];
            change[i] = at[i];
            for (j = 0; j < MODEL_SIDES; ++j) {
                change[i] -= row[j] * flow[j];
                matrix[i][j] = i == j;
                for (k = 0; k < MODEL_SIDES; ++k) {
                    matrix[i][j] -= row[k] * slope[k][j];
                }
            }
        }
        if (!model_solve(matrix[0], change, MODEL_SIDES, 1)) {
            return 0;
        }
        for (i = 0; i < MODEL_SIDES; ++i) {
            at[i] = model_believable(at[i] - change[i]);
        }
    }
    model_side_heat(numbers, at, 0.0, flow, slope);
    for (i = 0; i < MODEL_NODES; ++i) {
        network->at[i] = 0.0;
        for (j = 0; j < MODEL_SIDES; ++j) {
            network->at[i] += network->resistance[i][j] * flow[j];
        }
        network->at[i] = model_believable(network->at[i]);
    }
    return 1;
}

/* The operating point of the sides of the cells. */
static void model_sides_at(const model_network *network, double *at)
{
    int i;
    for (i = 0; i < MODEL_SIDES; ++i) {
        at[i] = network->at[model_side[i]];
    }
}

/* The cells and the losses join the network with their derivatives at rest. */
static void model_linearise(model_numbers *numbers, model_network *network)
{
    double at[MODEL_SIDES], flow[MODEL_SIDES], slope[MODEL_SIDES][MODEL_SIDES];
    int i, j;
    model_sides_at(network, at);
    model_side_heat(numbers, at, 0.0, flow, slope);
    for (i = 0; i < MODEL_SIDES; ++i) {
        for (j = 0; j < MODEL_SIDES; ++j) {
            const double conductance = -(slope[i][j] + slope[j][i]) / 2.0;
            numbers->linearised_conductance[i][j] = conductance;
            network->conductance[model_side[i]][model_side[j]] += conductance;
        }
    }
#ifdef MODEL_ELEMENTS
    for (i = 0; i < MODEL_ELEMENTS; ++i) {
        const double rise = network->at[i], hot = MODEL_T0 + rise, square = rise * rise;
        const double above = square + MODEL_CALM, exponent = numbers->HALF_EXPONENT;
        const double film = pow(above * MODEL_FILM_SCALE, exponent);
        numbers->linearised_loss[i] =
            numbers->film[i] * (film - 1.0 + 2.0 * exponent * film * square / above)
            + 4.0 * numbers->radiating[i] * hot * hot * hot;
        network->conductance[i][i] += numbers->linearised_loss[i];
    }
#endif
}

/* The conductance matrix, and the modes of the network with the linearised cells. Returns whether
   it has some. */
static int model_find_modes(model_numbers *numbers, model_network *network)
{
    int i, j;
    memset(network->conductance, 0, sizeof network->conductance);
    for (i = 0; i < MODEL_BRANCHES; ++i) {
        const int a = model_branch_from[i], b = model_branch_to[i];
        network->conductance[a][a] += network->branch[i];
        if (b < MODEL_NODES) {
            network->conductance[b][b] += network->branch[i];
            network->conductance[a][b] -= network->branch[i];
            network->conductance[b][a] -= network->branch[i];
        }
    }
    if (!model_find_rest(numbers, network)) {
        return 0;
    }
    model_linearise(numbers, network);
    for (i = 0; i < MODEL_NODES; ++i) {
        for (j = 0; j < MODEL_NODES; ++j) {
            const double scale = sqrt(numbers->capacitance[i]) * sqrt(numbers->capacitance[j]);
            network->matrix[i][j] = network->conductance[i][j] / scale;
        }
    }
    if (!model_diagonalise(network->matrix, numbers->rate)) {
        return 0;
    }
    for (i = 0; i < MODEL_NODES; ++i) {
        for (j = 0; j < MODEL_NODES; ++j) {
            const double scale = sqrt(numbers->rate[i]) * sqrt(numbers->capacitance[j]);
            numbers->shape[j][i] = network->matrix[i][j] / scale;
        }
    }
    return 1;
}
