#ifndef MODEL_H
#define MODEL_H

#ifdef __cplusplus
extern "C" {
#endif

#include "model_sizes.h"

/* Starts without a bump: with the reference at the measurement, the duty goes on where it is. */
void model_init(model_state *state, const model_real duty[MODEL_CELLS],
                const model_real measurement[MODEL_READINGS]);

/* The duty cycles until the next sample. */
void model_step(model_state *state, const model_real reference[MODEL_OUTPUTS],
                const model_real measurement[MODEL_READINGS], model_real duty[MODEL_CELLS]);

#ifdef MODEL_HORIZON
/* The same with the references of this sample and of the next ones, MODEL_OUTPUTS each. */
void model_step_ahead(model_state *state,
                      const model_real references[MODEL_HORIZON * MODEL_OUTPUTS],
                      const model_real measurement[MODEL_READINGS], model_real duty[MODEL_CELLS]);
#endif

#ifdef __cplusplus
}
#endif

#endif
