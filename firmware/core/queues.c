/* What waits for the line, and the frame that is on it: rule 5.
 *
 * Bodies wait, not frames: 5 bytes less for each.  A full STATE queue loses its oldest, as the newest tells most; the
 * others refuse the newest.  Each loss shows to the host: by sequence, by number, or by a missing answer.
 */
#include "core.h"

enum { QUEUE_STATE, QUEUE_ANSWER, QUEUE_EVENT, QUEUE_BLOCK, QUEUES }; /* highest priority first */

B51_STATIC_ASSERT(b51_each_queue_has_its_ring, QUEUES * sizeof(struct b51_ring) == sizeof b51_board.queues.rings);

static const B51_TABLE_MEMORY uint8_t DEPTH[QUEUES] = {B51_STATE_DEPTH, B51_ANSWER_DEPTH, B51_EVENT_DEPTH,
                                                        B51_BLOCK_DEPTH};

static uint8_t queue_of(uint8_t type) {
    switch (type) {
        case B51_STATE:
            return QUEUE_STATE;
        case B51_EVENT:
            return QUEUE_EVENT;
        case B51_CAPTURE_BLOCK:
            return QUEUE_BLOCK;
        default:
            return QUEUE_ANSWER;
    }
}

static B51_STATE_MEMORY uint8_t *place(uint8_t queue, uint8_t n) B51_ON_STACK {
    switch (queue) {
        case QUEUE_STATE:
            return b51_board.queues.states[n];
        case QUEUE_EVENT:
            return b51_board.queues.events[n];
        case QUEUE_BLOCK:
            return b51_board.queues.blocks[n];
        default:
            return b51_board.queues.answers[n];
    }
}

/* A place behind the last one is one at the beginning; an 8051 has no remainder to spare for it. */
static uint8_t wrapped(uint8_t queue, uint8_t n) B51_ON_STACK {
    uint8_t depth = DEPTH[queue];

    return n < depth ? n : (uint8_t)(n - depth);
}

static void drop_first(uint8_t queue) {
    B51_STATE_MEMORY struct b51_ring *ring = &b51_board.queues.rings[queue];

    ring->first = wrapped(queue, (uint8_t)(ring->first + 1U));
    ring->count--;
}

static bool is_full(uint8_t queue) {
    return b51_board.queues.rings[queue].count >= DEPTH[queue];
}

void b51_queue_put(const B51_STATE_MEMORY uint8_t *body) B51_ON_STACK {
    uint8_t queue = queue_of(body[0]);
    B51_STATE_MEMORY struct b51_ring *ring = &b51_board.queues.rings[queue];

    if (is_full(queue)) {
        b51_board.queues.dropped++;
        if (queue != QUEUE_STATE) {
            return;
        }
        drop_first(queue);
    }
    b51_copy(place(queue, wrapped(queue, (uint8_t)(ring->first + ring->count))), body, b51_body_size(body[0]));
    ring->count++;
}

/* Whether an answer to a command of this type would not be lost. */
bool b51_is_room_for_answer(uint8_t command) {
    return !is_full(QUEUE_ANSWER) && (command != B51_READ_CAPTURE || !is_full(QUEUE_BLOCK));
}

/* Whether nothing that RESET has to wait for is waiting or on its way. */
bool b51_answers_have_left(void) {
    return b51_board.queues.rings[QUEUE_ANSWER].count == 0U &&
           b51_board.queues.frame_sent == b51_board.queues.frame_size;
}

static void load_next_frame(uint8_t queue) B51_ON_STACK {
    const B51_STATE_MEMORY uint8_t *body = place(queue, b51_board.queues.rings[queue].first);

    b51_board.queues.frame_size = b51_frame_encode(body, b51_body_size(body[0]), b51_board.queues.frame);
    drop_first(queue);
}

/* The queue whose turn it is; QUEUES where none has a frame, or no time is left for it. */
static uint8_t next_queue(void) B51_ON_STACK {
    const B51_STATE_MEMORY struct b51_ring *ring = b51_board.queues.rings;
    uint8_t queue;

    for (queue = 0; queue < QUEUES; queue++, ring++) {
        if (ring->count != 0U) {
            return b51_hal_has_time(queue == QUEUE_STATE ? B51_FOR_STATE : B51_FOR_FRAME) ? queue : QUEUES;
        }
    }
    return QUEUES;
}

/* Hands the transmitter what it takes, a frame's length at most; a frame that has begun is finished first.
 *
 * The next frame is chosen when its delimiter was taken and not before, so that a newer STATE still goes first. */
void b51_send_frames(void) {
    uint8_t n, queue;

    for (n = 0; n < B51_MAX_FRAME; n++) {
        if (b51_board.queues.frame_sent < b51_board.queues.frame_size) {
            if (!b51_hal_send(b51_board.queues.frame[b51_board.queues.frame_sent])) {
                return;
            }
            b51_board.queues.frame_sent++;
        } else {
            queue = next_queue();
            if (queue == QUEUES || !b51_hal_send(0)) {
                return;
            }
            load_next_frame(queue);
            b51_board.queues.frame_sent = 1;
        }
    }
}
