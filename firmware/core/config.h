/* Settings of a target, with the values of the emulated board; protocol/README.md has all other numbers. */
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

/* Smallest i_c that is a fault while u_c is 0: an eighth of the converter's range.  A converter whose 0 A is not near
 * count 0 needs another value; 4096 switches the check off. */
#ifndef B51_UNCOMMANDED_CURRENT_COUNTS
#define B51_UNCOMMANDED_CURRENT_COUNTS 512U
#endif

/* A check at compile time; C99 has no static assertion. */
#define B51_STATIC_ASSERT(name, condition) typedef char name[(condition) ? 1 : -1]

/* Where the state lies: external RAM on an 8051, whose 256 internal bytes hold the stack and variables. */
#ifdef __SDCC_mcs51
#define B51_STATE_MEMORY __xdata
#else
#define B51_STATE_MEMORY
#endif

/* Where parameters and locals lie.  sdcc gives each function a fixed place in the 128 bytes that an 8051 addresses
 * directly.  This is the fastest, and there is room for the functions of each tick.  All other functions, and those
 * that the capture interrupt calls, have them on the stack: write this macro behind the parameters. */
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

/* `build` of IDENTITY, 8 characters: board51 compiles in the commit or the release of the sources. */
#ifndef B51_FIRMWARE_BUILD
#define B51_FIRMWARE_BUILD 'u', 'n', 'k', 'n', 'o', 'w', 'n', ' '
#endif

/* Largest number of commands in a tick: further ones wait, and are refused if too many wait. */
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
