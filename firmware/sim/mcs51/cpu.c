/* The instruction set of the MCS-51 (Intel, MCS 51 Microcontroller Family User's Manual, 1994, chapter 2). */
#include "cpu.h"

#include <string.h>

#define REG(c, address) ((c)->sfr[(address) - 0x80])

/* Cycles by opcode, a row for each upper half.  12T: the same manual, table 10.  1T: ADuC841 data sheet, Rev. 0,
 * 'Optimized single-cycle 8051 instruction set'; a branch costs the same whether it is taken or not. */
static const char *const CYCLES[2][16] = {
    {"1341122211111111", "4341122211111111", "4341222211111111", "4341222211111111", "3323222211111111",
     "3323222211111111", "3323222211111111", "3323232222222222", "3324932222222222", "3324222211111111",
     "2323912222222222", "2321444444444444", "2321122211111111", "2321242233333333", "4344122211111111",
     "4344122211111111"},
    {"1221111111111111", "2221111111111111", "2221111111111111", "2221111111111111", "2212111111111111",
     "2212111111111111", "2212111111111111", "2222121111111111", "2222422222222222", "2222111111111111",
     "2212412222222222", "2211222222222222", "2211111111111111", "2211121122222222", "2222111111111111",
     "2222111111111111"},
};

enum { P = 1, OV = 4, AC = 0x40, CY = 0x80 };

static uint8_t fetch(struct cpu *c) {
    return c->code[c->pc++];
}

static bool odd(uint8_t value) {
    value ^= (uint8_t)(value >> 4);
    return 0x6996 >> (value & 15) & 1;
}

static uint8_t get(struct cpu *c, uint8_t address) {
    if (address < 0x80) {
        return c->ram[address];
    }
    if (address == PSW) {
        return (uint8_t)((REG(c, PSW) & ~P) | odd(REG(c, ACC)));
    }
    return sfr_read(c, address);
}

static void put(struct cpu *c, uint8_t address, uint8_t value) {
    if (address < 0x80) {
        c->ram[address] = value;
    } else {
        sfr_write(c, address, value);
    }
}

static uint8_t bit_byte(uint8_t bit) {
    return bit < 0x80 ? (uint8_t)(0x20 + bit / 8) : (uint8_t)(bit & 0xF8);
}

static bool get_bit(struct cpu *c, uint8_t bit) {
    return get(c, bit_byte(bit)) >> (bit & 7) & 1;
}

static void put_bit(struct cpu *c, uint8_t bit, bool value) {
    uint8_t at = bit_byte(bit), mask = (uint8_t)(1U << (bit & 7));

    put(c, at, (uint8_t)(value ? get(c, at) | mask : get(c, at) & ~mask));
}

static void set_flag(struct cpu *c, uint8_t flag, bool value) {
    REG(c, PSW) = (uint8_t)(value ? REG(c, PSW) | flag : REG(c, PSW) & ~flag);
}

static bool carry(const struct cpu *c) {
    return REG(c, PSW) >> 7;
}

static void push(struct cpu *c, uint8_t value) {
    c->ram[++REG(c, SP)] = value;
}

static uint8_t pop(struct cpu *c) {
    return c->ram[REG(c, SP)--];
}

static void call(struct cpu *c, uint16_t to) {
    push(c, (uint8_t)c->pc);
    push(c, (uint8_t)(c->pc >> 8));
    c->pc = to;
}

static void jump_if(struct cpu *c, bool condition) {
    uint8_t offset = fetch(c);

    if (condition) {
        c->pc = (uint16_t)(c->pc + (int8_t)offset);
    }
}

static uint16_t dptr(const struct cpu *c) {
    return (uint16_t)(REG(c, DPH) << 8 | REG(c, DPL));
}

static void add(struct cpu *c, uint8_t value, bool with_carry) {
    uint8_t a = REG(c, ACC), in = with_carry && carry(c);
    unsigned sum = (unsigned)a + value + in;

    set_flag(c, CY, sum > 255);
    set_flag(c, AC, (a & 15) + (value & 15) + in > 15);
    set_flag(c, OV, (~(a ^ value) & (a ^ sum) & 0x80) != 0);
    REG(c, ACC) = (uint8_t)sum;
}

static void subtract(struct cpu *c, uint8_t value) {
    uint8_t a = REG(c, ACC), in = carry(c);
    unsigned difference = (unsigned)a - value - in;

    set_flag(c, CY, a < value + in);
    set_flag(c, AC, (a & 15) < (value & 15) + in);
    set_flag(c, OV, ((a ^ value) & (a ^ difference) & 0x80) != 0);
    REG(c, ACC) = (uint8_t)difference;
}

static void decimal_adjust(struct cpu *c) {
    unsigned a = REG(c, ACC);

    if ((a & 15) > 9 || (REG(c, PSW) & AC)) {
        a += 6;
    }
    if (a > 255) {
        set_flag(c, CY, true);
    }
    a &= 0xFF;
    if ((a >> 4) > 9 || carry(c)) {
        a += 0x60;
    }
    if (a > 255) {
        set_flag(c, CY, true);
    }
    REG(c, ACC) = (uint8_t)a;
}

