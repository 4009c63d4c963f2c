"""C functions that are the same in FMI 2.0 and 3.0 except for their names."""

NOTHING_AT_ALL = "n == 0 ? OK : ERROR"
"""The C expression that a function returns for values of a kind that a twin does not have: success
only if no value was asked for."""


def refused(name: str, arguments: str, answer: str) -> str:
    """Writes a function that a twin does not support.

    **Arguments:**

    - `name`, `arguments`: name and arguments in the standard, without the component.
    - `answer`: the expression that it returns, which may contain the argument `n` and no other.
    """
    given = f"component_t c, {arguments}" if arguments else "component_t c"
    words = [part.split()[-1].lstrip("*").removesuffix("[]") for part in given.split(", ")]
    used = {"n"} if "n ==" in answer else set()
    ignored = "".join(f"    (void){word};\n" for word in words if word not in used)
    return f"EXPORTED status_t {name}({given})\n{{\n{ignored}    return {answer};\n}}\n\n"


def of_state(prefix: str, word: str) -> str:
    """Writes the functions that store a state, restore it and free its memory.

    **Arguments:**

    - `prefix`, `word`: the parts of the functions' names, such as "fmi2" and "FMUstate".
    """
    return _OF_STATE.replace("PREFIX", prefix).replace("WORD", word)


def of_integration(prefix: str, derivatives: str) -> str:
    """Writes the functions for an external solver: time, continuous states, their derivatives and
    their nominal values.

    **Arguments:**

    - `prefix`: the beginning of the functions' names, such as "fmi2".
    - `derivatives`: the word for derivatives in these names.
    """
    return _OF_INTEGRATION.replace("PREFIX", prefix).replace("DERIVATIVES", derivatives)


_OF_INTEGRATION = """
EXPORTED status_t PREFIXSetTime(component_t c, double time)
{
    ((instance_t *)c)->time = time;
    return isfinite(time) ? OK : ERROR;
}

EXPORTED status_t PREFIXSetContinuousStates(component_t c, const double values[], size_t n)
{
    return set_states(c, values, n) ? OK : ERROR;
}

EXPORTED status_t PREFIXGetContinuousStates(component_t c, double values[], size_t n)
{
    return get_states(c, values, n) ? OK : ERROR;
}

EXPORTED status_t PREFIXGetDERIVATIVES(component_t c, double values[], size_t n)
{
    return get_slopes(c, values, n) ? OK : ERROR;
}

EXPORTED status_t PREFIXGetNominalsOfContinuousStates(component_t c, double values[], size_t n)
{
    (void)c;
    return get_nominals(values, n) ? OK : ERROR;
}
"""

_OF_STATE = """
EXPORTED status_t PREFIXGetWORD(component_t c, void **state)
{
    if (*state == NULL) {
        *state = copied(c);
        return *state == NULL ? ERROR : OK;
    }
    memcpy(*state, c, sizeof(instance_t));
    return OK;
}

EXPORTED status_t PREFIXSetWORD(component_t c, void *state)
{
    memcpy(c, state, sizeof(instance_t));
    return OK;
}

EXPORTED status_t PREFIXFreeWORD(component_t c, void **state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return OK;
}
"""
