/* The share of its power that a heater gives at a duty. Written by physics/_make_laws.py from
   physics/_driver.py. */
static inline model_real model_share_of_duty(model_real duty, model_real exponent)
{
    const model_real v0 = model_raised((duty * duty + model_number(1e-08)) /
        model_number(1.00000001), (exponent - 1) / 2);
    return duty * v0;
}
