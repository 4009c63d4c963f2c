/* Values and calls that an instance refuses, with a sentence for the simulator. */

/* The lowest temperature, degC. */
#define ABSOLUTE_ZERO (-273.15)

static int refuse(const listener_t *listener, uint32_t number, const char *problem)
{
    char message[300];
    const char *name = number < VARIABLES ? model_names[number] : "value reference";
    snprintf(message, sizeof message, "%s: %s", name, problem);
    tell(listener, message);
    return 0;
}

static int accepts(const listener_t *listener, uint32_t number, double value, double lowest,
                   double highest)
{
    char problem[100];
    if (isfinite(value) && value >= lowest && value <= highest) {
        return 1;
    }
    if (isfinite(value)) {
        snprintf(problem, sizeof problem, "expected %.10g to %.10g, got %.10g", lowest, highest,
                 value);
    } else {
        snprintf(problem, sizeof problem, "expected a finite number, got %g", value);
    }
    return refuse(listener, number, problem);
}

/* Whether a run may begin: an instance that has run keeps its state until it is reset. */
static int may_begin(const listener_t *listener, int is_running)
{
    if (is_running) {
        tell(listener, "expected " RESET " before another run, got the setup of an instance that "
                       "has run");
    }
    return !is_running;
}

/* Whether a step may be taken: between initialisation and termination, and on from the last one. */
static int may_step(const listener_t *listener, int is_running, int is_terminated, double now,
                    double time, double size)
{
    char message[300];
    if (!is_running || is_terminated) {
        snprintf(message, sizeof message,
                 "expected a step between initialisation and termination, got one %s",
                 is_terminated ? "behind the end; call " RESET " before another run" : "before");
    } else if (!isfinite(time) || !isfinite(size) || size < 0.0) {
        snprintf(message, sizeof message,
                 "expected a step of at least 0 s from a finite time, got %g s from %g s", size,
                 time);
    } else if (time < now - 1e-6 * (1.0 + fabs(now))) {
        snprintf(message, sizeof message,
                 "the time is %.10g s: expected a step from there on, got one from %.10g s; a "
                 "stored state goes back", now, time);
    } else {
        return 1;
    }
    tell(listener, message);
    return 0;
}
