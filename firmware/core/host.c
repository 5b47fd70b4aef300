/* The host's commands: once each, in order, as far as the control law leaves time (rules 2 to 4); what happens without
 * it (rule 10). */
#include "core.h"

#define PENDING_COMMANDS 8U /* a power of 2 */
#define STOP_BODY 2U
#define RETAINED_IDS 8U
#define HOST_LOSS_MS 500U

#define PLACES(array) (sizeof(array) / sizeof((array)[0]))
B51_STATIC_ASSERT(b51_commands_wait_in_a_power_of_two,
                  PENDING_COMMANDS == PLACES(b51_board.host.pending) &&
                      (PENDING_COMMANDS & (PENDING_COMMANDS - 1U)) == 0U);
B51_STATIC_ASSERT(b51_each_kept_answer_has_its_place,
                  RETAINED_IDS == PLACES(b51_board.host.kept) && RETAINED_IDS == PLACES(b51_board.host.kept_order));
B51_STATIC_ASSERT(b51_the_longest_time_out_has_32_bits, UINT64_C(1000) * UINT16_MAX + B51_TICK_US <= UINT32_MAX);

/* After `b51_board` was cleared. */
void b51_host_boot(void) {
    b51_board.host.divider = 1;
    b51_board.host.commands_left = B51_COMMANDS_PER_TICK;
    b51_board.host.ticks_since_overload = B51_TICKS_PER_S;
    b51_host_set_loss(B51_HOST_LOSS_COIL_OFF, HOST_LOSS_MS);
}

void b51_host_set_loss(uint8_t policy, uint16_t timeout_ms) B51_ON_STACK {
    b51_board.host.policy = policy;
    b51_board.host.timeout_ms = timeout_ms;
    b51_board.host.timeout_us = timeout_ms * UINT32_C(1000);
}

static B51_STATE_MEMORY struct b51_kept_answer *kept(uint8_t n) B51_ON_STACK {
    return &b51_board.host.kept[b51_board.host.kept_order[n]];
}

/* The place of an id in the order, or `kept_count`. */
static uint8_t find_kept(uint8_t id) B51_ON_STACK {
    uint8_t n;

    for (n = 0; n < b51_board.host.kept_count; n++) {
        if (kept(n)->id == id) {
            break;
        }
    }
    return n;
}

/* Keeps the answer.  A STOP takes over the place of its id; else the place that was taken first is given up. */
static void keep(const B51_STATE_MEMORY uint8_t *body) B51_ON_STACK {
    uint8_t n = find_kept(body[1]);
    uint8_t place;

    if (n == b51_board.host.kept_count && n < RETAINED_IDS) {
        b51_board.host.kept_order[n] = n; /* places are taken in their order until all are */
        b51_board.host.kept_count++;
    } else if (n == b51_board.host.kept_count) {
        n = 0;
    }
    place = b51_board.host.kept_order[n];
    for (; n + 1U < b51_board.host.kept_count; n++) {
        b51_board.host.kept_order[n] = b51_board.host.kept_order[n + 1U];
    }
    b51_board.host.kept_order[n] = place;
    b51_board.host.kept[place].id = body[1];
    b51_board.host.kept[place].type = body[0];
    b51_copy(b51_board.host.kept[place].body, b51_board.host.answer, b51_body_size(b51_board.host.answer[0]));
}

static void refuse(const B51_STATE_MEMORY uint8_t *body, uint8_t reason, uint16_t detail) B51_ON_STACK {
    b51_answer_nack(body, reason, detail);
    b51_queue_put(b51_board.host.answer);
}

/* A frame for whose answer there is no room. */
static void leave_unanswered(void) {
    b51_receiver_count_bad();
    if (b51_board.host.unanswered < UINT16_MAX) {
        b51_board.host.unanswered++;
    }
    if (b51_board.host.ticks_since_overload >= B51_TICKS_PER_S) {
        b51_board.host.ticks_since_overload = 0;
        b51_emit(B51_OVERLOAD, b51_board.host.unanswered);
    }
}

/* Keeps the answer that was composed, or that of a refusal, and sends it. */
static void answer_once(const B51_STATE_MEMORY uint8_t *body, uint8_t reason, uint16_t detail) B51_ON_STACK {
    if (reason != B51_ACCEPTED) {
        b51_answer_nack(body, reason, detail);
    }
    keep(body);
    b51_queue_put(b51_board.host.answer);
}

/* A STOP has overtaken it; what could turn the coil on again is not executed any more. */
static bool is_revoked(uint8_t type) {
    if (b51_board.host.overtaken == 0U) {
        return false;
    }
    b51_board.host.overtaken--;
    return type == B51_SET_MODE || type == B51_CAPTURE;
}

