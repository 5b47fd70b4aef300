/* The correction of the position sensor through two of its readings: rule 17. */
#include <stddef.h>

#include "core.h"

#define LEAST_SPAN 2048      /* between the two readings: noise of a count changes the slope by 0.05 % */
#define MOST_CORRECTION 500  /* counts at each of them */

/* What a slope differs by from 1 has 16 places, and 15 bits. */
B51_STATIC_ASSERT(b51_a_slope_has_16_bits, 2 * MOST_CORRECTION * INT32_C(65536) / LEAST_SPAN <= INT16_MAX);

/* The difference of two fields; out of every range if one is not a count, as only a damaged memory may have it. */
static int16_t difference(const B51_STATE_MEMORY uint8_t *a, const B51_STATE_MEMORY uint8_t *b) B51_ON_STACK {
    uint16_t more = b51_get_u16(a);
    uint16_t less = b51_get_u16(b);

    return more > B51_COUNTS_MAX || less > B51_COUNTS_MAX ? INT16_MIN : (int16_t)((int16_t)more - (int16_t)less);
}

/* The four fields of SET_CALIBRATION: the bound in the way, or 0, and it is in force. */
uint16_t b51_calibration_set(const B51_STATE_MEMORY uint8_t *at) B51_ON_STACK {
    B51_STATE_MEMORY struct b51_calibration_state *to = &b51_board.calibration;
    int16_t span = difference(at + 4, at);
    int16_t low = difference(at + 2, at);
    int16_t high = difference(at + 6, at + 4);

    if (span < LEAST_SPAN) {
        return (uint16_t)(b51_get_u16(at) + (uint16_t)LEAST_SPAN);
    }
    if (low < -MOST_CORRECTION || low > MOST_CORRECTION || high < -MOST_CORRECTION || high > MOST_CORRECTION) {
        return MOST_CORRECTION;
    }
    to->low_read = b51_get_u16(at);
    to->low_true = b51_get_u16(at + 2);
    to->high_read = b51_get_u16(at + 4);
    to->high_true = b51_get_u16(at + 6);
    to->corrects = low != 0 || high != 0;
    to->flatter = high < low;
    to->slope = (uint16_t)b51_divide_rounded((to->flatter ? low - high : high - low) * INT32_C(65536), span);
    return 0;
}

/* After `b51_board` was cleared: what the target has kept, or each reading as it is, with a slope of 1. */
void b51_calibration_boot(void) {
    const B51_STATE_MEMORY uint8_t *kept = b51_hal_calibration();

    if (kept != NULL) {
        (void)b51_calibration_set(kept);
    }
    if (b51_board.calibration.high_read == 0U) {
        b51_board.calibration.high_read = B51_COUNTS_MAX;
        b51_board.calibration.high_true = B51_COUNTS_MAX;
    }
}

/* A reading at an end of the converter stays there: it is not a position. */
uint16_t b51_calibrated(uint16_t x) B51_ON_STACK {
    const B51_STATE_MEMORY struct b51_calibration_state *of = &b51_board.calibration;
    bool below = x < of->low_read;
    int16_t more;

    if (x == 0U || x == B51_COUNTS_MAX) {
        return x;
    }
    more = (int16_t)b51_fraction_of(below ? of->low_read - x : x - of->low_read, of->slope);
    more = below != of->flatter ? -more : more;
    more = (int16_t)(more + (int16_t)(x - of->low_read) + (int16_t)of->low_true);
    return more < 0 ? 0U : more > B51_COUNTS_MAX ? (uint16_t)B51_COUNTS_MAX : (uint16_t)more;
}
