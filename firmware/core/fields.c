/* Fields of bodies: the commands' lengths and ranges as a table ('Fields'), and numbers to and from bytes. */
#include "core.h"

enum { U8, U16, I16, U32 };

struct field {
    uint8_t type;
    uint16_t low, high; /* of an i16 plus BIAS, so that they compare; not used for u32 */
};

struct row {
    uint8_t size; /* of the body */
    uint8_t count;
    const B51_TABLE_MEMORY struct field *fields; /* behind the id */
};

#define BIAS 0x8000U
#define ANY_U8 {U8, 0, 255}
#define ANY_U16 {U16, 0, 65535}
#define ONE_U16 {U16, 1, 65535}
#define COUNT {U16, 0, B51_COUNTS_MAX}
#define MANTISSA {I16, BIAS - 32767, BIAS + 32767}
#define AMPLITUDE {I16, BIAS - B51_COUNTS_MAX, BIAS + B51_COUNTS_MAX}
#define SHIFT {U8, 0, 30}
#define GAIN MANTISSA, SHIFT

static const B51_TABLE_MEMORY struct field HELLO_FIELDS[] = {ANY_U16, ANY_U8, ANY_U8};
static const B51_TABLE_MEMORY struct field SET_MODE_FIELDS[] = {{U8, 0, 2}};
static const B51_TABLE_MEMORY struct field SET_REFERENCE_FIELDS[] = {COUNT};
/* Of SET_GAINS, and behind them the limits: together what PARAMETERS begins with, and what a board stores. */
static const B51_TABLE_MEMORY struct field SETTINGS_FIELDS[] = {{U8, 0, 1}, GAIN,  GAIN,  GAIN,    GAIN, COUNT, COUNT,
                                               COUNT,      COUNT, COUNT, COUNT, ONE_U16, COUNT};
static const B51_TABLE_MEMORY struct field EXCITE_FIELDS[] = {{U8, 0, 6},  {U8, 0, 1}, AMPLITUDE,
                                             COUNT,       ONE_U16,    ONE_U16,
                                             ONE_U16,     {U32, 0, 0}};
static const B51_TABLE_MEMORY struct field CAPTURE_FIELDS[] = {COUNT, COUNT, {U16, 0, 2000}, {U16, 1, 2000}};
static const B51_TABLE_MEMORY struct field READ_CAPTURE_FIELDS[] = {{U16, 0, 1999}};
static const B51_TABLE_MEMORY struct field SET_STREAM_FIELDS[] = {{U16, 0, 1000}};
static const B51_TABLE_MEMORY struct field SET_CALIBRATION_FIELDS[] = {COUNT, COUNT, COUNT, COUNT};
static const B51_TABLE_MEMORY struct field SET_HOST_LOSS_FIELDS[] = {{U8, 0, 2}, {U16, 50, 60000}};

#define ROW(size, fields) {(size), sizeof(fields) / sizeof((fields)[0]), (fields)}
#define ID_ONLY {2, 0, 0}

static const B51_TABLE_MEMORY struct row ROWS[] = {
    /* HELLO */ ROW(6, HELLO_FIELDS),
    /* PING */ ID_ONLY,
    /* SET_MODE */ ROW(3, SET_MODE_FIELDS),
    /* SET_REFERENCE */ ROW(4, SET_REFERENCE_FIELDS),
    /* SET_GAINS */ {21, 12, SETTINGS_FIELDS},
    /* EXCITE */ ROW(18, EXCITE_FIELDS),
    /* STOP */ ID_ONLY,
    /* CAPTURE */ ROW(10, CAPTURE_FIELDS),
    /* READ_CAPTURE */ ROW(4, READ_CAPTURE_FIELDS),
    /* SET_STREAM */ ROW(4, SET_STREAM_FIELDS),
    /* SET_HOST_LOSS */ ROW(5, SET_HOST_LOSS_FIELDS),
    /* GET_PARAMETERS */ ID_ONLY,
    /* RESET */ ID_ONLY,
    /* GET_HEALTH */ ID_ONLY,
    /* SET_CALIBRATION */ ROW(10, SET_CALIBRATION_FIELDS),
    /* GET_CALIBRATION */ ID_ONLY,
};

B51_STATIC_ASSERT(b51_each_command_has_its_row, sizeof ROWS / sizeof ROWS[0] == B51_GET_CALIBRATION - B51_HELLO + 1);

/* Of a bound of a field. */
static uint16_t magnitude(uint8_t type, uint16_t bound) B51_ON_STACK {
    if (type != I16) {
        return bound;
    }
    return (uint16_t)(bound < BIAS ? BIAS - bound : bound - BIAS);
}

