/* The hardware under the core: all that a target has to write, and the longest that each call may take.
 *
 * The bounds leave half of a tick of 2 ms to the core.  A target with a longer tick may scale them; the capture
 * interrupt's are in force whatever the tick.  None of these functions waits for the host.
 */
#ifndef B51_HAL_H
#define B51_HAL_H

#include <stdbool.h>
#include <stdint.h>

#include "config.h"

struct b51_identity;
struct b51_settings;

/* Converters, in counts of 12 bits: a finer converter gives its upper 12 bits. */
uint16_t b51_hal_read_current(void);   /* i_c; 20 us, as it is read in the capture interrupt, too */
uint16_t b51_hal_read_position(void);  /* x; 100 us */
bool b51_hal_write_input(uint16_t u);  /* u_c, in force on return; 100 us, or 10 us where the board captures.  False:
                                        * the converter has not confirmed it, and what it gives is not known to have
                                        * changed */

/* Time. */
bool b51_hal_tick_due(void);              /* true once in each T_s; 5 us */
bool b51_hal_has_time(uint8_t work);      /* whether this, one of core.h's, can be done before the next tick; 5 us */
void b51_hal_capture_timer(uint16_t us);  /* calls `b51_capture_interrupt` after us, then each B51_CAPTURE_US;
                                           * 0: stop; 5 us */
bool b51_hal_capture_due(void);           /* its time has come, but its interrupt is still to be served; 5 us */

/* UART, 8N1.  Behind both a buffer: the core looks once in each turn of its main loop. */
int16_t b51_hal_receive(void);        /* below 0: no byte is there; 10 us */
bool b51_hal_send(uint8_t byte);      /* false: the transmitter is full, nothing was sent; 10 us */

/* Resets.  The watchdog resets the chip after 50 ms without `b51_hal_feed_watchdog`.  The start-up code of every target
 * writes 0 to the input converter before anything else: a converter may keep its output through a reset. */
void b51_hal_feed_watchdog(void);   /* 2 us */
uint8_t b51_hal_reset_cause(void);  /* RESET_POWER_ON, RESET_WATCHDOG or RESET_COMMANDED; 5 us */
uint16_t b51_hal_resets(void);      /* since power-on, saturating: kept in RAM that start-up does not clear; 5 us */
void b51_hal_restart(void);         /* resets the chip; on a chip it does not return */

/* The stack's room: start-up fills it with a pattern, and the last bytes of it are the canary. */
bool b51_hal_stack_is_intact(void);  /* the canary is what it was; 2 us */
uint16_t b51_hal_stack_free(void);   /* bytes from the end of the room on that nothing has used since the reset; 100 us;
                                      * UINT16_MAX: there is no room that is watched */

/* The count that the input converter wakes up with: its own memory's, as it was read after the reset.  5 us; UINT16_MAX:
 * it has no such memory, or does not answer. */
uint16_t b51_hal_input_at_power_on(void);

/* Of this board and not of the program: serial number, scalings; gains, operating point, limits.  A target that keeps
 * them in memory that can fail (EEPROM) checks its CRC, and gives those of its program memory where that is wrong.  The
 * core checks each field of the settings, and asks for those of the program where one is out of its range. */
const struct b51_identity *b51_hal_identity(void);  /* 5 us */
const struct b51_settings *b51_hal_settings(void);  /* 1 ms, once after a reset */
const struct b51_settings *b51_hal_program_settings(void);  /* 1 ms; in place of the others, which are then gone */

/* The calibration of x: CALIBRATION_SIZE bytes, kept through resets and without power where the target can, with a CRC.
 * To write them may take longer, while the loop goes on. */
const B51_STATE_MEMORY uint8_t *b51_hal_calibration(void);  /* 1 ms, once after a reset; NULL: none, or a wrong CRC */
void b51_hal_keep_calibration(const B51_STATE_MEMORY uint8_t *bytes);  /* 100 us */
bool b51_hal_calibration_is_kept(void);  /* what was given last has been written, and reads so; 200 us */

#endif
