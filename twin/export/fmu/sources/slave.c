#include "slave.h"
#include <math.h>
#include <stdio.h>

#define SLIVER 1e-6 /* of a tick: rounding errors of an importer's sums of steps */
#define MOST_TICKS 1e9

void slave_reset(Slave *s)
{
    model_reset(&s->model);
    s->phase = SETTING_UP;
    s->start_s = s->time_s = 0.0;
    s->ticks = 0;
    model_begin(&s->model);
}

void slave_begin(Slave *s)
{
    model_begin(&s->model);
    s->time_s = s->start_s;
    s->ticks = 0;
}

static const char *no_such(unsigned reference, const char *type, char *text)
{
    snprintf(text, TEXT, "Value reference %u is not a %s of this FMU. See modelDescription.xml", reference, type);
    return text;
}

const char *slave_set(Slave *s, unsigned reference, double value, char *text)
{
    const Variable *v = &variables[reference < VARIABLES ? reference : 0];
    if (reference >= VARIABLES) {
        return no_such(reference, "number", text);
    }
    if (v->role == OUTPUT || (v->role == FIXED && s->phase == RUNNING)) {
        snprintf(text, TEXT, "%s cannot be set %s", v->name,
                 v->role == OUTPUT ? "because it is an output" : "after the initialization: reset the FMU first");
        return text;
    }
    if (!(isfinite(value) && value >= v->low && value <= v->high)) {
        snprintf(text, TEXT, "%s = %g is not in %g .. %g. Check the unit", v->name, value, v->low, v->high);
        return text;
    }
    *(double *)((char *)&s->model + v->place) = value;
    return 0;
}

const char *slave_get(const Slave *s, unsigned reference, double *value, char *text)
{
    if (reference == TIME) {
        *value = s->time_s;
        return 0;
    }
    if (reference >= VARIABLES) {
        return no_such(reference, "number", text);
    }
    *value = *(const double *)((const char *)&s->model + variables[reference].place);
    return 0;
}

const char *slave_set_loop(Slave *s, unsigned reference, int closed, char *text)
{
    if (reference != CLOSED_LOOP) {
        return no_such(reference, "truth value", text);
    }
    s->model.closed_loop = closed != 0;
    return 0;
}

const char *slave_get_loop(const Slave *s, unsigned reference, int *closed, char *text)
{
    if (reference != CLOSED_LOOP) {
        return no_such(reference, "truth value", text);
    }
    *closed = s->model.closed_loop;
    return 0;
}

const char *slave_step(Slave *s, double time_s, double duration_s, char *text)
{
    double value = 0;
    unsigned n;
    const double end = floor((time_s + duration_s - s->start_s) / SAMPLE_TIME_S + SLIVER);
    if (!(duration_s > 0.0 && end - (double)s->ticks < MOST_TICKS)) {
        snprintf(text, TEXT, "A step of %g s at %g s cannot be done. Give a positive duration", duration_s, time_s);
        return text;
    }
    while ((double)s->ticks < end) {
        model_tick(&s->model);
        s->ticks += 1;
    }
    s->time_s = time_s + duration_s;
    for (n = 0; n < VARIABLES; n += 1) {
        slave_get(s, n, &value, text);
        if (!isfinite(value)) {
            snprintf(text, TEXT, "%s is not a number any longer at %g s. Check the parameters", variables[n].name,
                     s->time_s);
            return text;
        }
    }
    return 0;
}
