/* The functions of FMI 3.0 for co-simulation (chapters 2.3 and 4.2), on top of `slave.h`. */
#include "slave.h"
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifdef FMI3_FUNCTION_PREFIX /* set to `identifier_` where the sources are linked statically */
#define FMI(name) JOIN(FMI3_FUNCTION_PREFIX, name)
#else
#define FMI(name) name
#endif

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } Status;
typedef uint32_t Reference;
typedef void (*Logger)(void *, Status, const char *, const char *);

typedef struct {
    Slave slave;
    Logger logger;
    void *environment;
    char text[TEXT];
} Instance;

static Status report(Instance *n, const char *wrong)
{
    if (!wrong) {
        return OK;
    }
    if (n->logger) {
        n->logger(n->environment, ERROR, "logStatusError", wrong);
    }
    return ERROR;
}

EXPORT const char *FMI(fmi3GetVersion)(void) { return "3.0"; }

EXPORT Status FMI(fmi3SetDebugLogging)(Instance *n, bool on, size_t count, const char *const categories[])
{
    (void)n, (void)on, (void)count, (void)categories; /* only errors are logged, and those always */
    return OK;
}

EXPORT Instance *FMI(fmi3InstantiateCoSimulation)(const char *name, const char *token, const char *resources,
                                                  bool visible, bool logging, bool event_mode, bool early_return,
                                                  const Reference intermediate[], size_t intermediates,
                                                  void *environment, Logger logger, void (*update)(void))
{
    Instance *n = token && !strcmp(token, MODEL_TOKEN) ? calloc(1, sizeof *n) : NULL;
    (void)name, (void)resources, (void)visible, (void)logging, (void)event_mode, (void)early_return;
    (void)intermediate, (void)intermediates, (void)update;
    if (!n) {
        if (logger) {
            logger(environment, ERROR, "logStatusError",
                   "Not instantiated: give the instantiationToken of modelDescription.xml");
        }
        return NULL;
    }
    n->logger = logger;
    n->environment = environment;
    slave_reset(&n->slave);
    return n;
}

EXPORT void FMI(fmi3FreeInstance)(Instance *n) { free(n); }

EXPORT Status FMI(fmi3EnterInitializationMode)(Instance *n, bool has_tolerance, double tolerance, double start,
                                               bool has_stop, double stop)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop; /* the step of the integration is fixed */
    n->slave.start_s = start;
    n->slave.phase = INITIALISING;
    return OK;
}

EXPORT Status FMI(fmi3ExitInitializationMode)(Instance *n)
{
    slave_begin(&n->slave);
    n->slave.phase = RUNNING;
    return OK;
}

EXPORT Status FMI(fmi3Terminate)(Instance *n)
{
    (void)n;
    return OK;
}

EXPORT Status FMI(fmi3Reset)(Instance *n)
{
    slave_reset(&n->slave);
    return OK;
}

EXPORT Status FMI(fmi3GetFloat64)(Instance *n, const Reference references[], size_t count, double values[],
                                  size_t room)
{
    const char *wrong = room < count ? "Too little room for the values" : NULL;
    size_t k;
    if (n->slave.phase == INITIALISING) {
        slave_begin(&n->slave); /* outputs follow from the start values that were set so far */
    }
    for (k = 0; k < count && !wrong; k += 1) {
        wrong = slave_get(&n->slave, references[k], &values[k], n->text);
    }
    return report(n, wrong);
}

EXPORT Status FMI(fmi3SetFloat64)(Instance *n, const Reference references[], size_t count, const double values[],
                                  size_t room)
{
    const char *wrong = room < count ? "Fewer values than value references" : NULL;
    size_t k;
    for (k = 0; k < count && !wrong; k += 1) {
        wrong = slave_set(&n->slave, references[k], values[k], n->text);
    }
    return report(n, wrong);
}

EXPORT Status FMI(fmi3GetBoolean)(Instance *n, const Reference references[], size_t count, bool values[], size_t room)
{
    const char *wrong = room < count ? "Too little room for the values" : NULL;
    size_t k;
    int closed = 0;
    for (k = 0; k < count && !wrong; k += 1) {
        wrong = slave_get_loop(&n->slave, references[k], &closed, n->text);
        values[k] = closed != 0;
    }
    return report(n, wrong);
}

