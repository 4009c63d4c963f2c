#include "twin.h"

/* Computes the numbers of a twin, which its states refer to, from the values of its parameters, in
   the units of the rig file. Returns 0, or a sentence that says which values it expects. */
const char *model_prepare(model_numbers *numbers, const double *values);

/* How fast the temperatures of the nodes change, K/s; the duty is what reaches the cells, the
   ambient in degC. Of other inputs there are MODEL_INPUTS. */
void model_slopes(const model_numbers *numbers, const double nodes[MODEL_NODES],
                  const double duty[MODEL_CELLS], double ambient, const double *inputs,
                  double slopes[MODEL_NODES]);
