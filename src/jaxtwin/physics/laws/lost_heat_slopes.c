/* The derivatives of model_lost_heat by the temperatures of the two ends, W/K. Written by
   physics/_make_laws.py from physics/_heat_loss.py. */
static inline void model_lost_heat_slopes(model_real rise, model_real ambient, model_real film,
                                          model_real half_exponent, model_real radiating,
                                          model_real linear, model_real *by_near,
                                          model_real *by_far)
{
    const model_real v0 = (rise * rise + 1) * model_number(0.0024937655860349127);
    const model_real v1 = model_raised(v0, half_exponent);
    const model_real v2 = ambient + rise;
    const model_real v3 = v2 + ambient;
    const model_real v4 = v2 * v2 + ambient * ambient;
    const model_real v5 = film * (v1 - 1) + radiating * (v3 * v4 - linear);
    const model_real v6 = film * (half_exponent * (2 * rise * model_number(0.0024937655860349127) /
        v0) * v1);
    *by_near = v5 + rise * (v6 + radiating * (v4 + v3 * (2 * v2)));
    *by_far = rise * (radiating * (v4 + v3 * (2 * ambient)) - v6) - v5;
}
