/* Start-up, main loop, timers, converters of i_c and x, UART, watchdog and resets. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <stddef.h>

#include "avr.h"

#define RESETS_VALID 0x5AC3U

/* What start-up does not clear: random after power-on, kept by a reset. */
static struct {
    uint16_t valid, resets, check;
    uint8_t flags; /* of the reset, as MCUSR had them */
    bool commanded;
} kept __attribute__((section(".noinit")));

static uint8_t cause;
static uint16_t input_at_power_on;
static volatile uint8_t ticks_due;
static volatile bool woken; /* since the main loop began its turn */
static volatile uint8_t capture_waits; /* interrupts of timer 2 before the next one that counts */
static volatile bool capturing;
static volatile uint8_t rx_ring[B51_RX_RING];
static volatile uint8_t rx_in, rx_out;
static volatile uint8_t tx_ring[B51_TX_RING];
static volatile uint8_t tx_in, tx_out;

/* Where a simulator or debugger finds what it shows. */
extern const __flash uint16_t B51_VIEW[];
const __flash uint16_t B51_VIEW[] __attribute__((used)) = {
    offsetof(struct b51_board, next_tick),           offsetof(struct b51_board, queues.dropped),
    offsetof(struct b51_board, receiver.bad_frames), offsetof(struct b51_board, loop.mode),
    offsetof(struct b51_board, law.sum)};

/* The room of the stack: from the end of the variables to the top of RAM.  Its first bytes are the last that the stack
 * reaches. */
extern uint8_t _end[];

static void paint_stack(void) {
    uint8_t *at = _end;

    while (at < (uint8_t *)SP) {
        *at = B51_STACK_PATTERN;
        at++;
    }
}

/* Before RAM is initialised: the converter of u_c keeps its output through a reset, and the watchdog stays on. */
static void first(void) __attribute__((naked, used, section(".init3")));
static void first(void) {
    kept.flags = MCUSR;
    MCUSR = 0;
    wdt_disable();
    b51_dac_start();
    (void)b51_dac_write(0); /* the core writes again, and tells */
    paint_stack();
}

/* A boot loader may have cleared the flags: then what RAM kept decides. */
static void find_cause(void) {
    bool valid = kept.valid == RESETS_VALID && kept.check == (uint16_t)~kept.resets;

    if (!valid || (kept.flags & ((1 << PORF) | (1 << BORF) | (1 << EXTRF))) != 0) {
        cause = B51_RESET_POWER_ON;
        kept.resets = 0;
    } else {
        cause = kept.commanded ? B51_RESET_COMMANDED : B51_RESET_WATCHDOG;
        kept.resets = (uint16_t)(kept.resets + (kept.resets < UINT16_MAX ? 1U : 0U));
    }
    kept.check = (uint16_t)~kept.resets;
    kept.valid = RESETS_VALID;
    kept.commanded = false;
}

static void start(void) {
    UCSR0A = 1 << U2X0;
    UBRR0 = B51_UBRR_VALUE;
    UCSR0C = (1 << UCSZ01) | (1 << UCSZ00);
    UCSR0B = (1 << RXEN0) | (1 << TXEN0) | (1 << RXCIE0);
    DIDR0 = (1 << B51_ADC_CURRENT) | (1 << B51_ADC_POSITION);
    ADCSRA = (1 << ADEN) | B51_ADC_PRESCALER;
    TCCR2A = 1 << WGM21;
    OCR2A = (uint8_t)(B51_CAPTURE_COUNTS - 1U);
    TCCR2B = 1 << CS22; /* 16 MHz / 64 */
    OCR1A = (uint16_t)(B51_TICK_COUNTS - 1U);
    TIMSK1 = 1 << OCIE1A;
    TCCR1B = (1 << WGM12) | (1 << CS11); /* 16 MHz / 8 */
}

