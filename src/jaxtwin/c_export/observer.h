#ifndef MODEL_H
#define MODEL_H

#ifdef __cplusplus
extern "C" {
#endif

#include "model_sizes.h"

typedef struct {
    model_real x[MODEL_STATES]; /* what is estimated: see the parts below */
    model_real P[MODEL_STATES][MODEL_STATES]; /* its covariance */
    model_real duty[MODEL_CELLS]; /* that reaches the cells */
    model_real late[MODEL_COMMANDS][MODEL_CELLS]; /* the last commands, the newest first */
    model_real age[MODEL_COMMANDS]; /* the time since each was given, s */
    model_real slope[MODEL_CHANNELS]; /* of the expected readings, K/s */
    int rejected[MODEL_CHANNELS]; /* samples in sequence; more: it is followed */
#ifdef MODEL_INTERVAL
    model_real since; /* the last correction of the camera, s; below 0 before the first */
#endif
    model_real to_modes[MODEL_MODES][MODEL_MODES]; /* the rest is memory for a step */
    model_real by_driven[MODEL_ROWS][MODEL_DRIVEN];
    model_real moved[MODEL_ROWS][MODEL_STATES];
} model_state;

/* The parts of x: amplitudes of the modes; before MODEL_ROOM the duty behind the driver's lag, if
   there is one; at MODEL_ROOM the room; from MODEL_HEATS on heat into the node that each cell
   heats, W; from MODEL_COMMON on the error that all readings share, and from MODEL_OWN on that of
   each channel, K. */

/* From the mean of the first readings, degC, and duty cycles that have been commanded for long. */
void model_init(model_state *state, model_real reading, const model_real duty[MODEL_CELLS]);

/* A sample time later, under a command given at its start. */
void model_predict(model_state *state, const model_real duty[MODEL_CELLS]);

/* After readings and the ambient, degC. One that is missing is NaN. One that is impossible is
   rejected, for at most MODEL_MAX_REJECTED samples in sequence. */
void model_correct(model_state *state, const model_real readings[MODEL_CHANNELS],
                   model_real ambient);

/* The readings that are expected now, degC. */
void model_output(const model_state *state, model_real temperatures[MODEL_CHANNELS]);

/* The temperatures of the nodes, degC, and their standard deviations, K. */
void model_nodes(const model_state *state, model_real nodes[MODEL_NODES]);
void model_spreads(const model_state *state, model_real spreads[MODEL_NODES]);

#ifdef __cplusplus
}
#endif

#endif
