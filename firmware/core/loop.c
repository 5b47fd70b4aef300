/* The control loop between two converters: rules 6 to 9, 11, and the board's half of 12 and 13. */
#include "core.h"

#define OVER_CURRENT_TICKS 50U
#define SENSOR_FAULT_TICKS 500U
#define LIMIT_OF_INPUT 0U /* detail of LIMIT_HIT */

/* After `b51_board` was cleared and the settings are in force. */
void b51_loop_boot(void) {
    b51_board.loop.ticks_since_limit_hit = B51_TICKS_PER_S;
    b51_reference_boot(b51_board.law.gains.x_0);
}

/* The count of the input converter, as far as it has confirmed it. */
uint16_t b51_loop_u(void) {
    return b51_board.capture.running ? b51_capture_u() : b51_board.output.u;
}

/* As SET_MODE does: the mode in force is not entered again, but idle ends a capture in any case. */
void b51_loop_set_mode(uint8_t mode) {
    if (mode == B51_MODE_IDLE && b51_board.capture.running) {
        b51_capture_cancel();
    }
    if (mode == b51_board.loop.mode) {
        return;
    }
    b51_loop_end_excitation();
    b51_board.loop.mode = mode;
    b51_board.loop.open_loop_u = 0;
    b51_board.loop.limited = false;
    b51_board.loop.sensor_ticks = 0;
    b51_law_reset();
    b51_emit(B51_MODE_CHANGED, mode);
}

/* At once, not at the next tick. */
void b51_loop_switch_off(void) {
    b51_loop_set_mode(B51_MODE_IDLE);
    b51_output_write(0);
}

/* The signal stays at its offset. */
void b51_loop_end_excitation(void) {
    if (!b51_board.excitation.active) {
        return;
    }
    if (b51_board.excitation.signal.target == B51_TARGET_X_REF) {
        b51_board.reference.x_ref = b51_board.excitation.signal.offset;
    } else {
        b51_board.loop.open_loop_u = b51_board.excitation.signal.offset;
    }
    b51_board.excitation.active = false;
}

/* A reference that was checked; it ends an excitation of the reference. */
void b51_loop_set_reference(uint16_t x_ref) {
    if (b51_board.excitation.active && b51_board.excitation.signal.target == B51_TARGET_X_REF) {
        b51_board.excitation.active = false;
    }
    b51_reference_jump(x_ref);
}

static void fail(uint8_t code, uint16_t count) {
    b51_emit(code, count);
    b51_board.loop.fault = true;
    b51_loop_switch_off();
}

static void watch(uint16_t i, uint16_t x) {
    bool clipped = b51_board.loop.mode == B51_MODE_CLOSED_LOOP && (x == 0U || x == B51_COUNTS_MAX);

    if (i != B51_COUNTS_MAX) {
        b51_board.loop.over_current_ticks = 0;
    } else if (b51_board.loop.over_current_ticks < OVER_CURRENT_TICKS) {
        b51_board.loop.over_current_ticks++;
    }
    if (!clipped) {
        b51_board.loop.sensor_ticks = 0;
    } else if (b51_board.loop.sensor_ticks < SENSOR_FAULT_TICKS) {
        b51_board.loop.sensor_ticks++;
    }
    if (b51_board.loop.fault) {
        return;
    }
    if (!b51_hal_stack_is_intact()) { /* no command mends it: again after each SET_MODE, until a reset */
        fail(B51_STACK_FAULT, 0);
    } else if (b51_board.loop.over_current_ticks >= OVER_CURRENT_TICKS) {
        fail(B51_OVER_CURRENT, i);
    } else if (b51_board.loop.sensor_ticks >= SENSOR_FAULT_TICKS) {
        fail(B51_SENSOR_FAULT, x);
    }
}

static void play(void) {
    uint16_t value;

    if (!b51_board.excitation.active) {
        return;
    }
    value = b51_board.excitation.ahead ? b51_board.excitation.value : b51_excitation_next();
    b51_board.excitation.ahead = false;
    if (b51_excitation_over() && !b51_board.excitation.announced) {
        b51_board.excitation.announced = true;
        b51_emit(B51_EXCITATION_DONE, 0);
    }
    if (b51_board.excitation.signal.target == B51_TARGET_X_REF) {
        b51_board.reference.x_ref = value;
    } else {
        b51_board.loop.open_loop_u = value;
    }
}

static void report_limit(bool limited) {
    if (b51_board.loop.ticks_since_limit_hit < B51_TICKS_PER_S) {
        b51_board.loop.ticks_since_limit_hit++;
    }
    if (limited && !b51_board.loop.limited && b51_board.loop.ticks_since_limit_hit >= B51_TICKS_PER_S) {
        b51_emit(B51_LIMIT_HIT, LIMIT_OF_INPUT);
        b51_board.loop.ticks_since_limit_hit = 0;
    }
    b51_board.loop.limited = limited;
}

static uint8_t flags(uint16_t i, uint16_t x) {
    uint16_t set = b51_board.loop.mode;

    set |= b51_board.loop.limited ? B51_FLAG_INPUT_SATURATED : 0U;
    set |= x == 0U || x == B51_COUNTS_MAX ? B51_FLAG_POSITION_RANGE : 0U;
    set |= i == B51_COUNTS_MAX ? B51_FLAG_CURRENT_RANGE : 0U;
    set |= b51_board.loop.overrun ? B51_FLAG_OVERRUN : 0U;
    set |= b51_board.loop.host_lost ? B51_FLAG_HOST_LOST : 0U;
    set |= b51_board.loop.fault ? B51_FLAG_FAULT : 0U;
    b51_board.loop.overrun = false;
    return (uint8_t)set;
}

/* One tick, from the counts of current and position to the input converter; the flags of STATE. */
uint8_t b51_loop_run(uint16_t i, uint16_t x) {
    bool limited = false;

    watch(i, x);
    play();
    if (!b51_board.capture.running) { /* in each mode, so that u_c is out at the same time after the readings */
        b51_board.loop.u = b51_law_run(i, x, b51_board.reference.x_ref, &limited);
    }
    if (b51_board.loop.mode != B51_MODE_CLOSED_LOOP) {
        b51_law_reset();
        limited = false;
        b51_board.loop.u = b51_board.loop.mode == B51_MODE_OPEN_LOOP ? b51_board.loop.open_loop_u : 0U;
    }
    if (b51_board.capture.waits) {
        b51_capture_begin();
    } else if (!b51_board.capture.running) {
        b51_output_write(b51_board.loop.u);
    }
    report_limit(limited);
    b51_reference_refill();
    if (b51_output_is_unconfirmed()) { /* these two during another fault, too */
        fail(B51_OUTPUT_FAULT, b51_loop_u());
    }
    if (b51_output_is_bypassed(i)) {
        fail(B51_UNCOMMANDED_CURRENT, i);
    }
    b51_board.output.off = b51_board.output.u == 0U && !b51_board.capture.running;
    return flags(i, x);
}

/* The signal at the coming tick, when u_c of this one is out: from reading to u_c it takes the same time with a signal
 * as without.  Where no time is left, the tick has to compute it. */
void b51_loop_play_ahead(void) {
    if (b51_board.excitation.active && !b51_board.excitation.ahead && b51_hal_has_time(B51_FOR_VALUE)) {
        b51_board.excitation.value = b51_excitation_next();
        b51_board.excitation.ahead = true;
    }
}
