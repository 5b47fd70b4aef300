/* The core on a computer: its hardware is what the caller gives and takes.
 *
 * A board lies in memory of the caller, `posix_size()` bytes aligned as for uint64_t.  The core has one board; the one
 * that is called last is in it, the others are kept in their own memory.  So one thread at a time may call.
 *
 * The caller moves time:  b51_posix_pass (until a capture interrupt is due: b51_posix_capture), then b51_posix_tick each
 * T_s.
 */
#ifndef B51_POSIX_H
#define B51_POSIX_H

#include "../core/core.h"

#define B51_WATCHDOG_TICKS (UINT32_C(50000) / B51_TICK_US)
#define B51_BOOT_TICKS (UINT32_C(10000) / B51_TICK_US) /* from a reset to tick 0 */

enum { B51_OUTPUT_DEAF = 1, B51_OUTPUT_STUCK }; /* the converter does not confirm; it does, and keeps its output */

/* The values that the caller may read between two calls; they begin the board's memory. */
struct b51_posix_view {
    uint32_t next_tick, dropped, allowance;
    int32_t sum, capture_wait_us; /* until the capture interrupt is due; -1: none */
    uint16_t u, bad_frames;
    uint8_t mode;
    bool running; /* neither booting nor hanging */
    bool written; /* the converter of u_c was written during the last call of b51_posix_feed */
};

struct b51_posix_board {
    struct b51_posix_view view;
    struct b51_board state;
    struct b51_identity identity;
    struct b51_settings settings, settings_of_program;
    uint8_t calibration[B51_CALIBRATION_SIZE];
    const uint8_t *received;
    uint32_t received_count;
    uint8_t *sent;
    uint32_t dropped; /* before the last reset */
    uint16_t i, x, u;
    uint16_t resets;
    uint8_t cause, hung_ticks, dead_ticks, room, sent_count, delimiters;
    bool tick_due, restart, stack_broken, calibration_is_kept;
    uint8_t output_fault; /* OUTPUT_DEAF, OUTPUT_STUCK, or 0 */
};

uint32_t b51_posix_size(void);
void b51_posix_open(struct b51_posix_board *to, const struct b51_identity *identity,
                    const struct b51_settings *settings);
void b51_posix_close(const struct b51_posix_board *to);
void b51_posix_reset(struct b51_posix_board *to, uint8_t cause);
void b51_posix_hang(struct b51_posix_board *to);
void b51_posix_late(struct b51_posix_board *to);
void b51_posix_break_stack(struct b51_posix_board *to);
void b51_posix_fail_output(struct b51_posix_board *to, uint8_t fault);
void b51_posix_store(struct b51_posix_board *to, const struct b51_settings *settings);
void b51_posix_feed(struct b51_posix_board *to, const uint8_t *data, uint32_t count);
void b51_posix_pass(struct b51_posix_board *to, uint16_t us);
void b51_posix_capture(struct b51_posix_board *to, uint16_t i);
void b51_posix_tick(struct b51_posix_board *to, uint16_t i, uint16_t x, bool lose_state);
uint8_t b51_posix_take(struct b51_posix_board *to, uint8_t *data, uint8_t room);
void b51_posix_set_tick(struct b51_posix_board *to, uint32_t next_tick);

#endif
