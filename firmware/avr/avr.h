/* Between the files of this target. */
#ifndef B51_AVR_H
#define B51_AVR_H

#include "../core/core.h"
#include "target.h"

/* A rig of its own: scalings, gains, limits, and tables where its converters are not linear. */
#ifdef B51_PROFILE
#include B51_PROFILE
#endif

/* The table at `at`, entries 2^bits apart: a straight line between them, rounded down. */
uint16_t b51_between(const __flash uint16_t *table, uint16_t at, uint8_t bits);

void b51_dac_start(void);
bool b51_dac_write(uint16_t u);
uint16_t b51_dac_store_zero(void);
void b51_store_load(void);
void b51_store_go_on(void);

#endif
