#include <stdlib.h>
#include <string.h>

#include "twin.c"

#include "eigenvectors.c"
#include "network.c"
#include "step_factors.c"

const char *model_prepare(model_numbers *numbers, const double *values)
{
    const char *problem = "expected memory for the network, got none";
    model_network *network = malloc(sizeof *network);
    if (network != NULL) {
        model_sums(values, network->sums);
        problem = model_assemble(numbers, network);
        if (problem == NULL && !model_find_modes(numbers, network)) {
            problem = "expected values with which the network has modes, got others";
        }
        if (problem == NULL) {
            problem = model_set_steps(numbers, network);
        }
    }
    free(network);
    return problem;
}

void model_slopes(const model_numbers *numbers, const double nodes[MODEL_NODES],
                  const double duty[MODEL_CELLS], double ambient, const double *inputs,
                  double slopes[MODEL_NODES])
{
    const double deviation = ambient + MODEL_ZERO_CELSIUS - MODEL_T0;
    double first[MODEL_MODES], force[MODEL_MODES];
    model_state state;
    int i, m;
#if MODEL_INPUTS > 0
    double effects[MODEL_EFFECTS];
    model_effects(numbers, inputs, effects);
#else
    const double *effects = 0;
    (void)inputs;
#endif
    state.numbers = numbers;
    model_init(&state, nodes, duty);
    model_losses(numbers, state.z, deviation, effects, first);
    model_force(numbers, state.z, duty, first, effects, force);
    for (m = 0; m < MODEL_MODES; ++m) {
        force[m] -= numbers->rate[m] * state.z[m];
    }
    for (i = 0; i < MODEL_NODES; ++i) {
        slopes[i] = 0.0;
        for (m = 0; m < MODEL_MODES; ++m) {
            slopes[i] += numbers->shape[i][m] * force[m];
        }
    }
}
