/* The peripherals of chip.h.  Registers: ADuC841/ADuC842/ADuC843 data sheet, Rev. 0, by the names of its sections. */
#include "chip.h"

#include <string.h>

enum { SCON = 0x98, SBUF, T3FD = 0x9D, T3CON, CFG841 = 0xAF, ECON = 0xB9 };
enum { PSMCON = 0xDF };
enum { EDATA1 = 0xBC, WDCON = 0xC0, EADRL = 0xC6, EADRH, T2CON = 0xC8, RCAP2L = 0xCA, RCAP2H, TL2, TH2 };
enum { ADCCON2 = 0xD8, ADCDATAL, ADCDATAH, ADCCON1 = 0xEF, DAC0L = 0xF9, DAC0H, DACCON = 0xFD };

#define ON_CHIP_XRAM 2048U
#define REG(chip, address) ((chip)->cpu.sfr[(address) - 0x80])
#define BIT(n) (1U << (n))
#define TF2 BIT(7)
#define TR2 BIT(2)
#define TI BIT(1)
#define RI BIT(0)
#define REN BIT(4)
#define ADCI BIT(7)
#define SCONV BIT(4)
#define WDS BIT(2)
#define WDE BIT(1)
#define WDWR BIT(0)
#define EA BIT(7)
#define CMPD BIT(6)

/* 'Timer 3 Generated Baud Rates': 10 bits. */
static uint32_t byte_cycles(const struct chip *chip) {
    uint8_t t3con = REG(chip, T3CON);

    return t3con & BIT(7) ? ((uint32_t)(REG(chip, T3FD) + 64U) << (t3con & 7U)) * 10U / 4U : 1U << 30;
}

/* 'ADC circuit': 17 clocks of the converter, and 1 to 4 for its input. */
static uint32_t conversion_cycles(const struct chip *chip) {
    static const uint8_t DIVIDER[] = {32, 4, 8, 2};
    uint8_t adccon1 = REG(chip, ADCCON1);

    return DIVIDER[adccon1 >> 4 & 3] * (17U + 1U + (adccon1 >> 2 & 3U));
}

/* 'Watchdog timer'. */
static void refresh_watchdog(struct chip *chip) {
    uint8_t wdcon = REG(chip, WDCON);
    uint64_t period = (uint64_t)chip->clock_hz * (512U << (wdcon >> 4 & 7U)) / 32768U;

    chip->bark_at = !(wdcon & WDE) ? UINT64_MAX : wdcon & 0x80 ? chip->cpu.cycles : chip->cpu.cycles + period;
}

/* 'D/A converters': the output is 0 while it is cleared, and as after a reset without power. */
static void write_input(struct chip *chip) {
    uint8_t daccon = REG(chip, DACCON);
    bool on = (daccon & (BIT(3) | BIT(0))) == (BIT(3) | BIT(0));

    chip->u = on ? (uint16_t)((REG(chip, DAC0H) & 15U) << 8 | REG(chip, DAC0L)) : 0U;
    chip->reason = WRITES;
}

/* 'Using the Flash/EE data memory': reads of a page of 4 bytes. */
static void access_eeprom(struct chip *chip, uint8_t command) {
    uint32_t at = ((uint32_t)(REG(chip, EADRH) & 3U) << 8 | REG(chip, EADRL)) * 4U;

    if (command == 1) {
        memcpy(&REG(chip, EDATA1), chip->eeprom + at, 4);
    }
}

uint8_t sfr_read(struct cpu *cpu, uint8_t address) {
    struct chip *chip = (struct chip *)cpu;

    if (address == PSMCON) { /* 'Power supply monitor': the bit of the comparator is read alone */
        return (uint8_t)((cpu->sfr[address - 0x80] & ~CMPD) | (chip->low_supply ? 0U : CMPD));
    }
    return address == SBUF ? chip->received : cpu->sfr[address - 0x80];
}

void sfr_write(struct cpu *cpu, uint8_t address, uint8_t value) {
    struct chip *chip = (struct chip *)cpu;
    uint8_t before = cpu->sfr[address - 0x80];

    if (address == WDCON) { /* an instruction that sets WDWR has to come right before */
        if (chip->wdwr) {
            cpu->sfr[address - 0x80] = (uint8_t)(value & ~WDWR);
            refresh_watchdog(chip);
        }
        chip->wdwr = !chip->wdwr && (value & WDWR) != 0 && ((value ^ before) & ~WDWR) == 0;
        return;
    }
    cpu->sfr[address - 0x80] = value;
    switch (address) {
        case SBUF:
            chip->sent = value;
            chip->sending = true;
            chip->sent_at = cpu->cycles + byte_cycles(chip);
            break;
        case ADCCON2:
            if ((value & ~before & SCONV) != 0 && (REG(chip, ADCCON1) & BIT(7)) != 0) {
                chip->converting = true;
                chip->conversion_at = cpu->cycles + conversion_cycles(chip);
                chip->channel = value & 15U;
                chip->reason = CONVERTS;
            }
            break;
        case DAC0L: case DACCON:
            write_input(chip);
            break;
        case ECON:
            access_eeprom(chip, value);
            break;
        default:
            break;
    }
}

uint8_t xram_read(struct cpu *cpu, uint16_t address) {
    return address < ON_CHIP_XRAM && (REG((struct chip *)cpu, CFG841) & 1) ? cpu->xram[address] : 0xFF;
}

void xram_write(struct cpu *cpu, uint16_t address, uint8_t value) {
    if (address < ON_CHIP_XRAM && (REG((struct chip *)cpu, CFG841) & 1)) {
        cpu->xram[address] = value;
    }
}

