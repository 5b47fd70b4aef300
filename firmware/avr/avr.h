/* Between the files of this target. */
#ifndef BOARD51_AVR_H
#define BOARD51_AVR_H

#include "../core/core.h"
#include "target.h"

/* A rig of its own: scalings, gains, limits, and tables where its converters are not linear. */
#ifdef PROFILE
#include PROFILE
#endif

/* The table at `at`, entries 2^bits apart: a straight line between them, rounded down. */
uint16_t between(const __flash uint16_t *table, uint16_t at, uint8_t bits);

void dac_start(void);
bool dac_write(uint16_t u);
void store_load(void);

#endif
