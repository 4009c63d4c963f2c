#ifdef MODEL_PARAMETERS
/* Each instance of a twin whose parameters can be set has its own numbers, which functions get
   first. Those of other twins are constants, and their files are written without these words. */
#define MODEL_OF_INSTANCE const model_numbers *numbers,
#define MODEL_ITS_NUMBERS numbers,
#define MODEL_FIND_NUMBERS(state) const model_numbers *const numbers = (state)->numbers;
#else
#define MODEL_OF_INSTANCE
#define MODEL_ITS_NUMBERS
#define MODEL_FIND_NUMBERS(state)
#endif

/* An estimated duty of a heater may be below 0 by its error, and then cools as much as it would
   heat above. */
#ifdef MODEL_HAS_HEATERS
#define MODEL_IS_HEATER(cell) (model_is_heater[cell] > 0)
#else
#define MODEL_IS_HEATER(cell) 0
#endif

/* The current through a connected cell, within what its controller allows, A. */
#ifdef MODEL_IMAX
#define MODEL_LIMITED(current) model_fmin(model_fmax(current, -MODEL_IMAX), MODEL_IMAX)
#else
#define MODEL_LIMITED(current) (current)
#endif

/* What the inputs besides duty and ambient change: the temperatures of bodies and the conductances
   of links, as differences from those of the rig file, and the voltage of the supply. Each is a sum
   of products of powers of inputs and of the shares of their states. */
#if MODEL_INPUTS > 0
#define MODEL_SUPPLY(effects) effects[MODEL_EFFECTS - 1]

static model_real model_share(const model_real *inputs, int number)
{
    const int from = model_input_of[number];
    const model_real level = model_input_scale[from] * inputs[from] + model_input_offset[from];
    if (model_input_state[number] < 0) {
        return level;
    }
    return model_fmax(1 - model_fabs(level - (model_real)model_input_state[number]), 0);
}

static void model_effects(MODEL_OF_INSTANCE const model_real *inputs, model_real *effects)
{
    int i, j, n;
    for (i = 0; i < MODEL_EFFECTS; ++i) {
        effects[i] = 0;
    }
    for (j = 0; j < MODEL_PRODUCTS; ++j) {
        model_real product = 1;
        for (n = 0; n < MODEL_SHARES; ++n) {
            if (model_exponent[j][n] < 0 || model_exponent[j][n] > 0) {
                product *= model_pow(model_share(inputs, n), model_exponent[j][n]);
            }
        }
        for (i = 0; i < MODEL_EFFECTS; ++i) {
            effects[i] += model_by_product[i][j] * product;
        }
    }
}
#else
#define MODEL_SUPPLY(effects) MODEL_VS
#endif

#ifdef MODEL_HAS_DRIVE_LAW
#include "../physics/laws/share_of_duty.c"
#endif

/* Peltier and Joule heat of a cell into its two sides, W; temperatures in K. Those of a heater are
   the same node. */
static void model_heat(MODEL_OF_INSTANCE int cell, model_real duty, model_real cold,
                       model_real hot, model_real supply, model_real flow[2])
{
    const model_real loop = model_R[cell] + MODEL_RON;
    const model_real emf = model_alpha[cell] * (hot - cold);
    const model_real share = MODEL_IS_HEATER(cell) ? duty : model_fabs(duty);
#ifdef MODEL_MEAN_VOLTAGE
    const model_real drive = -duty * supply;
    const model_real current = MODEL_LIMITED((drive - emf) / (loop + share * MODEL_RS));
    const model_real square = current * current;
#else
    const model_real cools = duty < 0 ? supply : 0;
    const model_real drive = duty > 0 || MODEL_IS_HEATER(cell) ? -supply : cools;
    const model_real on = MODEL_LIMITED((drive - emf) / (loop + MODEL_RS));
#ifdef MODEL_BRAKES
    const model_real off = -emf / loop;
    const model_real current = share * on + (1 - share) * off;
    const model_real square = share * on * on + (1 - share) * off * off;
#else
    const model_real current = share * on;
    const model_real square = share * on * on;
#endif
#endif
    const model_real peltier = model_alpha[cell] * current;
    model_real joule = (model_real)0.5 * model_R[cell] * square;
#ifdef MODEL_HAS_POWERS
    if (model_power[cell] > 0) {
        joule = (model_real)0.5 * model_power[cell];
#ifdef MODEL_HAS_DRIVE_LAW
        joule *= model_share_of_duty(duty, model_drive_exponent[cell]);
#else
        joule *= share;
#endif
    }
#endif
    flow[0] = joule - peltier * cold;
    flow[1] = joule + peltier * hot;
}

