/* The input converter: what it has confirmed, and the two faults in which the coil may be on although the program wants
 * it off (rule 11).
 *
 * A program cannot switch off what does not listen.  So it tells the host, and writes again at each tick.
 */
#include "core.h"

#define UNCONFIRMED_TICKS 5U /* a disturbed write on a bus, or two, must not drop the ball */
#define UNCOMMANDED_TICKS 100U /* far longer than a coil's current takes to decay */

/* After `board` was cleared.  What the converter gives is not known before it confirms: at worst all it can. */
void output_boot(void) {
    board.output.u = COUNTS_MAX;
    output_write(0);
}

/* By the main loop, while no capture is running. */
void output_write(uint16_t u) {
    board.output.unconfirmed = !hal_write_input(u);
    if (!board.output.unconfirmed) {
        board.output.u = u;
    }
}

/* After SET_MODE has cleared a fault: what still lasts is raised again at this tick. */
void output_rearm(void) {
    if (board.output.unconfirmed_ticks == UNCONFIRMED_TICKS) {
        board.output.unconfirmed_ticks--;
    }
    if (board.output.current_ticks == UNCOMMANDED_TICKS) {
        board.output.current_ticks--;
    }
}

/* Counts the ticks in a row, saturating; whether this is the last of `enough`. */
static bool lasts(bool now, STATE_MEMORY uint8_t *ticks, uint8_t enough) ON_STACK {
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

bool output_is_unconfirmed(void) {
    bool refused = board.capture.running ? board.capture.refused : false;

    return lasts(board.output.unconfirmed || refused, &board.output.unconfirmed_ticks, UNCONFIRMED_TICKS);
}

bool output_is_bypassed(uint16_t i) {
    return lasts(board.output.off && i >= UNCOMMANDED_CURRENT_COUNTS, &board.output.current_ticks, UNCOMMANDED_TICKS);
}
