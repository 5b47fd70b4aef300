/* One frame: 00 | COBS( body | CRC high | CRC low ) | 00, as under 'Framing'. */
#include "core.h"

#define CRC_START 0xFFFFU
#define CRC_POLYNOMIAL 0x1021U

/* Bit by bit: a table of 512 bytes is 5 times as fast, where a chip has room for it and needs the time. */
uint16_t crc_of(const uint8_t *data, uint8_t size) {
    uint16_t crc = CRC_START;
    uint8_t n;
    uint8_t bit;

    for (n = 0; n < size; n++) {
        crc = (uint16_t)(crc ^ (uint16_t)data[n] << 8); /* not as int, which has 16 bits on a small chip */
        for (bit = 0; bit < 8U; bit++) {
            crc = (crc & 0x8000U) != 0U ? (uint16_t)(crc << 1 ^ CRC_POLYNOMIAL) : (uint16_t)(crc << 1);
        }
    }
    return crc;
}

/* Writes the frame of a body of at most MAX_BODY bytes: `size` + 5 bytes.  Returns that. */
uint8_t frame_encode(const uint8_t *body, uint8_t size, uint8_t *frame) {
    uint16_t crc = crc_of(body, size);
    uint8_t code = 1; /* where the code of the piece that is being written stands */
    uint8_t out = 2;
    uint8_t n;

    frame[0] = 0;
    for (n = 0; n < size + 2U; n++) {
        uint8_t byte = (uint8_t)crc; /* the last one */
        if (n < size) {
            byte = body[n];
        } else if (n == size) {
            byte = (uint8_t)(crc >> 8);
        }
        if (byte != 0U) {
            frame[out] = byte;
        } else {
            frame[code] = (uint8_t)(out - code);
            code = out;
        }
        out++;
    }
    frame[code] = (uint8_t)(out - code);
    frame[out] = 0;
    return (uint8_t)(out + 1U);
}

/* Undoes COBS in place, in what stood between two delimiters, and checks the CRC.  The body is then at encoded + 1.
 * Returns its size, 0 for a bad frame. */
uint8_t frame_decode(uint8_t *encoded, uint8_t size) {
    uint16_t next = encoded[0];

    while (next < size) { /* no byte is 0 here, so each turn goes on by one at least */
        uint8_t code = encoded[next];
        encoded[next] = 0;
        next = (uint16_t)(next + code);
    }
    if (next != size || size < 4U || crc_of(encoded + 1, (uint8_t)(size - 1U)) != 0U) {
        return 0;
    }
    return (uint8_t)(size - 3U);
}
