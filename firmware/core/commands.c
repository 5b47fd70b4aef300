/* What commands do, when they are refused, and their answers: rules 2, 6 to 8, 12 and 15.
 *
 * A refused command changes nothing.  An answer is composed when its command is executed, and is then only copied: what
 * it says is what was in force at that tick, however long it waits for the line, and in each repetition (rule 3).
 */
#include <string.h>

#include "core.h"

static STATE_MEMORY uint8_t *begin(uint8_t type, const STATE_MEMORY uint8_t *body) ON_STACK {
    board.host.answer[0] = type;
    board.host.answer[1] = body[1]; /* the id */
    return board.host.answer + 2;
}

void answer_ack(const STATE_MEMORY uint8_t *body) ON_STACK {
    STATE_MEMORY uint8_t *at = begin(ACK, body);

    *at = body[0];
    (void)put_u32(at + 1, board.next_tick);
}

void answer_nack(const STATE_MEMORY uint8_t *body, uint8_t reason, uint16_t detail) ON_STACK {
    STATE_MEMORY uint8_t *at = begin(NACK, body);

    at[0] = body[0];
    at[1] = reason;
    (void)put_u16(at + 2, detail);
}

static void answer_identity(const STATE_MEMORY uint8_t *body) ON_STACK {
    const struct identity *identity = hal_identity();
    STATE_MEMORY uint8_t *at = begin(IDENTITY, body);

    *at++ = PROTOCOL_VERSION;
    *at++ = identity->firmware_major;
    *at++ = identity->firmware_minor;
    at = put_u32(at, identity->board_id);
    at = put_u32(at, board.next_tick);
    at = put_u16(at, (uint16_t)TICK_US);
    *at++ = identity->adc_bits;
    *at++ = identity->dac_bits;
    memcpy(at, identity->scalings, sizeof identity->scalings);
    at = put_u16(at + sizeof identity->scalings, CAPTURE_US);
    at = put_u16(at, CAPTURE_SIZE);
    *at++ = hal_reset_cause();
    memcpy(at, identity->build, sizeof identity->build);
}

/* Rule 2.  Returns the reason of a refusal, as all below. */
uint8_t answer_hello(const STATE_MEMORY uint8_t *body, uint16_t *detail) ON_STACK {
    uint16_t session = get_u16(body + 2);

    if (body[4] > PROTOCOL_VERSION || body[5] < PROTOCOL_VERSION) {
        *detail = PROTOCOL_VERSION;
        return VERSION;
    }
    if (!board.host.session_open || session != board.host.session) {
        board.host.session_open = true;
        board.host.session = session;
        board.host.kept_count = 0;
    }
    answer_identity(body);
    return ACCEPTED;
}

static void answer_pong(const STATE_MEMORY uint8_t *body) ON_STACK {
    STATE_MEMORY uint8_t *at = put_u32(begin(PONG, body), board.next_tick);

    (void)put_u16(put_u16(at, board.receiver.bad_frames), board.overruns);
}

void answer_parameters(const STATE_MEMORY uint8_t *body) ON_STACK {
    const STATE_MEMORY struct gains *gains = &board.law.gains;
    const STATE_MEMORY struct limits *limits = &board.loop.limits;
    STATE_MEMORY uint8_t *at = begin(PARAMETERS, body);
    uint8_t n;

    *at++ = gains->law;
    for (n = 0; n < 4U; n++) {
        at = put_u16(at, (uint16_t)gains->mantissa[n]);
        *at++ = gains->shift[n];
    }
    at = put_u16(put_u16(put_u16(at, gains->i_0), gains->x_0), gains->u_0);
    at = put_u16(put_u16(put_u16(at, limits->x_ref_min), limits->x_ref_max), limits->x_ref_step);
    at = put_u16(put_u16(put_u16(at, limits->x_ref_slew), limits->u_max), board.host.divider);
    *at++ = board.host.policy;
    (void)put_u32(put_u16(at, board.host.timeout_ms), board.loop.gains_tick);
}

static uint8_t set_mode(const STATE_MEMORY uint8_t *body) ON_STACK {
    if (board.capture.running && body[2] != MODE_IDLE) {
        return BUSY;
    }
    board.loop.fault = false;
    output_rearm();
    loop_set_mode(body[2]);
    return ACCEPTED;
}

static uint8_t set_reference(const STATE_MEMORY uint8_t *body, uint16_t *detail) ON_STACK {
    const STATE_MEMORY struct limits *limits = &board.loop.limits;
    uint16_t x_ref = get_u16(body + 2);

    if (x_ref < limits->x_ref_min || x_ref > limits->x_ref_max) {
        *detail = x_ref < limits->x_ref_min ? limits->x_ref_min : limits->x_ref_max;
        return OUT_OF_RANGE;
    }
    if (distance(x_ref, board.reference.x_ref) > reference_allowance()) {
        *detail = reference_allowance();
        return SLEW;
    }
    loop_set_reference(x_ref);
    return ACCEPTED;
}

