/* The control law, eq. (16)-(19) of the paper, in counts and integers: rule 9. */
#include "core.h"

#define SUM_MAX 8388607 /* 24 bits */
#define HALF (1 << (B51_FRACTION_BITS - 1U))

/* Entering closed loop: integral 0, and speed 0 at the next tick. */
void b51_law_reset(void) {
    b51_board.law.sum = 0;
    b51_board.law.x_known = false;
}

static int32_t term(uint8_t n, int32_t operand) {
    return b51_scaled_product(b51_board.law.gains.mantissa[n], b51_board.law.gains.shift[n], operand);
}

/* u before rounding and limits, in 1/256 counts, with the integral as it is. */
int32_t b51_law_accumulate(uint16_t i, uint16_t x, uint16_t x_ref) {
    const B51_STATE_MEMORY struct b51_law_state *law = &b51_board.law;
    int32_t step = law->x_known ? (int32_t)x - law->x_previous : 0;
    int32_t u = (int32_t)law->gains.u_0 * (1 << B51_FRACTION_BITS);

    if (law->gains.law == B51_LAW_LQI) {
        u = b51_saturated_difference(u, term(0, (int32_t)i - law->gains.i_0));
        u = b51_saturated_difference(u, term(1, (int32_t)x - law->gains.x_0));
        u = b51_saturated_difference(u, term(2, step));
        return b51_saturated_difference(u, term(3, law->sum));
    }
    u = b51_saturated_sum(u, term(0, (int32_t)x_ref - x));
    u = b51_saturated_sum(u, term(1, law->sum));
    return b51_saturated_difference(u, term(2, step));
}

/* One tick: u_c in counts, whether it was limited, and the integral advanced. */
uint16_t b51_law_run(uint16_t i, uint16_t x, uint16_t x_ref, bool *limited) B51_ON_STACK {
    int32_t wanted = b51_shift_down(b51_saturated_sum(b51_law_accumulate(i, x, x_ref), HALF), B51_FRACTION_BITS);
    int32_t error = (int32_t)x_ref - x;
    /* Anti-windup: the sign of du/dsum decides which error would push u further past the limit that it is at. */
    int16_t rise = b51_board.law.gains.law == B51_LAW_LQI ? (int16_t)-b51_board.law.gains.mantissa[3]
                                                          : b51_board.law.gains.mantissa[1];
    bool further_up = wanted > B51_COUNTS_MAX && ((error > 0 && rise > 0) || (error < 0 && rise < 0));
    bool further_down = wanted < 0 && ((error > 0 && rise < 0) || (error < 0 && rise > 0));

    if (!further_up && !further_down) {
        int32_t sum = b51_board.law.sum + error;
        b51_board.law.sum = sum > SUM_MAX ? SUM_MAX : sum < -SUM_MAX - 1 ? -SUM_MAX - 1 : sum;
    }
    b51_board.law.x_previous = x;
    b51_board.law.x_known = true;
    *limited = wanted < 0 || wanted > B51_COUNTS_MAX;
    return wanted < 0 ? 0U : wanted > B51_COUNTS_MAX ? (uint16_t)B51_COUNTS_MAX : (uint16_t)wanted;
}
