/* The heat that a path loses beyond that of the conductance matrix, W. Written by
   physics/_make_laws.py from physics/_heat_loss.py. */
static inline model_real model_lost_heat(model_real rise, model_real ambient, model_real film,
                                         model_real half_exponent, model_real radiating,
                                         model_real linear)
{
    const model_real v0 = model_raised((rise * rise + 1) * model_number(0.0024937655860349127),
        half_exponent);
    const model_real v1 = ambient + rise;
    return rise * (film * (v0 - 1) + radiating * ((v1 + ambient) * (v1 * v1 + ambient * ambient) -
        linear));
}
