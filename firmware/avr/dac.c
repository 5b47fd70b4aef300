/* The converter of u_c: an MCP4725 at the two-wire interface. */
#include <avr/io.h>
#include <util/twi.h>

#include "avr.h"

/* As it is called before RAM is initialised, it keeps no variable. */
void dac_start(void) {
    TWSR = 0;
    TWBR = TWI_DIVIDER;
    TWCR = 1 << TWEN;
}

/* One step on the bus, and whether it came to its end.  The wait is bounded: a bus that is stuck must not stop the loop,
 * which tries again. */
static bool step(uint8_t control) {
    uint8_t patience = TWI_PATIENCE;

    TWCR = (uint8_t)((1 << TWINT) | (1 << TWEN) | control);
    while ((TWCR & (1 << TWINT)) == 0 && patience != 0U) {
        patience--;
    }
    return patience != 0U;
}

/* Whether the byte was acknowledged: a converter that is not there does not.  Both statuses are looked at for address
 * and data alike, as simavr gives that of data for an address, too, which the chip cannot. */
static bool put(uint8_t byte) {
    TWDR = byte;
    return step(0) && (TW_STATUS == TW_MT_SLA_ACK || TW_STATUS == TW_MT_DATA_ACK);
}

/* Fast mode: two bytes, in force with the acknowledge of the second one; its EEPROM stays as it is.  The stop condition
 * of a write that has just ended comes first.  True: the converter has acknowledged each byte. */
bool dac_write(uint16_t u) {
    uint8_t patience = TWI_PATIENCE;
    bool confirmed;

    while ((TWCR & (1 << TWSTO)) != 0 && patience != 0U) {
        patience--;
    }
    confirmed = step(1 << TWSTA) && put(DAC_ADDRESS << 1) && put((uint8_t)(u >> 8)) && put((uint8_t)u);
    TWCR = (1 << TWINT) | (1 << TWEN) | (1 << TWSTO);
    return confirmed;
}

#ifdef INPUT_TABLE
static const __flash uint16_t CODES[] = {INPUT_TABLE};

bool hal_write_input(uint16_t u) {
    return dac_write(between(CODES, u, 6));
}
#else
bool hal_write_input(uint16_t u) {
    return dac_write(u);
}
#endif
