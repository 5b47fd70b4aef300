/* The board: boot, main loop, one tick; rules 1, 4 and 16. */
#include <string.h>

#include "core.h"

#define RECEIVE_AT_ONCE 16U /* bytes in a turn of the main loop */

STATE_MEMORY struct board board;

/* Once after a reset, before the first tick. */
void board_boot(void) {
    uint8_t field;

    hal_capture_timer(0);
    memset(&board, 0, sizeof board);
    output_boot();
    board.ticks_since_overrun = TICKS_PER_S;
    field = settings_boot();
    loop_boot();
    host_boot();
    emit(hal_reset_cause(), hal_resets());
    if (field != 0U) {
        emit(SETTINGS_REJECTED, field);
    }
}

void emit(uint8_t code, uint16_t detail) ON_STACK {
    STATE_MEMORY uint8_t *at = board.body;

    *at++ = EVENT;
    *at++ = board.events++;
    at = put_u32(at, board.next_tick);
    *at++ = code;
    (void)put_u16(at, detail);
    queue_put(board.body);
}

/* A tick took longer than T_s. */
void board_late(void) {
    if (board.overruns < UINT16_MAX) {
        board.overruns++;
    }
    board.loop.overrun = true;
    if (board.ticks_since_overrun >= TICKS_PER_S) {
        board.ticks_since_overrun = 0;
        emit(OVERRUN, 0);
    }
}

/* Whether an acknowledged RESET is due: the ACK has left, or a line that never takes it has had its time. */
static bool reset_is_due(void) {
    if (board.host.reset_wait == 0U) {
        return false;
    }
    board.host.reset_wait--;
    return board.host.reset_wait == 0U || answers_have_left();
}

static void queue_state(uint16_t i, uint16_t x, uint8_t flags) ON_STACK {
    STATE_MEMORY uint8_t *body = board.body;

    body[0] = STATE;
    (void)put_u16(body + 1, (uint16_t)board.next_tick);
    put_pair(body + 3, i, x);
    put_pair(body + 6, loop_u(), board.reference.x_ref);
    body[9] = flags;
    queue_put(body);
}

/* The order is that of rule 4. */
static void tick(void) {
    uint16_t i = hal_read_current();
    uint16_t x = hal_read_position();
    uint8_t flags;

    hal_feed_watchdog();
    host_execute_pending();
    if (reset_is_due()) {
        hal_restart();
        return; /* on a chip it never comes here */
    }
    host_watch();
    flags = loop_run(i, x);
    if (board.host.divider == 1U || (board.host.divider != 0U && board.next_tick % board.host.divider == 0U)) {
        queue_state(i, x, flags);
    }
    loop_play_ahead();
    board.next_tick++;
    if (board.ticks_since_overrun < TICKS_PER_S) {
        board.ticks_since_overrun++;
    }
}

/* One turn of the main loop. */
void board_poll(void) {
    uint8_t n;
    uint8_t byte;

    if (capture_completed()) {
        output_write(board.loop.u);
        emit(CAPTURE_DONE, 0);
    }
    for (n = 0; n < RECEIVE_AT_ONCE && hal_receive(&byte); n++) {
        uint8_t size = receiver_take(byte);
        if (size != 0U) {
            host_receive(board.receiver.data + 1, size);
        }
    }
    if (hal_tick_due()) {
        tick();
    }
    send_frames();
}