static void multiply(struct cpu *c) {
    unsigned product = (unsigned)REG(c, ACC) * REG(c, B);

    REG(c, ACC) = (uint8_t)product;
    REG(c, B) = (uint8_t)(product >> 8);
    set_flag(c, CY, false);
    set_flag(c, OV, product > 255);
}

static void divide(struct cpu *c) {
    uint8_t a = REG(c, ACC), b = REG(c, B);

    set_flag(c, CY, false);
    set_flag(c, OV, b == 0);
    if (b != 0) {
        REG(c, ACC) = (uint8_t)(a / b);
        REG(c, B) = (uint8_t)(a % b);
    }
}

static void compare_and_jump(struct cpu *c, uint8_t left, uint8_t right) {
    set_flag(c, CY, left < right);
    jump_if(c, left != right);
}

/* The columns 0 to 3 of the table of opcodes, where each is its own. */
static void irregular(struct cpu *c, uint8_t op) {
    uint8_t *a = &REG(c, ACC);
    uint8_t first, in = carry(c);
    uint16_t to;

    if ((op & 0x0F) == 1) { /* AJMP, ACALL */
        first = fetch(c);
        to = (uint16_t)((c->pc & 0xF800) | (op & 0xE0) << 3 | first);
        if (op & 0x10) {
            call(c, to);
        } else {
            c->pc = to;
        }
        return;
    }
    switch (op) {
        case 0x02: case 0x12: /* LJMP, LCALL */
            to = (uint16_t)(fetch(c) << 8);
            to |= fetch(c);
            if (op == 0x12) {
                call(c, to);
            } else {
                c->pc = to;
            }
            break;
        case 0x22: case 0x32: /* RET, RETI */
            to = (uint16_t)(pop(c) << 8);
            c->pc = (uint16_t)(to | pop(c));
            if (op == 0x32) {
                c->in_service &= c->in_service & 2 ? 1 : 0;
            }
            break;
        case 0x10: case 0x20: case 0x30: /* JBC, JB, JNB */
            first = fetch(c);
            in = get_bit(c, first);
            if (op == 0x10 && in) {
                put_bit(c, first, false);
            }
            jump_if(c, in == (op != 0x30));
            break;
        case 0x40: jump_if(c, in); break;
        case 0x50: jump_if(c, !in); break;
        case 0x60: jump_if(c, *a == 0); break;
        case 0x70: jump_if(c, *a != 0); break;
        case 0x80: jump_if(c, true); break;
        case 0x73: c->pc = (uint16_t)(dptr(c) + *a); break;
        case 0x90: REG(c, DPH) = fetch(c); REG(c, DPL) = fetch(c); break;
        case 0xA3:
            to = (uint16_t)(dptr(c) + 1);
            REG(c, DPL) = (uint8_t)to;
            REG(c, DPH) = (uint8_t)(to >> 8);
            break;
        case 0x03: *a = (uint8_t)(*a >> 1 | *a << 7); break;
        case 0x23: *a = (uint8_t)(*a << 1 | *a >> 7); break;
        case 0x13: set_flag(c, CY, *a & 1); *a = (uint8_t)(*a >> 1 | in << 7); break;
        case 0x33: set_flag(c, CY, *a >> 7); *a = (uint8_t)(*a << 1 | in); break;
        case 0x42: first = fetch(c); put(c, first, get(c, first) | *a); break;
        case 0x52: first = fetch(c); put(c, first, get(c, first) & *a); break;
        case 0x62: first = fetch(c); put(c, first, get(c, first) ^ *a); break;
        case 0x43: first = fetch(c); put(c, first, get(c, first) | fetch(c)); break;
        case 0x53: first = fetch(c); put(c, first, get(c, first) & fetch(c)); break;
        case 0x63: first = fetch(c); put(c, first, get(c, first) ^ fetch(c)); break;
        case 0x72: first = fetch(c); set_flag(c, CY, in | get_bit(c, first)); break;
        case 0x82: first = fetch(c); set_flag(c, CY, in & get_bit(c, first)); break;
        case 0xA0: first = fetch(c); set_flag(c, CY, in | !get_bit(c, first)); break;
        case 0xB0: first = fetch(c); set_flag(c, CY, in & !get_bit(c, first)); break;
        case 0x92: put_bit(c, fetch(c), in); break;
        case 0xA2: set_flag(c, CY, get_bit(c, fetch(c))); break;
        case 0xB2: first = fetch(c); put_bit(c, first, !get_bit(c, first)); break;
        case 0xC2: put_bit(c, fetch(c), false); break;
        case 0xD2: put_bit(c, fetch(c), true); break;
        case 0xB3: set_flag(c, CY, !in); break;
        case 0xC3: set_flag(c, CY, false); break;
        case 0xD3: set_flag(c, CY, true); break;
        case 0x83: *a = c->code[(uint16_t)(c->pc + *a)]; break;
        case 0x93: *a = c->code[(uint16_t)(dptr(c) + *a)]; break;
        case 0xC0: /* PUSH: the new SP, if it is that */
            first = fetch(c);
            push(c, 0);
            c->ram[REG(c, SP)] = get(c, first);
            break;
        case 0xD0: first = pop(c); put(c, fetch(c), first); break;
        case 0xE0: *a = xram_read(c, dptr(c)); break;
        case 0xF0: xram_write(c, dptr(c), *a); break;
        case 0xE2: case 0xE3: *a = xram_read(c, c->ram[(REG(c, PSW) & 0x18) + (op & 1)]); break;
        case 0xF2: case 0xF3: xram_write(c, c->ram[(REG(c, PSW) & 0x18) + (op & 1)], *a); break;
        default: break; /* NOP */
    }
}