static void set_gains(const STATE_MEMORY uint8_t *body) ON_STACK {
    STATE_MEMORY struct gains *gains = &board.law.gains;
    uint8_t n;

    gains->law = body[2];
    for (n = 0; n < 4U; n++) {
        gains->mantissa[n] = get_i16(body + 3U + 3U * n);
        gains->shift[n] = body[5U + 3U * n];
    }
    gains->i_0 = get_u16(body + 15);
    gains->x_0 = get_u16(body + 17);
    gains->u_0 = get_u16(body + 19);
    board.loop.gains_tick = board.next_tick;
}

static uint8_t excite(const STATE_MEMORY uint8_t *body, uint16_t *detail) ON_STACK {
    const STATE_MEMORY struct limits *limits = &board.loop.limits;
    static STATE_MEMORY struct signal signal; /* not on the stack, which an 8051 has little of */
    uint16_t low, high, amplitude;

    signal.shape = body[2];
    signal.target = body[3];
    signal.amplitude = get_i16(body + 4);
    signal.offset = get_u16(body + 6);
    signal.period = get_u16(body + 8);
    signal.period_end = get_u16(body + 10);
    signal.seed = get_u16(body + 12);
    signal.duration = get_u32(body + 14);
    if (board.loop.fault) {
        return FAULT_ACTIVE;
    }
    if (board.capture.running) {
        return BUSY;
    }
    if (board.loop.mode != (signal.target == TARGET_U ? MODE_OPEN_LOOP : MODE_CLOSED_LOOP)) {
        *detail = board.loop.mode;
        return WRONG_MODE;
    }
    low = signal.target == TARGET_U ? 0U : limits->x_ref_min;
    high = signal.target == TARGET_U ? limits->u_max : limits->x_ref_max;
    amplitude = (uint16_t)(signal.amplitude < 0 ? -signal.amplitude : signal.amplitude);
    if (signal.offset < low + amplitude) {
        *detail = low;
        return OUT_OF_RANGE;
    }
    if (signal.offset + amplitude > high) {
        *detail = high;
        return OUT_OF_RANGE;
    }
    if (signal.shape == SHAPE_CHIRP && signal.duration == 0U) {
        *detail = 1;
        return OUT_OF_RANGE;
    }
    excitation_start(&signal);
    return ACCEPTED;
}

static uint8_t capture(const STATE_MEMORY uint8_t *body, uint16_t *detail) ON_STACK {
    uint16_t u_from = get_u16(body + 2);
    uint16_t u_to = get_u16(body + 4);
    uint16_t pre = get_u16(body + 6);
    uint16_t count = get_u16(body + 8);

    if (board.loop.fault) {
        return FAULT_ACTIVE;
    }
    if (board.capture.running) {
        return BUSY;
    }
    if (board.loop.mode == MODE_CLOSED_LOOP) {
        *detail = board.loop.mode;
        return WRONG_MODE;
    }
    if (u_from > board.loop.limits.u_max || u_to > board.loop.limits.u_max) {
        *detail = board.loop.limits.u_max;
        return OUT_OF_RANGE;
    }
#if CAPTURE_SIZE < 2000U /* the range of the table */
    if (count > CAPTURE_SIZE) {
        *detail = CAPTURE_SIZE;
        return OUT_OF_RANGE;
    }
#endif
    capture_start(u_from, u_to, pre, count, board.next_tick);
    return ACCEPTED;
}

static uint8_t read_capture(const STATE_MEMORY uint8_t *body) ON_STACK {
    uint16_t index = get_u16(body + 2);
    STATE_MEMORY uint8_t *at;

    if (board.capture.running) {
        return BUSY;
    }
    if (!board.capture.there || index >= board.capture.count) {
        return NOT_AVAILABLE;
    }
    at = put_u16(put_u16(begin(CAPTURE_BLOCK, body), index), board.capture.count);
    capture_pack(index, put_u32(at, board.capture.began_tick));
    return ACCEPTED;
}

/* Executes a command that was checked, composes its answer unless it is refused, and returns the reason. */
uint8_t command_execute(const STATE_MEMORY uint8_t *body, uint16_t *detail) ON_STACK {
    uint8_t reason = ACCEPTED;

    *detail = 0;
    switch (body[0]) {
        case PING:
            answer_pong(body);
            return ACCEPTED;
        case GET_PARAMETERS:
            answer_parameters(body);
            return ACCEPTED;
        case READ_CAPTURE:
            return read_capture(body);
        case SET_MODE:
            reason = set_mode(body);
            break;
        case SET_REFERENCE:
            reason = set_reference(body, detail);
            break;
        case SET_GAINS:
            set_gains(body);
            break;
        case EXCITE:
            reason = excite(body, detail);
            break;
        case CAPTURE:
            reason = capture(body, detail);
            break;
        case SET_STREAM:
            board.host.divider = get_u16(body + 2);
            break;
        case SET_HOST_LOSS:
            host_set_loss(body[2], get_u16(body + 3));
            break;
        default: /* RESET: STOP and HELLO do not come here */
            board.host.reset_wait = RESET_WAIT_TICKS;
            break;
    }
    if (reason == ACCEPTED) {
        answer_ack(body);
    }
    return reason;
}
