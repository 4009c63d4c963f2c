/* The derivative of model_share_of_duty by the duty. Written by physics/_make_laws.py from
   physics/_driver.py. */
static inline void model_share_of_duty_slopes(model_real duty, model_real exponent,
                                              model_real *by_duty)
{
    const model_real v0 = (duty * duty + model_number(1e-08)) / model_number(1.00000001);
    const model_real v1 = (exponent - 1) / 2;
    const model_real v2 = model_raised(v0, v1);
    *by_duty = v2 + duty * (v1 * (2 * duty / model_number(1.00000001) / v0) * v2);
}
