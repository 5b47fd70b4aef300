/* The functions of FMI 2.0 for co-simulation (FMI 2.0.5, chapters 2.1 and 4.2), on top of `slave.h`. */
#include "slave.h"
#include <stdlib.h>
#include <string.h>

#ifdef FMI2_FUNCTION_PREFIX /* set to `identifier_` where the sources are linked statically */
#define FMI(name) JOIN(FMI2_FUNCTION_PREFIX, name)
#else
#define FMI(name) name
#endif

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL, PENDING } Status;
typedef void (*Logger)(void *, const char *, Status, const char *, const char *, ...);

typedef struct {
    Logger logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*step_finished)(void *, Status);
    void *environment;
} Callbacks;

typedef struct {
    Slave slave;
    Callbacks callbacks;
    char *name;
    char text[TEXT];
} Instance;

static Status report(Instance *n, const char *wrong)
{
    if (!wrong) {
        return OK;
    }
    if (n->callbacks.logger) {
        /* As the format itself, which has no %: loggers of other languages do not fill formats in. */
        n->callbacks.logger(n->callbacks.environment, n->name, ERROR, "logStatusError", wrong);
    }
    return ERROR;
}

EXPORT const char *FMI(fmi2GetTypesPlatform)(void) { return "default"; }
EXPORT const char *FMI(fmi2GetVersion)(void) { return "2.0"; }

EXPORT Status FMI(fmi2SetDebugLogging)(Instance *n, int on, size_t count, const char *const categories[])
{
    (void)n, (void)on, (void)count, (void)categories; /* only errors are logged, and those always */
    return OK;
}

EXPORT Instance *FMI(fmi2Instantiate)(const char *name, int type, const char *guid, const char *resources,
                                      const Callbacks *callbacks, int visible, int logging)
{
    Instance *n = type == 1 && guid && !strcmp(guid, MODEL_TOKEN) ? calloc(1, sizeof *n) : NULL;
    (void)resources, (void)visible, (void)logging;
    if (!n) {
        if (callbacks && callbacks->logger) {
            callbacks->logger(callbacks->environment, name, ERROR, "logStatusError",
                              "Not instantiated: co-simulation only, with the guid of modelDescription.xml");
        }
        return NULL;
    }
    if (callbacks) {
        n->callbacks = *callbacks;
    }
    n->name = calloc(strlen(name ? name : "") + 1, 1);
    if (!n->name) {
        free(n);
        return NULL;
    }
    strcpy(n->name, name ? name : "");
    slave_reset(&n->slave);
    return n;
}

EXPORT void FMI(fmi2FreeInstance)(Instance *n)
{
    if (n) {
        free(n->name);
        free(n);
    }
}

EXPORT Status FMI(fmi2SetupExperiment)(Instance *n, int has_tolerance, double tolerance, double start, int has_stop,
                                       double stop)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop; /* the step of the integration is fixed */
    n->slave.start_s = start;
    return OK;
}

EXPORT Status FMI(fmi2EnterInitializationMode)(Instance *n)
{
    n->slave.phase = INITIALISING;
    return OK;
}

EXPORT Status FMI(fmi2ExitInitializationMode)(Instance *n)
{
    slave_begin(&n->slave);
    n->slave.phase = RUNNING;
    return OK;
}

EXPORT Status FMI(fmi2Terminate)(Instance *n)
{
    (void)n;
    return OK;
}

EXPORT Status FMI(fmi2Reset)(Instance *n)
{
    slave_reset(&n->slave);
    return OK;
}

EXPORT Status FMI(fmi2GetReal)(Instance *n, const unsigned references[], size_t count, double values[])
{
    const char *wrong = NULL;
    size_t k;
    if (n->slave.phase == INITIALISING) {
        slave_begin(&n->slave); /* outputs follow from the start values that were set so far */
    }
    for (k = 0; k < count && !wrong; k += 1) {
        wrong = slave_get(&n->slave, references[k], &values[k], n->text);
    }
    return report(n, wrong);
}

EXPORT Status FMI(fmi2SetReal)(Instance *n, const unsigned references[], size_t count, const double values[])
{
    const char *wrong = NULL;
    size_t k;
    for (k = 0; k < count && !wrong; k += 1) {
        wrong = slave_set(&n->slave, references[k], values[k], n->text);
    }
    return report(n, wrong);
}

EXPORT Status FMI(fmi2GetBoolean)(Instance *n, const unsigned references[], size_t count, int values[])
{
    const char *wrong = NULL;
    size_t k;
    for (k = 0; k < count && !wrong; k += 1) {
        wrong = slave_get_loop(&n->slave, references[k], &values[k], n->text);
    }
    return report(n, wrong);
}

EXPORT Status FMI(fmi2SetBoolean)(Instance *n, const unsigned references[], size_t count, const int values[])
{
    const char *wrong = NULL;
    size_t k;
    for (k = 0; k < count && !wrong; k += 1) {
        wrong = slave_set_loop(&n->slave, references[k], values[k], n->text);
    }
    return report(n, wrong);
}

