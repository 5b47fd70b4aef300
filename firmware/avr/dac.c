/* The converter of u_c: an MCP4725 at the two-wire interface. */
#include <avr/io.h>
#include <util/twi.h>

#include "avr.h"

/* Ends what the converter is in the middle of.  After a reset in its acknowledge it holds SDA until SCL falls, and no
 * start condition is possible.  So SCL falls until SDA is high, nine times at most (a byte and its acknowledge), then a
 * stop condition.  The interface is off meanwhile: the bits of DDRC pull the lines low, as PORTC is 0. */
static void free_bus(void) {
    uint8_t clocks = 9;

    TWCR = 0;
    for (; (PINC & B51_TWI_SDA) == 0 && clocks != 0U; clocks--) {
        DDRC |= B51_TWI_SCL;
        __builtin_avr_delay_cycles(B51_TWI_HALF_CYCLES);
        DDRC &= (uint8_t)~B51_TWI_SCL;
        __builtin_avr_delay_cycles(B51_TWI_HALF_CYCLES);
    }
    DDRC |= B51_TWI_SCL;
    DDRC |= B51_TWI_SDA;
    __builtin_avr_delay_cycles(B51_TWI_HALF_CYCLES);
    DDRC &= (uint8_t)~B51_TWI_SCL;
    __builtin_avr_delay_cycles(B51_TWI_HALF_CYCLES);
    DDRC &= (uint8_t)~B51_TWI_SDA;
    __builtin_avr_delay_cycles(B51_TWI_HALF_CYCLES);
    TWCR = 1 << TWEN;
}

/* As it is called before RAM is initialised, it keeps no variable. */
void b51_dac_start(void) {
    TWSR = 0;
    TWBR = B51_TWI_DIVIDER;
    free_bus();
}

/* One step on the bus, and whether it came to its end.  The wait is bounded: a bus that is stuck must not stop the loop.
 * The bus is then free for the next write: the core writes again at each tick. */
static bool step(uint8_t control) {
    uint8_t patience = B51_TWI_PATIENCE;

    TWCR = (uint8_t)((1 << TWINT) | (1 << TWEN) | control);
    while ((TWCR & (1 << TWINT)) == 0 && patience != 0U) {
        patience--;
    }
    if (patience == 0U) {
        free_bus();
        return false;
    }
    return true;
}

/* Whether the byte was acknowledged: a converter that is not there does not.  Both statuses are looked at for address
 * and data alike, as simavr gives that of data for an address, too, which the chip cannot. */
static bool put(uint8_t byte) {
    TWDR = byte;
    return step(0) && (TW_STATUS == TW_MT_SLA_ACK || TW_STATUS == TW_MT_DATA_ACK);
}

/* The stop condition of a message that has just ended comes first. */
static bool start_message(void) {
    uint8_t patience = B51_TWI_PATIENCE;

    while ((TWCR & (1 << TWSTO)) != 0 && patience != 0U) {
        patience--;
    }
    return step(1 << TWSTA);
}

static void stop_message(void) {
    if ((TWCR & (1 << TWINT)) != 0) { /* else `free_bus` has made the stop condition */
        TWCR = (1 << TWINT) | (1 << TWEN) | (1 << TWSTO);
    }
}

/* Fast mode: two bytes, in force with the acknowledge of the second one; its EEPROM stays as it is.  True: the converter
 * has acknowledged each byte. */
bool b51_dac_write(uint16_t u) {
    bool confirmed = start_message() && put(B51_DAC_ADDRESS << 1) && put((uint8_t)(u >> 8)) && put((uint8_t)u);

    stop_message();
    return confirmed;
}

/* Reads the status, the register and the word of the EEPROM, of which the last two bytes are left; false where the
 * converter does not answer. */
static bool read_stored(uint8_t *status, uint16_t *word) {
    bool answers = start_message();
    uint8_t n;

    TWDR = B51_DAC_ADDRESS << 1 | 1U;
    answers = answers && step(0) && TW_STATUS == TW_MR_SLA_ACK;
    for (n = 0; answers && n < 5U; n++) {
        answers = step(n < 4U ? 1 << TWEA : 0);
        *word = (uint16_t)(*word << 8 | TWDR);
        *status = n == 0U ? TWDR : *status;
    }
    stop_message();
    *word &= B51_DAC_STORED;
    return answers;
}

/* What the converter wakes up with.  From power-on to the first write, with a boot loader in between, that is what the
 * coil gets.  So where it is not 0, 0 is stored, once in its life; it is 50 ms at most, in which it takes no other write. */
uint16_t b51_dac_store_zero(void) {
    uint8_t looks = B51_DAC_LOOKS;
    bool stored = false;
    uint8_t status;
    uint16_t word;

    while (looks != 0U && read_stored(&status, &word)) {
        if ((status & B51_DAC_READY) != 0U && (word == 0U || stored)) {
            return word;
        }
        if ((status & B51_DAC_READY) != 0U) {
            stored = start_message() && put(B51_DAC_ADDRESS << 1) && put(B51_DAC_STORE) && put(0) && put(0);
            stop_message();
        }
        __builtin_avr_delay_cycles(B51_DAC_LOOK_CYCLES);
        looks--;
    }
    return UINT16_MAX;
}

#ifdef B51_INPUT_TABLE
static const __flash uint16_t CODES[] = {B51_INPUT_TABLE};

bool b51_hal_write_input(uint16_t u) {
    return b51_dac_write(b51_between(CODES, u, 6));
}
#else
bool b51_hal_write_input(uint16_t u) {
    return b51_dac_write(u);
}
#endif
