/* The firmware of a Board51 board: types, state and functions of the core.
 *
 * protocol/README.md is the specification; the rules in the comments are those of its 'Behaviour of the board'.
 * Reading order: this file, arithmetic.c, law.c, excitation.c, reference.c, output.c, calibration.c, capture.c, loop.c
 * (the control loop), then frames.c, receiver.c, queues.c, fields.c, commands.c, settings.c, host.c (the link), and board.c, which
 * joins the two.
 *
 * All state is in one variable.  There is one board in a program, so nothing is passed by pointer: an 8051 would look
 * up at each access which of its memories a pointer means.
 */
#ifndef B51_CORE_H
#define B51_CORE_H

#include <stdbool.h>
#include <stdint.h>

#include "config.h"
#include "hal.h"

#define B51_PROTOCOL_VERSION 1U
#define B51_COUNTS_MAX 4095
#define B51_FRACTION_BITS 8U /* of the law's accumulator, Q23.8 */

enum { B51_MODE_IDLE, B51_MODE_OPEN_LOOP, B51_MODE_CLOSED_LOOP };
enum { B51_LAW_LQI, B51_LAW_PID };
enum {
    B51_SHAPE_NONE,
    B51_SHAPE_STEP,
    B51_SHAPE_RECTANGLE,
    B51_SHAPE_SAWTOOTH,
    B51_SHAPE_PRBS,
    B51_SHAPE_MULTISINE,
    B51_SHAPE_CHIRP
};
enum { B51_TARGET_U, B51_TARGET_X_REF };
enum { B51_HOST_LOSS_KEEP, B51_HOST_LOSS_COIL_OFF, B51_HOST_LOSS_HOLD };

#define B51_FLAG_INPUT_SATURATED 0x04U
#define B51_FLAG_POSITION_RANGE 0x08U
#define B51_FLAG_CURRENT_RANGE 0x10U
#define B51_FLAG_OVERRUN 0x20U
#define B51_FLAG_HOST_LOST 0x40U
#define B51_FLAG_FAULT 0x80U

enum {
    B51_HELLO = 0x01,
    B51_PING,
    B51_SET_MODE,
    B51_SET_REFERENCE,
    B51_SET_GAINS,
    B51_EXCITE,
    B51_STOP,
    B51_CAPTURE,
    B51_READ_CAPTURE,
    B51_SET_STREAM,
    B51_SET_HOST_LOSS,
    B51_GET_PARAMETERS,
    B51_RESET,
    B51_GET_HEALTH,
    B51_SET_CALIBRATION,
    B51_GET_CALIBRATION,
    B51_STATE = 0x40,
    B51_IDENTITY,
    B51_PONG,
    B51_ACK,
    B51_NACK,
    B51_PARAMETERS,
    B51_EVENT,
    B51_CAPTURE_BLOCK,
    B51_HEALTH,
    B51_CALIBRATION
};

enum {
    B51_ACCEPTED = 0, /* not on the line */
    B51_UNKNOWN_TYPE,
    B51_BAD_LENGTH,
    B51_OUT_OF_RANGE,
    B51_WRONG_MODE,
    B51_BUSY,
    B51_VERSION,
    B51_NO_SESSION,
    B51_NOT_AVAILABLE,
    B51_FAULT_ACTIVE,
    B51_SLEW
};

enum {
    B51_RESET_POWER_ON = 1,
    B51_RESET_WATCHDOG,
    B51_RESET_COMMANDED,
    B51_HOST_LOST,
    B51_HOST_BACK,
    B51_OVER_CURRENT,
    B51_SENSOR_FAULT,
    B51_OVERRUN,
    B51_EXCITATION_DONE,
    B51_CAPTURE_DONE,
    B51_LIMIT_HIT,
    B51_MODE_CHANGED,
    B51_OUTPUT_FAULT,
    B51_UNCOMMANDED_CURRENT,
    B51_SETTINGS_REJECTED,
    B51_OVERLOAD,
    B51_STACK_FAULT
};

/* What the main loop does in the time that the control law leaves it.  A target knows how long each takes. */
enum {
    B51_FOR_NOTHING, /* no tick is due yet */
    B51_FOR_RECEIVING, /* RECEIVE_AT_ONCE bytes, and a STOP in them */
    B51_FOR_COMMAND,
    B51_FOR_SIGNAL, /* EXCITE, and its first value */
    B51_FOR_VALUE,  /* of a signal */
    B51_FOR_STATE, /* a frame of its size */
    B51_FOR_FRAME,
    B51_WORKS
};

