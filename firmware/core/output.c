/* The input converter: what it has confirmed, and the two faults in which the coil may be on although the program wants
 * it off (rule 11).
 *
 * A program cannot switch off what does not listen.  So it tells the host, and writes again at each tick.
 */
#include "core.h"

#define UNCONFIRMED_TICKS 5U /* a disturbed write on a bus, or two, must not drop the ball */
#define UNCOMMANDED_TICKS 100U /* far longer than a coil's current takes to decay */

/* After `b51_board` was cleared.  The output is unknown before the converter confirms: at worst its largest. */
void b51_output_boot(void) {
    b51_board.output.u = B51_COUNTS_MAX;
    b51_output_write(0);
}

/* By the main loop, while no capture is running. */
void b51_output_write(uint16_t u) {
    b51_board.output.unconfirmed = !b51_hal_write_input(u);
    if (!b51_board.output.unconfirmed) {
        b51_board.output.u = u;
    }
}

/* After SET_MODE has cleared a fault: what still lasts is raised again at this tick. */
void b51_output_rearm(void) {
    if (b51_board.output.unconfirmed_ticks == UNCONFIRMED_TICKS) {
        b51_board.output.unconfirmed_ticks--;
    }
    if (b51_board.output.current_ticks == UNCOMMANDED_TICKS) {
        b51_board.output.current_ticks--;
    }
}

/* Counts the ticks in a row, saturating; whether this is the last of `enough`. */
static bool lasts(bool now, B51_STATE_MEMORY uint8_t *ticks, uint8_t enough) B51_ON_STACK {
    if (!now) {
        *ticks = 0;
        return false;
    }
    if (*ticks >= enough) {
        return false;
    }
    (*ticks)++;
    return *ticks == enough;
}

/* Both once per tick, after the write: from the readings to u_c it takes no longer for them. */

bool b51_output_is_unconfirmed(void) {
    bool refused = b51_board.capture.running ? b51_board.capture.refused : false;

    return lasts(b51_board.output.unconfirmed || refused, &b51_board.output.unconfirmed_ticks, UNCONFIRMED_TICKS);
}

bool b51_output_is_bypassed(uint16_t i) {
    return lasts(b51_board.output.off && i >= B51_UNCOMMANDED_CURRENT_COUNTS, &b51_board.output.current_ticks,
                 UNCOMMANDED_TICKS);
}
