/* The firmware of a Board51 board: types, state and functions of the core.
 *
 * protocol/README.md is the specification; the rules in the comments are those of its 'Behaviour of the board'.
 * Reading order: this file, arithmetic.c, law.c, excitation.c, reference.c, output.c, capture.c, loop.c (the control
 * loop), then frames.c, receiver.c, queues.c, fields.c, commands.c, settings.c, host.c (the link), and board.c, which
 * joins the two.
 *
 * All state is in one variable.  There is one board in a program, so nothing is passed by pointer: an 8051 would look
 * up at each access which of its memories a pointer means.
 */
#ifndef BOARD51_CORE_H
#define BOARD51_CORE_H

#include <stdbool.h>
#include <stdint.h>

#include "config.h"
#include "hal.h"

#define PROTOCOL_VERSION 1U
#define COUNTS_MAX 4095
#define FRACTION_BITS 8U /* of the law's accumulator, Q23.8 */

enum { MODE_IDLE, MODE_OPEN_LOOP, MODE_CLOSED_LOOP };
enum { LAW_LQI, LAW_PID };
enum { SHAPE_NONE, SHAPE_STEP, SHAPE_RECTANGLE, SHAPE_SAWTOOTH, SHAPE_PRBS, SHAPE_MULTISINE, SHAPE_CHIRP };
enum { TARGET_U, TARGET_X_REF };
enum { HOST_LOSS_KEEP, HOST_LOSS_COIL_OFF, HOST_LOSS_HOLD };

#define FLAG_INPUT_SATURATED 0x04U
#define FLAG_POSITION_RANGE 0x08U
#define FLAG_CURRENT_RANGE 0x10U
#define FLAG_OVERRUN 0x20U
#define FLAG_HOST_LOST 0x40U
#define FLAG_FAULT 0x80U

enum {
    HELLO = 0x01,
    PING,
    SET_MODE,
    SET_REFERENCE,
    SET_GAINS,
    EXCITE,
    STOP,
    CAPTURE,
    READ_CAPTURE,
    SET_STREAM,
    SET_HOST_LOSS,
    GET_PARAMETERS,
    RESET,
    STATE = 0x40,
    IDENTITY,
    PONG,
    ACK,
    NACK,
    PARAMETERS,
    EVENT,
    CAPTURE_BLOCK
};

enum {
    ACCEPTED = 0, /* not on the line */
    UNKNOWN_TYPE,
    BAD_LENGTH,
    OUT_OF_RANGE,
    WRONG_MODE,
    BUSY,
    VERSION,
    NO_SESSION,
    NOT_AVAILABLE,
    FAULT_ACTIVE,
    SLEW
};

enum {
    RESET_POWER_ON = 1,
    RESET_WATCHDOG,
    RESET_COMMANDED,
    HOST_LOST,
    HOST_BACK,
    OVER_CURRENT,
    SENSOR_FAULT,
    OVERRUN,
    EXCITATION_DONE,
    CAPTURE_DONE,
    LIMIT_HIT,
    MODE_CHANGED,
    OUTPUT_FAULT,
    UNCOMMANDED_CURRENT,
    SETTINGS_REJECTED,
    OVERLOAD
};

/* What the main loop does in the time that the control law leaves it.  A target knows how long each takes. */
enum {
    FOR_NOTHING, /* no tick is due yet */
    FOR_RECEIVING, /* RECEIVE_AT_ONCE bytes, and a STOP in them */
    FOR_COMMAND,
    FOR_SIGNAL, /* EXCITE, and its first value */
    FOR_VALUE,  /* of a signal */
    FOR_STATE, /* a frame of its size */
    FOR_FRAME,
    WORKS
};

/* Sizes in bytes of bodies and of what stands between two delimiters. */
#define MAX_BODY 64U
#define MAX_ENCODED 67U
#define COMMAND_BODY 21U /* SET_GAINS, the longest command */
#define STATE_BODY 10U
#define ANSWER_BODY 54U /* IDENTITY, the longest answer but CAPTURE_BLOCK */
#define EVENT_BODY 9U
#define BLOCK_BODY 58U
#define MAX_FRAME (BLOCK_BODY + 5U) /* the longest that the board sends */
#define BLOCK_SAMPLES 32U

/* What differs from board to board. */
struct gains {
    uint8_t law;
    uint8_t shift[4];
    int16_t mantissa[4]; /* gain n = mantissa[n] * 2^-shift[n], counts of u_c per count */
    uint16_t i_0, x_0, u_0;
};

struct limits {
    uint16_t x_ref_min, x_ref_max, x_ref_step;
    uint16_t x_ref_slew; /* counts per second */
    uint16_t u_max;
};

struct settings {
    struct gains gains;
    struct limits limits;
};

struct identity {
    uint32_t board_id;
    uint8_t firmware_major, firmware_minor;
    uint8_t adc_bits, dac_bits;
    uint8_t scalings[24]; /* six f32 as on the line: the core does not calculate with them */
    uint8_t build[8];
};