/* Sizes in bytes of bodies and of what stands between two delimiters. */
#define B51_MAX_BODY 64U
#define B51_MAX_ENCODED 67U
#define B51_COMMAND_BODY 21U /* SET_GAINS, the longest command */
#define B51_STATE_BODY 10U
#define B51_ANSWER_BODY 54U /* IDENTITY, the longest answer but CAPTURE_BLOCK */
#define B51_EVENT_BODY 9U
#define B51_BLOCK_BODY 58U
#define B51_CALIBRATION_SIZE 8U /* of the fields of SET_CALIBRATION */
#define B51_MAX_FRAME (B51_BLOCK_BODY + 5U) /* the longest that the board sends */
#define B51_BLOCK_SAMPLES 32U

/* What differs from board to board. */
struct b51_gains {
    uint8_t law;
    uint8_t shift[4];
    int16_t mantissa[4]; /* gain n = mantissa[n] * 2^-shift[n], counts of u_c per count */
    uint16_t i_0, x_0, u_0;
};

struct b51_limits {
    uint16_t x_ref_min, x_ref_max, x_ref_step;
    uint16_t x_ref_slew; /* counts per second */
    uint16_t u_max;
};

struct b51_settings {
    struct b51_gains gains;
    struct b51_limits limits;
};

struct b51_identity {
    uint32_t board_id;
    uint8_t firmware_major, firmware_minor;
    uint8_t adc_bits, dac_bits;
    uint8_t scalings[24]; /* six f32 as on the line: the core does not calculate with them */
    uint8_t build[8];
};

/* State of each part; its file says what the fields mean to it. */
struct b51_law_state {
    struct b51_gains gains;
    int32_t sum; /* of x_ref - x, 24 bits */
    uint16_t x_previous;
    bool x_known; /* false at the first tick of closed loop: the speed is taken as 0 */
};

struct b51_reference_state {
    uint16_t x_ref;
    uint32_t full, refill; /* x_ref_step, and x_ref_slew in a tick, as the allowance */
    uint32_t allowance; /* millionths of a count: rule 7 keeps it exactly, and all fit 32 bits */
};

struct b51_signal { /* the fields of EXCITE */
    uint8_t shape, target;
    int16_t amplitude;
    uint16_t offset, period, period_end, seed;
    uint32_t duration;
};

struct b51_chirp_state { /* in 2^-48 of a turn */
    uint64_t phase, step, sweep;
};

struct b51_multisine_state { /* in 2^-32 of a turn, with what is left over a period of each */
    uint32_t phase, step;
    uint16_t rest, step_rest;
};

struct b51_excitation_state {
    struct b51_signal signal;
    bool active, announced;
    bool ahead;         /* `value` is the coming tick's */
    uint16_t value;     /* in counts of the target */
    uint32_t ticks;     /* values so far, saturating */
    uint16_t in_period; /* ticks mod period */
    uint16_t prbs;
    union {
        struct b51_chirp_state chirp;
        struct b51_multisine_state multisine;
    } of;
};

struct b51_capture_state {
    /* Shared with the capture interrupt: bytes that one side writes at a time, so that no read is torn. */
    volatile bool running, stepped, refused, step_is_next, complete;
    bool waits; /* for the tick at which it begins */
    bool there; /* a complete capture that can be read */
    uint16_t u_from, u_to, pre, count, taken;
    uint32_t began_tick;
    uint8_t samples[B51_CAPTURE_SIZE / 2U * 3U];
};

struct b51_loop_state {
    struct b51_limits limits;
    uint8_t mode;
    bool fault, host_lost, overrun, limited;
    uint16_t u;           /* what the mode says */
    uint16_t open_loop_u;
    uint8_t over_current_ticks;
    uint16_t sensor_ticks;
    uint16_t ticks_since_limit_hit; /* saturating at a second */
    uint32_t gains_tick;
};

struct b51_output_state {
    uint16_t u;       /* the last count that the converter confirmed; a step of a capture is added at its end */
    bool unconfirmed; /* the latest write of the main loop was not confirmed */
    bool off;         /* at the end of the tick before: 0 was confirmed, and no capture ran */
    uint8_t unconfirmed_ticks, current_ticks; /* in a row, saturating */
};

struct b51_calibration_state {
    uint16_t low_read, low_true, high_read, high_true; /* counts of x */
    bool corrects; /* not each reading as it is */
    bool flatter;  /* the slope is below 1 */
    uint16_t slope; /* what it differs by from 1, in 2^-16 */
};

