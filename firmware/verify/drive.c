/* The core with hardware that does anything: `make sanitize` runs it under the sanitizers.
 *
 *     drive TICKS [SEED]
 *
 * Readings, time left, room on the line, confirmations and settings are random, and so are frames: commands with fields
 * that are in range or not, damaged ones, and noise.
 */
#include <stdio.h>
#include <stdlib.h>

#include "../core/core.h"

#define ROOM 4096U /* bytes under way to the board */

static uint32_t chance = 1;
static uint8_t line[ROOM];
static uint32_t line_in, line_out;
static bool tick_is_due, capture_runs, line_is_slow;

/* 0 .. bound - 1 (xorshift). */
static uint32_t any(uint32_t bound) {
    chance ^= chance << 13;
    chance ^= chance >> 17;
    chance ^= chance << 5;
    return chance % bound;
}

/* A count, often at an end. */
static uint16_t any_count(void) {
    uint32_t kind = any(8);

    return (uint16_t)(kind == 0U ? 0U : kind == 1U ? 4095U : any(4096));
}

uint16_t b51_hal_read_current(void) {
    return any(16) == 0U ? any_count() : (uint16_t)any(600);
}

uint16_t b51_hal_read_position(void) {
    return any(16) == 0U ? any_count() : (uint16_t)(1 + any(4094));
}

bool b51_hal_write_input(uint16_t u) {
    if (u > B51_COUNTS_MAX) {
        abort();
    }
    return any(50) != 0U;
}

bool b51_hal_tick_due(void) {
    bool due = tick_is_due;

    tick_is_due = false;
    return due;
}

bool b51_hal_has_time(uint8_t work) {
    return work == B51_FOR_NOTHING ? any(100) != 0U : any(4) != 0U;
}

void b51_hal_capture_timer(uint16_t us) {
    capture_runs = us != 0U;
}

bool b51_hal_capture_due(void) {
    return any(2) != 0U;
}

int16_t b51_hal_receive(void) {
    return line_out == line_in ? (int16_t)-1 : (int16_t)line[line_out++ % ROOM];
}

bool b51_hal_send(uint8_t byte) {
    (void)byte;
    return any(line_is_slow ? 2 : 40) != 0U;
}

void b51_hal_feed_watchdog(void) {
}

uint8_t b51_hal_reset_cause(void) {
    return (uint8_t)(B51_RESET_POWER_ON + any(3));
}

uint16_t b51_hal_resets(void) {
    return (uint16_t)any(65536);
}

void b51_hal_restart(void) {
    b51_board_boot();
}

bool b51_hal_stack_is_intact(void) {
    return any(2000) != 0U;
}

uint16_t b51_hal_stack_free(void) {
    return (uint16_t)any(65536);
}

uint16_t b51_hal_input_at_power_on(void) {
    return (uint16_t)any(65536);
}

static const struct b51_settings OF_PROGRAM = {
    {B51_LAW_LQI, {17, 14, 11, 19}, {25690, 32576, 21199, -21585}, 1304, 2034, 1756}, {248, 3680, 1751, 14008, 4095}};
static const struct b51_identity IDENTITY_OF_DRIVE = {1, 1, 4, 12, 12, {0}, {B51_FIRMWARE_BUILD}};

const struct b51_identity *b51_hal_identity(void) {
    return &IDENTITY_OF_DRIVE;
}

/* Now and then what no host could have sent. */
const struct b51_settings *b51_hal_settings(void) {
    static struct b51_settings settings;
    uint8_t *at = (uint8_t *)&settings;

    settings = OF_PROGRAM;
    if (any(2) == 0U) {
        at[any((uint32_t)sizeof settings)] = (uint8_t)any(256);
    }
    return &settings;
}

const struct b51_settings *b51_hal_program_settings(void) {
    return &OF_PROGRAM;
}

const uint8_t *b51_hal_calibration(void) {
    static uint8_t bytes[B51_CALIBRATION_SIZE];
    uint8_t n;

    for (n = 0; n < sizeof bytes; n++) {
        bytes[n] = (uint8_t)any(n % 2U == 0U ? 256 : 17);
    }
    return any(2) == 0U ? bytes : 0;
}

void b51_hal_keep_calibration(const uint8_t *bytes) {
    (void)bytes;
}

bool b51_hal_calibration_is_kept(void) {
    return any(2) == 0U;
}

static void put_line(const uint8_t *bytes, uint32_t size) {
    for (; size != 0U && line_in - line_out < ROOM; size--) {
        line[line_in++ % ROOM] = *bytes++;
    }
}

/* A body of the right size most of the time; small numbers and counts are in range most of the time. */
static void put_command(void) {
    static const uint8_t SIZES[] = {6, 2, 3, 4, 21, 18, 2, 10, 4, 4, 5, 2, 2, 2, 10, 2};
    uint8_t body[B51_MAX_BODY];
    uint8_t frame[B51_MAX_BODY + 5U];
    uint8_t type = (uint8_t)any(sizeof SIZES);
    uint8_t size = any(20) == 0U ? (uint8_t)(1 + any(B51_MAX_BODY)) : SIZES[type];
    uint8_t n;

    type = type == B51_RESET - B51_HELLO && any(20) != 0U ? (uint8_t)(B51_EXCITE - B51_HELLO) : type;
    for (n = 0; n < B51_MAX_BODY; n++) {
        body[n] = (uint8_t)(any(3) == 0U ? any(256) : any(n % 2U == 0U ? 8 : 3));
    }
    body[0] = any(50) == 0U ? (uint8_t)any(256) : (uint8_t)(B51_HELLO + type);
    body[1] = (uint8_t)(1 + any(255));
    if (body[0] == B51_HELLO) {
        body[4] = 1;
        body[5] = 1;
    }
    size = b51_frame_encode(body, size, frame);
    if (any(10) == 0U) {
        frame[any(size)] = (uint8_t)any(256);
    }
    put_line(frame, size);
}

int main(int count, char **words) {
    unsigned long ticks = count > 1 ? strtoul(words[1], 0, 10) : 1000UL;
    unsigned long ticks_in[B51_MODE_CLOSED_LOOP + 1] = {0};
    unsigned long n;

    chance = count > 2 ? (uint32_t)strtoul(words[2], 0, 10) | 1U : 1U;
    b51_board_boot();
    for (n = 0; n < ticks; n++) {
        uint32_t turns = 1 + any(12);

        tick_is_due = true;
        line_is_slow = any(500) == 0U ? !line_is_slow : line_is_slow;
        ticks_in[b51_board.loop.mode]++;
        if (any(3) == 0U) {
            put_command();
        }
        if (any(100) == 0U) {
            uint8_t noise = (uint8_t)any(256);
            put_line(&noise, 1);
        }
        for (; turns != 0U; turns--) {
            (void)b51_board_poll();
            if (capture_runs && any(2) == 0U) {
                b51_capture_interrupt();
            }
        }
    }
    printf("ticks: idle %lu, open loop %lu, closed loop %lu\n", ticks_in[0], ticks_in[1], ticks_in[2]);
    return 0;
}
