/* Test signals, tick by tick, in counts: rule 8 and 'Arithmetic of the board'. */
#include "core.h"

#define HARMONICS 8U

/* Sets sweep to 2^48 / divisor, rounded down, 16 bits at a time. */
static void divide_turn(uint16_t divisor) ON_STACK {
    uint32_t rest = 1;
    uint8_t n;

    board.excitation.of.chirp.sweep = 0;
    for (n = 0; n < 3U; n++) {
        uint32_t digit = (rest << 16) / divisor;
        rest = (rest << 16) - digit * divisor;
        board.excitation.of.chirp.sweep = board.excitation.of.chirp.sweep << 16 | digit;
    }
}

/* sweep / divisor, rounded down and in place: sdcc has no division of 64 bits for an 8051, and little stack. */
static void divide_sweep(uint32_t divisor) {
    uint32_t lower = (uint32_t)board.excitation.of.chirp.sweep;
    uint32_t rest = (uint32_t)(board.excitation.of.chirp.sweep >> 32);
    uint8_t n;

    board.excitation.of.chirp.sweep = (uint64_t)(rest / divisor) << 32;
    rest %= divisor;
    for (n = 0; n < 32U; n++) { /* the quotient comes into `lower` from below as the dividend leaves above */
        bool carry = rest >> 31 != 0U;
        rest = rest << 1 | lower >> 31;
        lower <<= 1;
        if (carry || rest >= divisor) {
            rest -= divisor;
            lower |= 1U;
        }
    }
    board.excitation.of.chirp.sweep |= lower;
}

/* Sets sweep to |sweep - step|, plus divisor - 1 if that was below 0, so that its quotient is rounded away from
 * 0; whether it was. */
static bool subtract_step(uint32_t divisor) ON_STACK {
    if (board.excitation.of.chirp.sweep >= board.excitation.of.chirp.step) {
        board.excitation.of.chirp.sweep -= board.excitation.of.chirp.step;
        return false;
    }
    board.excitation.of.chirp.sweep = board.excitation.of.chirp.step - board.excitation.of.chirp.sweep + divisor - 1U;
    return true;
}

/* Below 0 as 2^64 minus it: only the low 48 bits of the phase are looked at. */
static void negate_sweep(void) ON_STACK {
    board.excitation.of.chirp.sweep = (uint64_t)0 - board.excitation.of.chirp.sweep;
}

static void add_steps(void) ON_STACK {
    board.excitation.of.chirp.step += board.excitation.of.chirp.sweep;
    board.excitation.of.chirp.phase += board.excitation.of.chirp.step;
}

/* From one value of a chirp to the next; the first is at phase 0.  The step, 2^48 // period, is needed for the second,
 * its change, (2^48 // period_end - step) // duration, for the third: so an 8051 has a tick for each division; and a
 * function for each part, as it has little stack. */
static void advance_chirp(void) {
    uint32_t duration = board.excitation.signal.duration;
    bool falls;

    if (board.excitation.ticks == 0U) {
        divide_turn(board.excitation.signal.period);
        board.excitation.of.chirp.step = board.excitation.of.chirp.sweep;
        return;
    }
    if (board.excitation.ticks == 1U) {
        divide_turn(board.excitation.signal.period_end);
        board.excitation.of.chirp.phase = board.excitation.of.chirp.step;
        return;
    }
    if (board.excitation.ticks == 2U) {
        falls = subtract_step(duration);
        divide_sweep(duration);
        if (falls) {
            negate_sweep();
        }
    }
    add_steps();
}

void excitation_start(const STATE_MEMORY struct signal *signal) ON_STACK {
    board.excitation.signal = *signal;
    board.excitation.active = true;
    board.excitation.ahead = false;
    board.excitation.ticks = 0;
    board.excitation.in_period = 0;
    board.excitation.prbs = (uint16_t)(signal->seed % 32767U + 1U);
    board.excitation.of.chirp.phase = 0;
    board.excitation.of.chirp.step = 0;
    board.excitation.of.chirp.sweep = 0;
    board.excitation.announced = excitation_done();
}

/* Whether the duration is over at the next value, so that the signal stays at its offset. */
bool excitation_done(void) {
    const STATE_MEMORY struct signal *signal = &board.excitation.signal;

    return signal->shape == SHAPE_NONE || (signal->duration != 0U && signal->duration <= board.excitation.ticks);
}

/* Whether it was over at the latest value. */
bool excitation_over(void) {
    const STATE_MEMORY struct signal *signal = &board.excitation.signal;

    return signal->shape == SHAPE_NONE || (signal->duration != 0U && signal->duration < board.excitation.ticks);
}

/* in_period / period of a turn, rounded down to 2^-32, from one value to the next: a quotient grows by that of 1, and by
 * another 1 where the remainders reach the period.  So 48 bits are divided once, as two times 32 by 16. */
