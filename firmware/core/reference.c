/* x_ref in force and the allowance for its jumps: rule 7. */
#include "core.h"

#define MILLION UINT32_C(1000000)

/* After the limits are in force; the products are made here, once. */
void reference_boot(uint16_t x_ref) {
    board.reference.x_ref = x_ref;
    board.reference.full = board.loop.limits.x_ref_step * MILLION; /* at most 4095e6: fits 32 bits */
    board.reference.refill = board.loop.limits.x_ref_slew * TICK_US;
    board.reference.allowance = board.reference.full;
}

/* The largest jump that is accepted now, in whole counts. */
uint16_t reference_allowance(void) {
    return (uint16_t)(board.reference.allowance / MILLION);
}

void reference_refill(void) {
    if (board.reference.full - board.reference.allowance <= board.reference.refill) {
        board.reference.allowance = board.reference.full;
    } else {
        board.reference.allowance += board.reference.refill;
    }
}

/* A jump that was checked. */
void reference_jump(uint16_t x_ref) {
    board.reference.allowance -= distance(x_ref, board.reference.x_ref) * MILLION;
    board.reference.x_ref = x_ref;
}
