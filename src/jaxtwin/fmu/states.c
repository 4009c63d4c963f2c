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

/* Bytes of a state: the token of the FMU, behind it the instance. */

EXPORTED status_t SERIALIZED_SIZE(component_t c, void *state, size_t *size)
{
    (void)c, (void)state;
    *size = sizeof MODEL_TOKEN + sizeof(instance_t);
    return OK;
}

EXPORTED status_t SERIALIZE(component_t c, void *state, BYTE bytes[], size_t size)
{
    (void)c;
    if (size < sizeof MODEL_TOKEN + sizeof(instance_t)) {
        return ERROR;
    }
    memcpy(bytes, MODEL_TOKEN, sizeof MODEL_TOKEN);
    memcpy(bytes + sizeof MODEL_TOKEN, state, sizeof(instance_t));
    return OK;
}

EXPORTED status_t DESERIALIZE(component_t c, const BYTE bytes[], size_t size, void **state)
{
    instance_t *self = c;
    if (size < sizeof MODEL_TOKEN + sizeof(instance_t) ||
        memcmp(bytes, MODEL_TOKEN, sizeof MODEL_TOKEN) != 0) {
        tell(&self->listener, "expected the bytes of a state of this FMU, got others");
        return ERROR;
    }
    if (*state == NULL) {
        *state = malloc(sizeof(instance_t));
    }
    if (*state == NULL) {
        return ERROR;
    }
    memcpy(*state, bytes + sizeof MODEL_TOKEN, sizeof(instance_t));
    return OK;
}
