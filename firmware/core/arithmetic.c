/* Integer arithmetic of an 8051: nothing is wider than 32 bits, what does not fit saturates and never wraps.
 *
 * A sum that wraps would drive the ball into a stop.  `>>` of a negative number is left to the compiler by the
 * standard, so the shifts here are of non-negative numbers only.
 */
#include "core.h"

/* value / 2^bits, rounded towards minus infinity: the page's `>>`. */
int32_t shift_down(int32_t value, uint8_t bits) {
    if (value >= 0) {
        return (int32_t)((uint32_t)value >> bits);
    }
    return -1 - (int32_t)((uint32_t)(-1 - value) >> bits);
}

int32_t saturated_sum(int32_t a, int32_t b) {
    if (b > 0 && a > INT32_MAX - b) {
        return INT32_MAX;
    }
    if (b < 0 && a < INT32_MIN - b) {
        return INT32_MIN;
    }
    return a + b;
}

int32_t saturated_difference(int32_t a, int32_t b) {
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
 * The product has 40 bits: `high` the upper 32 of them, `low` the last 8. */
int32_t scaled_product(int16_t mantissa, uint8_t shift, int32_t operand) {
    int32_t upper = shift_down(operand, 8);
    int32_t low = (int32_t)mantissa * (operand - upper * 256);
    int32_t carry = shift_down(low, 8);
    int32_t high = (int32_t)mantissa * upper + carry;
    uint8_t up;
    int32_t bound;

    low -= carry * 256;
    if (shift >= 16U) {
        return shift_down(high, (uint8_t)(shift - 16U));
    }
    up = (uint8_t)(16U - shift);
    bound = (int32_t)((uint32_t)1 << (31U - up));
    if (high >= bound) {
        return INT32_MAX;
    }
    if (high < -bound) {
        return INT32_MIN;
    }
    return high * (int32_t)((uint32_t)1 << up) + (int32_t)(((uint32_t)low << up) >> 8);
}

/* The nearest integer, halves upwards; denominator > 0, and 2 numerator + denominator fits 32 bits. */
int32_t divide_rounded(int32_t numerator, int32_t denominator) {
    int32_t dividend = 2 * numerator + denominator;
    int32_t divisor = 2 * denominator;
    int32_t quotient = dividend / divisor;

    return dividend % divisor < 0 ? quotient - 1 : quotient;
}

/* 32767 sin(2 pi phase / 2^32), by the table with linear interpolation. */
int16_t sine_q15(uint32_t phase) {
    uint16_t n = (uint16_t)(phase >> 24);
    int32_t fraction = (int32_t)(phase >> 16 & 0xFFU);
    int32_t low = SINE_Q15[n];

    return (int16_t)(low + shift_down((SINE_Q15[n + 1U] - low) * fraction, 8));
}

uint16_t distance(uint16_t a, uint16_t b) {
    return (uint16_t)(a > b ? a - b : b - a);
}
