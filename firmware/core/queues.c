/* What waits for the line, and the frame that is on it: rule 5.
 *
 * Bodies wait, not frames: 5 bytes less for each.  A full STATE queue loses its oldest, as the newest tells most; the
 * others refuse the newest.  Each loss shows to the host: by sequence, by number, or by a missing answer.
 */
#include "core.h"

enum { QUEUE_STATE, QUEUE_ANSWER, QUEUE_EVENT, QUEUE_BLOCK, QUEUES }; /* highest priority first */

static const TABLE_MEMORY uint8_t DEPTH[QUEUES] = {STATE_DEPTH, ANSWER_DEPTH, EVENT_DEPTH, BLOCK_DEPTH};

static uint8_t queue_of(uint8_t type) {
    switch (type) {
        case STATE:
            return QUEUE_STATE;
        case EVENT:
            return QUEUE_EVENT;
        case CAPTURE_BLOCK:
            return QUEUE_BLOCK;
        default:
            return QUEUE_ANSWER;
    }
}

static STATE_MEMORY uint8_t *place(uint8_t queue, uint8_t n) ON_STACK {
    switch (queue) {
        case QUEUE_STATE:
            return board.queues.states[n];
        case QUEUE_EVENT:
            return board.queues.events[n];
        case QUEUE_BLOCK:
            return board.queues.blocks[n];
        default:
            return board.queues.answers[n];
    }
}

/* A place behind the last one is one at the beginning; an 8051 has no remainder to spare for it. */
static uint8_t wrapped(uint8_t queue, uint8_t n) ON_STACK {
    uint8_t depth = DEPTH[queue];

    return n < depth ? n : (uint8_t)(n - depth);
}

static void drop_first(uint8_t queue) {
    STATE_MEMORY struct ring *ring = &board.queues.rings[queue];

    ring->first = wrapped(queue, (uint8_t)(ring->first + 1U));
    ring->count--;
}

static bool is_full(uint8_t queue) {
    return board.queues.rings[queue].count >= DEPTH[queue];
}

void queue_put(const STATE_MEMORY uint8_t *body) ON_STACK {
    uint8_t queue = queue_of(body[0]);
    STATE_MEMORY struct ring *ring = &board.queues.rings[queue];

    if (is_full(queue)) {
        board.queues.dropped++;
        if (queue != QUEUE_STATE) {
            return;
        }
        drop_first(queue);
    }
    copy(place(queue, wrapped(queue, (uint8_t)(ring->first + ring->count))), body, body_size(body[0]));
    ring->count++;
}

/* Whether an answer to a command of this type would not be lost. */
bool is_room_for_answer(uint8_t command) {
    return !is_full(QUEUE_ANSWER) && (command != READ_CAPTURE || !is_full(QUEUE_BLOCK));
}

/* Whether nothing that RESET has to wait for is waiting or on its way. */
bool answers_have_left(void) {
    return board.queues.rings[QUEUE_ANSWER].count == 0U && board.queues.frame_sent == board.queues.frame_size;
}

static void load_next_frame(uint8_t queue) ON_STACK {
    const STATE_MEMORY uint8_t *body = place(queue, board.queues.rings[queue].first);

    board.queues.frame_size = frame_encode(body, body_size(body[0]), board.queues.frame);
    drop_first(queue);
}

/* The queue whose turn it is; QUEUES where none has a frame, or no time is left for it. */
static uint8_t next_queue(void) ON_STACK {
    const STATE_MEMORY struct ring *ring = board.queues.rings;
    uint8_t queue;

    for (queue = 0; queue < QUEUES; queue++, ring++) {
        if (ring->count != 0U) {
            return hal_has_time(queue == QUEUE_STATE ? FOR_STATE : FOR_FRAME) ? queue : QUEUES;
        }
    }
    return QUEUES;
}

/* Hands the transmitter what it takes, a frame's length at most; a frame that has begun is finished first.
 *
 * The next frame is chosen when its delimiter was taken and not before, so that a newer STATE still goes first. */
void send_frames(void) {
    uint8_t n, queue;

    for (n = 0; n < MAX_FRAME; n++) {
        if (board.queues.frame_sent < board.queues.frame_size) {
            if (!hal_send(board.queues.frame[board.queues.frame_sent])) {
                return;
            }
            board.queues.frame_sent++;
        } else {
            queue = next_queue();
            if (queue == QUEUES || !hal_send(0)) {
                return;
            }
            load_next_frame(queue);
            board.queues.frame_sent = 1;
        }
    }
}