/* The paths of losses: from the elements of the plate to the room, or between any two ends. Beyond
   the numbers of the nodes are those of the room and of the bodies of given temperatures. The
   constants of a path are the last arguments of the law. */
#ifdef MODEL_LOSSES
#include "../physics/laws/lost_heat.c"
#define MODEL_LOSS(path)                                                                           \
    model_film[path], model_half_exponent[path], model_radiating[path], MODEL_LINEAR(path)
#endif
#ifdef MODEL_HAS_FAR_ENDS
#define MODEL_LINEAR(path) model_linear_radiation[path]
#define MODEL_ACROSS(path, mode)                                                                   \
    (model_shape[model_loss_from[path]][mode]                                                      \
     - (model_loss_to[path] < MODEL_NODES ? model_shape[model_loss_to[path]][mode] : 0))
#else
#define MODEL_LINEAR(path) 0
#define MODEL_ACROSS(path, mode) model_shape[path][mode]
#endif

/* What drives the modes beside their own decay. Of the sides of the cells, the cold ones are the
   first. */
static void model_force(MODEL_OF_INSTANCE const model_real *z, const model_real *duty,
                        const model_real *steady, const model_real *effects, model_real *force)
{
    model_real at[2 * MODEL_CELLS], flow[2 * MODEL_CELLS], both[2];
    int i, j, m;
    for (i = 0; i < 2 * MODEL_CELLS; ++i) {
        at[i] = 0;
        for (m = 0; m < MODEL_MODES; ++m) {
            at[i] += model_shape[model_side[i]][m] * z[m];
        }
    }
    for (i = 0; i < MODEL_CELLS; ++i) {
        model_heat(MODEL_ITS_NUMBERS i, duty[i], MODEL_T0 + at[i], MODEL_T0 + at[MODEL_CELLS + i],
                   MODEL_SUPPLY(effects), both);
        flow[i] = both[0];
        flow[MODEL_CELLS + i] = both[1];
    }
    for (i = 0; i < 2 * MODEL_CELLS; ++i) {
        for (j = 0; j < 2 * MODEL_CELLS; ++j) {
            flow[i] += model_linearised_conductance[i][j] * at[j];
        }
    }
    for (m = 0; m < MODEL_MODES; ++m) {
        force[m] = steady[m];
        for (i = 0; i < 2 * MODEL_CELLS; ++i) {
            force[m] += model_shape[model_side[i]][m] * flow[i];
        }
    }
#ifdef MODEL_LINKS
    for (i = 0; i < MODEL_LINKS; ++i) {
        model_real heat = 0;
        for (m = 0; m < MODEL_MODES; ++m) {
            heat += model_across[i][m] * z[m];
        }
        heat *= effects[MODEL_BODIES + i];
        for (m = 0; m < MODEL_MODES; ++m) {
            force[m] -= model_across[i][m] * heat;
        }
    }
#endif
#if MODEL_INPUTS == 0
    (void)effects;
#endif
}

/* Forces by the ambient, by coolant and the like, and by what is lost beyond linear losses. */
static void model_losses(MODEL_OF_INSTANCE const model_real *z, model_real ambient,
                         const model_real *effects, model_real *force)
{
    int m;
#ifdef MODEL_LINKS
    int link;
#endif
#if MODEL_INPUTS > 0 && MODEL_BODIES > 0
    int body;
#endif
#ifdef MODEL_LOSSES
    int i;
#endif
    for (m = 0; m < MODEL_MODES; ++m) {
        force[m] = model_surroundings[m] * ambient;
#ifdef MODEL_HAS_RESERVOIRS
        force[m] += model_reservoirs[m];
#endif
#if MODEL_INPUTS > 0 && MODEL_BODIES > 0
        for (body = 0; body < MODEL_BODIES; ++body) {
            force[m] += model_by_body[m][body] * effects[body];
        }
#endif
    }
#ifdef MODEL_LINKS
    for (link = 0; link < MODEL_LINKS; ++link) {
        /* At the ends that are no nodes. */
        model_real heat = model_link_ambient[link] * ambient + model_link_held[link];
#if MODEL_BODIES > 0
        for (body = 0; body < MODEL_BODIES; ++body) {
            heat += model_link_body[link][body] * effects[body];
        }
#endif
        heat *= effects[MODEL_BODIES + link];
        for (m = 0; m < MODEL_MODES; ++m) {
            force[m] -= model_across[link][m] * heat;
        }
    }
#endif
#if MODEL_INPUTS == 0
    (void)effects;
#endif
#ifdef MODEL_LOSSES
    for (i = 0; i < MODEL_LOSSES; ++i) {
        model_real at = 0, end = ambient, rise, left;
        for (m = 0; m < MODEL_MODES; ++m) {
            at += MODEL_ACROSS(i, m) * z[m];
        }
#ifdef MODEL_HAS_FAR_ENDS
        if (model_loss_to[i] != MODEL_NODES) {
            end = model_loss_held[i];
        }
        rise = at - end;
        for (m = 0; model_loss_to[i] < MODEL_NODES && m < MODEL_MODES; ++m) {
            end += model_shape[model_loss_to[i]][m] * z[m];
        }
#else
        rise = at - end;
#endif
        left = model_linearised_loss[i] * at
               - model_lost_heat(rise, MODEL_T0 + end, MODEL_LOSS(i));
        for (m = 0; m < MODEL_MODES; ++m) {
            force[m] += MODEL_ACROSS(i, m) * left;
        }
    }
#else
    (void)z;
#endif
}