EXPORT Status FMI(fmi3SetBoolean)(Instance *n, const Reference references[], size_t count, const bool values[],
                                  size_t room)
{
    const char *wrong = room < count ? "Fewer values than value references" : NULL;
    size_t k;
    for (k = 0; k < count && !wrong; k += 1) {
        wrong = slave_set_loop(&n->slave, references[k], values[k], n->text);
    }
    return report(n, wrong);
}

EXPORT Status FMI(fmi3GetFMUState)(Instance *n, void **state)
{
    *state = *state ? *state : malloc(sizeof n->slave);
    if (!*state) {
        return report(n, "No memory for the state. End other programs");
    }
    memcpy(*state, &n->slave, sizeof n->slave);
    return OK;
}

EXPORT Status FMI(fmi3SetFMUState)(Instance *n, const void *state)
{
    memcpy(&n->slave, state, sizeof n->slave);
    return OK;
}

EXPORT Status FMI(fmi3FreeFMUState)(Instance *n, void **state)
{
    (void)n;
    free(*state);
    *state = NULL;
    return OK;
}

EXPORT Status FMI(fmi3SerializedFMUStateSize)(Instance *n, const void *state, size_t *size)
{
    (void)state;
    *size = sizeof n->slave;
    return OK;
}

EXPORT Status FMI(fmi3SerializeFMUState)(Instance *n, const void *state, uint8_t bytes[], size_t size)
{
    if (size < sizeof n->slave) {
        return report(n, "Too little room for the state. Ask fmi3SerializedFMUStateSize");
    }
    memcpy(bytes, state, sizeof n->slave);
    return OK;
}

EXPORT Status FMI(fmi3DeserializeFMUState)(Instance *n, const uint8_t bytes[], size_t size, void **state)
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

EXPORT Status FMI(fmi3EnterStepMode)(Instance *n)
{
    (void)n; /* there is no event mode to leave */
    return OK;
}

EXPORT Status FMI(fmi3DoStep)(Instance *n, double time, double duration, bool no_set_state_before, bool *event,
                              bool *terminate, bool *early, double *last_time)
{
    const char *wrong = slave_step(&n->slave, time, duration, n->text);
    (void)no_set_state_before;
    *event = *terminate = *early = false;
    *last_time = wrong ? time : time + duration;
    return report(n, wrong);
}

/* The rest is of variables, interfaces and options that modelDescription.xml does not announce. */


