/* Gains, operating point and limits from the memory of the target, in force only where a host could have sent them: rule
 * 1.  A right CRC says that they were stored so, not that they make sense. */
#include "core.h"

#define FIELD_X_REF_MAX 14U

static void take(const struct b51_settings *settings) {
    b51_board.law.gains = settings->gains;
    b51_board.loop.limits = settings->limits;
}

/* The first field that is out of its range, counted from 1 in the order of PARAMETERS, which is composed to be read by
 * the table of its fields; 0 where none is. */
static uint8_t first_bad_field(void) {
    uint8_t n;

    b51_answer_parameters(b51_board.host.answer);
    n = b51_fields_check_settings(b51_board.host.answer + 2);
    return n == 0U && b51_board.loop.limits.x_ref_min > b51_board.loop.limits.x_ref_max ? FIELD_X_REF_MAX : n;
}

/* After `b51_board` was cleared; the field for which those of the program are in force, or 0. */
uint8_t b51_settings_boot(void) {
    uint8_t field;

    take(b51_hal_settings());
    field = first_bad_field();
    if (field != 0U) {
        take(b51_hal_program_settings());
    }
    return field;
}