/* The forces that all stages share, at a stage of a part of a step. */
#ifdef MODEL_LOSSES
#define MODEL_STEADY(stage) (first[m] + model_at[part][stage] * slope[m])
#else
#define MODEL_STEADY(stage) first[m]
#endif

/* A part of a step by ETDRK4-B (Krogstad, J. Comput. Phys. 203, 2005, eq. 51), under the duty that
   reaches the cells at its start, middle and end. The losses are those at the start of the step,
   first, and grow by slope in half a step. */
static void model_advance(MODEL_OF_INSTANCE model_real *z, int part, const model_real *start,
                          const model_real *middle, const model_real *end,
                          const model_real *first, const model_real *slope,
                          const model_real *effects)
{
    model_real p[MODEL_MODES], b[MODEL_MODES];
    model_real f0[MODEL_MODES], fa[MODEL_MODES], fb[MODEL_MODES], fc[MODEL_MODES];
    int m;
#ifndef MODEL_LOSSES
    (void)slope;
#endif
    for (m = 0; m < MODEL_MODES; ++m) {
        p[m] = MODEL_STEADY(0);
    }
    model_force(MODEL_ITS_NUMBERS z, start, p, effects, f0);
    for (m = 0; m < MODEL_MODES; ++m) {
        p[m] = MODEL_STEADY(1);
        b[m] = z[m] + model_half_decay[part][m] * z[m];
        b[m] += model_half[part][m] * f0[m];
    }
    model_force(MODEL_ITS_NUMBERS b, middle, p, effects, fa);
    for (m = 0; m < MODEL_MODES; ++m) {
        b[m] = z[m] + model_half_decay[part][m] * z[m];
        b[m] += model_half_start[part][m] * f0[m] + model_half_middle[part][m] * fa[m];
    }
    model_force(MODEL_ITS_NUMBERS b, middle, p, effects, fb);
    for (m = 0; m < MODEL_MODES; ++m) {
        p[m] = MODEL_STEADY(2);
        b[m] = z[m] + model_decay[part][m] * z[m];
        b[m] += model_whole_start[part][m] * f0[m] + model_whole_middle[part][m] * fb[m];
    }
    model_force(MODEL_ITS_NUMBERS b, end, p, effects, fc);
    for (m = 0; m < MODEL_MODES; ++m) {
        z[m] += model_decay[part][m] * z[m] + model_first[part][m] * f0[m]
                + model_middle[part][m] * (fa[m] + fb[m]) + model_last[part][m] * fc[m];
    }
}

/* How the losses change in half a step: from those at the start, first, to those in the middle. */
#ifdef MODEL_LOSSES
static void model_loss_slope(MODEL_OF_INSTANCE const model_real *z, const model_real *duty,
                             model_real ambient, const model_real *effects,
                             const model_real *first, const model_real *heat, model_real *slope)
{
    model_real b[MODEL_MODES];
    int m;
    model_force(MODEL_ITS_NUMBERS z, duty, first, effects, slope);
    for (m = 0; m < MODEL_MODES; ++m) {
        b[m] = z[m] + model_to_half_decay[m] * z[m] + model_to_half[m] * slope[m];
    }
    model_losses(MODEL_ITS_NUMBERS b, ambient, effects, slope);
    for (m = 0; m < MODEL_MODES; ++m) {
        slope[m] += (heat == 0 ? 0 : heat[m]) - first[m];
    }
}
#endif