static uint8_t execute(struct cpu *c) {
    uint8_t op = fetch(c), row = op >> 4, column = op & 15, cycles = (uint8_t)(CYCLES[c->slow][row][column] - '0');
    uint8_t *a = &REG(c, ACC), *at = 0, direct = 0, value = 0;

    c->cycles += cycles;
    if (column < 4) {
        irregular(c, op);
        return cycles;
    }
    /* The operand: A or a number, a direct address, a byte of internal RAM by R0 or R1, a register. */
    if (column >= 8) {
        at = &c->ram[(REG(c, PSW) & 0x18) + (column & 7)];
    } else if (column >= 6) {
        at = &c->ram[c->ram[(REG(c, PSW) & 0x18) + (column & 1)]];
    } else if (column == 4 && (row < 2 || row == 7)) {
        at = a;
    } else if (column == 4 && (row < 8 || row == 9)) {
        value = fetch(c);
    } else if (column == 5 && row != 10) {
        direct = fetch(c);
        value = row != 7 && row != 15 ? get(c, direct) : 0;
    }
    if (at != 0) {
        value = *at;
    }
#define STORE(expression) (at != 0 ? (void)(*at = (uint8_t)(expression)) : put(c, direct, (uint8_t)(expression)))
    switch (row) {
        case 0: STORE(value + 1); break;
        case 1: STORE(value - 1); break;
        case 2: add(c, value, false); break;
        case 3: add(c, value, true); break;
        case 4: *a |= value; break;
        case 5: *a &= value; break;
        case 6: *a ^= value; break;
        case 7: value = fetch(c); STORE(value); break;
        case 8:
            if (column == 4) {
                divide(c);
            } else {
                put(c, fetch(c), value);
            }
            break;
        case 9: subtract(c, value); break;
        case 10:
            if (column == 4) {
                multiply(c);
            } else if (column > 5) {
                *at = get(c, fetch(c));
            }
            break;
        case 11:
            if (column == 4) {
                compare_and_jump(c, *a, fetch(c));
            } else if (column == 5) {
                compare_and_jump(c, *a, value);
            } else {
                compare_and_jump(c, value, fetch(c));
            }
            break;
        case 12:
            if (column == 4) {
                *a = (uint8_t)(*a << 4 | *a >> 4);
            } else {
                STORE(*a);
                *a = value;
            }
            break;
        case 13:
            if (column == 4) {
                decimal_adjust(c);
            } else if (column == 6 || column == 7) { /* XCHD */
                *at = (uint8_t)((value & 0xF0) | (*a & 15));
                *a = (uint8_t)((*a & 0xF0) | (value & 15));
            } else {
                value--;
                STORE(value);
                jump_if(c, value != 0);
            }
            break;
        case 14: *a = column == 4 ? 0 : value; break;
        default:
            if (column == 4) {
                *a = (uint8_t)~*a;
            } else {
                STORE(*a);
            }
            break;
    }
    return cycles;
}

uint8_t cpu_step(struct cpu *c) {
    uint8_t cycles = execute(c);

    if (REG(c, SP) > c->deepest) { /* a program moves it by hand, too */
        c->deepest = REG(c, SP);
    }
    return cycles;
}

/* Takes the first pending interrupt that is enabled and not held off by one of its priority or higher. */
void cpu_interrupt(struct cpu *c, uint8_t pending) {
    uint8_t level, n, ready = (uint8_t)(pending & REG(c, IE));

    for (level = REG(c, IE) & 0x80 ? 2 : 0; level > c->in_service; level--) {
        uint8_t here = (uint8_t)(level == 2 ? ready & REG(c, IP) : ready & ~REG(c, IP));
        if (here != 0) {
            for (n = 0; !(here >> n & 1); n++) {
            }
            c->in_service |= level;
            call(c, (uint16_t)(8 * n + 3));
            c->cycles += c->slow ? 2 : 4;
            return;
        }
    }
}

void cpu_reset(struct cpu *c) {
    memset(c->sfr, 0, sizeof c->sfr);
    REG(c, SP) = 7;
    c->pc = 0;
    c->in_service = 0;
}
