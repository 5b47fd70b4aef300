/* The host's commands: once each, in order, as far as the control law leaves time (rules 2 to 4); what happens without it (rule 10). */
#include "core.h"

#define PENDING_COMMANDS 8U /* a power of 2 */
#define STOP_BODY 2U
#define RETAINED_IDS 8U
#define HOST_LOSS_MS 500U

/* After `board` was cleared. */
void host_boot(void) {
    board.host.divider = 1;
    board.host.commands_left = COMMANDS_PER_TICK;
    board.host.ticks_since_overload = TICKS_PER_S;
    host_set_loss(HOST_LOSS_COIL_OFF, HOST_LOSS_MS);
}

void host_set_loss(uint8_t policy, uint16_t timeout_ms) ON_STACK {
    board.host.policy = policy;
    board.host.timeout_ms = timeout_ms;
    board.host.timeout_us = timeout_ms * UINT32_C(1000);
}

static STATE_MEMORY struct kept_answer *kept(uint8_t n) ON_STACK {
    return &board.host.kept[board.host.kept_order[n]];
}

/* The place of an id in the order, or `kept_count`. */
static uint8_t find_kept(uint8_t id) ON_STACK {
    uint8_t n;

    for (n = 0; n < board.host.kept_count; n++) {
        if (kept(n)->id == id) {
            break;
        }
    }
    return n;
}

/* Keeps the answer.  A STOP takes over the place of its id; else the place that was taken first is given up. */
static void keep(const STATE_MEMORY uint8_t *body) ON_STACK {
    uint8_t n = find_kept(body[1]);
    uint8_t place;

    if (n == board.host.kept_count && n < RETAINED_IDS) {
        board.host.kept_order[n] = n; /* places are taken in their order until all are */
        board.host.kept_count++;
    } else if (n == board.host.kept_count) {
        n = 0;
    }
    place = board.host.kept_order[n];
    for (; n + 1U < board.host.kept_count; n++) {
        board.host.kept_order[n] = board.host.kept_order[n + 1U];
    }
    board.host.kept_order[n] = place;
    board.host.kept[place].id = body[1];
    board.host.kept[place].type = body[0];
    copy(board.host.kept[place].body, board.host.answer, body_size(board.host.answer[0]));
}

static void refuse(const STATE_MEMORY uint8_t *body, uint8_t reason, uint16_t detail) ON_STACK {
    answer_nack(body, reason, detail);
    queue_put(board.host.answer);
}

/* A frame for whose answer there is no room. */
static void leave_unanswered(void) {
    receiver_count_bad();
    if (board.host.unanswered < UINT16_MAX) {
        board.host.unanswered++;
    }
    if (board.host.ticks_since_overload >= TICKS_PER_S) {
        board.host.ticks_since_overload = 0;
        emit(OVERLOAD, board.host.unanswered);
    }
}

/* Keeps the answer that was composed, or that of a refusal, and sends it. */
static void answer_once(const STATE_MEMORY uint8_t *body, uint8_t reason, uint16_t detail) ON_STACK {
    if (reason != ACCEPTED) {
        answer_nack(body, reason, detail);
    }
    keep(body);
    queue_put(board.host.answer);
}

/* A STOP has overtaken it; what could turn the coil on again is not executed any more. */
static bool is_revoked(uint8_t type) {
    if (board.host.overtaken == 0U) {
        return false;
    }
    board.host.overtaken--;
    return type == SET_MODE || type == CAPTURE;
}

