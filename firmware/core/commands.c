/* What commands do, when they are refused, and their answers: rules 2, 6 to 8, 12, 15 and 17.
 *
 * A refused command changes nothing.  An answer is composed when its command is executed, and is then only copied: what
 * it says is what was in force at that tick, however long it waits for the line, and in each repetition (rule 3).
 */
#include <string.h>

#include "core.h"

static B51_STATE_MEMORY uint8_t *begin(uint8_t type, const B51_STATE_MEMORY uint8_t *body) B51_ON_STACK {
    b51_board.host.answer[0] = type;
    b51_board.host.answer[1] = body[1]; /* the id */
    return b51_board.host.answer + 2;
}

void b51_answer_ack(const B51_STATE_MEMORY uint8_t *body) B51_ON_STACK {
    B51_STATE_MEMORY uint8_t *at = begin(B51_ACK, body);

    *at = body[0];
    (void)b51_put_u32(at + 1, b51_board.next_tick);
}

void b51_answer_nack(const B51_STATE_MEMORY uint8_t *body, uint8_t reason, uint16_t detail) B51_ON_STACK {
    B51_STATE_MEMORY uint8_t *at = begin(B51_NACK, body);

    at[0] = body[0];
    at[1] = reason;
    (void)b51_put_u16(at + 2, detail);
}

static void answer_identity(const B51_STATE_MEMORY uint8_t *body) B51_ON_STACK {
    const struct b51_identity *identity = b51_hal_identity();
    B51_STATE_MEMORY uint8_t *at = begin(B51_IDENTITY, body);

    *at++ = B51_PROTOCOL_VERSION;
    *at++ = identity->firmware_major;
    *at++ = identity->firmware_minor;
    at = b51_put_u32(at, identity->board_id);
    at = b51_put_u32(at, b51_board.next_tick);
    at = b51_put_u16(at, (uint16_t)B51_TICK_US);
    *at++ = identity->adc_bits;
    *at++ = identity->dac_bits;
    (void)memcpy(at, identity->scalings, sizeof identity->scalings);
    at = b51_put_u16(at + sizeof identity->scalings, B51_CAPTURE_US);
    at = b51_put_u16(at, B51_CAPTURE_SIZE);
    *at++ = b51_hal_reset_cause();
    (void)memcpy(at, identity->build, sizeof identity->build);
}

/* Rule 2.  Returns the reason of a refusal, as all below. */
uint8_t b51_answer_hello(const B51_STATE_MEMORY uint8_t *body, uint16_t *detail) B51_ON_STACK {
    uint16_t session = b51_get_u16(body + 2);

    if (body[4] > B51_PROTOCOL_VERSION || body[5] < B51_PROTOCOL_VERSION) {
        *detail = B51_PROTOCOL_VERSION;
        return B51_VERSION;
    }
    if (!b51_board.host.session_open || session != b51_board.host.session) {
        b51_board.host.session_open = true;
        b51_board.host.session = session;
        b51_board.host.kept_count = 0;
    }
    answer_identity(body);
    return B51_ACCEPTED;
}

static void answer_pong(const B51_STATE_MEMORY uint8_t *body) B51_ON_STACK {
    B51_STATE_MEMORY uint8_t *at = b51_put_u32(begin(B51_PONG, body), b51_board.next_tick);

    (void)b51_put_u16(b51_put_u16(at, b51_board.receiver.bad_frames), b51_board.overruns);
}

void b51_answer_parameters(const B51_STATE_MEMORY uint8_t *body) B51_ON_STACK {
    const B51_STATE_MEMORY struct b51_gains *gains = &b51_board.law.gains;
    const B51_STATE_MEMORY struct b51_limits *limits = &b51_board.loop.limits;
    B51_STATE_MEMORY uint8_t *at = begin(B51_PARAMETERS, body);
    uint8_t n;

    *at++ = gains->law;
    for (n = 0; n < 4U; n++) {
        at = b51_put_u16(at, (uint16_t)gains->mantissa[n]);
        *at++ = gains->shift[n];
    }
    at = b51_put_u16(b51_put_u16(b51_put_u16(at, gains->i_0), gains->x_0), gains->u_0);
    at = b51_put_u16(b51_put_u16(b51_put_u16(at, limits->x_ref_min), limits->x_ref_max), limits->x_ref_step);
    at = b51_put_u16(b51_put_u16(b51_put_u16(at, limits->x_ref_slew), limits->u_max), b51_board.host.divider);
    *at++ = b51_board.host.policy;
    (void)b51_put_u32(b51_put_u16(at, b51_board.host.timeout_ms), b51_board.loop.gains_tick);
}

