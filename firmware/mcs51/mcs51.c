/* hal.h on an ADuC841, and what runs before and in place of an operating system.
 *
 * The capture interrupt may come in the middle of anything.  So what it calls keeps nothing at fixed addresses: one
 * argument in registers, locals on the stack, no product and no quotient.  tests/firmware/test_mcs51_image.py looks.
 */
#include "part.h"

#define RECEIVED 64U /* bytes, powers of 2: 5.5 ms of a line without a gap */
#define SENT 16U
#define KEPT_VALID 0xB51AU
B51_STATIC_ASSERT(b51_a_ring_is_a_power_of_two, (RECEIVED & (RECEIVED - 1U)) == 0U && (SENT & (SENT - 1U)) == 0U);
B51_STATIC_ASSERT(b51_a_ring_is_counted_in_8_bits, RECEIVED <= 256U && SENT <= 256U);

static volatile uint8_t ticks_due;
static volatile uint8_t until_tick; /* interrupts of the timer */
static volatile uint16_t capture_us; /* until the next sample, at an interrupt; 0: none */
static volatile uint8_t received_in, received_out, sent_in, sent_out;
static volatile __bit sending;
static __xdata uint8_t received[RECEIVED], sent[SENT];

/* What outlives a reset. */
static __xdata __at(B51_XRAM_KEPT) struct {
    uint16_t valid, resets, check;
    uint8_t cause, why; /* of this start, and of the watchdog's next reset */
} kept;
B51_STATIC_ASSERT(b51_what_is_kept_has_its_room, sizeof kept <= 8U && B51_XRAM_KEPT + 8U <= 0x800U);
enum { BY_A_FAULT, BY_COMMAND, BY_THE_SUPPLY };

/* What the board is, as it lies in the data memory: with a CRC over it as over a frame. */
static __xdata union {
    struct {
        struct b51_identity identity;
        struct b51_settings settings;
        uint8_t crc[2];
    } is;
    uint8_t bytes[72];
} memory;
#define MEMORY_SIZE sizeof memory.is
B51_STATIC_ASSERT(b51_whole_pages_hold_the_memory,
                  MEMORY_SIZE <= sizeof memory.bytes && sizeof memory.bytes % 4U == 0U);
B51_STATIC_ASSERT(b51_the_identity_is_not_padded, sizeof(struct b51_identity) == 40U);
B51_STATIC_ASSERT(b51_the_settings_are_not_padded, sizeof(struct b51_settings) == 29U);

/* Where nothing valid was programmed: the emulated rig's scalings, gains and limits (gateway/emulator/firmware_model). */
static const __code struct b51_identity IDENTITY_OF_PROGRAM = {
    0, 1, 4, 12, 12,
    {0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x3A, 0x7C, 0x1C, 0x64, 0xB8, 0x30, 0xA0, 0xBF, 0x35,
     0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0xA0, 0x3A},
    {B51_FIRMWARE_BUILD}};
static const __code struct b51_settings SETTINGS_OF_PROGRAM = {
    {B51_LAW_LQI, {17, 14, 11, 19}, {25690, 32576, 21199, -21585}, 1304, 2034, 1756}, {248, 3680, 1751, 14008, 4095}};

/* 12 bits of a channel; the top of the range where the converter does not answer, which is a fault after 50 ticks. */
static uint16_t convert(uint8_t channel) __critical __reentrant {
    uint8_t patience = B51_ADC_PATIENCE;

    ADCCON2 = channel;
    SCONV = 1;
    while (SCONV) {
        if (--patience == 0U) {
            return B51_COUNTS_MAX;
        }
    }
    return (uint16_t)((uint16_t)(ADCDATAH & 0x0FU) << 8 | ADCDATAL);
}

uint16_t b51_hal_read_current(void) {
    return convert(B51_CHANNEL_CURRENT);
}

uint16_t b51_hal_read_position(void) {
    return convert(B51_CHANNEL_POSITION);
}

/* The converter is on the chip: there is no bus that could lose the write, and nothing that could acknowledge it.  What
 * its pin drives is seen by i_c alone. */
bool b51_hal_write_input(uint16_t u) {
    DAC0H = (uint8_t)(u >> 8);
    DAC0L = (uint8_t)u;
    return true;
}

/* Each tick that was not run in its time is one that took too long.  The compiler reads, subtracts and writes in three
 * instructions, so the interrupt that counts is kept out meanwhile. */
bool b51_hal_tick_due(void) {
    uint8_t due;

    if (ticks_due == 0U) {
        return false;
    }
    EA = 0;
    due = ticks_due;
    ticks_due = 0;
    EA = 1;
    for (; due > 1U; due--) {
        b51_board_late();
    }
    return true;
}

