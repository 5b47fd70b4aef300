/* A burst of i_c around a step of u_c: rule 12.
 *
 *     u_from for 20 ms | u_from, `pre` samples | u_to, the rest of `count` samples | as the mode says
 *                      ^ sample 0, at `began_tick`
 *
 * The interrupt takes the samples and makes the step, and touches nothing else: the main loop never writes the
 * converter of u_c while a capture is running, and reports its end.  A step that the converter does not confirm is not
 * made again: it would no longer be at its sample.
 */
#include "core.h"

#define SETTLE_US 20000U

B51_STATIC_ASSERT(b51_the_first_sample_is_at_a_tick, SETTLE_US % B51_TICK_US == 0U);

void b51_capture_start(uint16_t u_from, uint16_t u_to, uint16_t pre, uint16_t count, uint32_t tick) B51_ON_STACK {
    b51_board.capture.u_from = u_from;
    b51_board.capture.u_to = u_to;
    b51_board.capture.pre = pre;
    b51_board.capture.count = count;
    b51_board.capture.taken = 0;
    b51_board.capture.began_tick = tick + SETTLE_US / B51_TICK_US;
    b51_board.capture.there = false;
    b51_board.capture.complete = false;
    b51_board.capture.stepped = false;
    b51_board.capture.refused = false;
    b51_board.capture.step_is_next = pre == 0U;
    b51_board.capture.waits = true;
    b51_board.capture.running = true;
}

/* At its tick, in place of the write of u_c. */
void b51_capture_begin(void) B51_ON_STACK {
    b51_board.capture.waits = false;
    b51_output_write(b51_board.capture.u_from);
    b51_hal_capture_timer(SETTLE_US);
}

/* From here on the converter is the main loop's again. */
static void leave(void) {
    b51_board.capture.running = false;
    b51_board.capture.waits = false;
    if (b51_board.capture.stepped) {
        b51_board.output.u = b51_board.capture.u_to;
    }
}

/* Ends a capture that is running; one that is complete stays. */
void b51_capture_cancel(void) {
    b51_hal_capture_timer(0);
    leave();
}

static void store(uint16_t n, uint16_t i) B51_ON_STACK {
    /* n / 2 * 3, without the product routine of an 8051's compiler, which the main loop may be in the middle of. */
    B51_STATE_MEMORY uint8_t *pair = &b51_board.capture.samples[(n & 0xFFFEU) + n / 2U];

    if (n % 2U == 0U) {
        pair[0] = (uint8_t)i;
        pair[1] = (uint8_t)(i >> 8);
        pair[2] = 0;
    } else {
        pair[1] = (uint8_t)(pair[1] | i << 4);
        pair[2] = (uint8_t)(i >> 4);
    }
}

/* Called by the target at the times of `b51_hal_capture_timer`: a sample each, then the end of the last one's time. */
void b51_capture_interrupt(void) B51_ON_STACK {
    if (!b51_board.capture.running || b51_board.capture.complete) {
        return;
    }
    if (b51_board.capture.taken == b51_board.capture.count) {
        b51_hal_capture_timer(0);
        b51_board.capture.complete = true;
        return;
    }
    store(b51_board.capture.taken, b51_hal_read_current());
    if (b51_board.capture.step_is_next) { /* after the sample, which still shows the current before the step */
        b51_board.capture.stepped = b51_hal_write_input(b51_board.capture.u_to);
        b51_board.capture.refused = !b51_board.capture.stepped;
    }
    b51_board.capture.taken++;
    b51_board.capture.step_is_next = b51_board.capture.taken == b51_board.capture.pre;
}

/* Whether a capture has come to its end since the last call. */
bool b51_capture_completed(void) {
    if (!b51_board.capture.running || !b51_board.capture.complete) {
        return false;
    }
    leave();
    b51_board.capture.there = true;
    return true;
}

/* u_c while it is running: what was confirmed last.  A step that is due at this instant counts, although its interrupt
 * is still to be served. */
uint16_t b51_capture_u(void) {
    bool stepped = b51_board.capture.stepped || (b51_board.capture.step_is_next && b51_hal_capture_due());

    return stepped ? b51_board.capture.u_to : b51_board.output.u;
}

static void copy_half_a_pair_on(B51_STATE_MEMORY uint8_t *to, const B51_STATE_MEMORY uint8_t *from, uint8_t size) {
    uint8_t low = (uint8_t)(*from++ >> 4);

    for (; size != 0U; size--) {
        uint8_t byte = *from++;
        *to++ = (uint8_t)(low | byte << 4);
        low = (uint8_t)(byte >> 4);
    }
}

/* Up to 32 samples from index on, two in three bytes, the rest 0: 48 bytes.  There is one at index.  They are stored as
 * they are packed; from an odd index on they are half a pair, 12 bits, further on. */
void b51_capture_pack(uint16_t index, B51_STATE_MEMORY uint8_t *packed) B51_ON_STACK {
    const B51_STATE_MEMORY uint8_t *from = &b51_board.capture.samples[index / 2U * 3U];
    uint16_t left = (uint16_t)(b51_board.capture.count - index);
    uint8_t samples = left < B51_BLOCK_SAMPLES ? (uint8_t)left : B51_BLOCK_SAMPLES;
    uint8_t size = (uint8_t)((3U * samples + 1U) / 2U);
    uint8_t n;

    if (index % 2U == 0U) {
        b51_copy(packed, from, size);
    } else {
        copy_half_a_pair_on(packed, from + 1, (uint8_t)(size - samples % 2U));
        if (samples % 2U != 0U) { /* nothing is behind the last sample */
            packed[size - 1U] = (uint8_t)(from[size] >> 4);
        }
    }
    for (n = size; n < B51_BLOCK_SAMPLES / 2U * 3U; n++) {
        packed[n] = 0;
    }
}
