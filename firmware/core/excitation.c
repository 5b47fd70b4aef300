/* Test signals, tick by tick, in counts: rule 8 and 'Arithmetic of the board'. */
#include "core.h"

#define HARMONICS 8U

/* Twice the largest sum and the largest peak, which `multisine` divides: 4095 * 8 * 32767 * 2 + 224331. */
B51_STATIC_ASSERT(b51_a_multisine_has_32_bits, INT64_C(65534) * B51_COUNTS_MAX * HARMONICS + 224331 <= INT32_MAX);

/* Sets sweep to 2^48 / divisor, rounded down, 16 bits at a time. */
static void divide_turn(uint16_t divisor) B51_ON_STACK {
    uint32_t rest = 1;
    uint8_t n;

    b51_board.excitation.of.chirp.sweep = 0;
    for (n = 0; n < 3U; n++) {
        uint32_t digit = (rest << 16) / divisor;
        rest = (rest << 16) - digit * divisor;
        b51_board.excitation.of.chirp.sweep = b51_board.excitation.of.chirp.sweep << 16 | digit;
    }
}

/* sweep / divisor, rounded down and in place: sdcc has no division of 64 bits for an 8051, and little stack. */
static void divide_sweep(uint32_t divisor) {
    uint32_t lower = (uint32_t)b51_board.excitation.of.chirp.sweep;
    uint32_t rest = (uint32_t)(b51_board.excitation.of.chirp.sweep >> 32);
    uint8_t n;

    b51_board.excitation.of.chirp.sweep = (uint64_t)(rest / divisor) << 32;
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
    b51_board.excitation.of.chirp.sweep |= lower;
}

/* Sets sweep to |sweep - step|, plus divisor - 1 if that was below 0, so that its quotient is rounded away from
 * 0; whether it was. */
static bool subtract_step(uint32_t divisor) B51_ON_STACK {
    if (b51_board.excitation.of.chirp.sweep >= b51_board.excitation.of.chirp.step) {
        b51_board.excitation.of.chirp.sweep -= b51_board.excitation.of.chirp.step;
        return false;
    }
    b51_board.excitation.of.chirp.sweep =
        b51_board.excitation.of.chirp.step - b51_board.excitation.of.chirp.sweep + divisor - 1U;
    return true;
}

/* Below 0 as 2^64 minus it: only the low 48 bits of the phase count. */
static void negate_sweep(void) B51_ON_STACK {
    b51_board.excitation.of.chirp.sweep = (uint64_t)0 - b51_board.excitation.of.chirp.sweep;
}

static void add_steps(void) B51_ON_STACK {
    b51_board.excitation.of.chirp.step += b51_board.excitation.of.chirp.sweep;
    b51_board.excitation.of.chirp.phase += b51_board.excitation.of.chirp.step;
}

/* From one value of a chirp to the next; the first is at phase 0.  The step, 2^48 / period rounded down, is needed for the
 * second, its change, (2^48 / period_end - step) / duration, for the third: so an 8051 has a tick for each division; and a
 * function for each part, as it has little stack. */
static void advance_chirp(void) {
    uint32_t duration = b51_board.excitation.signal.duration;
    bool falls;

    if (b51_board.excitation.ticks == 0U) {
        divide_turn(b51_board.excitation.signal.period);
        b51_board.excitation.of.chirp.step = b51_board.excitation.of.chirp.sweep;
        return;
    }
    if (b51_board.excitation.ticks == 1U) {
        divide_turn(b51_board.excitation.signal.period_end);
        b51_board.excitation.of.chirp.phase = b51_board.excitation.of.chirp.step;
        return;
    }
    if (b51_board.excitation.ticks == 2U) {
        falls = subtract_step(duration);
        divide_sweep(duration);
        if (falls) {
            negate_sweep();
        }
    }
    add_steps();
}

void b51_excitation_start(const B51_STATE_MEMORY struct b51_signal *signal) B51_ON_STACK {
    b51_board.excitation.signal = *signal;
    b51_board.excitation.active = true;
    b51_board.excitation.ahead = false;
    b51_board.excitation.ticks = 0;
    b51_board.excitation.in_period = 0;
    b51_board.excitation.prbs = (uint16_t)(signal->seed % 32767U + 1U);
    b51_board.excitation.of.chirp.phase = 0;
    b51_board.excitation.of.chirp.step = 0;
    b51_board.excitation.of.chirp.sweep = 0;
    b51_board.excitation.announced = b51_excitation_done();
}

/* Whether the duration is over at the next value, so that the signal stays at its offset. */
bool b51_excitation_done(void) {
    const B51_STATE_MEMORY struct b51_signal *signal = &b51_board.excitation.signal;

    return signal->shape == B51_SHAPE_NONE || (signal->duration != 0U && signal->duration <= b51_board.excitation.ticks);
}

/* Whether it was over at the latest value. */
bool b51_excitation_over(void) {
    const B51_STATE_MEMORY struct b51_signal *signal = &b51_board.excitation.signal;

    return signal->shape == B51_SHAPE_NONE || (signal->duration != 0U && signal->duration < b51_board.excitation.ticks);
}

