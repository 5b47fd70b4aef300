/* x_ref in force and the allowance for its jumps: rule 7. */
#include "core.h"

#define MILLION UINT32_C(1000000)

B51_STATIC_ASSERT(b51_the_largest_allowance_has_32_bits, UINT64_C(1000000) * B51_COUNTS_MAX <= UINT32_MAX);
B51_STATIC_ASSERT(b51_the_largest_refill_has_32_bits, (uint64_t)UINT16_MAX * B51_TICK_US <= UINT32_MAX);

/* After the limits are in force; the products are made here, once. */
void b51_reference_boot(uint16_t x_ref) {
    b51_board.reference.x_ref = x_ref;
    b51_board.reference.full = b51_board.loop.limits.x_ref_step * MILLION; /* at most 4095e6: fits 32 bits */
    b51_board.reference.refill = b51_board.loop.limits.x_ref_slew * B51_TICK_US;
    b51_board.reference.allowance = b51_board.reference.full;
}

/* The largest jump that is accepted now, in whole counts. */
uint16_t b51_reference_allowance(void) {
    return (uint16_t)(b51_board.reference.allowance / MILLION);
}

void b51_reference_refill(void) {
    if (b51_board.reference.full - b51_board.reference.allowance <= b51_board.reference.refill) {
        b51_board.reference.allowance = b51_board.reference.full;
    } else {
        b51_board.reference.allowance += b51_board.reference.refill;
    }
}

/* A jump that was checked. */
void b51_reference_jump(uint16_t x_ref) {
    b51_board.reference.allowance -= b51_distance(x_ref, b51_board.reference.x_ref) * MILLION;
    b51_board.reference.x_ref = x_ref;
}
