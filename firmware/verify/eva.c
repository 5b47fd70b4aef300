/* Entries for Frama-C's analysis of values (`make eva`): each calls a part of the core with all that may come.
 *
 * What a part relies on is stated here as ranges: those of the page's fields, which `b51_fields_check` and
 * `b51_settings_boot` enforce, and those of its own state.  That the state stays in them is not shown here.
 */
#include <__fc_builtin.h>

#include "../core/core.h"

static uint8_t any8(uint8_t low, uint8_t high) {
    return Frama_C_unsigned_char_interval(low, high);
}

static uint16_t any16(uint16_t low, uint16_t high) {
    return Frama_C_unsigned_short_interval(low, high);
}

static int32_t any32(int32_t low, int32_t high) {
    return Frama_C_interval(low, high);
}

static uint32_t any_u32(void) {
    return Frama_C_unsigned_int_interval(0, UINT32_MAX);
}

static uint16_t count(void) {
    return any16(0, B51_COUNTS_MAX);
}

static bool any_bool(void) {
    return any8(0, 1) != 0U;
}

/* Bytes: anything that a line brings. */
static void fill(uint8_t *at, uint32_t size) {
    uint32_t n;

    for (n = 0; n < size; n++) {
        at[n] = any8(0, 255);
    }
}

/* The hardware: each answer that hal.h allows. */

uint16_t b51_hal_read_current(void) {
    return count();
}

uint16_t b51_hal_read_position(void) {
    return count();
}

bool b51_hal_write_input(uint16_t u) {
    /*@ assert u <= 4095; */
    return any_bool();
}

bool b51_hal_tick_due(void) {
    return any_bool();
}

bool b51_hal_has_time(uint8_t work) {
    (void)work;
    return any_bool();
}

void b51_hal_capture_timer(uint16_t us) {
    (void)us;
}

bool b51_hal_capture_due(void) {
    return any_bool();
}

int16_t b51_hal_receive(void) {
    return (int16_t)any32(-1, 255);
}

bool b51_hal_send(uint8_t byte) {
    (void)byte;
    return any_bool();
}

void b51_hal_feed_watchdog(void) {
}

uint8_t b51_hal_reset_cause(void) {
    return any8(B51_RESET_POWER_ON, B51_RESET_COMMANDED);
}

uint16_t b51_hal_resets(void) {
    return any16(0, UINT16_MAX);
}

void b51_hal_restart(void) {
}

bool b51_hal_stack_is_intact(void) {
    return any_bool();
}

uint16_t b51_hal_stack_free(void) {
    return any16(0, UINT16_MAX);
}

uint16_t b51_hal_input_at_power_on(void) {
    return any16(0, UINT16_MAX);
}

static struct b51_identity identity;
static struct b51_settings settings;
static const struct b51_settings OF_PROGRAM = {
    {B51_LAW_LQI, {17, 14, 11, 19}, {25690, 32576, 21199, -21585}, 1304, 2034, 1756}, {248, 3680, 1751, 14008, 4095}};

const struct b51_identity *b51_hal_identity(void) {
    return &identity;
}

const struct b51_settings *b51_hal_settings(void) {
    fill((uint8_t *)&settings, sizeof settings);
    return &settings;
}

const struct b51_settings *b51_hal_program_settings(void) {
    return &OF_PROGRAM;
}

static uint8_t calibration[B51_CALIBRATION_SIZE];

const uint8_t *b51_hal_calibration(void) {
    fill(calibration, sizeof calibration);
    return any_bool() ? calibration : 0;
}

void b51_hal_keep_calibration(const uint8_t *bytes) {
    (void)bytes;
}

bool b51_hal_calibration_is_kept(void) {
    return any_bool();
}

/* calibration.c: all fields, all readings. */
void eva_calibration(void) {
    b51_calibration_boot();
    (void)b51_calibrated(count());
}

/* arithmetic.c */
void eva_arithmetic(void) {
    int32_t a = any32(INT32_MIN, INT32_MAX);
    int32_t b = any32(INT32_MIN, INT32_MAX);

    (void)b51_shift_down(a, any8(0, 31));
    (void)b51_saturated_sum(a, b);
    (void)b51_saturated_difference(a, b);
    (void)b51_scaled_product((int16_t)any32(-32767, 32767), any8(0, 30), any32(-8388608, 8388607));
    (void)b51_sine_q15(any_u32());
    (void)b51_distance(any16(0, UINT16_MAX), any16(0, UINT16_MAX));
    (void)b51_fraction_of(count(), any16(0, INT16_MAX));
}

