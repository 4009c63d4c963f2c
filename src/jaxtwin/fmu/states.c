/* Functions that FMI 2.0 and 3.0 name differently: time and states of a solver from outside, and
   whole states that are stored, restored and freed. */

EXPORTED status_t SET_TIME(component_t c, double time)
{
    ((instance_t *)c)->time = time;
    return isfinite(time) ? OK : ERROR;
}

EXPORTED status_t SET_STATES(component_t c, const double values[], size_t n)
{
    return set_states(c, values, n) ? OK : ERROR;
}

EXPORTED status_t GET_STATES(component_t c, double values[], size_t n)
{
    return get_states(c, values, n) ? OK : ERROR;
}

EXPORTED status_t GET_DERIVATIVES(component_t c, double values[], size_t n)
{
    return get_slopes(c, values, n) ? OK : ERROR;
}

EXPORTED status_t GET_NOMINALS(component_t c, double values[], size_t n)
{
    (void)c;
    return get_nominals(values, n) ? OK : ERROR;
}

EXPORTED status_t GET_FMU_STATE(component_t c, void **state)
{
    if (*state == NULL) {
        *state = copied(c);
        return *state == NULL ? ERROR : OK;
    }
    memcpy(*state, c, sizeof(instance_t));
    return OK;
}

EXPORTED status_t SET_FMU_STATE(component_t c, void *state)
{
    restore(c, state);
    return OK;
}

EXPORTED status_t FREE_FMU_STATE(component_t c, void **state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return OK;
}