static void execute(const STATE_MEMORY struct command *command) ON_STACK {
    const STATE_MEMORY uint8_t *body = command->body;
    uint8_t n = find_kept(body[1]);
    uint16_t detail = 0;
    uint8_t reason = fields_check(body, command->size, &detail);
    bool revoked = is_revoked(body[0]);

    if (body[0] == HELLO && reason == ACCEPTED) { /* answered afresh each time, and not kept */
        reason = answer_hello(body, &detail);
        if (reason != ACCEPTED) {
            answer_nack(body, reason, detail);
        }
        queue_put(board.host.answer);
    } else if (n < board.host.kept_count && kept(n)->type == body[0]) {
        queue_put(kept(n)->body);
    } else if (n < board.host.kept_count) {
        refuse(body, BUSY, 0);
    } else if (reason != ACCEPTED) {
        /* Not kept: noise may leave the CRC right and the length wrong, and the repetition must not meet it again. */
        refuse(body, reason, detail);
    } else if (!board.host.session_open && body[0] != PING) {
        refuse(body, NO_SESSION, 0);
    } else if (revoked) {
        answer_once(body, BUSY, 0);
    } else {
        reason = command_execute(body, &detail);
        answer_once(body, reason, detail);
    }
}

/* Commands that wait, in the order in which they came, as far as the budget of this tick, the time and the room for
 * their answers go.  None after a RESET: its ACK must not wait for what a host goes on asking. */
void host_execute(void) {
    while (board.host.pending_count != 0U && board.host.commands_left != 0U && board.host.reset_wait == 0U) {
        const STATE_MEMORY struct command *command = &board.host.pending[board.host.pending_first];

        uint8_t type = command->body[0];

        if (!is_room_for_answer(type) || !hal_has_time(type == EXCITE ? FOR_SIGNAL : FOR_COMMAND)) {
            return;
        }
        board.host.commands_left--;
        execute(command);
        board.host.pending_first = (uint8_t)(board.host.pending_first + 1U) & (PENDING_COMMANDS - 1U);
        board.host.pending_count--;
    }
}

/* At once, whatever waits. */
static void stop(const STATE_MEMORY uint8_t *body) ON_STACK {
    board.host.overtaken = board.host.pending_count;
    loop_switch_off();
    if (board.host.reset_wait != 0U) {
        return;
    }
    if (!is_room_for_answer(STOP)) {
        leave_unanswered();
        return;
    }
    answer_ack(body);
    keep(body);
    queue_put(board.host.answer);
}

static void put_pending(const STATE_MEMORY uint8_t *body, uint8_t size) ON_STACK {
    uint8_t place = (uint8_t)(board.host.pending_first + board.host.pending_count) & (PENDING_COMMANDS - 1U);
    STATE_MEMORY struct command *command = &board.host.pending[place];

    /* What is longer than any command is refused for it, and only its type and id are looked at again. */
    copy(command->body, body, size < COMMAND_BODY ? size : COMMAND_BODY);
    command->size = size;
    board.host.pending_count++;
}

/* A body with a right CRC. */
void host_receive(const STATE_MEMORY uint8_t *body, uint8_t size) ON_STACK {
    if (size < 2U || body[1] == 0U || is_sent_by_board(body[0])) {
        receiver_count_bad();
        return;
    }
    board.host.silent_us = 0;
    if (board.loop.host_lost) {
        board.loop.host_lost = false;
        emit(HOST_BACK, 0);
    }
    if (body[0] == STOP && size == STOP_BODY) {
        stop(body);
    } else if (board.host.pending_count < PENDING_COMMANDS) {
        put_pending(body, size);
    } else if (is_room_for_answer(body[0])) {
        refuse(body, BUSY, 0);
    } else {
        leave_unanswered();
    }
}

/* Once per tick: the policy acts at the tick at which the time-out is over. */
void host_watch(void) {
    if (board.host.silent_us < board.host.timeout_us) {
        board.host.silent_us += TICK_US;
    }
    if (board.loop.host_lost || board.host.silent_us < board.host.timeout_us) {
        return;
    }
    board.loop.host_lost = true;
    emit(HOST_LOST, board.host.policy);
    if (board.host.policy == HOST_LOSS_HOLD && board.loop.mode == MODE_CLOSED_LOOP) {
        loop_end_excitation();
    } else if (board.host.policy != HOST_LOSS_KEEP) {
        loop_switch_off();
    }
}
