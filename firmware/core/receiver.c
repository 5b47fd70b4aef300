/* Bytes from the host to bodies with a right CRC.  Bad bytes are dropped and counted, and never answered. */
#include "core.h"

void b51_receiver_count_bad(void) {
    if (b51_board.receiver.bad_frames < UINT16_MAX) {
        b51_board.receiver.bad_frames++;
    }
}

/* Takes one byte.  Returns the size of the body that it completes, which is at board.receiver.data + 1, or 0. */
uint8_t b51_receiver_take(uint8_t byte) {
    uint8_t size = b51_board.receiver.size;
    bool overflow = b51_board.receiver.overflow;
    uint8_t body;

    if (byte != 0U) {
        if (size >= B51_MAX_ENCODED) {
            b51_board.receiver.overflow = true; /* this frame is lost, the next is not */
        } else {
            b51_board.receiver.data[size] = byte;
            b51_board.receiver.size = (uint8_t)(size + 1U);
        }
        return 0;
    }
    b51_board.receiver.size = 0;
    b51_board.receiver.overflow = false;
    if (size == 0U) { /* two delimiters in a row are nothing */
        return 0;
    }
    body = overflow ? 0U : b51_frame_decode(b51_board.receiver.data, size);
    if (body == 0U) {
        b51_receiver_count_bad();
    }
    return body;
}
