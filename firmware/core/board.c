/* The board: boot, main loop, one tick; rules 1, 4 and 16. */
#include <string.h>

#include "core.h"

#define RECEIVE_AT_ONCE 8U /* bytes in a turn of the main loop */

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

/* The order is that of rule 4: the law first, whatever else waits. */
static void tick(void) {
    uint16_t i = hal_read_current();
    uint16_t x = hal_read_position();
    uint8_t flags;

    hal_feed_watchdog();
    if (reset_is_due()) {
        hal_restart();
        return; /* on a chip it never comes here */
    }
    host_watch();
    flags = loop_run(i, x);
    if (board.host.divider == 1U || (board.host.divider != 0U && board.next_tick % board.host.divider == 0U)) {
        queue_state(i, x, flags);
    }
    board.next_tick++;
    board.host.commands_left = COMMANDS_PER_TICK;
    if (board.ticks_since_overrun < TICKS_PER_S) {
        board.ticks_since_overrun++;
    }
    if (board.host.ticks_since_overload < TICKS_PER_S) {
        board.host.ticks_since_overload++;
    }
    if (!hal_has_time(FOR_NOTHING)) {
        board_late();
    }
}

/* Up to the end of a frame, so that its turn does not take longer for what follows it; whether there may be more. */
static bool receive(void) {
    uint8_t n;

    for (n = 0; n < RECEIVE_AT_ONCE; n++) {
        int16_t byte = hal_receive();
        uint8_t size;

        if (byte < 0) {
            return false;
        }
        size = receiver_take((uint8_t)byte);
        if (size != 0U) {
            host_receive(board.receiver.data + 1, size);
            return true;
        }
    }
    return true;
}

/* One turn of the main loop; whether another one has something to do before an interrupt.  Nothing of it but the tick is
 * begun that could delay the next one. */
bool board_poll(void) {
    bool again = true;

    if (capture_completed()) {
        output_write(board.loop.u);
        emit(CAPTURE_DONE, 0);
    }
    if (hal_tick_due()) {
        tick();
    } else {
        again = hal_has_time(FOR_RECEIVING) && receive();
        if (!again) { /* bytes first: their ring is short */
            host_execute();
            loop_play_ahead();
        }
    }
    send_frames();
    return again;
}
