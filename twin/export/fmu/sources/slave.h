/* The rig as a co-simulation slave; `fmi2.c` and `fmi3.c` are its two interfaces.

   Rule 1: a tick of SAMPLE_TIME_S is run when all of it has passed.  Between ticks the outputs stand.
   Rule 2: inputs act from the tick on that begins when they are set, or next. */
#ifndef SLAVE_H
#define SLAVE_H
#include "model.h"

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)

#define TIME (VARIABLES + 1) /* value reference of the time; FMI 3.0 has it as a variable */

typedef enum { SETTING_UP, INITIALISING, RUNNING } Phase;

typedef struct {
    Model model;
    Phase phase;
    double start_s, time_s;
    long ticks; /* that have been run */
} Slave;

void slave_reset(Slave *s);
void slave_begin(Slave *s);
/* These return 0, or a sentence on what is wrong; `text` is its memory of TEXT characters. */
#define TEXT 300
const char *slave_set(Slave *s, unsigned reference, double value, char *text);
const char *slave_get(const Slave *s, unsigned reference, double *value, char *text);
const char *slave_set_loop(Slave *s, unsigned reference, int closed, char *text);
const char *slave_get_loop(const Slave *s, unsigned reference, int *closed, char *text);
const char *slave_step(Slave *s, double time_s, double duration_s, char *text);
#endif