struct b51_receiver_state {
    uint8_t data[B51_MAX_ENCODED];
    uint8_t size;
    bool overflow;
    uint16_t bad_frames;
};

struct b51_ring {
    uint8_t first, count;
};

struct b51_queues_state {
    struct b51_ring rings[4];
    uint8_t states[B51_STATE_DEPTH][B51_STATE_BODY];
    uint8_t answers[B51_ANSWER_DEPTH][B51_ANSWER_BODY];
    uint8_t events[B51_EVENT_DEPTH][B51_EVENT_BODY];
    uint8_t blocks[B51_BLOCK_DEPTH][B51_BLOCK_BODY];
    uint32_t dropped;
    uint8_t frame[B51_MAX_FRAME]; /* the one that is being sent */
    uint8_t frame_size, frame_sent;
};

struct b51_command { /* one that waits */
    uint8_t body[B51_COMMAND_BODY];
    uint8_t size; /* that came, which may be more */
};

struct b51_kept_answer {
    uint8_t id, type; /* of the command */
    uint8_t body[B51_BLOCK_BODY];
};

struct b51_host_state {
    struct b51_command pending[8];
    uint8_t pending_first, pending_count;
    uint8_t overtaken;     /* by a STOP: how many of `pending`, from the first */
    uint8_t commands_left; /* to execute before the next tick */
    uint16_t unanswered;   /* frames, saturating */
    uint16_t ticks_since_overload; /* since its event; saturating at a second */
    struct b51_kept_answer kept[8];
    uint8_t kept_order[8]; /* places in `kept`, the one taken first in front */
    uint8_t kept_count;
    uint8_t answer[B51_BLOCK_BODY]; /* being composed */
    bool session_open;
    uint16_t session;
    uint8_t policy;
    uint16_t timeout_ms;
    uint32_t timeout_us, silent_us;
    uint16_t divider;
    uint8_t reset_wait; /* ticks left for the ACK of RESET; 0: no reset is due */
};

struct b51_board {
    struct b51_law_state law;
    struct b51_reference_state reference;
    struct b51_excitation_state excitation;
    struct b51_capture_state capture;
    struct b51_loop_state loop;
    struct b51_output_state output;
    struct b51_calibration_state calibration;
    struct b51_receiver_state receiver;
    struct b51_queues_state queues;
    struct b51_host_state host;
    uint8_t body[B51_STATE_BODY]; /* of a STATE or an EVENT, being composed */
    uint32_t next_tick;
    uint8_t events; /* number of the next one */
    uint16_t overruns;
    uint16_t ticks_since_overrun; /* since its event; saturating at a second */
};

extern B51_STATE_MEMORY struct b51_board b51_board;

/* arithmetic.c */
int32_t b51_shift_down(int32_t value, uint8_t bits);
int32_t b51_saturated_sum(int32_t a, int32_t b);
int32_t b51_saturated_difference(int32_t a, int32_t b);
int32_t b51_scaled_product(int16_t mantissa, uint8_t shift, int32_t operand);
uint16_t b51_fraction_of(uint16_t a, uint16_t b);
int32_t b51_divide_rounded(int32_t numerator, int32_t denominator) B51_ON_STACK;
int16_t b51_sine_q15(uint32_t phase) B51_ON_STACK;
uint16_t b51_distance(uint16_t a, uint16_t b);

/* tables.c */
extern const B51_TABLE_MEMORY int16_t B51_SINE_Q15[257];
extern const B51_TABLE_MEMORY uint32_t B51_MULTISINE_PEAK[128];

/* law.c */
void b51_law_reset(void);
int32_t b51_law_accumulate(uint16_t i, uint16_t x, uint16_t x_ref);
uint16_t b51_law_run(uint16_t i, uint16_t x, uint16_t x_ref, bool *limited) B51_ON_STACK;

/* reference.c */
void b51_reference_boot(uint16_t x_ref);
uint16_t b51_reference_allowance(void);
void b51_reference_refill(void);
void b51_reference_jump(uint16_t x_ref);

/* excitation.c */
void b51_excitation_start(const B51_STATE_MEMORY struct b51_signal *signal) B51_ON_STACK;
bool b51_excitation_done(void);
bool b51_excitation_over(void);
uint16_t b51_excitation_next(void) B51_ON_STACK;

/* capture.c */
void b51_capture_start(uint16_t u_from, uint16_t u_to, uint16_t pre, uint16_t count, uint32_t tick) B51_ON_STACK;
void b51_capture_begin(void) B51_ON_STACK;
void b51_capture_cancel(void);
void b51_capture_interrupt(void) B51_ON_STACK;
bool b51_capture_completed(void);
uint16_t b51_capture_u(void);
void b51_capture_pack(uint16_t index, B51_STATE_MEMORY uint8_t *packed) B51_ON_STACK;

