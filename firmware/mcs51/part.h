/* ADuC841: registers, clock and baud of this part; another 8051 needs its own file.
 *
 * Sections in quotes are those of the data sheet ADuC841/ADuC842/ADuC843, Rev. 0 (Analog Devices, November 2003).  The
 * names of registers and bits are in <ADuC84x.h>, which comes with sdcc.
 *
 * On the part:  12-bit converters (ADC 0 i_c, ADC 1 x, DAC 0 u_c), 62 kB of program memory, 2 kB of external RAM and
 * 256 bytes of internal, 4 kB of non-volatile data memory, a timer for the baud only.  One clock is one cycle.
 *
 * Wiring: a resistor from DAC 0 to ground.  From a reset until the first write the DAC has no power and its pin floats;
 * the resistor keeps the coil off then.
 */
#ifndef B51_MCS51_PART_H
#define B51_MCS51_PART_H

#include "../core/core.h"

#include <ADuC84x.h>

/* 'Features': 20 MIPS with a crystal of 20 MHz, at 5 V.  T_s and the capture are whole numbers of its cycles. */
#ifndef B51_CLOCK_HZ
#define B51_CLOCK_HZ UINT32_C(20000000)
#endif
#define B51_CYCLES(us) (((us) * (B51_CLOCK_HZ / 100U) + 5000U) / 10000U) /* rounded */

/* 'Timer 3 generated baud rates', p. 68: DIV = log2(clock / 16 / baud) rounded down, T3FD to the nearest. */
#ifndef B51_BAUD
#define B51_BAUD UINT32_C(115200)
#endif
#define B51_QUOTIENT (B51_CLOCK_HZ / 16U / B51_BAUD)
#define B51_AT_LEAST(n) (B51_QUOTIENT >= (n) ? 1U : 0U)
#define B51_DIVIDER \
    (1U + B51_AT_LEAST(4U) + B51_AT_LEAST(8U) + B51_AT_LEAST(16U) + B51_AT_LEAST(32U) + B51_AT_LEAST(64U) + \
     B51_AT_LEAST(128U))
#define B51_FRACTION ((2U * B51_CLOCK_HZ / (1UL << (B51_DIVIDER - 1U)) + B51_BAUD / 2U) / B51_BAUD - 64U)
#define B51_T3CON_BAUD (T3BAUDEN | B51_DIVIDER)
#define B51_SCON_8N1 0x50U /* 'UART serial interface': mode 1, receiver on */

/* 'Timer/Counter 2', 16 bits with automatic reload: an interrupt each B51_CAPTURE_US, and B51_TICK_PARTS of them are
 * T_s.  So ticks and samples keep their phase, and neither drifts. */
#define B51_TIMER_RELOAD (65536UL - B51_CYCLES(B51_CAPTURE_US))
#define B51_TICK_PARTS (B51_TICK_US / B51_CAPTURE_US)
#define B51_PARTS(us) ((us) / B51_CAPTURE_US)
#if B51_TICK_US % B51_CAPTURE_US != 0 || B51_TICK_US / B51_CAPTURE_US > 255
#error "B51_CAPTURE_US has to divide B51_TICK_US into 255 parts at most"
#endif

/* 'ADC circuit information': clock / 4 (at most 8.38 MHz), 4 of its clocks for the input to settle: 22 in all. */
#define B51_ADCCON1_ON (MD | CK0 | AQ1 | AQ0)
#define B51_ADC_PATIENCE 60U /* turns of at least 4 cycles; a conversion that takes longer has failed */
#define B51_CHANNEL_CURRENT 0U
#define B51_CHANNEL_POSITION 1U

/* 'D/A converters': 12 bits, 0 to AVDD, DAC 0 alone, changed by the write of its low byte. */
#define B51_DACCON_ON (RNG0 | CLR0 | SYNC | PD0)

/* 'Watchdog timer': 31.2 ms, the longest below the 50 ms of rule 1, and at once.  Each write needs WDWR set by the
 * instruction before it. */
#define B51_WDCON_ON 0x12U
#define B51_WDCON_NOW 0x82U

/* 'Power supply monitor': trips below 4.37 V, as 20 MHz need 4.75 V; CMPD is 0 then.  It is polled, without interrupt. */
#define B51_PSMCON_ON PSMEN /* TPD1, TPD0: 00 */

/* 'Using the Flash/EE data memory': pages of 4 bytes. */
#define B51_ECON_READ_PAGE 1U

/* 'Memory organization': the stack may go to the end of the 256 bytes.  Behind it begin the registers again. */
#define B51_STACK_END 0xFFU
#define B51_STACK_PATTERN 0xC5U
#define B51_STACK_CANARY 4U

/* 'Internal XRAM': 2 kB once XRAMEN is set.  Its last bytes are not cleared by start-up. */
#define B51_XRAM_KEPT 0x07F8

#endif
