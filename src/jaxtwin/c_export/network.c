/* The network of a twin from the values of its parameters, and its modes with the cells at rest, as
   simulation/_modes.py computes them. */

#define MODEL_SIDES (2 * MODEL_CELLS)

typedef struct {
    double sums[MODEL_SUMS]; /* of products of parameters */
    double branch[MODEL_BRANCHES]; /* conductances, W/K */
    double matrix[MODEL_NODES][MODEL_NODES]; /* conductances, W/K, which become the modes */
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
#ifdef MODEL_HAS_DRIVE_LAW
        numbers->drive_exponent[i] = sums[MODEL_SUM_DRIVE_EXPONENT + i];
        if (!(numbers->drive_exponent[i] > 0.0)) {
            return "expected values with which all exponents of the duty are above 0, got others";
        }
#endif
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
#ifdef MODEL_LOSSES
    memset(numbers->film, 0, sizeof numbers->film);
    for (i = 0; i < MODEL_BRANCHES; ++i) {
        if (model_branch_is_film[i]) {
            numbers->film[model_branch_from[i]] += network->branch[i];
        }
    }
    for (i = 0; i < MODEL_LOSSES; ++i) {
        numbers->half_exponent[i] = sums[MODEL_SUM_EXPONENT + i] / 2.0;
#ifdef MODEL_HAS_FAR_ENDS
        numbers->loss_held[i] = 0.0;
#ifdef MODEL_SUM_RESERVOIR
        if (model_loss_to[i] > MODEL_NODES) {
            numbers->loss_held[i] =
                sums[MODEL_SUM_RESERVOIR + model_loss_to[i] - MODEL_NODES - 1] - MODEL_T0;
        }
#endif
        if (i >= MODEL_PLATE_LOSSES) {
            numbers->film[i] = sums[MODEL_SUM_CONVECTION + i - MODEL_PLATE_LOSSES];
        }
#endif
        numbers->radiating[i] = MODEL_STEFAN_BOLTZMANN * sums[MODEL_SUM_RADIATING + i];
    }
#endif
#if MODEL_INPUTS > 0
    memcpy(numbers->by_product, sums + MODEL_SUM_BY_PRODUCT, sizeof numbers->by_product);
#endif
    return NULL;
}

/* The derivative of the heat of the cells into their sides at rest, W/K, by differences that are
   exact because the heat is quadratic. */
static void model_heat_slope(const model_numbers *numbers, double duty,
                             double slope[MODEL_SIDES][MODEL_SIDES])
{
    int i, side;
    memset(slope, 0, sizeof(double) * MODEL_SIDES * MODEL_SIDES);
    for (i = 0; i < MODEL_CELLS; ++i) {
        for (side = 0; side < 2; ++side) {
            const int column = side * MODEL_CELLS + i;
            const double cold = side == 0 ? 1.0 : 0.0, hot = 1.0 - cold;
            double above[2], below[2];
            model_heat(numbers, i, duty, MODEL_T0 + cold, MODEL_T0 + hot, numbers->VS, above);
            model_heat(numbers, i, duty, MODEL_T0 - cold, MODEL_T0 - hot, numbers->VS, below);
            slope[i][column] = (above[0] - below[0]) / 2.0;
            slope[MODEL_CELLS + i][column] = (above[1] - below[1]) / 2.0;
        }
    }
}

#ifdef MODEL_LOSSES
#include "../physics/laws/lost_heat_slopes.c"
#endif

/* The cells and the losses join the network with their derivatives at rest: with idle cells all is
   as warm as the surroundings. */
static void model_linearise(model_numbers *numbers, model_network *network)
{
    double slope[MODEL_SIDES][MODEL_SIDES];
    int i, j;
    model_heat_slope(numbers, 0.0, slope);
    for (i = 0; i < MODEL_SIDES; ++i) {
        for (j = 0; j < MODEL_SIDES; ++j) {
            const double conductance = -(slope[i][j] + slope[j][i]) / 2.0;
            numbers->linearised_conductance[i][j] = conductance;
            network->matrix[model_side[i]][model_side[j]] += conductance;
        }
    }
#ifdef MODEL_LOSSES
    for (i = 0; i < MODEL_LOSSES; ++i) {
        double end = 0.0, by_near, by_far;
        int near = i;
#ifdef MODEL_HAS_FAR_ENDS
        const int far = model_loss_to[i];
        near = model_loss_from[i];
        end = numbers->loss_held[i];
#endif
        model_lost_heat_slopes(-end, MODEL_T0 + end, MODEL_LOSS(i), &by_near, &by_far);
        numbers->linearised_loss[i] = by_near;
        network->matrix[near][near] += numbers->linearised_loss[i];
#ifdef MODEL_HAS_FAR_ENDS
        if (far < MODEL_NODES) {
            network->matrix[far][far] += numbers->linearised_loss[i];
            network->matrix[near][far] -= numbers->linearised_loss[i];
            network->matrix[far][near] -= numbers->linearised_loss[i];
        }
#endif
    }
#endif
}

/* The conductance matrix, and the modes of the network with the linearised cells. Returns whether
   it has some. */
static int model_find_modes(model_numbers *numbers, model_network *network)
{
    int i, j;
    memset(network->matrix, 0, sizeof network->matrix);
    for (i = 0; i < MODEL_BRANCHES; ++i) {
        const int a = model_branch_from[i], b = model_branch_to[i];
        network->matrix[a][a] += network->branch[i];
        if (b < MODEL_NODES) {
            network->matrix[b][b] += network->branch[i];
            network->matrix[a][b] -= network->branch[i];
            network->matrix[b][a] -= network->branch[i];
        }
    }
    model_linearise(numbers, network);
    for (i = 0; i < MODEL_NODES; ++i) {
        for (j = 0; j < MODEL_NODES; ++j) {
            network->matrix[i][j] /= sqrt(numbers->capacitance[i]) * sqrt(numbers->capacitance[j]);
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