/* output.c */
void b51_output_boot(void);
void b51_output_write(uint16_t u);
bool b51_output_is_unconfirmed(void);
bool b51_output_is_bypassed(uint16_t i);
void b51_output_rearm(void);

/* calibration.c */
void b51_calibration_boot(void);
uint16_t b51_calibration_set(const B51_STATE_MEMORY uint8_t *at) B51_ON_STACK;
uint16_t b51_calibrated(uint16_t x) B51_ON_STACK;

/* loop.c */
void b51_loop_boot(void);
uint16_t b51_loop_u(void);
void b51_loop_set_mode(uint8_t mode);
void b51_loop_switch_off(void);
void b51_loop_end_excitation(void);
void b51_loop_set_reference(uint16_t x_ref);
uint8_t b51_loop_run(uint16_t i, uint16_t x);
void b51_loop_play_ahead(void);

/* frames.c */
uint16_t b51_crc_of(const B51_STATE_MEMORY uint8_t *data, uint8_t size);
uint8_t b51_frame_encode(const B51_STATE_MEMORY uint8_t *body, uint8_t size, B51_STATE_MEMORY uint8_t *frame);
uint8_t b51_frame_decode(B51_STATE_MEMORY uint8_t *encoded, uint8_t size) B51_ON_STACK;

/* receiver.c */
uint8_t b51_receiver_take(uint8_t byte);
void b51_receiver_count_bad(void);

/* queues.c */
void b51_queue_put(const B51_STATE_MEMORY uint8_t *body) B51_ON_STACK;
bool b51_answers_have_left(void);
bool b51_is_room_for_answer(uint8_t command);
void b51_send_frames(void);

/* fields.c */
uint8_t b51_fields_check(const B51_STATE_MEMORY uint8_t *body, uint8_t size, uint16_t *detail) B51_ON_STACK;
uint8_t b51_fields_check_settings(const B51_STATE_MEMORY uint8_t *at) B51_ON_STACK;
bool b51_is_sent_by_board(uint8_t type);
uint8_t b51_body_size(uint8_t type);
void b51_copy(B51_STATE_MEMORY uint8_t *to, const B51_STATE_MEMORY uint8_t *from, uint8_t size);
uint16_t b51_get_u16(const B51_STATE_MEMORY uint8_t *at);
uint32_t b51_get_u32(const B51_STATE_MEMORY uint8_t *at);
int16_t b51_get_i16(const B51_STATE_MEMORY uint8_t *at);
B51_STATE_MEMORY uint8_t *b51_put_u16(B51_STATE_MEMORY uint8_t *at, uint16_t value);
B51_STATE_MEMORY uint8_t *b51_put_u32(B51_STATE_MEMORY uint8_t *at, uint32_t value) B51_ON_STACK;
void b51_put_pair(B51_STATE_MEMORY uint8_t *at, uint16_t a, uint16_t b);

/* commands.c: compose the answer into board.host.answer */
uint8_t b51_command_execute(const B51_STATE_MEMORY uint8_t *body, uint16_t *detail) B51_ON_STACK;
uint8_t b51_answer_hello(const B51_STATE_MEMORY uint8_t *body, uint16_t *detail) B51_ON_STACK;
void b51_answer_ack(const B51_STATE_MEMORY uint8_t *body) B51_ON_STACK;
void b51_answer_parameters(const B51_STATE_MEMORY uint8_t *body) B51_ON_STACK;
void b51_answer_nack(const B51_STATE_MEMORY uint8_t *body, uint8_t reason, uint16_t detail) B51_ON_STACK;

/* settings.c */
uint8_t b51_settings_boot(void);

/* host.c */
void b51_host_boot(void);
void b51_host_set_loss(uint8_t policy, uint16_t timeout_ms) B51_ON_STACK;
void b51_host_receive(const B51_STATE_MEMORY uint8_t *body, uint8_t size) B51_ON_STACK;
void b51_host_execute(void);
void b51_host_watch(void);

/* board.c: what a target calls */
void b51_board_boot(void); /* once after a reset, when the hardware is ready */
bool b51_board_poll(void); /* again and again: the main loop, which may wait for an interrupt where it is false */
void b51_board_late(void); /* a tick took longer than T_s */
void b51_emit(uint8_t code, uint16_t detail) B51_ON_STACK;

#endif