/* State of each part; its file says what the fields mean to it. */
struct law_state {
    struct gains gains;
    int32_t sum; /* of x_ref - x, 24 bits */
    uint16_t x_previous;
    bool x_known; /* false at the first tick of closed loop: the speed is taken as 0 */
};

struct reference_state {
    uint16_t x_ref;
    uint32_t full, refill; /* x_ref_step, and x_ref_slew in a tick, as the allowance */
    uint32_t allowance; /* millionths of a count: rule 7 keeps it exactly, and all fit 32 bits */
};

struct signal { /* the fields of EXCITE */
    uint8_t shape, target;
    int16_t amplitude;
    uint16_t offset, period, period_end, seed;
    uint32_t duration;
};

struct chirp_state { /* in 2^-48 of a turn */
    uint64_t phase, step, sweep;
};

struct multisine_state { /* in 2^-32 of a turn, with what is left over a period of each */
    uint32_t phase, step;
    uint16_t rest, step_rest;
};

struct excitation_state {
    struct signal signal;
    bool active, announced;
    bool ahead;         /* `value` is the coming tick's */
    uint16_t value;     /* in counts of the target */
    uint32_t ticks;     /* values so far, saturating */
    uint16_t in_period; /* ticks mod period */
    uint16_t prbs;
    union {
        struct chirp_state chirp;
        struct multisine_state multisine;
    } of;
};

struct capture_state {
    /* Shared with the capture interrupt: bytes that one side writes at a time, so that no read is torn. */
    volatile bool running, stepped, refused, step_is_next, complete;
    bool waits; /* for the tick at which it begins */
    bool there; /* a complete capture that can be read */
    uint16_t u_from, u_to, pre, count, taken;
    uint32_t began_tick;
    uint8_t samples[CAPTURE_SIZE / 2U * 3U];
};

struct loop_state {
    struct limits limits;
    uint8_t mode;
    bool fault, host_lost, overrun, limited;
    uint16_t u;           /* what the mode says */
    uint16_t open_loop_u;
    uint8_t over_current_ticks;
    uint16_t sensor_ticks;
    uint16_t ticks_since_limit_hit; /* saturating at a second */
    uint32_t gains_tick;
};

struct output_state {
    uint16_t u;       /* the last count that the converter confirmed; a step of a capture is added at its end */
    bool unconfirmed; /* the latest write of the main loop was not confirmed */
    bool off;         /* at the end of the tick before: 0 was confirmed, and no capture ran */
    uint8_t unconfirmed_ticks, current_ticks; /* in a row, saturating */
};

struct receiver_state {
    uint8_t data[MAX_ENCODED];
    uint8_t size;
    bool overflow;
    uint16_t bad_frames;
};

struct ring {
    uint8_t first, count;
};

struct queues_state {
    struct ring rings[4];
    uint8_t states[STATE_DEPTH][STATE_BODY];
    uint8_t answers[ANSWER_DEPTH][ANSWER_BODY];
    uint8_t events[EVENT_DEPTH][EVENT_BODY];
    uint8_t blocks[BLOCK_DEPTH][BLOCK_BODY];
    uint32_t dropped;
    uint8_t frame[MAX_FRAME]; /* the one that is being sent */
    uint8_t frame_size, frame_sent;
};

struct command { /* one that waits */
    uint8_t body[COMMAND_BODY];
    uint8_t size; /* that came, which may be more */
};

struct kept_answer {
    uint8_t id, type; /* of the command */
    uint8_t body[BLOCK_BODY];
};

struct host_state {
    struct command pending[8];
    uint8_t pending_first, pending_count;
    uint8_t overtaken;     /* by a STOP: the first so many of `pending` */
    uint8_t commands_left; /* to execute before the next tick */
    uint16_t unanswered;   /* frames, saturating */
    uint16_t ticks_since_overload; /* since its event; saturating at a second */
    struct kept_answer kept[8];
    uint8_t kept_order[8]; /* places in `kept`, the one taken first in front */
    uint8_t kept_count;
    uint8_t answer[BLOCK_BODY]; /* being composed */
    bool session_open;
    uint16_t session;
    uint8_t policy;
    uint16_t timeout_ms;
    uint32_t timeout_us, silent_us;
    uint16_t divider;
    uint8_t reset_wait; /* ticks left for the ACK of RESET; 0: no reset is due */
};

struct board {
    struct law_state law;
    struct reference_state reference;
    struct excitation_state excitation;
    struct capture_state capture;
    struct loop_state loop;
    struct output_state output;
    struct receiver_state receiver;
    struct queues_state queues;
    struct host_state host;
    uint8_t body[STATE_BODY]; /* of a STATE or an EVENT, being composed */
    uint32_t next_tick;
    uint8_t events; /* number of the next one */
    uint16_t overruns;
    uint16_t ticks_since_overrun; /* since its event; saturating at a second */
};

extern STATE_MEMORY struct board board;

