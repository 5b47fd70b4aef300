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

/* Fast mode: two bytes, in force with the acknowledge of the second one; its EEPROM stays as it is.  The stop condition
 * of a write that has just ended comes first.  True: the converter has acknowledged each byte. */
bool b51_dac_write(uint16_t u) {
    uint8_t patience = B51_TWI_PATIENCE;
    bool confirmed;

    while ((TWCR & (1 << TWSTO)) != 0 && patience != 0U) {
        patience--;
    }
    confirmed = step(1 << TWSTA) && put(B51_DAC_ADDRESS << 1) && put((uint8_t)(u >> 8)) && put((uint8_t)u);
    if ((TWCR & (1 << TWINT)) != 0) { /* else `free_bus` has made the stop condition */
        TWCR = (1 << TWINT) | (1 << TWEN) | (1 << TWSTO);
    }
    return confirmed;
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