/* Idle until an interrupt has work for the main loop; not at all if one had during the last turn. */
static void rest(void) {
    cli();
    while (!woken) {
        sleep_enable();
        sei(); /* in force after the next instruction, so that no interrupt comes before the sleep */
        sleep_cpu();
        sleep_disable();
        cli();
    }
    woken = false;
    sei();
}

int main(void) {
    find_cause();
    b51_store_load();
    input_at_power_on = b51_dac_store_zero();
    wdt_enable(WDTO_30MS);
    b51_board_boot();
    start();
    sei();
    for (;;) {
        while (b51_board_poll()) {
        }
        rest();
    }
}

/* Time. */

ISR(TIMER1_COMPA_vect) {
    ticks_due = (uint8_t)(ticks_due + (ticks_due < UINT8_MAX ? 1U : 0U));
    woken = true;
}

/* Each tick that was not run in its time is one that took too long. */
bool b51_hal_tick_due(void) {
    uint8_t due;

    cli();
    due = ticks_due;
    ticks_due = 0;
    sei();
    for (; due > 1U; due--) {
        b51_board_late();
    }
    if (due != 0U) {
        b51_store_go_on();
    }
    return due != 0U;
}

/* Counts of timer 1 before its end, with the interrupts of a full line in their time. */
static const __flash uint16_t COUNTS_FOR[B51_WORKS] = {0,         2U * 150U, 2U * 250U, 2U * 550U,
                                                      2U * 300U, 2U * 100U, 2U * 200U};

/* The tick is checked last: if it comes in between, there is no time. */
bool b51_hal_has_time(uint8_t work) {
    return B51_TICK_COUNTS - TCNT1 > COUNTS_FOR[work] && ticks_due == 0U;
}

/* Bytes that come in while a sample is taken must not wait for it, but the next sample must: two would write to one bus.
 * Its flag stays set meanwhile, so it is taken right after this one. */
ISR(TIMER2_COMPA_vect) {
    woken = true;
    if (capture_waits != 0U) {
        capture_waits--;
        return;
    }
    TIMSK2 = 0;
    sei();
    b51_capture_interrupt();
    cli();
    if (capturing) { /* it may have been the last one */
        TIMSK2 = 1 << OCIE2A;
    }
}

void b51_hal_capture_timer(uint16_t us) {
    TIMSK2 = 0;
    capturing = us != 0U;
    if (capturing) {
        capture_waits = (uint8_t)(us / B51_CAPTURE_US - 1U);
        TCNT2 = 0;
        TIFR2 = 1 << OCF2A;
        TIMSK2 = 1 << OCIE2A;
    }
}

bool b51_hal_capture_due(void) {
    return TIMSK2 != 0U && capture_waits == 0U && (TIFR2 & (1 << OCF2A)) != 0;
}

/* Converters. */

/* The capture interrupt converts, too: it waits for a conversion that is under way.  The receiver holds two bytes.  What
 * never ends is the top of the range: a fault after 50 ticks. */
static uint16_t code_of(uint8_t channel) {
    uint8_t flags = SREG;
    uint8_t patience = B51_ADC_PATIENCE;
    uint16_t code;

    cli();
    ADMUX = (uint8_t)(B51_ADC_REFERENCE | channel);
    ADCSRA |= 1 << ADSC;
    while ((ADCSRA & (1 << ADSC)) != 0 && patience != 0U) {
        patience--;
    }
    code = patience != 0U ? ADC : B51_ADC_TOP;
    SREG = flags;
    return code;
}

static uint16_t linear(uint16_t code) {
    return (uint16_t)(code << 2 | code >> 8); /* 0 .. 1023 to 0 .. 4095 */
}

uint16_t b51_hal_read_current(void) {
    return linear(code_of(B51_ADC_CURRENT));
}

#ifdef B51_POSITION_TABLE
static const __flash uint16_t COUNTS[] = {B51_POSITION_TABLE};

