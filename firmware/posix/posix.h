/* The core on a computer: its hardware is what the caller gives and takes.
 *
 * A board lies in memory of the caller, `posix_size()` bytes aligned as for uint64_t.  The core has one board; the one
 * that is called last is in it, the others are kept in their own memory.  So one thread at a time may call.
 *
 * The caller moves time:  posix_pass (until a capture interrupt is due: posix_capture), then posix_tick each T_s.
 */
#ifndef BOARD51_POSIX_H
#define BOARD51_POSIX_H

#include "../core/core.h"

#define WATCHDOG_TICKS (UINT32_C(50000) / TICK_US)
#define BOOT_TICKS (UINT32_C(10000) / TICK_US) /* from a reset to tick 0 */

enum { OUTPUT_DEAF = 1, OUTPUT_STUCK }; /* the converter does not confirm; it does, and keeps its output */

/* What the caller may look at between two calls; it begins the board's memory. */
struct posix_view {
    uint32_t next_tick, dropped, allowance;
    int32_t sum, capture_wait_us; /* until the capture interrupt is due; -1: none */
    uint16_t u, bad_frames;
    uint8_t mode;
    bool running; /* neither booting nor hanging */
    bool written; /* the converter of u_c was written during the last call of posix_feed */
};

struct posix_board {
    struct posix_view view;
    struct board state;
    struct identity identity;
    struct settings settings, settings_of_program;
    const uint8_t *received;
    uint32_t received_count;
    uint8_t *sent;
    uint32_t dropped; /* before the last reset */
    uint16_t i, x, u;
    uint16_t resets;
    uint8_t cause, hung_ticks, dead_ticks, room, sent_count, delimiters;
    bool tick_due, restart;
    uint8_t output_fault; /* OUTPUT_DEAF, OUTPUT_STUCK, or 0 */
};

uint32_t posix_size(void);
void posix_open(struct posix_board *to, const struct identity *identity, const struct settings *settings);
void posix_close(const struct posix_board *to);
void posix_reset(struct posix_board *to, uint8_t cause);
void posix_hang(struct posix_board *to);
void posix_late(struct posix_board *to);
void posix_fail_output(struct posix_board *to, uint8_t fault);
void posix_store(struct posix_board *to, const struct settings *settings);
void posix_feed(struct posix_board *to, const uint8_t *data, uint32_t count);
void posix_pass(struct posix_board *to, uint16_t us);
void posix_capture(struct posix_board *to, uint16_t i);
void posix_tick(struct posix_board *to, uint16_t i, uint16_t x, bool lose_state);
uint8_t posix_take(struct posix_board *to, uint8_t *data, uint8_t room);
void posix_set_tick(struct posix_board *to, uint32_t next_tick);

#endif
