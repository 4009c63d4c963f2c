/* What an instance of a twin and one of a controller include, and how a library exports a
   function. */

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"
#include "model_fmu.h"

#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORTED __attribute__((visibility("default")))
#else
#define EXPORTED
#endif

/* Whom an instance tells what is wrong: the simulator's function, whose type differs between the
   versions of FMI, and its arguments. */
typedef struct {
    void (*logger)(void);
    void *environment;
    char name[100]; /* of the instance */
} listener_t;

static void tell(const listener_t *listener, const char *message);
