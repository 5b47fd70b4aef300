/* Integer arithmetic of an 8051: nothing is wider than 32 bits, what does not fit saturates and never wraps.
 *
 * A sum that wraps would drive the ball into a stop.  `>>` of a negative number is left to the compiler by the
 * standard, so the shifts here are of non-negative numbers only.
 */
#include "core.h"

/* Of two bytes: the only product that an 8051 has an instruction for.  sdcc takes it if both are bytes; its `int` of 16
 * bits holds the result as a negative number, which elsewhere would not be defined. */
#ifdef __SDCC_mcs51
#define PRODUCT(a, b) ((uint16_t)((a) * (b)))
#else
#define PRODUCT(a, b) ((uint16_t)((uint16_t)(a) * (b)))
#endif

/* value / 2^bits, rounded towards minus infinity: the page's `>>`. */
int32_t b51_shift_down(int32_t value, uint8_t bits) {
    if (value >= 0) {
        return (int32_t)((uint32_t)value >> bits);
    }
    return -1 - (int32_t)((uint32_t)(-1 - value) >> bits);
}

int32_t b51_saturated_sum(int32_t a, int32_t b) {
    if (b > 0 && a > INT32_MAX - b) {
        return INT32_MAX;
    }
    if (b < 0 && a < INT32_MIN - b) {
        return INT32_MIN;
    }
    return a + b;
}

int32_t b51_saturated_difference(int32_t a, int32_t b) {
    if (b < 0 && a > INT32_MAX + b) {
        return INT32_MAX;
    }
    if (b > 0 && a < INT32_MIN + b) {
        return INT32_MIN;
    }
    return a - b;
}

/* mantissa * operand >> (shift - 8), saturated; operand has 24 bits, shift is at most 30.
 *
 * The magnitude of the product has 38 bits: `high` all but the last 8, `low` those.  It is put together of products of
 * bytes, which are what an 8051 multiplies.  A negative quotient is rounded away from 0, as `>>` does. */
int32_t b51_scaled_product(int16_t mantissa, uint8_t shift, int32_t operand) {
    bool negative = (mantissa < 0) != (operand < 0);
    uint16_t a = (uint16_t)(mantissa < 0 ? -mantissa : mantissa);
    uint32_t b = (uint32_t)(operand < 0 ? -operand : operand);
    uint8_t a_0 = (uint8_t)a, a_1 = (uint8_t)(a >> 8);
    uint8_t b_0 = (uint8_t)b, b_1 = (uint8_t)(b >> 8), b_2 = (uint8_t)(b >> 16);
    uint16_t lowest = PRODUCT(a_0, b_0);
    uint8_t low = (uint8_t)lowest;
    uint8_t lost;
    uint32_t high = (uint32_t)(uint16_t)(PRODUCT(a_1, b_0) + (lowest >> 8)) + PRODUCT(a_0, b_1);

    high += (uint32_t)(uint16_t)(PRODUCT(a_1, b_1) + PRODUCT(a_0, b_2)) << 8;
    if (b_2 != 0U) {
        high += (uint32_t)PRODUCT(a_1, b_2) << 16;
    }
    if (shift >= 16U) {
        lost = low;
        for (shift = (uint8_t)(shift - 16U); shift >= 8U; shift = (uint8_t)(shift - 8U)) {
            lost |= (uint8_t)high;
            high >>= 8;
        }
        lost |= (uint8_t)(high & ((1U << shift) - 1U));
        high >>= shift;
    } else {
        for (shift = (uint8_t)(16U - shift); shift >= 8U && high <= UINT32_MAX >> 8; shift = (uint8_t)(shift - 8U)) {
            high = high << 8 | low;
            low = 0;
        }
        if (shift >= 8U || high > UINT32_MAX >> shift) {
            return negative ? INT32_MIN : INT32_MAX;
        }
        high = high << shift | (uint16_t)((uint16_t)low << shift) >> 8;
        lost = (uint8_t)(low << shift);
    }
    if (negative && lost != 0U && high < UINT32_MAX) {
        high++;
    }
    if (high > (uint32_t)INT32_MAX) {
        return negative ? INT32_MIN : INT32_MAX;
    }
    return negative ? -(int32_t)high : (int32_t)high;
}

/* a b / 2^16, to the nearest integer, halves upwards; a is a count, b has 15 bits. */
uint16_t b51_fraction_of(uint16_t a, uint16_t b) {
    uint8_t a_0 = (uint8_t)a, a_1 = (uint8_t)(a >> 8);
    uint8_t b_0 = (uint8_t)b, b_1 = (uint8_t)(b >> 8);
    uint16_t middle = PRODUCT(a_0, b_0);

    middle = (uint16_t)(PRODUCT(a_0, b_1) + (middle >> 8));
    middle = (uint16_t)(middle + PRODUCT(a_1, b_0) + 0x80U);
    return (uint16_t)(PRODUCT(a_1, b_1) + (middle >> 8));
}

/* The nearest integer, halves upwards; denominator > 0, and 2 numerator + denominator fits 32 bits. */
int32_t b51_divide_rounded(int32_t numerator, int32_t denominator) B51_ON_STACK {
    int32_t dividend = 2 * numerator + denominator;
    int32_t divisor = 2 * denominator;
    int32_t quotient = dividend / divisor;

    return dividend < quotient * divisor ? quotient - 1 : quotient; /* a product is faster than a remainder */
}

/* 32767 sin(2 pi phase / 2^32), by the table with linear interpolation, rounded downwards. */
int16_t b51_sine_q15(uint32_t phase) B51_ON_STACK {
    uint8_t n = (uint8_t)(phase >> 24);
    uint8_t fraction = (uint8_t)(phase >> 16);
    int16_t low = B51_SINE_Q15[n];
    int16_t rise = (int16_t)(B51_SINE_Q15[n + 1U] - low); /* at most 804 */
    uint16_t size = (uint16_t)(rise < 0 ? -rise : rise);
    uint16_t lower = PRODUCT((uint8_t)size, fraction);
    uint16_t part = (uint16_t)(PRODUCT((uint8_t)(size >> 8), fraction) + (lower >> 8));

    if (rise >= 0) {
        return (int16_t)(low + (int16_t)part);
    }
    return (int16_t)(low - (int16_t)part - ((lower & 0xFFU) != 0U ? 1 : 0));
}

uint16_t b51_distance(uint16_t a, uint16_t b) {
    return (uint16_t)(a > b ? a - b : b - a);
}
