/* The hardware of posix.h, and the boards that share the core. */
#include "posix.h"

#include <string.h>

static struct b51_posix_board *here; /* the board that is in the core */

static void enter(struct b51_posix_board *to) {
    if (here == to) {
        return;
    }
    if (here != NULL) {
        here->state = b51_board;
    }
    b51_board = to->state;
    here = to;
}

static void show(void) {
    struct b51_posix_view *view = &here->view;

    view->next_tick = b51_board.next_tick;
    view->dropped = here->dropped + b51_board.queues.dropped;
    view->allowance = b51_board.reference.allowance;
    view->sum = b51_board.law.sum;
    view->u = here->u;
    view->bad_frames = b51_board.receiver.bad_frames;
    view->mode = b51_board.loop.mode;
    view->running = here->dead_ticks == 0U && here->hung_ticks == 0U;
}

/* The hardware, as in hal.h. */

uint16_t b51_hal_read_current(void) {
    return here->i;
}

uint16_t b51_hal_read_position(void) {
    return here->x;
}

bool b51_hal_write_input(uint16_t u) {
    if (here->output_fault == 0U) {
        here->u = u;
    }
    here->view.written = true;
    return here->output_fault != B51_OUTPUT_DEAF;
}

bool b51_hal_tick_due(void) {
    bool due = here->tick_due;

    here->tick_due = false;
    return due;
}

/* This board computes in no time. */
bool b51_hal_has_time(uint8_t work) {
    (void)work;
    return true;
}

void b51_hal_capture_timer(uint16_t us) {
    here->view.capture_wait_us = us == 0U ? -1 : us;
}

bool b51_hal_capture_due(void) {
    return here->view.capture_wait_us == 0;
}

int16_t b51_hal_receive(void) {
    if (here->received_count == 0U) {
        return -1;
    }
    here->received_count--;
    return *here->received++;
}

/* As many bytes as the caller has room for, and one frame at a time: the next waits for the next `b51_posix_take`. */
bool b51_hal_send(uint8_t byte) {
    if (here->sent == NULL || here->sent_count == here->room || here->delimiters == 2U) {
        return false;
    }
    here->sent[here->sent_count++] = byte;
    here->delimiters = (uint8_t)(here->delimiters + (byte == 0U ? 1U : 0U));
    return true;
}

/* The watchdog is not counted down: a board hangs in `b51_posix_hang` alone, which knows when it began. */
void b51_hal_feed_watchdog(void) {
}

uint8_t b51_hal_reset_cause(void) {
    return here->cause;
}

uint16_t b51_hal_resets(void) {
    return here->resets;
}

void b51_hal_restart(void) {
    here->restart = true;
}

/* Its stack is the computer's: it breaks where the caller says so.  Its converter has no memory. */
bool b51_hal_stack_is_intact(void) {
    return !here->stack_broken;
}

uint16_t b51_hal_stack_free(void) {
    return here->stack_broken ? 0U : UINT16_MAX;
}

uint16_t b51_hal_input_at_power_on(void) {
    return UINT16_MAX;
}

/* Its memory keeps a calibration without power, at once. */
const uint8_t *b51_hal_calibration(void) {
    return here->calibration_is_kept ? here->calibration : NULL;
}

void b51_hal_keep_calibration(const uint8_t *bytes) {
    (void)memcpy(here->calibration, bytes, sizeof here->calibration);
    here->calibration_is_kept = true;
}

bool b51_hal_calibration_is_kept(void) {
    return here->calibration_is_kept;
}

const struct b51_identity *b51_hal_identity(void) {
    return &here->identity;
}

const struct b51_settings *b51_hal_settings(void) {
    return &here->settings;
}

const struct b51_settings *b51_hal_program_settings(void) {
    return &here->settings_of_program;
}

/* The caller's side. */

static void poll(void) {
    while (b51_board_poll() && !here->restart) {
    }
}

static void boot(uint8_t cause) {
    here->dropped += b51_board.queues.dropped;
    here->cause = cause;
    here->hung_ticks = 0;
    here->stack_broken = false;
    here->delimiters = 0;
    here->restart = false;
    b51_board_boot();
}

static void reset(uint8_t cause) {
    if (cause == B51_RESET_POWER_ON) {
        here->resets = 0;
        here->u = 0; /* the converter's own power-on value */
    } else if (here->resets < UINT16_MAX) {
        here->resets++;
    }
    boot(cause);
    here->dead_ticks = B51_BOOT_TICKS;
}

uint32_t b51_posix_size(void) {
    return (uint32_t)sizeof(struct b51_posix_board);
}

