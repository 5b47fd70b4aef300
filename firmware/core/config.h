/* What a target may choose, each with the value of the emulated board; the rest of the numbers are the page's. */
#ifndef B51_CONFIG_H
#define B51_CONFIG_H

#ifndef B51_TICK_US
#define B51_TICK_US UINT32_C(2000) /* T_s */
#endif
#ifndef B51_CAPTURE_US
#define B51_CAPTURE_US 40U /* between two samples of a capture */
#endif
#ifndef B51_CAPTURE_SIZE
#define B51_CAPTURE_SIZE 2000U /* samples, even; 3 bytes hold two */
#endif

/* From here on i_c is a current that nobody ordered where u_c is 0: an eighth of the converter's range.  For a converter
 * whose 0 A is not near count 0 it has to be another one; 4096: the board does not look. */
#ifndef B51_UNCOMMANDED_CURRENT_COUNTS
#define B51_UNCOMMANDED_CURRENT_COUNTS 512U
#endif

/* What has to hold when it is compiled; C99 has no word for it. */
#define B51_STATIC_ASSERT(name, condition) typedef char name[(condition) ? 1 : -1]

/* Where the state lies: external RAM on an 8051, whose 256 bytes of its own are for the stack and for variables. */
#ifdef __SDCC_mcs51
#define B51_STATE_MEMORY __xdata
#else
#define B51_STATE_MEMORY
#endif

/* Where parameters and locals lie.  sdcc gives those of each function a fixed place in the 128 bytes that an 8051
 * addresses directly: the fastest, and there is room for what runs in each tick.  Of all other functions, and of what
 * the capture interrupt calls, they are on the stack, with this behind the parameters. */
#ifdef __SDCC_mcs51
#define B51_ON_STACK __reentrant
#else
#define B51_ON_STACK
#endif

/* Where tables lie: an AVR would copy them into its RAM (avr-gcc -std=gnu99 reads them from flash instead). */
#if defined(__AVR__)
#define B51_TABLE_MEMORY __flash
#elif defined(__SDCC_mcs51)
#define B51_TABLE_MEMORY __code
#else
#define B51_TABLE_MEMORY
#endif

/* What IDENTITY says of the program: 8 characters.  board51 gives the commit or the release of the sources. */
#ifndef B51_FIRMWARE_BUILD
#define B51_FIRMWARE_BUILD 'u', 'n', 'k', 'n', 'o', 'w', 'n', ' '
#endif

/* Commands that are executed in T_s at most: what more comes waits, and is refused where too many wait. */
#ifndef B51_COMMANDS_PER_TICK
#define B51_COMMANDS_PER_TICK 1U
#endif

#define B51_TICKS_PER_S (UINT32_C(1000000) / B51_TICK_US)
#define B51_RESET_WAIT_TICKS (UINT32_C(50000) / B51_TICK_US) /* rule 1: the ACK of RESET has 50 ms to leave */

/* Depth of the transmit queues, in frames (rule 5: at least four STATEs).  A chip with little RAM has fewer. */
#ifndef B51_STATE_DEPTH
#define B51_STATE_DEPTH 8U
#endif
#ifndef B51_ANSWER_DEPTH
#define B51_ANSWER_DEPTH 8U
#endif
#ifndef B51_EVENT_DEPTH
#define B51_EVENT_DEPTH 16U
#endif
#ifndef B51_BLOCK_DEPTH
#define B51_BLOCK_DEPTH 8U
#endif

#endif