#define NONE(type) count ? report(n, "This FMU has no variable of type " type ". See modelDescription.xml") : OK

EXPORT Status FMI(fmi2GetInteger)(Instance *n, const unsigned references[], size_t count, int values[])
{
    (void)references, (void)values;
    return NONE("Integer");
}

EXPORT Status FMI(fmi2SetInteger)(Instance *n, const unsigned references[], size_t count, const int values[])
{
    (void)references, (void)values;
    return NONE("Integer");
}

EXPORT Status FMI(fmi2GetString)(Instance *n, const unsigned references[], size_t count, const char *values[])
{
    (void)references, (void)values;
    return NONE("String");
}

EXPORT Status FMI(fmi2SetString)(Instance *n, const unsigned references[], size_t count, const char *const values[])
{
    (void)references, (void)values;
    return NONE("String");
}

EXPORT Status FMI(fmi2GetFMUstate)(Instance *n, void **state)
{
    if (!*state) {
        *state = malloc(sizeof n->slave);
    }
    if (!*state) {
        return report(n, "No memory for the state. End other programs");
    }
    memcpy(*state, &n->slave, sizeof n->slave);
    return OK;
}

EXPORT Status FMI(fmi2SetFMUstate)(Instance *n, const void *state)
{
    memcpy(&n->slave, state, sizeof n->slave);
    return OK;
}

EXPORT Status FMI(fmi2FreeFMUstate)(Instance *n, void **state)
{
    (void)n;
    free(*state);
    *state = NULL;
    return OK;
}

EXPORT Status FMI(fmi2SerializedFMUstateSize)(Instance *n, const void *state, size_t *size)
{
    (void)n, (void)state;
    *size = sizeof n->slave;
    return OK;
}

EXPORT Status FMI(fmi2SerializeFMUstate)(Instance *n, const void *state, char bytes[], size_t size)
{
    if (size < sizeof n->slave) {
        return report(n, "Too little room for the state. Ask fmi2SerializedFMUstateSize");
    }
    memcpy(bytes, state, sizeof n->slave);
    return OK;
}

EXPORT Status FMI(fmi2DeSerializeFMUstate)(Instance *n, const char bytes[], size_t size, void **state)
{
    if (size < sizeof n->slave) {
        return report(n, "These bytes are not a state of this FMU");
    }
    *state = *state ? *state : malloc(sizeof n->slave);
    if (!*state) {
        return report(n, "No memory for the state. End other programs");
    }
    memcpy(*state, bytes, sizeof n->slave);
    return OK;
}

EXPORT Status FMI(fmi2GetDirectionalDerivative)(Instance *n, const unsigned unknown[], size_t unknowns,
                                                const unsigned known[], size_t knowns, const double dv_known[],
                                                double dv_unknown[])
{
    (void)unknown, (void)unknowns, (void)known, (void)knowns, (void)dv_known, (void)dv_unknown;
    return report(n, "This FMU has no directional derivatives, as modelDescription.xml says");
}

EXPORT Status FMI(fmi2SetRealInputDerivatives)(Instance *n, const unsigned references[], size_t count,
                                               const int order[], const double values[])
{
    (void)references, (void)count, (void)order, (void)values;
    return report(n, "Inputs are held over a tick: this FMU takes no derivatives of them");
}

EXPORT Status FMI(fmi2GetRealOutputDerivatives)(Instance *n, const unsigned references[], size_t count,
                                                const int order[], double values[])
{
    (void)references, (void)count, (void)order, (void)values;
    return report(n, "This FMU has no derivatives of its outputs, as modelDescription.xml says");
}

EXPORT Status FMI(fmi2DoStep)(Instance *n, double time, double duration, int no_set_state_before)
{
    (void)no_set_state_before;
    return report(n, slave_step(&n->slave, time, duration, n->text));
}

EXPORT Status FMI(fmi2CancelStep)(Instance *n)
{
    return report(n, "No step is under way: fmi2DoStep ends before it returns");
}

EXPORT Status FMI(fmi2GetStatus)(Instance *n, int kind, Status *value)
{
    (void)n, (void)kind;
    *value = OK;
    return OK;
}

EXPORT Status FMI(fmi2GetRealStatus)(Instance *n, int kind, double *value)
{
    (void)kind;
    *value = n->slave.start_s + (double)n->slave.ticks * SAMPLE_TIME_S;
    return OK;
}

EXPORT Status FMI(fmi2GetIntegerStatus)(Instance *n, int kind, int *value)
{
    (void)n, (void)kind, (void)value;
    return DISCARD;
}

EXPORT Status FMI(fmi2GetBooleanStatus)(Instance *n, int kind, int *value)
{
    (void)n, (void)kind;
    *value = 0;
    return OK;
}

EXPORT Status FMI(fmi2GetStringStatus)(Instance *n, int kind, const char **value)
{
    (void)n, (void)kind, (void)value;
    return DISCARD;
}