static void execute(const B51_STATE_MEMORY struct b51_command *command) B51_ON_STACK {
    const B51_STATE_MEMORY uint8_t *body = command->body;
    uint8_t n = find_kept(body[1]);
    uint16_t detail = 0;
    uint8_t reason = b51_fields_check(body, command->size, &detail);
    bool revoked = is_revoked(body[0]);

    if (body[0] == B51_HELLO && reason == B51_ACCEPTED) { /* answered afresh each time, and not kept */
        reason = b51_answer_hello(body, &detail);
        if (reason != B51_ACCEPTED) {
            b51_answer_nack(body, reason, detail);
        }
        b51_queue_put(b51_board.host.answer);
    } else if (n < b51_board.host.kept_count && kept(n)->type == body[0]) {
        b51_queue_put(kept(n)->body);
    } else if (n < b51_board.host.kept_count) {
        refuse(body, B51_BUSY, 0);
    } else if (reason != B51_ACCEPTED) {
        /* Not kept: noise may leave the CRC right and the length wrong, and the repetition must not meet it again. */
        refuse(body, reason, detail);
    } else if (!b51_board.host.session_open && body[0] != B51_PING) {
        refuse(body, B51_NO_SESSION, 0);
    } else if (revoked) {
        answer_once(body, B51_BUSY, 0);
    } else {
        reason = b51_command_execute(body, &detail);
        answer_once(body, reason, detail);
    }
}

/* Commands that wait, in the order in which they came, as far as the budget of this tick, the time and the room for
 * their answers go.  None after a RESET: its ACK must not wait for what a host goes on asking. */
void b51_host_execute(void) {
    while (b51_board.host.pending_count != 0U && b51_board.host.commands_left != 0U &&
           b51_board.host.reset_wait == 0U) {
        const B51_STATE_MEMORY struct b51_command *command = &b51_board.host.pending[b51_board.host.pending_first];

        uint8_t type = command->body[0];

        if (!b51_is_room_for_answer(type) || !b51_hal_has_time(type == B51_EXCITE ? B51_FOR_SIGNAL : B51_FOR_COMMAND)) {
            return;
        }
        b51_board.host.commands_left--;
        execute(command);
        b51_board.host.pending_first = (uint8_t)(b51_board.host.pending_first + 1U) & (PENDING_COMMANDS - 1U);
        b51_board.host.pending_count--;
    }
}

/* At once, whatever waits. */
static void stop(const B51_STATE_MEMORY uint8_t *body) B51_ON_STACK {
    b51_board.host.overtaken = b51_board.host.pending_count;
    b51_loop_switch_off();
    if (b51_board.host.reset_wait != 0U) {
        return;
    }
    if (!b51_is_room_for_answer(B51_STOP)) {
        leave_unanswered();
        return;
    }
    b51_answer_ack(body);
    keep(body);
    b51_queue_put(b51_board.host.answer);
}

static void put_pending(const B51_STATE_MEMORY uint8_t *body, uint8_t size) B51_ON_STACK {
    uint8_t place = (uint8_t)(b51_board.host.pending_first + b51_board.host.pending_count) & (PENDING_COMMANDS - 1U);
    B51_STATE_MEMORY struct b51_command *command = &b51_board.host.pending[place];

    /* A body longer than any command is refused for its length; only its type and id are read. */
    b51_copy(command->body, body, size < B51_COMMAND_BODY ? size : B51_COMMAND_BODY);
    command->size = size;
    b51_board.host.pending_count++;
}

/* A body with a right CRC. */
void b51_host_receive(const B51_STATE_MEMORY uint8_t *body, uint8_t size) B51_ON_STACK {
    if (size < 2U || body[1] == 0U || b51_is_sent_by_board(body[0])) {
        b51_receiver_count_bad();
        return;
    }
    b51_board.host.silent_us = 0;
    if (b51_board.loop.host_lost) {
        b51_board.loop.host_lost = false;
        b51_emit(B51_HOST_BACK, 0);
    }
    if (body[0] == B51_STOP && size == STOP_BODY) {
        stop(body);
    } else if (b51_board.host.pending_count < PENDING_COMMANDS) {
        put_pending(body, size);
    } else if (b51_is_room_for_answer(body[0])) {
        refuse(body, B51_BUSY, 0);
    } else {
        leave_unanswered();
    }
}

/* Once per tick: the policy acts at the tick at which the time-out is over. */
void b51_host_watch(void) {
    if (b51_board.host.silent_us < b51_board.host.timeout_us) {
        b51_board.host.silent_us += B51_TICK_US;
    }
    if (b51_board.loop.host_lost || b51_board.host.silent_us < b51_board.host.timeout_us) {
        return;
    }
    b51_board.loop.host_lost = true;
    b51_emit(B51_HOST_LOST, b51_board.host.policy);
    if (b51_board.host.policy == B51_HOST_LOSS_HOLD && b51_board.loop.mode == B51_MODE_CLOSED_LOOP) {
        b51_loop_end_excitation();
    } else if (b51_board.host.policy != B51_HOST_LOSS_KEEP) {
        b51_loop_switch_off();
    }
}