/* What `until_tick` has to be above: interrupts of the timer, with those of a full line in their time. */
static const __code uint8_t PARTS_FOR[B51_WORKS] = {
    0, B51_PARTS(300), B51_PARTS(800), B51_PARTS(1000), B51_PARTS(650), B51_PARTS(200), B51_PARTS(500)};

/* The tick is checked last: if it comes in between, there is no time. */
bool b51_hal_has_time(uint8_t work) {
    return until_tick > PARTS_FOR[work] && ticks_due == 0U;
}

void b51_hal_capture_timer(uint16_t us) {
    ET2 = 0; /* two bytes; an interrupt that comes now is served then */
    capture_us = us;
    ET2 = 1;
}

/* Two bytes, and an interrupt that is served between two looks would change both. */
bool b51_hal_capture_due(void) __critical {
    return TF2 && capture_us != 0U && capture_us <= B51_CAPTURE_US;
}

int16_t b51_hal_receive(void) {
    uint8_t byte;

    if (received_out == received_in) {
        return -1;
    }
    byte = received[received_out];
    received_out = (uint8_t)(received_out + 1U) & (RECEIVED - 1U);
    return byte;
}

bool b51_hal_send(uint8_t byte) {
    uint8_t next = (uint8_t)(sent_in + 1U) & (SENT - 1U);

    if (next == sent_out) {
        return false;
    }
    sent[sent_in] = byte;
    sent_in = next;
    if (!sending) {
        sending = 1;
        TI = 1; /* the interrupt takes the first byte as it takes all others */
    }
    return true;
}

static void reset_by_watchdog(uint8_t why) {
    kept.why = why;
    EA = 0;
    WDWR = 1;
    WDCON = B51_WDCON_NOW;
    for (;;) {
    }
}

/* Where the supply is too low, the program may go wrong at any instruction: it is left while it can still be. */
void b51_hal_feed_watchdog(void) {
    if ((PSMCON & CMPD) == 0U) {
        (void)b51_hal_write_input(0);
        reset_by_watchdog(BY_THE_SUPPLY);
    }
    EA = 0;
    WDWR = 1;
    WDCON = B51_WDCON_ON;
    EA = 1;
}

uint8_t b51_hal_reset_cause(void) {
    return kept.cause;
}

uint16_t b51_hal_resets(void) {
    return kept.resets;
}

/* By the watchdog: its time is also how long the line has for the bytes that it was given. */
void b51_hal_restart(void) {
    while (sending) {
    }
    reset_by_watchdog(BY_COMMAND);
}

const struct b51_identity *b51_hal_identity(void) {
    return &memory.is.identity;
}

const struct b51_settings *b51_hal_settings(void) {
    return &memory.is.settings;
}

const struct b51_settings *b51_hal_program_settings(void) {
    memory.is.settings = SETTINGS_OF_PROGRAM;
    return &memory.is.settings;
}

/* The stack grows up, from behind the variables to the end of internal RAM.  sdcc has no name for its pointer but SP. */
static void paint_stack(void) {
    __idata uint8_t *at = (__idata uint8_t *)(uint8_t)(SP + 1U);

    do {
        *at = B51_STACK_PATTERN;
    } while (at++ != (__idata uint8_t *)B51_STACK_END);
}

bool b51_hal_stack_is_intact(void) {
    __idata uint8_t *at = (__idata uint8_t *)B51_STACK_END;

    while (*at == B51_STACK_PATTERN) {
        if (at == (__idata uint8_t *)(B51_STACK_END + 1U - B51_STACK_CANARY)) {
            return true;
        }
        at--;
    }
    return false;
}

uint16_t b51_hal_stack_free(void) {
    __idata uint8_t *at = (__idata uint8_t *)B51_STACK_END;

    while ((uint8_t)at > SP && *at == B51_STACK_PATTERN) {
        at--;
    }
    return (uint8_t)(B51_STACK_END - (uint8_t)at);
}

uint16_t b51_hal_input_at_power_on(void) {
    return UINT16_MAX;
}

/* To write the data memory stops the chip for 2 ms a page, and the line brings 23 bytes meanwhile: a calibration is not
 * kept. */
const __xdata uint8_t *b51_hal_calibration(void) {
    return 0;
}

void b51_hal_keep_calibration(const __xdata uint8_t *bytes) {
    (void)bytes;
}

bool b51_hal_calibration_is_kept(void) {
    return false;
}

