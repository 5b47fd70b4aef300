/* Between the files of this target. */
#ifndef BOARD51_AVR_H
#define BOARD51_AVR_H

#include "../core/core.h"
#include "target.h"

void dac_start(void);
void dac_write(uint16_t u);
void store_load(void);

#endif
