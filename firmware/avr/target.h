/* ATmega328P at 16 MHz on an Arduino Uno with a MagnetoShield: every register that is used, clock, baud and wiring.
 *
 * In quotes: sections of the data sheet "ATmega48A/PA/88A/PA/168A/PA/328/P" (Microchip DS40002061); their numbers
 * differ between its editions.  The converter's are those of "MCP4725" (Microchip DS22039).  The wiring is that of the
 * MagnetoShield R3 and R4 (github.com/gergelytakacs/AutomationShield/wiki/MagnetoShield).
 *
 *     tick, T_s              timer 1     "16-bit Timer/Counter1", CTC mode     TCCR1A/B, OCR1A, TIMSK1
 *     capture, CAPTURE_US    timer 2     "8-bit Timer/Counter2", CTC mode      TCCR2A/B, OCR2A, TIMSK2, TIFR2, TCNT2
 *     A2: i_c, A3: x         ADC         "Prescaling and Conversion Timing"    ADMUX, ADCSRA, ADC, DIDR0
 *     u_c: 0x60, 400 kHz     TWI         "Bit Rate Generator Unit"             TWBR, TWSR, TWCR, TWDR
 *     A4: SDA, A5: SCL       port C      "Ports as General Digital I/O"        DDRC, PINC (a bus that is held)
 *     8N1, double speed      USART 0     "Double Speed Operation"              UBRR0, UCSR0A/B/C, UDR0
 *     reset after 32 ms      watchdog    "Watchdog Timer"                      WDTCSR
 *     cause of a reset                   "MCU Status Register"                 MCUSR
 *     between interrupts                 "Idle Mode"                           SMCR
 *     identity, settings     EEPROM      "EEPROM Data Memory"                  through avr-libc
 */
#ifndef B51_AVR_TARGET_H
#define B51_AVR_TARGET_H

#define F_CPU UINT32_C(16000000)

/* The rate that the divider gives may be off by 2.5 % at most: 115200 is by 2.1 %; 250000, 500000, 1000000 not. */
#ifndef B51_BAUD
#define B51_BAUD UINT32_C(115200)
#endif
#define B51_UBRR_VALUE ((F_CPU + B51_BAUD * 4U) / (B51_BAUD * 8U) - 1U)
#define B51_BAUD_GIVEN (F_CPU / (8U * (B51_UBRR_VALUE + 1U)))
#if B51_BAUD_GIVEN * 1000 > B51_BAUD * 1025 || B51_BAUD_GIVEN * 1000 < B51_BAUD * 975 || B51_UBRR_VALUE > 4095
#error "BAUD cannot be made from 16 MHz within 2.5 %: take 38400, 57600, 115200, 250000"
#endif

/* Timers: 0.5 us a count for the tick, 4 us for the capture. */
#define B51_TICK_COUNTS (B51_TICK_US * 2U)
#define B51_CAPTURE_COUNTS (B51_CAPTURE_US / 4U)
#if B51_TICK_COUNTS > 65536 || B51_CAPTURE_US % 4 != 0 || B51_CAPTURE_US > 1024 || B51_CAPTURE_US < 200
#error "T_s is 32 ms at most; B51_CAPTURE_US a multiple of 4 us from 200 (a conversion, and a write of u_c) to 1024"
#endif

/* 250 kHz: a conversion takes 52 us, its sample is taken 6 us after its start.  Up to 200 kHz give all 10 bits. */
#define B51_ADC_PRESCALER ((1 << ADPS2) | (1 << ADPS1)) /* 64 */
#define B51_ADC_REFERENCE 0                             /* the AREF pin, which the shield drives with 3.3 V */
#define B51_ADC_PATIENCE 250U /* looks at a conversion, 8 cycles each; it takes 832 cycles, the first one 1600 */
#define B51_ADC_TOP 1023U
#define B51_ADC_CURRENT 2
#define B51_ADC_POSITION 3

#define B51_TWI_RATE UINT32_C(400000)
#define B51_TWI_DIVIDER ((F_CPU / B51_TWI_RATE - 16U) / 2U)
#define B51_TWI_PATIENCE 250U /* looks at a byte on the bus; it takes 23 us, 50 looks */
#define B51_TWI_SDA (1U << 4)   /* of port C */
#define B51_TWI_SCL (1U << 5)
#define B51_TWI_HALF_CYCLES 32U /* 2 us: a clock made by hand, slower than the 400 kHz */
#define B51_DAC_ADDRESS 0x60U

/* "Write Commands", "Read Command": the converter's own EEPROM. */
#define B51_DAC_STORE 0x60U       /* of a message: into register and EEPROM */
#define B51_DAC_READY 0x80U       /* of the status: 0 while it stores, 50 ms at most */
#define B51_DAC_STORED 0x6FFFU    /* of the word: power-down bits and code */
#define B51_DAC_LOOKS 250U        /* at the status, 0.4 ms each */
#define B51_DAC_LOOK_CYCLES 4000U /* 0.25 ms between two of them */

#define B51_STACK_PATTERN 0xC5U

/* Bytes, powers of two: what a tick of 2 ms brings at 250000, and what leaves within 1 ms at 115200. */
#define B51_RX_RING 64U
#define B51_TX_RING 16U
#if B51_RX_RING > 256 || (B51_RX_RING & (B51_RX_RING - 1)) != 0 || \
    B51_TX_RING > 256 || (B51_TX_RING & (B51_TX_RING - 1)) != 0
#error "A ring has a power of two of places, 256 at most: its ends are counted in 8 bits"
#endif

#endif
