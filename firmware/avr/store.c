/* Identity and settings: from EEPROM, each with a CRC behind it; those of the program where one is damaged or blank, or
 * where the core rejects the settings.
 *
 *     0    identity (40 bytes) | CRC-16, low byte first | settings (29 bytes) | CRC-16
 */
#include <avr/eeprom.h>
#include <avr/pgmspace.h>

#include "avr.h"

/* The bytes of the EEPROM are those of the structures, which this chip does not pad. */
B51_STATIC_ASSERT(b51_the_identity_is_not_padded, sizeof(struct b51_identity) == 40U);
B51_STATIC_ASSERT(b51_the_settings_are_not_padded, sizeof(struct b51_settings) == 29U);
B51_STATIC_ASSERT(b51_both_fit_the_eeprom,
                  sizeof(struct b51_identity) + sizeof(struct b51_settings) + 4U <= E2END + 1U);

/* A board without a number of its own is number 0. */
#ifdef B51_PROFILE
static const __flash struct b51_identity IDENTITY_OF_PROGRAM = {
    0, B51_PROFILE_FIRMWARE, {B51_PROFILE_SCALINGS}, {B51_FIRMWARE_BUILD}};
static const __flash struct b51_settings SETTINGS_OF_PROGRAM = {{B51_PROFILE_GAINS}, {B51_PROFILE_LIMITS}};
#else /* the rig of board51's emulator */
static const __flash struct b51_identity IDENTITY_OF_PROGRAM = {
    0,
    1,
    3,
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
static struct b51_settings settings;

/* Reads `size` bytes and their CRC; false where they do not agree. */
static bool read(void *to, uint16_t at, uint8_t size) {
    eeprom_read_block(to, (const void *)at, size);
    return b51_crc_of(to, size) == eeprom_read_word((const uint16_t *)(at + size));
}

const struct b51_settings *b51_hal_program_settings(void) {
    memcpy_P(&settings, &SETTINGS_OF_PROGRAM, sizeof settings);
    return &settings;
}

void b51_store_load(void) {
    if (!read(&identity, 0, sizeof identity)) {
        memcpy_P(&identity, &IDENTITY_OF_PROGRAM, sizeof identity);
    }
    memcpy_P(identity.build, IDENTITY_OF_PROGRAM.build, sizeof identity.build); /* the EEPROM may be older than the program */
    identity.firmware_major = IDENTITY_OF_PROGRAM.firmware_major;
    identity.firmware_minor = IDENTITY_OF_PROGRAM.firmware_minor;
    if (!read(&settings, sizeof identity + 2U, sizeof settings)) {
        (void)b51_hal_program_settings();
    }
}

const struct b51_identity *b51_hal_identity(void) {
    return &identity;
}

const struct b51_settings *b51_hal_settings(void) {
    return &settings;
}