/* in_period / period of a turn, rounded down to 2^-32, from one value to the next: a quotient grows by that of 1, and by
 * another 1 where the remainders reach the period.  So 48 bits are divided once, as two times 32 by 16. */
static void advance_multisine(void) B51_ON_STACK {
    B51_STATE_MEMORY struct b51_multisine_state *turn = &b51_board.excitation.of.multisine;
    uint16_t period = b51_board.excitation.signal.period;

    if (b51_board.excitation.ticks == 1U && period != 1U) {
        uint16_t upper = (uint16_t)(UINT32_C(0x10000) / period);
        uint32_t rest = (UINT32_C(0x10000) - (uint32_t)upper * period) << 16; /* a product is faster than a remainder */
        uint16_t lower = (uint16_t)(rest / period);
        turn->step = (uint32_t)upper << 16 | lower;
        turn->step_rest = (uint16_t)(rest - (uint32_t)lower * period);
    }
    if (b51_board.excitation.in_period == 0U) {
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

static int32_t sum_of_sines(uint16_t seed) B51_ON_STACK {
    uint32_t phase = b51_board.excitation.of.multisine.phase + ((uint32_t)(seed >> 7) << 23);
    uint32_t angle = 0; /* h phase - h (h - 1) / 16 of a turn */
    int32_t total = 0;
    uint8_t flips = (uint8_t)(seed << 1); /* its last bit is that of harmonic h: never of the first */
    uint8_t h;

    for (h = 1; h <= HARMONICS; h++) {
        int16_t value;
        angle += phase;
        phase -= UINT32_C(1) << 29;
        value = b51_sine_q15(angle);
        total += (flips & 1U) != 0U ? -value : value;
        flips >>= 1;
    }
    return total;
}

static int32_t chirp(int16_t amplitude) B51_ON_STACK {
    return b51_divide_rounded(
        (int32_t)amplitude * b51_sine_q15((uint32_t)(b51_board.excitation.of.chirp.phase >> 16)), 32767);
}

static int16_t prbs(int16_t amplitude) B51_ON_STACK {
    uint16_t r = b51_board.excitation.prbs;

    if (b51_board.excitation.ticks != 0U && b51_board.excitation.in_period == 0U) {
        r = (uint16_t)((r << 1 | ((r >> 14 ^ r >> 13) & 1U)) & 0x7FFFU);
        b51_board.excitation.prbs = r;
    }
    return r >> 14 != 0U ? amplitude : (int16_t)-amplitude;
}

static int32_t sawtooth(int16_t amplitude) B51_ON_STACK {
    int32_t numerator = 2 * (int32_t)amplitude * b51_board.excitation.in_period;

    return b51_divide_rounded(numerator, b51_board.excitation.signal.period) - amplitude;
}

/* At most 4095 * 8 * 32767, twice that and a peak: below 2^31. */
static int32_t multisine(int16_t amplitude) B51_ON_STACK {
    uint16_t seed = b51_board.excitation.signal.seed;
    int32_t value = b51_divide_rounded(amplitude * sum_of_sines(seed), (int32_t)B51_MULTISINE_PEAK[seed & 0x7FU]);
    int16_t top = amplitude < 0 ? (int16_t)-amplitude : amplitude;

    return value > top ? top : value < -top ? -top : value;
}

/* The shape alone, without the offset.  Each is a function, so that an 8051 has one's locals on its stack at a time. */
static int32_t shape(void) B51_ON_STACK {
    const B51_STATE_MEMORY struct b51_signal *signal = &b51_board.excitation.signal;

    switch (signal->shape) {
        case B51_SHAPE_STEP:
            return b51_board.excitation.ticks >= signal->period ? signal->amplitude : 0;
        case B51_SHAPE_RECTANGLE:
            return 2 * (uint32_t)b51_board.excitation.in_period < signal->period ? signal->amplitude
                                                                                  : -signal->amplitude;
        case B51_SHAPE_SAWTOOTH:
            return sawtooth(signal->amplitude);
        case B51_SHAPE_PRBS:
            return prbs(signal->amplitude);
        case B51_SHAPE_MULTISINE:
            return multisine(signal->amplitude);
        case B51_SHAPE_CHIRP:
            return chirp(signal->amplitude);
        default:
            return 0;
    }
}

/* The next value of the signal, in counts of its target. */
uint16_t b51_excitation_next(void) B51_ON_STACK {
    int32_t value = b51_board.excitation.signal.offset;

    if (b51_board.excitation.signal.shape == B51_SHAPE_CHIRP) {
        advance_chirp();
    } else if (b51_board.excitation.signal.shape == B51_SHAPE_MULTISINE && b51_board.excitation.ticks != 0U) {
        advance_multisine();
    }
    if (!b51_excitation_done()) {
        value += shape();
    }
    if (b51_board.excitation.ticks < UINT32_MAX) {
        b51_board.excitation.ticks++;
    }
    b51_board.excitation.in_period++;
    if (b51_board.excitation.in_period >= b51_board.excitation.signal.period) {
        b51_board.excitation.in_period = 0;
    }
    return (uint16_t)value;
}