void b51_posix_open(struct b51_posix_board *to, const struct b51_identity *identity,
                    const struct b51_settings *settings) {
    (void)memset(to, 0, sizeof *to);
    to->identity = *identity;
    to->settings = *settings;
    to->settings_of_program = *settings;
    enter(to);
    boot(B51_RESET_POWER_ON);
    show();
}

/* Before its memory is given back. */
void b51_posix_close(const struct b51_posix_board *to) {
    if (here == to) {
        here = NULL;
    }
}

/* A reset from outside: power, or what the caller wants to be one. */
void b51_posix_reset(struct b51_posix_board *to, uint8_t cause) {
    enter(to);
    reset(cause);
    show();
}

/* The program hangs: no loop, no answers, u_c as it is, until the watchdog resets the board. */
void b51_posix_hang(struct b51_posix_board *to) {
    enter(to);
    here->hung_ticks = B51_WATCHDOG_TICKS;
    show();
}

void b51_posix_late(struct b51_posix_board *to) {
    enter(to);
    b51_board_late();
    show();
}

/* The end of the stack is overwritten, until the next reset. */
void b51_posix_break_stack(struct b51_posix_board *to) {
    to->stack_broken = true;
}

/* What goes wrong with the converter of u_c from now on; 0: nothing. */
void b51_posix_fail_output(struct b51_posix_board *to, uint8_t fault) {
    enter(to);
    here->output_fault = fault;
}

/* Writes the board's memory, which it reads at its next boot. */
void b51_posix_store(struct b51_posix_board *to, const struct b51_settings *settings) {
    to->settings = *settings;
}

void b51_posix_feed(struct b51_posix_board *to, const uint8_t *data, uint32_t count) {
    enter(to);
    here->view.written = false;
    if (here->view.running) {
        poll(); /* what has been waiting for room */
        here->received = data;
        here->received_count = count;
        poll();
    }
    show();
}

/* Time passes, at most until the capture interrupt is due.  The one that ends a capture is served here: it reads no
 * converter, so it needs nothing of the caller. */
void b51_posix_pass(struct b51_posix_board *to, uint16_t us) {
    enter(to);
    if (here->view.capture_wait_us >= 0 && here->hung_ticks == 0U) {
        here->view.capture_wait_us -= us;
        if (here->view.capture_wait_us == 0 && b51_board.capture.taken == b51_board.capture.count) {
            b51_capture_interrupt();
            poll();
        }
    }
    show();
}

/* Serves the capture interrupt, with i_c at this instant. */
void b51_posix_capture(struct b51_posix_board *to, uint16_t i) {
    enter(to);
    here->i = i;
    here->view.capture_wait_us = (int32_t)B51_CAPTURE_US;
    b51_capture_interrupt();
    show();
}

/* One tick, at the end of T_s.  A STATE that the board loses is taken back as if it had never been queued. */
void b51_posix_tick(struct b51_posix_board *to, uint16_t i, uint16_t x, bool lose_state) {
    uint8_t states[B51_STATE_DEPTH][B51_STATE_BODY];
    struct b51_ring ring;

    enter(to);
    if (here->dead_ticks != 0U) {
        here->dead_ticks--;
    } else if (here->hung_ticks != 0U) {
        here->hung_ticks--;
        if (here->hung_ticks == 0U) {
            reset(B51_RESET_WATCHDOG);
        }
    } else {
        (void)memcpy(states, b51_board.queues.states, sizeof states);
        ring = b51_board.queues.rings[0];
        here->i = i;
        here->x = x;
        poll(); /* what has been waiting for room */
        here->tick_due = true;
        poll();
        if (here->restart) {
            reset(B51_RESET_COMMANDED);
        } else if (lose_state) {
            (void)memcpy(b51_board.queues.states, states, sizeof states);
            /* the oldest is back, too */
            b51_board.queues.dropped -= b51_board.queues.rings[0].first != ring.first ? 1U : 0U;
            b51_board.queues.rings[0] = ring;
        }
    }
    show();
}

/* What the transmitter takes, at most `room` bytes and at most to the end of a frame; the number of bytes. */
uint8_t b51_posix_take(struct b51_posix_board *to, uint8_t *data, uint8_t room) {
    enter(to);
    if (here->dead_ticks != 0U) {
        return 0;
    }
    here->sent = data;
    here->room = room;
    here->sent_count = 0;
    here->delimiters = (uint8_t)(here->delimiters % 2U);
    b51_send_frames();
    here->sent = NULL;
    show();
    return here->sent_count;
}

/* As if so many ticks had passed: a wrap of the tick takes 99 days. */
void b51_posix_set_tick(struct b51_posix_board *to, uint32_t next_tick) {
    enter(to);
    b51_board.next_tick = next_tick;
    show();
}
