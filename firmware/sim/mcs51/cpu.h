/* The processor of an 8051: instructions, their cycles, interrupts.  What its special function registers do is the
 * chip's (chip.c): `sfr_read` and `sfr_write` are called for each access of the program to one of them.
 *
 * Checked against ucsim's s51 opcode by opcode: tests/firmware/test_mcs51_cpu.py.
 */
#ifndef BOARD51_MCS51_CPU_H
#define BOARD51_MCS51_CPU_H

#include <stdbool.h>
#include <stdint.h>

enum { SP = 0x81, DPL, DPH, PSW = 0xD0, ACC = 0xE0, B = 0xF0, IE = 0xA8, IP = 0xB8 };

struct cpu {
    uint64_t cycles; /* since power-on: clocks of a 1T part, machine cycles of 12 or 6 clocks of the others */
    uint16_t pc;
    uint8_t slow; /* 1: cycles of the 12T family, else of the 1T part */
    uint8_t in_service; /* bit 0: an interrupt of low priority, bit 1: of high */
    uint8_t deepest; /* stack pointer */
    uint8_t ram[256], sfr[128], xram[65536], code[65536];
};

uint8_t sfr_read(struct cpu *cpu, uint8_t address);
void sfr_write(struct cpu *cpu, uint8_t address, uint8_t value);
uint8_t xram_read(struct cpu *cpu, uint16_t address);
void xram_write(struct cpu *cpu, uint16_t address, uint8_t value);

void cpu_reset(struct cpu *cpu);
uint8_t cpu_step(struct cpu *cpu); /* one instruction; its cycles */
void cpu_interrupt(struct cpu *cpu, uint8_t pending); /* bit n: the source of vector 8 n + 3 */

#endif
