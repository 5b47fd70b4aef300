/* What the core relies on, checked when it is compiled: sizes of frames and queues, and that sums of counts fit.
 *
 * What a file relies on alone is checked there.  The array of a condition that is false has a negative size.
 */
#include "core.h"

/* The tick, in the numbers that count it: rules 1, 4 and 16. */
B51_STATIC_ASSERT(b51_a_second_is_whole_ticks, UINT32_C(1000000) % B51_TICK_US == 0U);
B51_STATIC_ASSERT(b51_a_second_is_counted_in_16_bits, B51_TICKS_PER_S < UINT16_MAX);
B51_STATIC_ASSERT(b51_the_wait_of_reset_is_counted_in_8_bits,
                  B51_RESET_WAIT_TICKS >= 1U && B51_RESET_WAIT_TICKS <= UINT8_MAX);
B51_STATIC_ASSERT(b51_identity_holds_the_tick, B51_TICK_US <= UINT16_MAX);

/* Bodies, field by field as the page has them, and frames. */
B51_STATIC_ASSERT(b51_state_has_its_fields, B51_STATE_BODY == 1U + 2U + 3U + 3U + 1U);
B51_STATIC_ASSERT(b51_event_has_its_fields, B51_EVENT_BODY == 1U + 1U + 4U + 1U + 2U);
B51_STATIC_ASSERT(b51_identity_has_its_fields,
                  B51_ANSWER_BODY == 2U + 3U + 4U + 4U + 2U + 2U + sizeof(((struct b51_identity *)0)->scalings) + 2U +
                                         2U + 1U + sizeof(((struct b51_identity *)0)->build));
B51_STATIC_ASSERT(b51_parameters_fit_an_answer, 2U + 1U + 4U * 3U + 6U + 10U + 2U + 3U + 4U <= B51_ANSWER_BODY);
B51_STATIC_ASSERT(b51_a_block_has_its_fields, B51_BLOCK_BODY == 2U + 2U + 2U + 4U + B51_BLOCK_SAMPLES / 2U * 3U);
B51_STATIC_ASSERT(b51_the_longest_command_is_set_gains, B51_COMMAND_BODY == 2U + 1U + 4U * 3U + 6U);
B51_STATIC_ASSERT(b51_any_answer_fits_where_it_is_composed, B51_ANSWER_BODY <= B51_BLOCK_BODY);
B51_STATIC_ASSERT(b51_the_receiver_holds_a_body_and_its_crc, B51_MAX_ENCODED == B51_MAX_BODY + 2U + 1U);
B51_STATIC_ASSERT(b51_a_frame_is_counted_in_8_bits, B51_MAX_BODY + 5U <= UINT8_MAX && B51_BLOCK_BODY <= B51_MAX_BODY);

/* Queues: rule 5.  The place behind the last is first + count, in 8 bits. */
B51_STATIC_ASSERT(b51_four_states_wait, B51_STATE_DEPTH >= 4U && B51_STATE_DEPTH <= 128U);
B51_STATIC_ASSERT(b51_an_answer_waits, B51_ANSWER_DEPTH >= 1U && B51_ANSWER_DEPTH <= 128U);
B51_STATIC_ASSERT(b51_the_events_of_a_boot_wait, B51_EVENT_DEPTH >= 2U && B51_EVENT_DEPTH <= 128U);
B51_STATIC_ASSERT(b51_a_block_waits, B51_BLOCK_DEPTH >= 1U && B51_BLOCK_DEPTH <= 128U);
B51_STATIC_ASSERT(b51_a_command_is_executed, B51_COMMANDS_PER_TICK >= 1U && B51_COMMANDS_PER_TICK <= UINT8_MAX);

/* The capture: two samples in three bytes, at most what READ_CAPTURE can ask for. */
B51_STATIC_ASSERT(b51_the_samples_are_pairs, B51_CAPTURE_SIZE % 2U == 0U && B51_CAPTURE_SIZE >= 2U);
B51_STATIC_ASSERT(b51_the_samples_can_be_asked_for, B51_CAPTURE_SIZE <= 2000U);
B51_STATIC_ASSERT(b51_identity_holds_the_sample_time, B51_CAPTURE_US >= 1U && B51_CAPTURE_US <= UINT16_MAX);

/* Counts: 12 bits, which the sums of the law and of the signals have to hold. */
B51_STATIC_ASSERT(b51_counts_have_12_bits, B51_COUNTS_MAX == 4095);
B51_STATIC_ASSERT(b51_a_product_takes_8_bits_of_the_fraction, B51_FRACTION_BITS == 8U);
B51_STATIC_ASSERT(b51_the_mode_is_two_bits_of_the_flags, B51_MODE_CLOSED_LOOP < B51_FLAG_INPUT_SATURATED);
B51_STATIC_ASSERT(b51_no_current_is_no_fault, B51_UNCOMMANDED_CURRENT_COUNTS >= 1U);
