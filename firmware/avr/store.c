/* Identity and settings: from EEPROM, each with a CRC behind it; those of the program where one is damaged or blank, or
 * where the core rejects the settings.
 *
 *     0    identity (40 bytes) | CRC-16, low byte first | settings (29 bytes) | CRC-16 | calibration (8 bytes) | CRC-16
 */
#include <avr/eeprom.h>
#include <avr/pgmspace.h>
#include <stddef.h>
#include <string.h>

#include "avr.h"

#define CALIBRATION_AT 73U

/* The bytes of the EEPROM are those of the structures, which this chip does not pad. */
B51_STATIC_ASSERT(b51_the_identity_is_not_padded, sizeof(struct b51_identity) == 40U);
B51_STATIC_ASSERT(b51_the_settings_are_not_padded, sizeof(struct b51_settings) == 29U);
B51_STATIC_ASSERT(b51_both_fit_the_eeprom,
                  sizeof(struct b51_identity) + sizeof(struct b51_settings) + 4U <= CALIBRATION_AT);
B51_STATIC_ASSERT(b51_the_calibration_fits_the_eeprom, CALIBRATION_AT + B51_CALIBRATION_SIZE + 2U <= E2END + 1U);

/* A board without a number of its own is number 0. */
#ifdef B51_PROFILE
static const __flash struct b51_identity IDENTITY_OF_PROGRAM = {
    0, B51_PROFILE_FIRMWARE, {B51_PROFILE_SCALINGS}, {B51_FIRMWARE_BUILD}};
static const __flash struct b51_settings SETTINGS_OF_PROGRAM = {{B51_PROFILE_GAINS}, {B51_PROFILE_LIMITS}};
#else /* the rig of board51's emulator */
static const __flash struct b51_identity IDENTITY_OF_PROGRAM = {
    0,
    1,
    4,
    10,
    12,
    {0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x3A,  /* f32: i_c: 0 A, 2/4096 A a count */
     0x7C, 0x1C, 0x64, 0xB8, 0x30, 0xA0, 0xBF, 0x35,  /* x: -54.386 um, 1.42772 um */
     0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0xA0, 0x3A}, /* u_c: 0 V, 5/4096 V */
    {B51_FIRMWARE_BUILD}};
static const __flash struct b51_settings SETTINGS_OF_PROGRAM = {
    {B51_LAW_LQI, {17, 14, 11, 19}, {25690, 32576, 21199, -21585}, 1304, 2034, 1756}, {248, 3680, 1751, 14008, 4095}};
#endif

static struct b51_identity identity;
/* The settings are read once, at the boot; the place is then the calibration's, with its CRC. */
static union {
    struct b51_settings settings;
    uint8_t calibration[B51_CALIBRATION_SIZE + 2U];
} place;
static uint8_t bytes_left; /* of the calibration, to be written */

/* Reads `size` bytes and their CRC; false where they do not agree. */
static bool read(void *to, uint16_t at, uint8_t size) {
    eeprom_read_block(to, (const void *)at, size);
    return b51_crc_of(to, size) == eeprom_read_word((const uint16_t *)(at + size));
}

const struct b51_settings *b51_hal_program_settings(void) {
    memcpy_P(&place.settings, &SETTINGS_OF_PROGRAM, sizeof place.settings);
    return &place.settings;
}

void b51_store_load(void) {
    if (!read(&identity, 0, sizeof identity)) {
        memcpy_P(&identity, &IDENTITY_OF_PROGRAM, sizeof identity);
    }
    memcpy_P(identity.build, IDENTITY_OF_PROGRAM.build, sizeof identity.build); /* the EEPROM may be older than the program */
    identity.firmware_major = IDENTITY_OF_PROGRAM.firmware_major;
    identity.firmware_minor = IDENTITY_OF_PROGRAM.firmware_minor;
    if (!read(&place.settings, sizeof identity + 2U, sizeof place.settings)) {
        (void)b51_hal_program_settings();
    }
}

const struct b51_identity *b51_hal_identity(void) {
    return &identity;
}

const struct b51_settings *b51_hal_settings(void) {
    return &place.settings;
}

/* Of a calibration whose bytes were not all written, the CRC is wrong, too. */
const uint8_t *b51_hal_calibration(void) {
    return read(place.calibration, CALIBRATION_AT, B51_CALIBRATION_SIZE) ? place.calibration : NULL;
}

void b51_hal_keep_calibration(const uint8_t *bytes) {
    uint16_t crc = b51_crc_of(bytes, B51_CALIBRATION_SIZE);

    (void)memcpy(place.calibration, bytes, B51_CALIBRATION_SIZE);
    place.calibration[B51_CALIBRATION_SIZE] = (uint8_t)crc;
    place.calibration[B51_CALIBRATION_SIZE + 1U] = (uint8_t)(crc >> 8);
    bytes_left = sizeof place.calibration;
}

/* A byte takes 3.4 ms, so there is one in each second tick. */
void b51_store_go_on(void) {
    if (bytes_left != 0U && eeprom_is_ready()) {
        bytes_left--;
        eeprom_write_byte((uint8_t *)(CALIBRATION_AT + bytes_left), place.calibration[bytes_left]);
    }
}

bool b51_hal_calibration_is_kept(void) {
    return bytes_left == 0U && eeprom_is_ready() && read(place.calibration, CALIBRATION_AT, B51_CALIBRATION_SIZE);
}
