#ifndef MODEL_H
#define MODEL_H

#ifdef __cplusplus
extern "C" {
#endif

#include "model_sizes.h"

typedef struct {
#ifdef MODEL_PARAMETERS
    const model_numbers *numbers; /* set before model_init */
#endif
    model_real z[MODEL_MODES]; /* amplitudes of the modes */
    model_real duty[MODEL_CELLS]; /* that reaches the cells */
#if MODEL_QUEUE > 0
    model_real late[MODEL_QUEUE][MODEL_CELLS]; /* commands on their way */
#endif
#if MODEL_INPUTS > 0
    model_real inputs[MODEL_INPUTS]; /* of the next steps, set by whoever calls */
#endif
} model_state;

/* From temperatures of the nodes, degC, and duty cycles that have been commanded for long. Other
   inputs have the values of the rig file. */
void model_init(model_state *state, const model_real nodes[MODEL_NODES],
                const model_real duty[MODEL_CELLS]);

/* A sample time later, under duty cycles held until then; the ambient in degC. */
void model_step(model_state *state, const model_real duty[MODEL_CELLS], model_real ambient);

/* What the channels read now, degC. */
void model_output(const model_state *state, model_real ambient,
                  model_real temperatures[MODEL_CHANNELS]);

/* The temperatures of the nodes now, degC: a sensor where there is none. */
void model_nodes(const model_state *state, model_real nodes[MODEL_NODES]);

#ifdef __cplusplus
}
#endif

#endif