/* 'Timer/Counter 2' with 16-bit reload, counting cycles. */
static void count(struct chip *chip, uint32_t cycles) {
    uint32_t period = 0x10000U - (uint32_t)(REG(chip, RCAP2H) << 8 | REG(chip, RCAP2L));
    uint32_t next = (uint32_t)(REG(chip, TH2) << 8 | REG(chip, TL2)) + cycles;

    if (!(REG(chip, T2CON) & TR2)) {
        return;
    }
    for (; next > 0xFFFF; next -= period) {
        REG(chip, T2CON) |= TF2;
    }
    REG(chip, TL2) = (uint8_t)next;
    REG(chip, TH2) = (uint8_t)(next >> 8);
}

static bool put(struct line *line, uint8_t byte, uint64_t at) {
    uint32_t place = (line->first + line->count) % LINE_BYTES;

    if (line->count == LINE_BYTES) {
        return false;
    }
    line->data[place] = byte;
    line->at[place] = at;
    line->count++;
    return true;
}

static void move_bytes(struct chip *chip) {
    struct line *in = &chip->to_chip;

    if (chip->sending && chip->cpu.cycles >= chip->sent_at) {
        chip->sending = false;
        REG(chip, SCON) |= TI;
        (void)put(&chip->from_chip, chip->sent, chip->sent_at);
    }
    if (in->count != 0 && chip->cpu.cycles >= in->at[in->first]) {
        bool taken = (REG(chip, SCON) & (REN | RI)) == REN;
        chip->received = taken ? in->data[in->first] : chip->received;
        chip->lost_bytes += !taken;
        REG(chip, SCON) |= taken ? RI : 0U;
        in->first = (in->first + 1) % LINE_BYTES;
        in->count--;
    }
}

static void convert(struct chip *chip) {
    if (chip->converting && !chip->dead_converter && chip->cpu.cycles >= chip->conversion_at) {
        chip->converting = false;
        REG(chip, ADCDATAL) = (uint8_t)chip->converted;
        REG(chip, ADCDATAH) = (uint8_t)(chip->channel << 4 | (chip->converted >> 8 & 15));
        REG(chip, ADCCON2) = (uint8_t)((REG(chip, ADCCON2) & ~SCONV) | ADCI);
    }
}

static void interrupt(struct chip *chip) {
    uint8_t pending = REG(chip, SCON) & (TI | RI) ? BIT(4) : 0U;

    pending |= REG(chip, T2CON) & TF2 ? BIT(5) : 0U;
    if (pending != 0) {
        cpu_interrupt(&chip->cpu, pending);
    }
}

static void watch(struct chip *chip) {
    uint64_t cycles = chip->cpu.cycles - chip->turn_at;

    if (chip->cpu.pc == chip->watched_pc) {
        chip->turns++;
        chip->longest_turn = cycles > chip->longest_turn ? (uint32_t)cycles : chip->longest_turn;
        chip->turn_at = chip->cpu.cycles;
    }
}

static void reset(struct chip *chip, uint8_t wdcon) {
    cpu_reset(&chip->cpu);
    REG(chip, WDCON) = wdcon;
    REG(chip, PSMCON) = 0xDE;
    REG(chip, DACCON) = BIT(2); /* its value after a reset: outputs cleared, without power */
    chip->sending = chip->converting = chip->wdwr = false;
    chip->held_until = 0;
    refresh_watchdog(chip);
    write_input(chip);
    chip->reason = BOOTS;
}

uint32_t chip_size(void) {
    return (uint32_t)sizeof(struct chip);
}

void chip_power_on(struct chip *chip) {
    memset(chip->cpu.ram, 0x5A, sizeof chip->cpu.ram); /* anything: nothing may rely on it */
    memset(chip->cpu.xram, 0xA5, sizeof chip->cpu.xram);
    reset(chip, 0x10); /* the watchdog waits for WDE */
    chip->to_chip.count = chip->from_chip.count = 0;
}

void chip_watchdog(struct chip *chip) {
    reset(chip, 0x10 | WDS);
}

void chip_pin(struct chip *chip) {
    reset(chip, 0x10);
}

/* Runs to the first instruction that ends at `until` or later, or that asks the caller; returns why it stopped. */
uint8_t chip_run(struct chip *chip, uint64_t until) {
    chip->reason = RAN;
    while (chip->cpu.cycles < until && chip->reason == RAN) {
        uint64_t before = chip->cpu.cycles;
        bool wdwr = chip->wdwr;

        if (before < chip->held_until && chip->cpu.in_service == 0 && (REG(chip, IE) & EA) != 0) {
            chip->cpu.cycles++;
        } else {
            watch(chip);
            (void)cpu_step(&chip->cpu);
            chip->wdwr = chip->wdwr && !wdwr; /* for one instruction */
        }
        interrupt(chip);
        count(chip, (uint32_t)(chip->cpu.cycles - before));
        convert(chip);
        move_bytes(chip);
        if (chip->cpu.cycles >= chip->bark_at) {
            chip_watchdog(chip);
        }
    }
    return chip->reason;
}

/* A byte of the host, whose stop bit is over at a cycle; not before the byte ahead of it is through. */
bool chip_feed(struct chip *chip, uint8_t byte, uint64_t at) {
    uint64_t free_at = chip->received_at + (REG(chip, T3CON) & BIT(7) ? byte_cycles(chip) : 0U); /* else it boots */

    chip->received_at = at > free_at ? at : free_at;
    return put(&chip->to_chip, byte, chip->received_at);
}

/* What the chip has sent; the number of bytes. */
uint32_t chip_take(struct chip *chip, uint8_t *data, uint32_t room) {
    struct line *out = &chip->from_chip;
    uint32_t n;

    for (n = 0; n < room && out->count != 0; n++) {
        data[n] = out->data[out->first];
        out->first = (out->first + 1) % LINE_BYTES;
        out->count--;
    }
    return n;
}
