/* Values that an instance refuses, with a sentence for the simulator. */

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
        snprintf(problem, sizeof problem, "expected %g to %g, got %g", lowest, highest, value);
    } else {
        snprintf(problem, sizeof problem, "expected a finite number, got %g", value);
    }
    return refuse(listener, number, problem);
}
