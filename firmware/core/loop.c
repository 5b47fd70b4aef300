/* The control loop between two converters: rules 6 to 9, 11, and the board's half of 12 and 13. */
#include "core.h"

#define OVER_CURRENT_TICKS 50U
#define SENSOR_FAULT_TICKS 500U
#define LIMIT_OF_INPUT 0U /* detail of LIMIT_HIT */

/* After `board` was cleared and the settings are in force. */
void loop_boot(void) {
    board.loop.ticks_since_limit_hit = TICKS_PER_S;
    reference_boot(board.law.gains.x_0);
}

/* The count of the input converter, as far as it has confirmed it. */
uint16_t loop_u(void) {
    return board.capture.running ? capture_u() : board.output.u;
}

/* As SET_MODE does: the mode in force is not entered again, but idle ends a capture in any case. */
void loop_set_mode(uint8_t mode) {
    if (mode == MODE_IDLE && board.capture.running) {
        capture_cancel();
    }
    if (mode == board.loop.mode) {
        return;
    }
    loop_end_excitation();
    board.loop.mode = mode;
    board.loop.open_loop_u = 0;
    board.loop.limited = false;
    board.loop.sensor_ticks = 0;
    law_reset();
    emit(MODE_CHANGED, mode);
}

/* At once, not at the next tick. */
void loop_switch_off(void) {
    loop_set_mode(MODE_IDLE);
    board.loop.u = 0;
    output_write(0);
}

/* The signal stays at its offset. */
void loop_end_excitation(void) {
    if (!board.excitation.active) {
        return;
    }
    if (board.excitation.signal.target == TARGET_X_REF) {
        board.reference.x_ref = board.excitation.signal.offset;
    } else {
        board.loop.open_loop_u = board.excitation.signal.offset;
    }
    board.excitation.active = false;
}

/* A reference that was checked; it ends an excitation of the reference. */
void loop_set_reference(uint16_t x_ref) {
    if (board.excitation.active && board.excitation.signal.target == TARGET_X_REF) {
        board.excitation.active = false;
    }
    reference_jump(x_ref);
}

static void fail(uint8_t code, uint16_t count) {
    emit(code, count);
    board.loop.fault = true;
    loop_switch_off();
}

static void watch_converters(uint16_t i, uint16_t x) {
    bool clipped = board.loop.mode == MODE_CLOSED_LOOP && (x == 0U || x == COUNTS_MAX);

    if (i != COUNTS_MAX) {
        board.loop.over_current_ticks = 0;
    } else if (board.loop.over_current_ticks < OVER_CURRENT_TICKS) {
        board.loop.over_current_ticks++;
    }
    if (!clipped) {
        board.loop.sensor_ticks = 0;
    } else if (board.loop.sensor_ticks < SENSOR_FAULT_TICKS) {
        board.loop.sensor_ticks++;
    }
    if (board.loop.fault) {
        return;
    }
    if (board.loop.over_current_ticks >= OVER_CURRENT_TICKS) {
        fail(OVER_CURRENT, i);
    } else if (board.loop.sensor_ticks >= SENSOR_FAULT_TICKS) {
        fail(SENSOR_FAULT, x);
    }
}

static void play(void) {
    uint16_t value;

    if (!board.excitation.active) {
        return;
    }
    value = board.excitation.ahead ? board.excitation.value : excitation_next();
    board.excitation.ahead = false;
    if (excitation_over() && !board.excitation.announced) {
        board.excitation.announced = true;
        emit(EXCITATION_DONE, 0);
    }
    if (board.excitation.signal.target == TARGET_X_REF) {
        board.reference.x_ref = value;
    } else {
        board.loop.open_loop_u = value;
    }
}

static void report_limit(bool limited) {
    if (board.loop.ticks_since_limit_hit < TICKS_PER_S) {
        board.loop.ticks_since_limit_hit++;
    }
    if (limited && !board.loop.limited && board.loop.ticks_since_limit_hit >= TICKS_PER_S) {
        emit(LIMIT_HIT, LIMIT_OF_INPUT);
        board.loop.ticks_since_limit_hit = 0;
    }
    board.loop.limited = limited;
}

static uint8_t flags(uint16_t i, uint16_t x) {
    uint16_t set = board.loop.mode;

    set |= board.loop.limited ? FLAG_INPUT_SATURATED : 0U;
    set |= x == 0U || x == COUNTS_MAX ? FLAG_POSITION_RANGE : 0U;
    set |= i == COUNTS_MAX ? FLAG_CURRENT_RANGE : 0U;
    set |= board.loop.overrun ? FLAG_OVERRUN : 0U;
    set |= board.loop.host_lost ? FLAG_HOST_LOST : 0U;
    set |= board.loop.fault ? FLAG_FAULT : 0U;
    board.loop.overrun = false;
    return (uint8_t)set;
}

/* One tick, from the counts of current and position to the input converter; the flags of STATE. */
uint8_t loop_run(uint16_t i, uint16_t x) {
    bool limited = false;

    watch_converters(i, x);
    play();
    if (!board.capture.running) { /* in each mode, so that u_c is out at the same time after the readings */
        board.loop.u = law_run(i, x, board.reference.x_ref, &limited);
    }
    if (board.loop.mode != MODE_CLOSED_LOOP) {
        law_reset();
        limited = false;
        board.loop.u = board.loop.mode == MODE_OPEN_LOOP ? board.loop.open_loop_u : 0U;
    }
    if (board.capture.waits) {
        capture_begin();
    } else if (!board.capture.running) {
        output_write(board.loop.u);
    }
    report_limit(limited);
    reference_refill();
    if (output_is_unconfirmed()) { /* these two during another fault, too */
        fail(OUTPUT_FAULT, loop_u());
    }
    if (output_is_bypassed(i)) {
        fail(UNCOMMANDED_CURRENT, i);
    }
    board.output.off = board.output.u == 0U && !board.capture.running;
    return flags(i, x);
}

/* The signal at the coming tick, when u_c of this one is out: from reading to u_c it takes the same time with a signal
 * as without.  Where no time is left, the tick has to compute it. */
void loop_play_ahead(void) {
    if (board.excitation.active && !board.excitation.ahead && hal_has_time(FOR_VALUE)) {
        board.excitation.value = excitation_next();
        board.excitation.ahead = true;
    }
}