/* arithmetic.c */
int32_t shift_down(int32_t value, uint8_t bits);
int32_t saturated_sum(int32_t a, int32_t b);
int32_t saturated_difference(int32_t a, int32_t b);
int32_t scaled_product(int16_t mantissa, uint8_t shift, int32_t operand);
int32_t divide_rounded(int32_t numerator, int32_t denominator) ON_STACK;
int16_t sine_q15(uint32_t phase) ON_STACK;
uint16_t distance(uint16_t a, uint16_t b);

/* tables.c */
extern const TABLE_MEMORY int16_t SINE_Q15[257];
extern const TABLE_MEMORY uint32_t MULTISINE_PEAK[128];

/* law.c */
void law_reset(void);
int32_t law_accumulate(uint16_t i, uint16_t x, uint16_t x_ref);
uint16_t law_run(uint16_t i, uint16_t x, uint16_t x_ref, bool *limited) ON_STACK;

/* reference.c */
void reference_boot(uint16_t x_ref);
uint16_t reference_allowance(void);
void reference_refill(void);
void reference_jump(uint16_t x_ref);

/* excitation.c */
void excitation_start(const STATE_MEMORY struct signal *signal) ON_STACK;
bool excitation_done(void);
bool excitation_over(void);
uint16_t excitation_next(void) ON_STACK;

/* capture.c */
void capture_start(uint16_t u_from, uint16_t u_to, uint16_t pre, uint16_t count, uint32_t tick) ON_STACK;
void capture_begin(void) ON_STACK;
void capture_cancel(void);
void capture_interrupt(void) ON_STACK;
bool capture_completed(void);
uint16_t capture_u(void);
void capture_pack(uint16_t index, STATE_MEMORY uint8_t *packed) ON_STACK;

/* output.c */
void output_boot(void);
void output_write(uint16_t u);
bool output_is_unconfirmed(void);
bool output_is_bypassed(uint16_t i);
void output_rearm(void);

/* loop.c */
void loop_boot(void);
uint16_t loop_u(void);
void loop_set_mode(uint8_t mode);
void loop_switch_off(void);
void loop_end_excitation(void);
void loop_set_reference(uint16_t x_ref);
uint8_t loop_run(uint16_t i, uint16_t x);
void loop_play_ahead(void);

/* frames.c */
uint16_t crc_of(const STATE_MEMORY uint8_t *data, uint8_t size);
uint8_t frame_encode(const STATE_MEMORY uint8_t *body, uint8_t size, STATE_MEMORY uint8_t *frame);
uint8_t frame_decode(STATE_MEMORY uint8_t *encoded, uint8_t size) ON_STACK;

/* receiver.c */
uint8_t receiver_take(uint8_t byte);
void receiver_count_bad(void);

/* queues.c */
void queue_put(const STATE_MEMORY uint8_t *body) ON_STACK;
bool answers_have_left(void);
bool is_room_for_answer(uint8_t command);
void send_frames(void);

/* fields.c */
uint8_t fields_check(const STATE_MEMORY uint8_t *body, uint8_t size, uint16_t *detail) ON_STACK;
uint8_t fields_check_settings(const STATE_MEMORY uint8_t *at) ON_STACK;
bool is_sent_by_board(uint8_t type);
uint8_t body_size(uint8_t type);
void copy(STATE_MEMORY uint8_t *to, const STATE_MEMORY uint8_t *from, uint8_t size);
uint16_t get_u16(const STATE_MEMORY uint8_t *at);
uint32_t get_u32(const STATE_MEMORY uint8_t *at);
int16_t get_i16(const STATE_MEMORY uint8_t *at);
STATE_MEMORY uint8_t *put_u16(STATE_MEMORY uint8_t *at, uint16_t value);
STATE_MEMORY uint8_t *put_u32(STATE_MEMORY uint8_t *at, uint32_t value) ON_STACK;
void put_pair(STATE_MEMORY uint8_t *at, uint16_t a, uint16_t b);

/* commands.c: compose the answer into board.host.answer */
uint8_t command_execute(const STATE_MEMORY uint8_t *body, uint16_t *detail) ON_STACK;
uint8_t answer_hello(const STATE_MEMORY uint8_t *body, uint16_t *detail) ON_STACK;
void answer_ack(const STATE_MEMORY uint8_t *body) ON_STACK;
void answer_parameters(const STATE_MEMORY uint8_t *body) ON_STACK;
void answer_nack(const STATE_MEMORY uint8_t *body, uint8_t reason, uint16_t detail) ON_STACK;

/* settings.c */
uint8_t settings_boot(void);

/* host.c */
void host_boot(void);
void host_set_loss(uint8_t policy, uint16_t timeout_ms) ON_STACK;
void host_receive(const STATE_MEMORY uint8_t *body, uint8_t size) ON_STACK;
void host_execute(void);
void host_watch(void);

/* board.c: what a target calls */
void board_boot(void); /* once after a reset, when the hardware is ready */
bool board_poll(void); /* again and again: the main loop, which may wait for an interrupt where it is false */
void board_late(void); /* a tick took longer than T_s */
void emit(uint8_t code, uint16_t detail) ON_STACK;

#endif