#define NO_VARIABLES(name, type)                                                                                  \
    EXPORT Status FMI(name)(Instance * n, const Reference references[], size_t count, type values[], size_t room) \
    {                                                                                                             \
        (void)references, (void)values, (void)room;                                                               \
        return count ? report(n, #name ": this FMU has no variable of that type") : OK;                          \
    }


NO_VARIABLES(fmi3GetFloat32, float)
NO_VARIABLES(fmi3SetFloat32, const float)
NO_VARIABLES(fmi3GetInt8, int8_t)
NO_VARIABLES(fmi3SetInt8, const int8_t)
NO_VARIABLES(fmi3GetUInt8, uint8_t)
NO_VARIABLES(fmi3SetUInt8, const uint8_t)
NO_VARIABLES(fmi3GetInt16, int16_t)
NO_VARIABLES(fmi3SetInt16, const int16_t)
NO_VARIABLES(fmi3GetUInt16, uint16_t)
NO_VARIABLES(fmi3SetUInt16, const uint16_t)
NO_VARIABLES(fmi3GetInt32, int32_t)
NO_VARIABLES(fmi3SetInt32, const int32_t)
NO_VARIABLES(fmi3GetUInt32, uint32_t)
NO_VARIABLES(fmi3SetUInt32, const uint32_t)
NO_VARIABLES(fmi3GetInt64, int64_t)
NO_VARIABLES(fmi3SetInt64, const int64_t)
NO_VARIABLES(fmi3GetUInt64, uint64_t)
NO_VARIABLES(fmi3SetUInt64, const uint64_t)
NO_VARIABLES(fmi3GetString, const char *)
NO_VARIABLES(fmi3SetString, const char *const)

#define NOT_HERE(name, arguments)                                                                \
    EXPORT Status FMI(name) arguments                                                            \
    {                                                                                            \
        return report(n, #name " is not for this FMU, as modelDescription.xml says");            \
    }

NOT_HERE(fmi3GetBinary, (Instance *n, const Reference r[], size_t c, size_t s[], const uint8_t *v[], size_t m))
NOT_HERE(fmi3SetBinary, (Instance *n, const Reference r[], size_t c, const size_t s[], const uint8_t *const v[],
         size_t m))
NOT_HERE(fmi3GetClock, (Instance *n, const Reference r[], size_t c, bool v[]))
NOT_HERE(fmi3SetClock, (Instance *n, const Reference r[], size_t c, const bool v[]))
NOT_HERE(fmi3GetNumberOfVariableDependencies, (Instance *n, Reference r, size_t *c))
NOT_HERE(fmi3GetVariableDependencies, (Instance *n, Reference r, size_t a[], Reference b[], size_t d[], int k[],
         size_t c))
NOT_HERE(fmi3GetDirectionalDerivative, (Instance *n, const Reference a[], size_t b, const Reference c[], size_t d,
         const double e[], size_t f, double g[], size_t h))
NOT_HERE(fmi3GetAdjointDerivative, (Instance *n, const Reference a[], size_t b, const Reference c[], size_t d,
         const double e[], size_t f, double g[], size_t h))
NOT_HERE(fmi3EnterConfigurationMode, (Instance *n))
NOT_HERE(fmi3ExitConfigurationMode, (Instance *n))
NOT_HERE(fmi3EnterEventMode, (Instance *n))
NOT_HERE(fmi3GetIntervalDecimal, (Instance *n, const Reference r[], size_t c, double v[], int q[]))
NOT_HERE(fmi3GetIntervalFraction, (Instance *n, const Reference r[], size_t c, uint64_t v[], uint64_t w[], int q[]))
NOT_HERE(fmi3GetShiftDecimal, (Instance *n, const Reference r[], size_t c, double v[]))
NOT_HERE(fmi3GetShiftFraction, (Instance *n, const Reference r[], size_t c, uint64_t v[], uint64_t w[]))
NOT_HERE(fmi3SetIntervalDecimal, (Instance *n, const Reference r[], size_t c, const double v[]))
NOT_HERE(fmi3SetIntervalFraction, (Instance *n, const Reference r[], size_t c, const uint64_t v[],
         const uint64_t w[]))
NOT_HERE(fmi3SetShiftDecimal, (Instance *n, const Reference r[], size_t c, const double v[]))
NOT_HERE(fmi3SetShiftFraction, (Instance *n, const Reference r[], size_t c, const uint64_t v[], const uint64_t w[]))
NOT_HERE(fmi3EvaluateDiscreteStates, (Instance *n))
NOT_HERE(fmi3UpdateDiscreteStates, (Instance *n, bool *a, bool *b, bool *c, bool *d, bool *e, double *f))
NOT_HERE(fmi3EnterContinuousTimeMode, (Instance *n))
NOT_HERE(fmi3CompletedIntegratorStep, (Instance *n, bool a, bool *b, bool *c))
NOT_HERE(fmi3SetTime, (Instance *n, double t))
NOT_HERE(fmi3SetContinuousStates, (Instance *n, const double v[], size_t c))
NOT_HERE(fmi3GetContinuousStateDerivatives, (Instance *n, double v[], size_t c))
NOT_HERE(fmi3GetEventIndicators, (Instance *n, double v[], size_t c))
NOT_HERE(fmi3GetContinuousStates, (Instance *n, double v[], size_t c))
NOT_HERE(fmi3GetNominalsOfContinuousStates, (Instance *n, double v[], size_t c))
NOT_HERE(fmi3GetNumberOfEventIndicators, (Instance *n, size_t *c))
NOT_HERE(fmi3GetNumberOfContinuousStates, (Instance *n, size_t *c))
NOT_HERE(fmi3GetOutputDerivatives, (Instance *n, const Reference r[], size_t c, const int32_t o[], double v[],
         size_t m))
NOT_HERE(fmi3ActivateModelPartition, (Instance *n, Reference r, double t))

EXPORT Instance *FMI(fmi3InstantiateModelExchange)(const char *name, const char *token, const char *resources,
                                                   bool visible, bool logging, void *environment, Logger logger)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)logger;
    return NULL;
}

EXPORT Instance *FMI(fmi3InstantiateScheduledExecution)(const char *name, const char *token, const char *resources,
                                                        bool visible, bool logging, void *environment, Logger logger,
                                                        void (*update)(void *), void (*lock)(void),
                                                        void (*unlock)(void))
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)logger;
    (void)update, (void)lock, (void)unlock;
    return NULL;
}