/* law.c, reference.c, loop.c up to the output: gains, limits and state within their ranges. */
static void set_loop(void) {
    uint8_t n;

    b51_board.law.gains.law = any8(0, 1);
    for (n = 0; n < 4U; n++) {
        b51_board.law.gains.mantissa[n] = (int16_t)any32(-32767, 32767);
        b51_board.law.gains.shift[n] = any8(0, 30);
    }
    b51_board.law.gains.i_0 = count();
    b51_board.law.gains.x_0 = count();
    b51_board.law.gains.u_0 = count();
    b51_board.law.sum = any32(-8388608, 8388607);
    b51_board.law.x_previous = count();
    b51_board.law.x_known = any_bool();
    b51_board.loop.limits.x_ref_min = count();
    b51_board.loop.limits.x_ref_max = count();
    b51_board.loop.limits.x_ref_step = count();
    b51_board.loop.limits.x_ref_slew = any16(1, UINT16_MAX);
    b51_board.loop.limits.u_max = count();
}

void eva_law(void) {
    bool limited = false;

    set_loop();
    (void)b51_law_run(count(), count(), count(), &limited);
}

void eva_reference(void) {
    set_loop();
    b51_reference_boot(count());
    for (;;) {
        uint16_t x_ref = count();

        if (b51_distance(x_ref, b51_board.reference.x_ref) <= b51_reference_allowance()) {
            b51_reference_jump(x_ref);
        }
        b51_reference_refill();
    }
}

/* Where the receiver hands its bytes over: `eva_receiver` shows what is required and takes the rest for granted;
 * `eva_frames` shows the rest for each size. */
/*@ requires 1 <= size <= 67;
  @ requires \valid(encoded + (0 .. size - 1));
  @ assigns \result, encoded[0 .. size - 1] \from encoded[0 .. size - 1], size;
  @ ensures \result <= 64; */
uint8_t b51_frame_decode(uint8_t *encoded, uint8_t size);

/* receiver.c: any bytes, for ever. */
void eva_receiver(void) {
    //@ loop widen_hints b51_board.receiver.size, 67;
    for (;;) {
        (void)b51_receiver_take(any8(0, 255));
    }
}

/* frames.c: each size, any bytes. */
void eva_frames(void) {
    static uint8_t body[B51_MAX_BODY];
    static uint8_t frame[B51_MAX_BODY + 5U];
    uint8_t size;

    //@ loop unroll 67;
    for (size = 1; size <= B51_MAX_ENCODED; size++) {
        fill(frame, sizeof frame);
        (void)b51_frame_decode(frame, size);
    }
    //@ loop unroll 64;
    for (size = 1; size <= B51_MAX_BODY; size++) {
        fill(body, sizeof body);
        (void)b51_frame_encode(body, size, frame);
    }
}

/* fields.c, settings.c: any body of at least two bytes, of each type; any memory of the settings. */
void eva_fields(void) {
    static uint8_t body[B51_MAX_BODY];
    uint16_t detail = 0;
    uint16_t type;

    //@ loop unroll 256;
    for (type = 0; type <= UINT8_MAX; type++) {
        fill(body, sizeof body);
        body[0] = (uint8_t)type;
        (void)b51_fields_check(body, any8(2, B51_MAX_BODY), &detail);
    }
    (void)b51_settings_boot();
}

/* excitation.c: each shape, for ever. */
void eva_signals(void) {
    static struct b51_signal signal;

    signal.shape = any8(B51_SHAPE_NONE, B51_SHAPE_CHIRP);
    signal.target = any8(0, 1);
    signal.amplitude = (int16_t)any32(-4095, 4095);
    signal.offset = count();
    signal.period = any16(1, UINT16_MAX);
    signal.period_end = any16(1, UINT16_MAX);
    signal.seed = any16(1, UINT16_MAX);
    signal.duration = any_u32();
    if (signal.shape == B51_SHAPE_CHIRP && signal.duration == 0U) {
        signal.duration = 1;
    }
    b51_excitation_start(&signal);
    for (;;) {
        (void)b51_excitation_next();
    }
}

/* capture.c: any capture that CAPTURE may ask for, its interrupts, and blocks from its first, second and last samples. */
void eva_capture(void) {
    static uint8_t packed[48];
    uint16_t left;

    b51_capture_start(count(), count(), any16(0, B51_CAPTURE_SIZE), any16(1, B51_CAPTURE_SIZE), any_u32());
    b51_capture_begin();
    b51_board.capture.taken = any16(0, B51_CAPTURE_SIZE - 1U);
    b51_capture_interrupt();
    (void)b51_capture_completed();
    (void)b51_capture_u();
    //@ loop unroll 33;
    for (left = 1; left <= B51_BLOCK_SAMPLES + 1U; left++) {
        b51_board.capture.count = left;
        b51_capture_pack(0, packed);
        b51_board.capture.count = left + 1U;
        b51_capture_pack(1, packed);
        b51_board.capture.count = B51_CAPTURE_SIZE;
        b51_capture_pack(B51_CAPTURE_SIZE - left, packed);
    }
}

/* queues.c: any messages, a line that takes what it likes. */
void eva_queues(void) {
    static uint8_t body[B51_BLOCK_BODY];

    uint8_t type;

    for (;;) {
        //@ loop unroll 10;
        for (type = B51_STATE; type <= B51_CALIBRATION; type++) {
            fill(body, sizeof body);
            body[0] = type;
            b51_queue_put(body);
        }
        b51_send_frames();
    }
}