/* In a frame of its own, as a message never changes its length: a host that does not know it does not ask for it. */
static void answer_health(const B51_STATE_MEMORY uint8_t *body) B51_ON_STACK {
    (void)b51_put_u16(b51_put_u16(begin(B51_HEALTH, body), b51_hal_stack_free()), b51_hal_input_at_power_on());
}

static void answer_calibration(const B51_STATE_MEMORY uint8_t *body) B51_ON_STACK {
    const B51_STATE_MEMORY struct b51_calibration_state *of = &b51_board.calibration;
    B51_STATE_MEMORY uint8_t *at = b51_put_u16(b51_put_u16(begin(B51_CALIBRATION, body), of->low_read), of->low_true);

    at = b51_put_u16(b51_put_u16(at, of->high_read), of->high_true);
    *at = b51_hal_calibration_is_kept() ? 1U : 0U;
}

/* Not while the coil is driven: x would jump. */
static uint8_t set_calibration(const B51_STATE_MEMORY uint8_t *body, uint16_t *detail) B51_ON_STACK {
    if (b51_board.loop.fault) {
        return B51_FAULT_ACTIVE;
    }
    if (b51_board.capture.running) {
        return B51_BUSY;
    }
    if (b51_board.loop.mode != B51_MODE_IDLE) {
        *detail = b51_board.loop.mode;
        return B51_WRONG_MODE;
    }
    *detail = b51_calibration_set(body + 2);
    if (*detail != 0U) {
        return B51_OUT_OF_RANGE;
    }
    b51_hal_keep_calibration(body + 2);
    return B51_ACCEPTED;
}

static uint8_t set_mode(const B51_STATE_MEMORY uint8_t *body) B51_ON_STACK {
    if (b51_board.capture.running && body[2] != B51_MODE_IDLE) {
        return B51_BUSY;
    }
    b51_board.loop.fault = false;
    b51_output_rearm();
    b51_loop_set_mode(body[2]);
    return B51_ACCEPTED;
}

static uint8_t set_reference(const B51_STATE_MEMORY uint8_t *body, uint16_t *detail) B51_ON_STACK {
    const B51_STATE_MEMORY struct b51_limits *limits = &b51_board.loop.limits;
    uint16_t x_ref = b51_get_u16(body + 2);

    if (x_ref < limits->x_ref_min || x_ref > limits->x_ref_max) {
        *detail = x_ref < limits->x_ref_min ? limits->x_ref_min : limits->x_ref_max;
        return B51_OUT_OF_RANGE;
    }
    if (b51_distance(x_ref, b51_board.reference.x_ref) > b51_reference_allowance()) {
        *detail = b51_reference_allowance();
        return B51_SLEW;
    }
    b51_loop_set_reference(x_ref);
    return B51_ACCEPTED;
}

static void set_gains(const B51_STATE_MEMORY uint8_t *body) B51_ON_STACK {
    B51_STATE_MEMORY struct b51_gains *gains = &b51_board.law.gains;
    uint8_t n;

    gains->law = body[2];
    for (n = 0; n < 4U; n++) {
        gains->mantissa[n] = b51_get_i16(body + 3U + 3U * n);
        gains->shift[n] = body[5U + 3U * n];
    }
    gains->i_0 = b51_get_u16(body + 15);
    gains->x_0 = b51_get_u16(body + 17);
    gains->u_0 = b51_get_u16(body + 19);
    b51_board.loop.gains_tick = b51_board.next_tick;
}

static uint8_t excite(const B51_STATE_MEMORY uint8_t *body, uint16_t *detail) B51_ON_STACK {
    const B51_STATE_MEMORY struct b51_limits *limits = &b51_board.loop.limits;
    static B51_STATE_MEMORY struct b51_signal signal; /* not on the stack, which an 8051 has little of */
    uint16_t low, high, amplitude;

    signal.shape = body[2];
    signal.target = body[3];
    signal.amplitude = b51_get_i16(body + 4);
    signal.offset = b51_get_u16(body + 6);
    signal.period = b51_get_u16(body + 8);
    signal.period_end = b51_get_u16(body + 10);
    signal.seed = b51_get_u16(body + 12);
    signal.duration = b51_get_u32(body + 14);
    if (b51_board.loop.fault) {
        return B51_FAULT_ACTIVE;
    }
    if (b51_board.capture.running) {
        return B51_BUSY;
    }
    if (b51_board.loop.mode != (signal.target == B51_TARGET_U ? B51_MODE_OPEN_LOOP : B51_MODE_CLOSED_LOOP)) {
        *detail = b51_board.loop.mode;
        return B51_WRONG_MODE;
    }
    low = signal.target == B51_TARGET_U ? 0U : limits->x_ref_min;
    high = signal.target == B51_TARGET_U ? limits->u_max : limits->x_ref_max;
    amplitude = (uint16_t)(signal.amplitude < 0 ? -signal.amplitude : signal.amplitude);
    if (signal.offset < low + amplitude) {
        *detail = low;
        return B51_OUT_OF_RANGE;
    }
    if (signal.offset + amplitude > high) {
        *detail = high;
        return B51_OUT_OF_RANGE;
    }
    if (signal.shape == B51_SHAPE_CHIRP && signal.duration == 0U) {
        *detail = 1;
        return B51_OUT_OF_RANGE;
    }
    b51_excitation_start(&signal);
    return B51_ACCEPTED;
}

