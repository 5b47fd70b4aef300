/* A host, a rig and a line out of one generator of numbers, for the core on any processor: what it did is one number.
 *
 * Compiled for this machine and for a chip, in whose simulator it runs: the numbers must be the same.  On a chip `int`
 * has 16 bits, and a shift or a product that only fits 32 shows here.
 */
#include <string.h>

#include "core.h"

#ifndef TICKS
#define TICKS 2000U
#endif

#if defined(__AVR__)
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>

static void print(char c) {
    UCSR0B = 1 << TXEN0;
    while ((UCSR0A & (1 << UDRE0)) == 0) {
    }
    UDR0 = (uint8_t)c;
}

static void end(void) { /* what ends simavr */
    cli();
    sleep_mode();
}
#else
#include <stdio.h>

static void print(char c) {
    (void)putchar(c);
}

static void end(void) {
}
#endif

static uint32_t hash = UINT32_C(2166136261);
static uint32_t seed = UINT32_C(20240611);
static uint8_t incoming[MAX_BODY + 5U];
static uint8_t incoming_count, incoming_at;
static uint16_t i_count = 1300, x_count = 2000, capture_us, resets;
static uint8_t cause = RESET_POWER_ON, id;
static bool armed, due, restart;
static uint32_t sent;

static void note(uint8_t byte) { /* FNV-1a */
    hash = (hash ^ byte) * UINT32_C(16777619);
}

static uint16_t number(uint16_t low, uint16_t high) {
    seed = seed * UINT32_C(1664525) + UINT32_C(1013904223);
    return (uint16_t)(low + (seed >> 16) % ((uint32_t)high - low + 1U));
}

uint16_t hal_read_current(void) {
    uint16_t chance = number(0, 999);

    i_count = (uint16_t)(i_count + number(0, 40));
    i_count = i_count < 100U ? 100U : i_count > 4000U ? 3000U : (uint16_t)(i_count - 20U);
    return chance < 3U ? (uint16_t)COUNTS_MAX : i_count;
}

uint16_t hal_read_position(void) {
    x_count = (uint16_t)(x_count + number(0, 60));
    x_count = x_count < 100U ? 100U : x_count > 4000U ? 3000U : (uint16_t)(x_count - 30U);
    return x_count;
}

bool hal_write_input(uint16_t u) {
    static uint8_t deaf; /* writes that it will not confirm */

    note((uint8_t)u);
    note((uint8_t)(u >> 8));
    if (number(0, 199) == 0U) {
        deaf = (uint8_t)number(1, 12);
    }
    deaf = (uint8_t)(deaf - (deaf != 0U ? 1U : 0U));
    return deaf == 0U;
}

bool hal_tick_due(void) {
    bool now = due;

    due = false;
    return now;
}

void hal_capture_timer(uint16_t us) {
    armed = us != 0U;
    capture_us = us;
}

bool hal_capture_due(void) {
    return armed && capture_us == 0U;
}

bool hal_receive(uint8_t *byte) {
    if (incoming_at == incoming_count) {
        return false;
    }
    *byte = incoming[incoming_at++];
    return true;
}

bool hal_send(uint8_t byte) {
    if (number(0, 15) == 0U) {
        return false; /* full, now and then in the middle of a frame */
    }
    note(byte);
    sent++;
    return true;
}

void hal_feed_watchdog(void) {
}

uint8_t hal_reset_cause(void) {
    return cause;
}

uint16_t hal_resets(void) {
    return resets;
}

void hal_restart(void) {
    restart = true;
}

const struct identity *hal_identity(void) {
    static const struct identity IDENTITY_OF_TEST = {51, 1, 0, 12, 12, {1, 2, 3, 4, 5, 6, 7, 8}, {'c', 'h', 'i', 'p'}};

    return &IDENTITY_OF_TEST;
}

const struct settings *hal_settings(void) {
    static const struct settings SETTINGS = {
        {LAW_LQI, {16, 14, 11, 21}, {12844, 32492, 21147, -21527}, 1304, 2034, 1756}, {248, 3680, 1751, 14008, 4000}};

    return &SETTINGS;
}

const struct settings *hal_program_settings(void) {
    return hal_settings();
}

/* One field: a number each, in an order that C fixes. */
static uint8_t *field(uint8_t *at, uint16_t low, uint16_t high) {
    return put_u16(at, number(low, high));
}