/* The first of the fields from `at` on that is out of its range, counted from 1, with the bound in the way; 0: none. */
static uint8_t first_outside(const B51_TABLE_MEMORY struct field *field, uint8_t count,
                             const B51_STATE_MEMORY uint8_t *at, uint16_t *bound) B51_ON_STACK {
    uint8_t n;

    for (n = 1; n <= count; n++, field++) {
        uint16_t value;

        if (field->type == U32) {
            at += 4;
            continue;
        }
        value = field->type == U8 ? *at : b51_get_u16(at);
        value = (uint16_t)(field->type == I16 ? value + BIAS : value);
        at += field->type == U8 ? 1 : 2;
        if (value < field->low || value > field->high) {
            *bound = magnitude(field->type, value < field->low ? field->low : field->high);
            return n;
        }
    }
    return 0;
}

/* Those of the settings, as PARAMETERS has them from its law on. */
uint8_t b51_fields_check_settings(const B51_STATE_MEMORY uint8_t *at) B51_ON_STACK {
    uint16_t bound;

    return first_outside(SETTINGS_FIELDS, sizeof SETTINGS_FIELDS / sizeof SETTINGS_FIELDS[0], at, &bound);
}

/* Why a command cannot be understood, with the bound in the way; the first field that is out of range counts. */
uint8_t b51_fields_check(const B51_STATE_MEMORY uint8_t *body, uint8_t size, uint16_t *detail) B51_ON_STACK {
    const B51_TABLE_MEMORY struct row *row;

    *detail = 0;
    if (body[0] < B51_HELLO || body[0] > B51_GET_CALIBRATION) {
        return B51_UNKNOWN_TYPE;
    }
    row = &ROWS[body[0] - B51_HELLO];
    if (size != row->size) {
        return B51_BAD_LENGTH;
    }
    return first_outside(row->fields, row->count, body + 2, detail) == 0U ? B51_ACCEPTED : B51_OUT_OF_RANGE;
}

/* A line with an echo must not make the board talk to itself. */
bool b51_is_sent_by_board(uint8_t type) {
    return type >= B51_STATE && type <= B51_CALIBRATION;
}

/* From STATE on. */
static const B51_TABLE_MEMORY uint8_t SIZES[] = {B51_STATE_BODY, B51_ANSWER_BODY, 10, 7, 6, 40, B51_EVENT_BODY,
                                                 B51_BLOCK_BODY, 6, 11};
B51_STATIC_ASSERT(b51_each_message_has_its_size, sizeof SIZES == B51_CALIBRATION - B51_STATE + 1);

/* Of a message to the host. */
uint8_t b51_body_size(uint8_t type) {
    return SIZES[type - B51_STATE];
}

uint16_t b51_get_u16(const B51_STATE_MEMORY uint8_t *at) {
    return (uint16_t)(at[0] | (uint16_t)at[1] << 8);
}

uint32_t b51_get_u32(const B51_STATE_MEMORY uint8_t *at) {
    return b51_get_u16(at) | (uint32_t)b51_get_u16(at + 2) << 16;
}

int16_t b51_get_i16(const B51_STATE_MEMORY uint8_t *at) {
    uint16_t value = b51_get_u16(at);

    return value < 0x8000U ? (int16_t)value : (int16_t)(-1 - (int16_t)(0xFFFFU - value));
}

/* memcpy, where an 8051 knows which memory it is. */
void b51_copy(B51_STATE_MEMORY uint8_t *to, const B51_STATE_MEMORY uint8_t *from, uint8_t size) {
    for (; size != 0U; size--) {
        *to++ = *from++;
    }
}

/* These return where the next field begins. */
B51_STATE_MEMORY uint8_t *b51_put_u16(B51_STATE_MEMORY uint8_t *at, uint16_t value) {
    at[0] = (uint8_t)value;
    at[1] = (uint8_t)(value >> 8);
    return at + 2;
}

B51_STATE_MEMORY uint8_t *b51_put_u32(B51_STATE_MEMORY uint8_t *at, uint32_t value) B51_ON_STACK {
    return b51_put_u16(b51_put_u16(at, (uint16_t)value), (uint16_t)(value >> 16));
}

/* Two counts in three bytes: a[7:0], b[3:0] a[11:8], b[11:4]. */
void b51_put_pair(B51_STATE_MEMORY uint8_t *at, uint16_t a, uint16_t b) {
    at[0] = (uint8_t)a;
    at[1] = (uint8_t)(a >> 8 | (b & 0x0FU) << 4);
    at[2] = (uint8_t)(b >> 4);
}
