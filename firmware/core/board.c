/* The board: boot, main loop, one tick; rules 1, 4 and 16. */
#include <string.h>

#include "core.h"

#define RECEIVE_AT_ONCE 8U /* bytes in a turn of the main loop */

B51_STATE_MEMORY struct b51_board b51_board;

/* Once after a reset, before the first tick. */
void b51_board_boot(void) {
    uint8_t field;

    b51_hal_capture_timer(0);
    (void)memset(&b51_board, 0, sizeof b51_board);
    b51_output_boot();
    b51_board.ticks_since_overrun = B51_TICKS_PER_S;
    field = b51_settings_boot();
    b51_calibration_boot();
    b51_loop_boot();
    b51_host_boot();
    b51_emit(b51_hal_reset_cause(), b51_hal_resets());
    if (field != 0U) {
        b51_emit(B51_SETTINGS_REJECTED, field);
    }
}

void b51_emit(uint8_t code, uint16_t detail) B51_ON_STACK {
    B51_STATE_MEMORY uint8_t *at = b51_board.body;

    *at++ = B51_EVENT;
    *at++ = b51_board.events++;
    at = b51_put_u32(at, b51_board.next_tick);
    *at++ = code;
    (void)b51_put_u16(at, detail);
    b51_queue_put(b51_board.body);
}

/* A tick took longer than T_s. */
void b51_board_late(void) {
    if (b51_board.overruns < UINT16_MAX) {
        b51_board.overruns++;
    }
    b51_board.loop.overrun = true;
    if (b51_board.ticks_since_overrun >= B51_TICKS_PER_S) {
        b51_board.ticks_since_overrun = 0;
        b51_emit(B51_OVERRUN, 0);
    }
}

/* Whether an acknowledged RESET is due: the ACK has left, or a line that never takes it has had its time. */
static bool reset_is_due(void) {
    if (b51_board.host.reset_wait == 0U) {
        return false;
    }
    b51_board.host.reset_wait--;
    return b51_board.host.reset_wait == 0U || b51_answers_have_left();
}

static void queue_state(uint16_t i, uint16_t x, uint8_t flags) B51_ON_STACK {
    B51_STATE_MEMORY uint8_t *body = b51_board.body;

    body[0] = B51_STATE;
    (void)b51_put_u16(body + 1, (uint16_t)b51_board.next_tick);
    b51_put_pair(body + 3, i, x);
    b51_put_pair(body + 6, b51_loop_u(), b51_board.reference.x_ref);
    body[9] = flags;
    b51_queue_put(body);
}

/* The order is that of rule 4: the law first, whatever else waits. */
static void tick(void) {
    uint16_t i = b51_hal_read_current();
    uint16_t x = b51_hal_read_position();
    uint8_t flags;

    if (b51_board.calibration.corrects) { /* without a calibration it takes no time */
        x = b51_calibrated(x);
    }
    b51_hal_feed_watchdog();
    if (reset_is_due()) {
        b51_hal_restart();
        return; /* on a chip it never comes here */
    }
    b51_host_watch();
    flags = b51_loop_run(i, x);
    if (b51_board.host.divider == 1U ||
        (b51_board.host.divider != 0U && b51_board.next_tick % b51_board.host.divider == 0U)) {
        queue_state(i, x, flags);
    }
    b51_board.next_tick++;
    b51_board.host.commands_left = B51_COMMANDS_PER_TICK;
    if (b51_board.ticks_since_overrun < B51_TICKS_PER_S) {
        b51_board.ticks_since_overrun++;
    }
    if (b51_board.host.ticks_since_overload < B51_TICKS_PER_S) {
        b51_board.host.ticks_since_overload++;
    }
    if (!b51_hal_has_time(B51_FOR_NOTHING)) {
        b51_board_late();
    }
}

/* Up to the end of a frame, so that its turn does not take longer for what follows it; whether there may be more. */
static bool receive(void) {
    uint8_t n;

    for (n = 0; n < RECEIVE_AT_ONCE; n++) {
        int16_t byte = b51_hal_receive();
        uint8_t size;

        if (byte < 0) {
            return false;
        }
        size = b51_receiver_take((uint8_t)byte);
        if (size != 0U) {
            b51_host_receive(b51_board.receiver.data + 1, size);
            return true;
        }
    }
    return true;
}

/* One turn of the main loop; whether another one has something to do before an interrupt.  Nothing of it but the tick is
 * begun that could delay the next one. */
bool b51_board_poll(void) {
    bool again = true;

    if (b51_capture_completed()) {
        b51_output_write(b51_board.loop.u);
        b51_emit(B51_CAPTURE_DONE, 0);
    }
    if (b51_hal_tick_due()) {
        tick();
    } else {
        again = b51_hal_has_time(B51_FOR_RECEIVING) && receive();
        if (!again) { /* bytes first: their ring is short */
            b51_host_execute();
            b51_loop_play_ahead();
        }
    }
    b51_send_frames();
    return again;
}
