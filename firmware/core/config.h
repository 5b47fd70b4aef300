/* What a target may choose, each with the value of the emulated board; the rest of the numbers are the page's. */
#ifndef BOARD51_CONFIG_H
#define BOARD51_CONFIG_H

#ifndef TICK_US
#define TICK_US UINT32_C(2000) /* T_s */
#endif
#ifndef CAPTURE_US
#define CAPTURE_US 40U /* between two samples of a capture */
#endif
#ifndef CAPTURE_SIZE
#define CAPTURE_SIZE 2000U /* samples, even; 3 bytes hold two */
#endif

/* From here on i_c is a current that nobody ordered where u_c is 0: an eighth of the converter's range.  For a converter
 * whose 0 A is not near count 0 it has to be another one; 4096: the board does not look. */
#ifndef UNCOMMANDED_CURRENT_COUNTS
#define UNCOMMANDED_CURRENT_COUNTS 512U
#endif

/* Where the state lies: external RAM on an 8051, whose 256 bytes of its own are for the stack and for variables. */
#ifdef __SDCC_mcs51
#define STATE_MEMORY __xdata
#else
#define STATE_MEMORY
#endif

/* Where parameters and locals lie.  sdcc gives those of each function a fixed place in the 128 bytes that an 8051
 * addresses directly: the fastest, and there is room for what runs in each tick.  Of all other functions, and of what
 * the capture interrupt calls, they are on the stack, with this behind the parameters. */
#ifdef __SDCC_mcs51
#define ON_STACK __reentrant
#else
#define ON_STACK
#endif

/* Where tables lie: an AVR would copy them into its RAM (avr-gcc -std=gnu99 reads them from flash instead). */
#if defined(__AVR__)
#define TABLE_MEMORY __flash
#elif defined(__SDCC_mcs51)
#define TABLE_MEMORY __code
#else
#define TABLE_MEMORY
#endif

/* What IDENTITY says of the program: 8 characters.  board51 gives the commit or the release of the sources. */
#ifndef FIRMWARE_BUILD
#define FIRMWARE_BUILD 'u', 'n', 'k', 'n', 'o', 'w', 'n', ' '
#endif

/* Commands that are executed in T_s at most: what more comes waits, and is refused where too many wait. */
#ifndef COMMANDS_PER_TICK
#define COMMANDS_PER_TICK 1U
#endif

#define TICKS_PER_S (UINT32_C(1000000) / TICK_US)
#define RESET_WAIT_TICKS (UINT32_C(50000) / TICK_US) /* rule 1: the ACK of RESET has 50 ms to leave */

/* Depth of the transmit queues, in frames (rule 5: at least four STATEs).  A chip with little RAM has fewer. */
#ifndef STATE_DEPTH
#define STATE_DEPTH 8U
#endif
#ifndef ANSWER_DEPTH
#define ANSWER_DEPTH 8U
#endif
#ifndef EVENT_DEPTH
#define EVENT_DEPTH 16U
#endif
#ifndef BLOCK_DEPTH
#define BLOCK_DEPTH 8U
#endif

#endif
