/* Test signals, tick by tick, in counts: rule 8 and 'Arithmetic of the board'. */
#include "core.h"

#define HARMONICS 8U
#define CHIRP_TURN ((uint64_t)1 << 48)

/* dividend / divisor, rounded down, 16 bits at a time: the bits of the dividend leave a digit above while those of the
 * quotient enter it below.  Without a division or a shift by one of 64 bits: sdcc has none for an 8051, and on an AVR
 * they would take longer than a tick. */
static uint64_t quotient(uint64_t dividend, uint32_t divisor) {
    uint64_t result = 0;
    uint32_t rest = 0;
    uint8_t digit;
    uint8_t n;

    for (digit = 0; digit < 4U; digit++) {
        uint16_t bits = (uint16_t)(dividend >> 48);

        for (n = 0; n < 16U; n++) {
            bool carry = rest >> 31 != 0U;

            rest = rest << 1 | (bits >> 15 & 1U);
            bits = (uint16_t)(bits << 1);
            if (carry || rest >= divisor) {
                rest -= divisor;
                bits |= 1U;
            }
        }
        dividend <<= 16;
        result = result << 16 | bits;
    }
    return result;
}

/* (2^48 // period_end - 2^48 // period) // duration, rounded down.  Below 0 as 2^64 minus it: only the low 48 bits of
 * the phase are looked at. */
static uint64_t chirp_sweep(const struct signal *signal) {
    uint64_t first = board.excitation.step; /* 2^48 // period */
    uint64_t last = quotient(CHIRP_TURN, signal->period_end);
    uint32_t duration = signal->duration == 0U ? 1U : signal->duration;

    if (last >= first) {
        return quotient(last - first, duration);
    }
    return (uint64_t)0 - quotient(first - last + duration - 1U, duration);
}

void excitation_start(const struct signal *signal) {
    board.excitation.signal = *signal;
    board.excitation.active = true;
    board.excitation.ticks = 0;
    board.excitation.in_period = 0;
    board.excitation.prbs = (uint16_t)(signal->seed % 32767U + 1U);
    board.excitation.phase = 0;
    board.excitation.step = 0;
    board.excitation.sweep = 0;
    if (signal->shape == SHAPE_CHIRP) { /* not for the others: three long divisions take an 8051 several ticks */
        board.excitation.step = quotient(CHIRP_TURN, signal->period);
        board.excitation.sweep = chirp_sweep(signal);
    }
    board.excitation.announced = excitation_done();
}

/* Whether the duration is over, so that the signal stays at its offset. */
bool excitation_done(void) {
    const struct signal *signal = &board.excitation.signal;

    return signal->shape == SHAPE_NONE || (signal->duration != 0U && signal->duration <= board.excitation.ticks);
}

/* in_period / period of a turn, rounded down to 2^-32: a division of 48 bits by 16 in two of 32 by 16. */
static uint32_t phase_in_period(void) {
    uint32_t period = board.excitation.signal.period;
    uint32_t dividend = (uint32_t)board.excitation.in_period << 16;
    uint32_t upper = dividend / period;
    uint32_t lower = (dividend % period << 16) / period;

    return upper << 16 | lower;
}

static int32_t multisine(uint16_t seed) {
    uint32_t phase = phase_in_period() + ((uint32_t)(seed >> 7) << 23);
    int32_t total = 0;
    uint8_t h;

    for (h = 1; h <= HARMONICS; h++) {
        int32_t value = sine_q15(h * phase - ((uint32_t)h * (h - 1U) << 28));
        total += h > 1U && (seed >> (h - 2U) & 1U) != 0U ? -value : value;
    }
    return total;
}

static int32_t chirp(int16_t amplitude) {
    int32_t value = divide_rounded((int32_t)amplitude * sine_q15((uint32_t)(board.excitation.phase >> 16)), 32767);

    board.excitation.phase += board.excitation.step;
    board.excitation.step += board.excitation.sweep;
    return value;
}

static int32_t prbs(int32_t amplitude) {
    uint16_t r = board.excitation.prbs;

    if (board.excitation.ticks != 0U && board.excitation.in_period == 0U) {
        r = (uint16_t)((r << 1 | ((r >> 14 ^ r >> 13) & 1U)) & 0x7FFFU);
        board.excitation.prbs = r;
    }
    return r >> 14 != 0U ? amplitude : -amplitude;
}

/* The shape alone, without the offset. */
static int32_t shape(void) {
    const struct signal *signal = &board.excitation.signal;
    int32_t amplitude = signal->amplitude;
    int32_t s = board.excitation.in_period;
    int32_t top = amplitude < 0 ? -amplitude : amplitude;
    int32_t value;

    switch (signal->shape) {
        case SHAPE_STEP:
            return board.excitation.ticks >= signal->period ? amplitude : 0;
        case SHAPE_RECTANGLE:
            return 2 * s < signal->period ? amplitude : -amplitude;
        case SHAPE_SAWTOOTH:
            return divide_rounded(2 * amplitude * s, signal->period) - amplitude;
        case SHAPE_PRBS:
            return prbs(amplitude);
        case SHAPE_MULTISINE:
            /* At most 4095 * 8 * 32767, twice that and a peak: below 2^31. */
            value = divide_rounded(amplitude * multisine(signal->seed), (int32_t)MULTISINE_PEAK[signal->seed & 0x7FU]);
            return value > top ? top : value < -top ? -top : value;
        case SHAPE_CHIRP:
            return chirp(signal->amplitude);
        default:
            return 0;
    }
}

/* The signal at this tick, in counts of its target; then the next tick. */
uint16_t excitation_next(void) {
    int32_t value = board.excitation.signal.offset;

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
