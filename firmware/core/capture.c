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

void capture_start(uint16_t u_from, uint16_t u_to, uint16_t pre, uint16_t count, uint32_t tick) ON_STACK {
    board.capture.u_from = u_from;
    board.capture.u_to = u_to;
    board.capture.pre = pre;
    board.capture.count = count;
    board.capture.taken = 0;
    board.capture.began_tick = tick + SETTLE_US / TICK_US;
    board.capture.there = false;
    board.capture.complete = false;
    board.capture.stepped = false;
    board.capture.refused = false;
    board.capture.step_is_next = pre == 0U;
    board.capture.waits = true;
    board.capture.running = true;
}

/* At its tick, in place of the write of u_c. */
void capture_begin(void) ON_STACK {
    board.capture.waits = false;
    output_write(board.capture.u_from);
    hal_capture_timer(SETTLE_US);
}

/* From here on the converter is the main loop's again. */
static void leave(void) {
    board.capture.running = false;
    board.capture.waits = false;
    if (board.capture.stepped) {
        board.output.u = board.capture.u_to;
    }
}

/* Ends a capture that is running; one that is complete stays. */
void capture_cancel(void) {
    hal_capture_timer(0);
    leave();
}

static void store(uint16_t n, uint16_t i) ON_STACK {
    /* n / 2 * 3, without the product routine of an 8051's compiler, which the main loop may be in the middle of. */
    STATE_MEMORY uint8_t *pair = &board.capture.samples[(n & 0xFFFEU) + n / 2U];

    if (n % 2U == 0U) {
        pair[0] = (uint8_t)i;
        pair[1] = (uint8_t)(i >> 8);
        pair[2] = 0;
    } else {
        pair[1] = (uint8_t)(pair[1] | i << 4);
        pair[2] = (uint8_t)(i >> 4);
    }
}

/* Called by the target at the times of `hal_capture_timer`: a sample each, then the end of the last one's time. */
void capture_interrupt(void) ON_STACK {
    if (!board.capture.running || board.capture.complete) {
        return;
    }
    if (board.capture.taken == board.capture.count) {
        hal_capture_timer(0);
        board.capture.complete = true;
        return;
    }
    store(board.capture.taken, hal_read_current());
    if (board.capture.step_is_next) { /* after the sample, which still shows the current before the step */
        board.capture.stepped = hal_write_input(board.capture.u_to);
        board.capture.refused = !board.capture.stepped;
    }
    board.capture.taken++;
    board.capture.step_is_next = board.capture.taken == board.capture.pre;
}

/* Whether a capture has come to its end since the last call. */
bool capture_completed(void) {
    if (!board.capture.running || !board.capture.complete) {
        return false;
    }
    leave();
    board.capture.there = true;
    return true;
}

/* u_c while it is running: what was confirmed last.  A step that is due at this instant counts, although its interrupt is still to be served. */
uint16_t capture_u(void) {
    bool stepped = board.capture.stepped || (board.capture.step_is_next && hal_capture_due());

    return stepped ? board.capture.u_to : board.output.u;
}

static void copy_half_a_pair_on(STATE_MEMORY uint8_t *to, const STATE_MEMORY uint8_t *from, uint8_t size) {
    uint8_t low = (uint8_t)(*from++ >> 4);

    for (; size != 0U; size--) {
        uint8_t byte = *from++;
        *to++ = (uint8_t)(low | byte << 4);
        low = (uint8_t)(byte >> 4);
    }
}

/* Up to 32 samples from index on, two in three bytes, the rest 0: 48 bytes.  There is one at index.  They are stored as
 * they are packed; from an odd index on they are half a pair, 12 bits, further on. */
void capture_pack(uint16_t index, STATE_MEMORY uint8_t *packed) ON_STACK {
    const STATE_MEMORY uint8_t *from = &board.capture.samples[index / 2U * 3U];
    uint16_t left = (uint16_t)(board.capture.count - index);
    uint8_t samples = left < BLOCK_SAMPLES ? (uint8_t)left : BLOCK_SAMPLES;
    uint8_t size = (uint8_t)((3U * samples + 1U) / 2U);
    uint8_t n;

    if (index % 2U == 0U) {
        copy(packed, from, size);
    } else {
        copy_half_a_pair_on(packed, from + 1, (uint8_t)(size - samples % 2U));
        if (samples % 2U != 0U) { /* nothing is behind the last sample */
            packed[size - 1U] = (uint8_t)(from[size] >> 4);
        }
    }
    for (n = size; n < BLOCK_SAMPLES / 2U * 3U; n++) {
        packed[n] = 0;
    }
}