static void put_gains(uint8_t *at) {
    uint8_t n;

    for (n = 0; n < 4U; n++) {
        uint16_t mantissa = number(0, 0x7FFF);
        at = put_u16(at, number(0, 3) != 0U ? mantissa : (uint16_t)(0U - mantissa));
        *at++ = (uint8_t)number(0, 30);
    }
    for (n = 0; n < 3U; n++) {
        at = field(at, 0, COUNTS_MAX);
    }
}

/* A command, most of the time one that can be executed. */
static uint8_t compose(uint8_t *body) {
    static const uint8_t SIZES[] = {6, 2, 3, 4, 21, 18, 2, 10, 4, 4, 5, 2, 2};
    uint8_t type = (uint8_t)number(HELLO, RESET);
    uint8_t *at;
    uint8_t n;

    if (type == RESET && number(0, 9) != 0U) {
        type = EXCITE;
    }
    body[0] = type;
    body[1] = number(0, 9) == 0U ? id : ++id;
    for (n = 2; n < MAX_BODY; n++) {
        body[n] = (uint8_t)number(0, 255);
    }
    if (number(0, 19) == 0U) { /* anything */
        return (uint8_t)number(1, MAX_BODY);
    }
    switch (type) {
        case HELLO:
            (void)field(body + 2, 7, 8);
            body[4] = body[5] = 1;
            break;
        case SET_MODE:
            body[2] = (uint8_t)number(0, 2);
            break;
        case SET_REFERENCE:
            (void)field(body + 2, 200, 3700);
            break;
        case SET_GAINS:
            body[2] = (uint8_t)number(0, 1);
            put_gains(body + 3);
            break;
        case EXCITE:
            body[2] = (uint8_t)number(0, 6);
            body[3] = (uint8_t)(board.loop.mode == MODE_CLOSED_LOOP ? TARGET_X_REF : TARGET_U);
            (void)put_u16(body + 4, (uint16_t)(number(0, 1800) - 900U));
            at = field(body + 6, 1200, 2600);
            at = field(at, 1, 300);
            at = field(at, 1, 300);
            at = field(at, 1, 65535);
            (void)put_u32(at, number(0, 200));
            break;
        case CAPTURE:
            at = field(body + 2, 0, 4000);
            at = field(at, 0, 4095);
            at = field(at, 0, 150);
            (void)field(at, 1, 200);
            break;
        case READ_CAPTURE:
            (void)field(body + 2, 0, 150);
            break;
        case SET_STREAM:
            (void)field(body + 2, 0, 5);
            break;
        case SET_HOST_LOSS:
            body[2] = (uint8_t)number(0, 2);
            (void)field(body + 3, 50, 300);
            break;
        default:
            break;
    }
    return SIZES[type - 1U];
}

static void pass_time(void) { /* T_s, and the captures in it */
    uint16_t us;

    for (us = 0; us < TICK_US; us = (uint16_t)(us + 20U)) {
        if (armed && capture_us == 0U) {
            capture_us = CAPTURE_US;
            capture_interrupt();
            board_poll();
        }
        capture_us = (uint16_t)(capture_us - (armed ? 20U : 0U));
    }
}

static void print_hex(uint32_t value) {
    uint8_t n;

    for (n = 0; n < 8U; n++) {
        print("0123456789abcdef"[value >> 28]);
        value <<= 4;
    }
    print(' ');
}

int main(void) {
    uint8_t body[MAX_BODY];
    uint16_t n;
    uint8_t turns;

    board_boot();
    for (n = 0; n < TICKS; n++) {
        if (number(0, 3) == 0U) {
            incoming_count = frame_encode(body, compose(body), incoming);
            incoming_at = 0;
            if (number(0, 40) == 0U) {
                incoming[number(0, 6)] ^= 4U; /* damage */
            }
        }
        pass_time();
        due = true;
        for (turns = 0; turns < 6U; turns++) {
            board_poll();
        }
        if (restart) {
            restart = false;
            cause = RESET_COMMANDED;
            resets++;
            board_boot();
        }
        if (number(0, 999) == 0U) {
            board_late();
        }
    }
    print_hex(hash);
    print_hex(sent);
    print_hex(board.next_tick);
    print_hex(resets);
    print('\n');
    end();
    return 0;
}