static uint8_t capture(const B51_STATE_MEMORY uint8_t *body, uint16_t *detail) B51_ON_STACK {
    uint16_t u_from = b51_get_u16(body + 2);
    uint16_t u_to = b51_get_u16(body + 4);
    uint16_t pre = b51_get_u16(body + 6);
    uint16_t count = b51_get_u16(body + 8);

    if (b51_board.loop.fault) {
        return B51_FAULT_ACTIVE;
    }
    if (b51_board.capture.running) {
        return B51_BUSY;
    }
    if (b51_board.loop.mode == B51_MODE_CLOSED_LOOP) {
        *detail = b51_board.loop.mode;
        return B51_WRONG_MODE;
    }
    if (u_from > b51_board.loop.limits.u_max || u_to > b51_board.loop.limits.u_max) {
        *detail = b51_board.loop.limits.u_max;
        return B51_OUT_OF_RANGE;
    }
#if B51_CAPTURE_SIZE < 2000U /* the range of the table */
    if (count > B51_CAPTURE_SIZE) {
        *detail = B51_CAPTURE_SIZE;
        return B51_OUT_OF_RANGE;
    }
#endif
    b51_capture_start(u_from, u_to, pre, count, b51_board.next_tick);
    return B51_ACCEPTED;
}

static uint8_t read_capture(const B51_STATE_MEMORY uint8_t *body) B51_ON_STACK {
    uint16_t index = b51_get_u16(body + 2);
    B51_STATE_MEMORY uint8_t *at;

    if (b51_board.capture.running) {
        return B51_BUSY;
    }
    if (!b51_board.capture.there || index >= b51_board.capture.count) {
        return B51_NOT_AVAILABLE;
    }
    at = b51_put_u16(b51_put_u16(begin(B51_CAPTURE_BLOCK, body), index), b51_board.capture.count);
    b51_capture_pack(index, b51_put_u32(at, b51_board.capture.began_tick));
    return B51_ACCEPTED;
}

/* Executes a command that was checked, composes its answer unless it is refused, and returns the reason. */
uint8_t b51_command_execute(const B51_STATE_MEMORY uint8_t *body, uint16_t *detail) B51_ON_STACK {
    uint8_t reason = B51_ACCEPTED;

    *detail = 0;
    switch (body[0]) {
        case B51_PING:
            answer_pong(body);
            return B51_ACCEPTED;
        case B51_GET_PARAMETERS:
            b51_answer_parameters(body);
            return B51_ACCEPTED;
        case B51_GET_HEALTH:
            answer_health(body);
            return B51_ACCEPTED;
        case B51_GET_CALIBRATION:
            answer_calibration(body);
            return B51_ACCEPTED;
        case B51_READ_CAPTURE:
            return read_capture(body);
        case B51_SET_MODE:
            reason = set_mode(body);
            break;
        case B51_SET_REFERENCE:
            reason = set_reference(body, detail);
            break;
        case B51_SET_GAINS:
            set_gains(body);
            break;
        case B51_EXCITE:
            reason = excite(body, detail);
            break;
        case B51_CAPTURE:
            reason = capture(body, detail);
            break;
        case B51_SET_CALIBRATION:
            reason = set_calibration(body, detail);
            break;
        case B51_SET_STREAM:
            b51_board.host.divider = b51_get_u16(body + 2);
            break;
        case B51_SET_HOST_LOSS:
            b51_host_set_loss(body[2], b51_get_u16(body + 3));
            break;
        default: /* RESET: STOP and HELLO do not come here */
            b51_board.host.reset_wait = B51_RESET_WAIT_TICKS;
            break;
    }
    if (reason == B51_ACCEPTED) {
        b51_answer_ack(body);
    }
    return reason;
}
