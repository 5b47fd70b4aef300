/* Bytes from the host to bodies with a right CRC.  What is bad is dropped and counted, and never answered. */
#include "core.h"

void receiver_count_bad(void) {
    if (board.receiver.bad_frames < UINT16_MAX) {
        board.receiver.bad_frames++;
    }
}

/* Takes one byte.  Returns the size of the body that it completes, which is at board.receiver.data + 1, or 0. */
uint8_t receiver_take(uint8_t byte) {
    uint8_t size = board.receiver.size;
    bool overflow = board.receiver.overflow;
    uint8_t body;

    if (byte != 0U) {
        if (size >= MAX_ENCODED) {
            board.receiver.overflow = true; /* this frame is lost, the next is not */
        } else {
            board.receiver.data[size] = byte;
            board.receiver.size++;
        }
        return 0;
    }
    board.receiver.size = 0;
    board.receiver.overflow = false;
    if (size == 0U) { /* two delimiters in a row are nothing */
        return 0;
    }
    body = overflow ? 0U : frame_decode(board.receiver.data, size);
    if (body == 0U) {
        receiver_count_bad();
    }
    return body;
}