static void read_memory(void) {
    uint8_t page;
    uint8_t *to = memory.bytes;

    EADRH = 0;
    for (page = 0; page < sizeof memory.bytes / 4U; page++) {
        EADRL = page;
        ECON = B51_ECON_READ_PAGE;
        *to++ = EDATA1;
        *to++ = EDATA2;
        *to++ = EDATA3;
        *to++ = EDATA4;
    }
    if (b51_crc_of(memory.bytes, MEMORY_SIZE) != 0U) {
        memory.is.identity = IDENTITY_OF_PROGRAM;
        (void)b51_hal_program_settings();
    }
    for (page = 0; page < sizeof IDENTITY_OF_PROGRAM.build; page++) { /* the data memory may be older than the program */
        memory.is.identity.build[page] = IDENTITY_OF_PROGRAM.build[page];
    }
    memory.is.identity.firmware_major = IDENTITY_OF_PROGRAM.firmware_major;
    memory.is.identity.firmware_minor = IDENTITY_OF_PROGRAM.firmware_minor;
}

/* The interrupts.  That of the line has registers of its own and calls nothing. */

void b51_on_time(void) __interrupt(5) {
    TF2 = 0;
    if (--until_tick == 0U) {
        until_tick = B51_TICK_PARTS;
        ticks_due++;
    }
    if (capture_us > B51_CAPTURE_US) {
        capture_us -= B51_CAPTURE_US;
    } else if (capture_us != 0U) {
        capture_us = B51_CAPTURE_US;
        b51_capture_interrupt();
    }
}

void b51_on_line(void) __interrupt(4) __using(1) {
    if (RI) {
        RI = 0;
        received[received_in] = SBUF; /* a ring that runs over is a bad frame or two */
        received_in = (uint8_t)(received_in + 1U) & (RECEIVED - 1U);
    }
    if (TI) {
        TI = 0;
        if (sent_out == sent_in) {
            sending = 0;
        } else {
            SBUF = sent[sent_out];
            sent_out = (uint8_t)(sent_out + 1U) & (SENT - 1U);
        }
    }
}

/* WDS tells the watchdog from power and from the pin of the reset.  What XRAM holds after power-on is random: 48 bits of
 * it are not what the program left there. */
static void find_cause(void) {
    bool valid = kept.valid == KEPT_VALID && kept.check == (uint16_t)~kept.resets;

    if (!WDS || (valid && kept.why == BY_THE_SUPPLY)) {
        kept.cause = B51_RESET_POWER_ON;
        kept.resets = 0;
    } else {
        kept.cause = valid && kept.why == BY_COMMAND ? B51_RESET_COMMANDED : B51_RESET_WATCHDOG;
        kept.resets = valid ? kept.resets : 0U;
        kept.resets += kept.resets < UINT16_MAX ? 1U : 0U;
    }
    kept.check = (uint16_t)~kept.resets;
    kept.valid = KEPT_VALID;
    kept.why = BY_A_FAULT;
}

/* Called by start-up before it clears the memory: 0 to the converter first, then what the clearing itself needs. */
unsigned char _sdcc_external_startup(void) {
    DAC0H = 0;
    DAC0L = 0;
    DACCON = B51_DACCON_ON;
    CFG841 = XRAMEN;
    PSMCON = B51_PSMCON_ON;
    while ((PSMCON & CMPD) == 0U) { /* the watchdog is off */
    }
    find_cause();
    WDWR = 1;
    WDCON = B51_WDCON_ON; /* and WDS is 0 */
    return 0;
}

void main(void) {
    ADCCON1 = B51_ADCCON1_ON;
    T3FD = B51_FRACTION;
    T3CON = B51_T3CON_BAUD;
    SCON = B51_SCON_8N1;
    RCAP2L = (uint8_t)B51_TIMER_RELOAD;
    RCAP2H = (uint8_t)(B51_TIMER_RELOAD >> 8);
    PT2 = 1; /* a capture's sample comes before everything else */
    until_tick = B51_TICK_PARTS;
    paint_stack();
    read_memory();
    b51_board_boot();
    ES = 1;
    TR2 = 1;
    EA = 1;
    for (;;) {
        (void)b51_board_poll();
    }
}

/* Where a simulator or a debugger finds what it shows: the order is that of firmware/sim/mcs51/board.py. */
const void __xdata *const __code B51_WATCHED[] = {
    &b51_board.loop.mode,      &b51_board.queues.dropped,      &b51_board.receiver.bad_frames, &b51_board.law.sum,
    &b51_board.reference.allowance, &b51_board.next_tick,
};