static void advance_multisine(void) ON_STACK {
    STATE_MEMORY struct multisine_state *turn = &board.excitation.of.multisine;
    uint16_t period = board.excitation.signal.period;

    if (board.excitation.ticks == 1U && period != 1U) {
        uint16_t upper = (uint16_t)(UINT32_C(0x10000) / period);
        uint32_t rest = (UINT32_C(0x10000) - (uint32_t)upper * period) << 16; /* a product is faster than a remainder */
        uint16_t lower = (uint16_t)(rest / period);
        turn->step = (uint32_t)upper << 16 | lower;
        turn->step_rest = (uint16_t)(rest - (uint32_t)lower * period);
    }
    if (board.excitation.in_period == 0U) {
        turn->phase = 0;
        turn->rest = 0;
        return;
    }
    turn->phase += turn->step;
    if (turn->rest >= period - turn->step_rest) {
        turn->rest = (uint16_t)(turn->rest - (period - turn->step_rest));
        turn->phase++;
    } else {
        turn->rest = (uint16_t)(turn->rest + turn->step_rest);
    }
}

static int32_t sum_of_sines(uint16_t seed) ON_STACK {
    uint32_t phase = board.excitation.of.multisine.phase + ((uint32_t)(seed >> 7) << 23);
    uint32_t angle = 0;
    int32_t total = 0;
    uint8_t h;

    for (h = 1; h <= HARMONICS; h++) {
        int16_t value;
        angle += phase - ((uint32_t)(h - 1U) << 29); /* h phase - h (h - 1) / 16 of a turn */
        value = sine_q15(angle);
        total += h > 1U && (seed >> (h - 2U) & 1U) != 0U ? -value : value;
    }
    return total;
}

static int32_t chirp(int16_t amplitude) ON_STACK {
    return divide_rounded((int32_t)amplitude * sine_q15((uint32_t)(board.excitation.of.chirp.phase >> 16)), 32767);
}

static int16_t prbs(int16_t amplitude) ON_STACK {
    uint16_t r = board.excitation.prbs;

    if (board.excitation.ticks != 0U && board.excitation.in_period == 0U) {
        r = (uint16_t)((r << 1 | ((r >> 14 ^ r >> 13) & 1U)) & 0x7FFFU);
        board.excitation.prbs = r;
    }
    return r >> 14 != 0U ? amplitude : (int16_t)-amplitude;
}

static int32_t sawtooth(int16_t amplitude) ON_STACK {
    int32_t numerator = 2 * (int32_t)amplitude * board.excitation.in_period;

    return divide_rounded(numerator, board.excitation.signal.period) - amplitude;
}

/* At most 4095 * 8 * 32767, twice that and a peak: below 2^31. */
static int32_t multisine(int16_t amplitude) ON_STACK {
    uint16_t seed = board.excitation.signal.seed;
    int32_t value = divide_rounded(amplitude * sum_of_sines(seed), (int32_t)MULTISINE_PEAK[seed & 0x7FU]);
    int16_t top = amplitude < 0 ? (int16_t)-amplitude : amplitude;

    return value > top ? top : value < -top ? -top : value;
}

/* The shape alone, without the offset.  Each is a function, so that an 8051 has one's locals on its stack at a time. */
static int32_t shape(void) ON_STACK {
    const STATE_MEMORY struct signal *signal = &board.excitation.signal;

    switch (signal->shape) {
        case SHAPE_STEP:
            return board.excitation.ticks >= signal->period ? signal->amplitude : 0;
        case SHAPE_RECTANGLE:
            return 2 * (uint32_t)board.excitation.in_period < signal->period ? signal->amplitude : -signal->amplitude;
        case SHAPE_SAWTOOTH:
            return sawtooth(signal->amplitude);
        case SHAPE_PRBS:
            return prbs(signal->amplitude);
        case SHAPE_MULTISINE:
            return multisine(signal->amplitude);
        case SHAPE_CHIRP:
            return chirp(signal->amplitude);
        default:
            return 0;
    }
}

/* The next value of the signal, in counts of its target. */
uint16_t excitation_next(void) ON_STACK {
    int32_t value = board.excitation.signal.offset;

    if (board.excitation.signal.shape == SHAPE_CHIRP) {
        advance_chirp();
    } else if (board.excitation.signal.shape == SHAPE_MULTISINE && board.excitation.ticks != 0U) {
        advance_multisine();
    }
    if (!excitation_done()) {
        value += shape();
    }
    if (board.excitation.ticks < UINT32_MAX) {
        board.excitation.ticks++;
    }
    board.excitation.in_period++;
    if (board.excitation.in_period >= board.excitation.signal.period) {
        board.excitation.in_period = 0;
    }
    return (uint16_t)value;
}
