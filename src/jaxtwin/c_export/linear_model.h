#ifndef MODEL_H
#define MODEL_H

#ifdef __cplusplus
extern "C" {
#endif

#include "model_sizes.h"

typedef struct {
    model_real x[MODEL_STATES];
} model_state;

/* At rest at the operating point. */
void model_init(model_state *state);

/* A sample time later, under duty cycles held until then. */
void model_step(model_state *state, const model_real duty[MODEL_INPUTS]);

/* What the channels read now, degC. */
void model_output(const model_state *state, const model_real duty[MODEL_INPUTS],
                  model_real temperatures[MODEL_OUTPUTS]);

#ifdef __cplusplus
}
#endif

#endif