uint16_t b51_hal_read_position(void) {
    return b51_between(COUNTS, code_of(B51_ADC_POSITION), 4);
}
#else
uint16_t b51_hal_read_position(void) {
    return linear(code_of(B51_ADC_POSITION));
}
#endif

#ifdef B51_PROFILE
/* What two neighbours differ by, 4095 at most, times 63 needs 32 bits. */
uint16_t b51_between(const __flash uint16_t *table, uint16_t at, uint8_t bits) {
    uint8_t entry = (uint8_t)(at >> bits);
    uint16_t low = table[entry];
    int16_t rise = (int16_t)(table[entry + 1U] - low);
    uint8_t part = (uint8_t)(at & ((1U << bits) - 1U));

    return (uint16_t)(low + (uint16_t)(((int32_t)rise * part) >> bits));
}
#endif

/* UART. */

/* Wakes the main loop at the end of a frame, and where half of the ring is full: a turn for each byte would take a third
 * of T_s. */
ISR(USART_RX_vect) {
    uint8_t byte = UDR0;
    uint8_t at = rx_in;
    uint8_t next = (uint8_t)((at + 1U) % B51_RX_RING);
    uint8_t out = rx_out;

    if (next != out) { /* else it is lost, and its frame's CRC shows it */
        rx_ring[at] = byte;
        rx_in = next;
    }
    if (byte == 0U || (uint8_t)(next - out) % B51_RX_RING >= B51_RX_RING / 2U) {
        woken = true;
    }
}

int16_t b51_hal_receive(void) {
    uint8_t at = rx_out;
    uint8_t byte;

    if (at == rx_in) {
        return -1;
    }
    byte = rx_ring[at];
    rx_out = (uint8_t)((at + 1U) % B51_RX_RING);
    return byte;
}

/* Wakes the main loop for more when half is gone, and at the end: not for each byte. */
ISR(USART_UDRE_vect) {
    uint8_t at = tx_out;
    uint8_t left = (uint8_t)(tx_in - at) % B51_TX_RING;

    if (left == 0U) {
        UCSR0B &= (uint8_t)~(1 << UDRIE0);
    } else {
        UDR0 = tx_ring[at];
        tx_out = (uint8_t)((at + 1U) % B51_TX_RING);
        left--;
    }
    if (left == B51_TX_RING / 2U || left == 0U) {
        woken = true;
    }
}

bool b51_hal_send(uint8_t byte) {
    uint8_t next = (uint8_t)((tx_in + 1U) % B51_TX_RING);

    if (next == tx_out) {
        return false;
    }
    tx_ring[tx_in] = byte;
    tx_in = next;
    UCSR0B |= 1 << UDRIE0;
    return true;
}

/* Watchdog and resets. */

void b51_hal_feed_watchdog(void) {
    wdt_reset();
}

uint8_t b51_hal_reset_cause(void) {
    return cause;
}

uint16_t b51_hal_resets(void) {
    return kept.resets;
}

/* Four bytes: a call and an interrupt at once do not leap over them.  In each tick, so without a loop. */
bool b51_hal_stack_is_intact(void) {
    return _end[0] == B51_STACK_PATTERN && _end[1] == B51_STACK_PATTERN && _end[2] == B51_STACK_PATTERN &&
           _end[3] == B51_STACK_PATTERN;
}

uint16_t b51_hal_stack_free(void) {
    const uint8_t *at = _end;

    while (at < (const uint8_t *)SP && *at == B51_STACK_PATTERN) {
        at++;
    }
    return (uint16_t)(at - _end);
}

uint16_t b51_hal_input_at_power_on(void) {
    return input_at_power_on;
}

/* The chip has no instruction for it: the watchdog does it, 16 ms later.  The ACK leaves meanwhile. */
void b51_hal_restart(void) {
    b51_hal_capture_timer(0);
    (void)b51_dac_write(0);
    kept.commanded = true;
    wdt_enable(WDTO_15MS);
    for (;;) {
    }
}
