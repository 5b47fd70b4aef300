/* An ADuC841 as far as the firmware in firmware/mcs51 uses it, for a caller that is its crystal, rig and line.
 *
 * The caller gives time (`chip_run`) and is asked back at each conversion and each change of the output: so its plant
 * needs to know no more than that.  The chip lies in the caller's memory; nothing here is shared by two chips.
 */
#ifndef BOARD51_MCS51_CHIP_H
#define BOARD51_MCS51_CHIP_H

#include "cpu.h"

#define LINE_BYTES 4096U /* a power of 2 */

enum { RAN, CONVERTS, WRITES, BOOTS }; /* why `chip_run` returned */

struct line { /* bytes on their way, each with the cycle at which its stop bit is over */
    uint32_t first, count;
    uint64_t at[LINE_BYTES];
    uint8_t data[LINE_BYTES];
};

struct chip {
    struct cpu cpu; /* first: a pointer to it is one to the chip */
    /* The caller's. */
    uint64_t held_until;   /* until then the main loop stands still where it admits interrupts; they and hardware go on */
    uint32_t clock_hz;     /* cycles of `cpu` in a second */
    uint16_t converted;    /* what the conversion that was asked for gives */
    uint16_t watched_pc;   /* `turns` counts how often the program comes here: once in a turn of its main loop */
    bool dead_converter;   /* a conversion never ends */
    bool low_supply;       /* below the trip point of the supply's monitor */
    uint8_t eeprom[4096];
    /* To look at. */
    uint32_t turns, longest_turn, lost_bytes; /* longest_turn in cycles, since the caller set it to 0 */
    uint16_t u; /* count of DAC 0 */
    uint8_t channel;
    struct line to_chip, from_chip;
    /* Inside. */
    uint64_t turn_at, sent_at, conversion_at, bark_at, received_at;
    bool sending, converting, wdwr;
    uint8_t reason, sent, received;
};

uint32_t chip_size(void);
void chip_power_on(struct chip *chip);
void chip_watchdog(struct chip *chip); /* a reset by it */
void chip_pin(struct chip *chip);      /* a reset by its pin: RAM stays as it is */
uint8_t chip_run(struct chip *chip, uint64_t until);
bool chip_feed(struct chip *chip, uint8_t byte, uint64_t at);
uint32_t chip_take(struct chip *chip, uint8_t *data, uint32_t room);

#endif
