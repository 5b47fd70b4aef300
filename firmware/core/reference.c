/* x_ref in force and the allowance for its jumps: rule 7. */
#include "core.h"

#define MILLION UINT32_C(1000000)

static uint32_t full(void) {
    return board.loop.limits.x_ref_step * MILLION; /* at most 4095e6: fits 32 bits */
}

void reference_boot(uint16_t x_ref) {
    board.reference.x_ref = x_ref;
    board.reference.allowance = full();
}

/* The largest jump that is accepted now, in whole counts. */
uint16_t reference_allowance(void) {
    return (uint16_t)(board.reference.allowance / MILLION);
}

void reference_refill(void) {
    uint32_t refill = board.loop.limits.x_ref_slew * TICK_US;

    if (full() - board.reference.allowance <= refill) {
        board.reference.allowance = full();
    } else {
        board.reference.allowance += refill;
    }
}

/* A jump that was checked. */
void reference_jump(uint16_t x_ref) {
    board.reference.allowance -= distance(x_ref, board.reference.x_ref) * MILLION;
    board.reference.x_ref = x_ref;
}
