/* One frame: 00 | COBS( body | CRC high | CRC low ) | 00, as under 'Framing'. */
#include "core.h"

#define CRC_START 0xFFU

/* The polynomial 0x1021 a byte at a time, in bytes: x is what is fed back, and 0x1021 puts it at bits 0, 5 and 12. */
uint16_t b51_crc_of(const B51_STATE_MEMORY uint8_t *data, uint8_t size) {
    uint8_t high = CRC_START;
    uint8_t low = CRC_START;

    for (; size != 0U; size--) {
        uint8_t x = (uint8_t)(high ^ *data++);
        x = (uint8_t)(x ^ x >> 4);
        high = (uint8_t)(low ^ x << 4 ^ x >> 3);
        low = (uint8_t)(x << 5 ^ x);
    }
    return (uint16_t)((uint16_t)high << 8 | low);
}

/* Writes the frame of a body of at most B51_MAX_BODY bytes: `size` + 5 bytes.  Returns that. */
uint8_t b51_frame_encode(const B51_STATE_MEMORY uint8_t *body, uint8_t size, B51_STATE_MEMORY uint8_t *frame) {
    uint16_t crc = b51_crc_of(body, size);
    B51_STATE_MEMORY uint8_t *code = frame + 1; /* of the piece that is being written */
    B51_STATE_MEMORY uint8_t *to = frame + 2;
    uint8_t end = (uint8_t)(size + 2U);
    uint8_t piece = 1; /* its length, and the code */
    uint8_t n;

    *frame = 0;
    for (n = 0; n < end; n++) {
        uint8_t byte = (uint8_t)(n < size ? *body++ : n == size ? crc >> 8 : crc);
        if (byte != 0U) {
            *to = byte;
            piece++;
        } else {
            *code = piece;
            code = to;
            piece = 1;
        }
        to++;
    }
    *code = piece;
    *to = 0;
    return (uint8_t)(size + 5U);
}

/* Undoes COBS in place, in what stood between two delimiters, and checks the CRC.  The body is then at encoded + 1.
 * Returns its size, 0 for a bad frame. */
uint8_t b51_frame_decode(B51_STATE_MEMORY uint8_t *encoded, uint8_t size) B51_ON_STACK {
    uint16_t next = encoded[0];

    while (next < size) { /* no byte is 0 here, so each turn goes on by one at least */
        uint8_t code = encoded[next];
        encoded[next] = 0;
        next = (uint16_t)(next + code);
    }
    if (next != size || size < 4U || b51_crc_of(encoded + 1, (uint8_t)(size - 1U)) != 0U) {
        return 0;
    }
    return (uint8_t)(size - 3U);
}
