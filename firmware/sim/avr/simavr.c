/* An ATmega328P of libsimavr between two events: a conversion that starts, the input converter that changes, the end of
 * the time that was asked for.  What is on the other side of its pins is the caller's (board.py).
 */
#include <simavr/avr_adc.h>
#include <simavr/avr_eeprom.h>
#include <simavr/avr_twi.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_io.h>
#include <stdlib.h>
#include <string.h>

enum { DEAF = 1, STUCK };
enum { TIME_IS_OVER, CONVERSION, INPUT_CHANGED, CRASHED };

#define F_CPU 16000000U
#define DAC_ADDRESS 0x60
#define DAC_STORES 0x60U /* of a message: into the EEPROM, too */
#define DAC_READY 0xC0U /* and powered */
#define DAC_STORING_CYCLES (F_CPU / 40U) /* 25 ms, in which it takes no write */
#define BYTE_BITS 9U
#define ADDRESS_BITS 11U /* with the start condition and the stop before it */
#define SIMAVR_BYTE_CYCLES 144U
#define BIT_CYCLES 40U /* at 400 kHz */
#define AFTER_ADDRESS_CYCLES 16U /* within which the program sees that an address has been moved */
#define TWINT (1U << 7)
#define TWEN (1U << 2)
#define SDA (1U << 4) /* of port C */
#define SCL (1U << 5)
#define STEPS_AT_MOST 100000U      /* of a wait that is of a few hundred */
#define OUTPUT_SIZE 4096U
#define RAM_PATTERN 0xC5 /* what RAM holds after power-on: what the stack has not reached keeps it */

/* What the caller may look at; it begins the memory of a chip. */
struct chip {
    uint64_t cycle;  /* of the last event */
    uint64_t slept;  /* cycles without an instruction, since the start */
    uint8_t *memory; /* registers and RAM */
    uint32_t sent_count;
    uint16_t u;      /* of the converter */
    uint8_t channel; /* of the conversion */
    uint8_t output_fault; /* DEAF: the converter does not answer on its bus; STUCK: it does, and keeps its output */
    uint64_t acknowledge_at; /* cycle at which the last byte's acknowledge began */
    uint16_t held;         /* falls of SCL until the converter lets SDA go; 0: it does not hold it */
    uint16_t held_by_reset; /* those of a reset in an acknowledge */
    uint16_t bit_cycles;   /* of the bus, 16 at least; more: a converter or a cable that makes it slower */
    uint16_t broken;       /* messages within which another one began */
    uint8_t watched_byte;  /* of a message, 1: its address; 0 once it is acknowledged */
    uint8_t dead_converter; /* a conversion never ends */
    uint16_t stored;        /* what the converter wakes up with */
    uint8_t sent[OUTPUT_SIZE];
    uint8_t event, selected, received_count;
    uint8_t received[3]; /* by the converter, of the message on its bus */
    uint64_t stored_at;  /* cycle until which it stores */
    avr_t *avr;
    avr_irq_t *adc, *twi, *uart;
    avr_uart_t *line;
    avr_twi_t *bus;
    avr_io_write_t write_twcr, write_adcsra;
    void *adc_block;
    avr_io_t on_reset;
    uint8_t bytes; /* of the message on the bus */
};

static void silent(avr_t *avr, const int level, const char *format, va_list values) {
    (void)avr, (void)level, (void)format, (void)values;
}

static void no_sleep(avr_t *avr, avr_cycle_count_t cycles) {
    struct chip *chip = avr->custom.data;

    chip->slept += cycles + 1U; /* as the caller in simavr counts them */
}

static void happen(struct chip *chip, uint8_t event) {
    chip->event = event;
    chip->cycle = chip->avr->cycle;
}

static void on_conversion(avr_irq_t *irq, uint32_t value, void *to) {
    struct chip *chip = to;
    union {
        uint32_t value;
        avr_adc_mux_t mux;
    } what = {.value = value};

    (void)irq;
    chip->channel = (uint8_t)what.mux.src;
    happen(chip, CONVERSION);
}

/* By the converter, of the message on its bus: fast mode in two bytes, or three for register and EEPROM. */
static void take(struct chip *chip, uint8_t byte) {
    uint8_t size, stores;

    chip->received[chip->received_count++] = byte;
    stores = (chip->received[0] & 0xE0U) == DAC_STORES;
    size = stores ? 3U : 2U;
    if (chip->received_count < size) {
        return;
    }
    chip->received_count = 0;
    if (chip->output_fault != 0U || chip->avr->cycle < chip->stored_at) {
        return;
    }
    if (stores) {
        chip->u = chip->stored = (uint16_t)(chip->received[1] << 4 | chip->received[2] >> 4);
        chip->stored_at = chip->avr->cycle + DAC_STORING_CYCLES;
        happen(chip, INPUT_CHANGED);
    } else if ((chip->received[0] & 0xC0U) == 0U) {
        chip->u = (uint16_t)((chip->received[0] & 0x0FU) << 8 | chip->received[1]);
        happen(chip, INPUT_CHANGED);
    }
}

/* Status, register, EEPROM: the bytes of a read. */
static uint8_t told(const struct chip *chip, uint8_t n) {
    const uint8_t bytes[] = {chip->avr->cycle < chip->stored_at ? DAC_READY & 0x7FU : DAC_READY, (uint8_t)(chip->u >> 4),
                             (uint8_t)(chip->u << 4), (uint8_t)(chip->stored >> 8), (uint8_t)chip->stored};

    return bytes[n % sizeof bytes];
}

static void on_bus(avr_irq_t *irq, uint32_t value, void *to) {
    struct chip *chip = to;
    avr_twi_msg_irq_t message = {.u.v = value};
    uint8_t what = message.u.twi.msg;

    (void)irq;
    if ((what & TWI_COND_STOP) != 0) {
        chip->selected = 0;
        chip->bytes = 0;
    } else { /* simavr moves an address in 0.1 us and a byte in 9, whatever the rate; the program waits for it anyway */
        chip->avr->cycle += (what & TWI_COND_START) != 0 ? ADDRESS_BITS * chip->bit_cycles
                                                         : BYTE_BITS * chip->bit_cycles - SIMAVR_BYTE_CYCLES;
    }
    if ((what & TWI_COND_START) != 0) {
        chip->selected = chip->output_fault != DEAF && message.u.twi.addr >> 1 == DAC_ADDRESS;
        chip->received_count = 0;
        chip->broken += chip->bytes != 0U;
        chip->bytes = 0;
    }
    if (!chip->selected) {
        return;
    }
    avr_raise_irq(chip->twi + TWI_IRQ_INPUT, avr_twi_irq_msg(TWI_COND_ACK, DAC_ADDRESS << 1, 1));
    chip->bytes++;
    chip->acknowledge_at = chip->avr->cycle - BIT_CYCLES +
                           ((what & TWI_COND_START) != 0 ? AFTER_ADDRESS_CYCLES : SIMAVR_BYTE_CYCLES);
    if (chip->bytes == chip->watched_byte) {
        chip->watched_byte = 0;
    }
    if ((what & TWI_COND_WRITE) != 0) {
        take(chip, message.u.twi.data);
    } else if ((what & TWI_COND_READ) != 0) {
        avr_raise_irq(chip->twi + TWI_IRQ_INPUT,
                      avr_twi_irq_msg(TWI_COND_READ, DAC_ADDRESS << 1, told(chip, chip->received_count++)));
    }
}

/* A one at TWINT clears it until the step has ended; simavr leaves it set, and a program would not wait.  A start
 * condition waits for SDA: while the converter holds it, simavr does not learn of the start, and no step ends. */
static void on_twcr(avr_t *avr, avr_io_addr_t address, uint8_t value, void *to) {
    struct chip *chip = to;

    if (chip->held != 0U && (value & TWEN) != 0U) {
        avr->data[address] = value;
    } else {
        chip->write_twcr(avr, address, value, chip->bus);
    }
    if ((value & TWINT) != 0U) {
        avr->data[address] &= (uint8_t)~TWINT;
    }
}

static void on_adcsra(avr_t *avr, avr_io_addr_t address, uint8_t value, void *to) {
    struct chip *chip = to;

    if (chip->dead_converter) {
        avr->data[address] = value;
    } else {
        chip->write_adcsra(avr, address, value, chip->adc_block);
    }
}

static void on_ddrc(avr_t *avr, avr_io_addr_t address, uint8_t value, void *to) {
    struct chip *chip = to;
    uint8_t before = avr->data[address];

    if ((value & ~before & SCL) != 0 && chip->held != 0U) {
        chip->held--;
    }
    avr->data[address] = value;
}

/* The lines are high where nobody pulls them low. */
static uint8_t on_pinc(avr_t *avr, avr_io_addr_t address, void *to) {
    const struct chip *chip = to;
    uint8_t pulled = avr->data[address + 1U]; /* DDRC */

    return (uint8_t)((SDA | SCL) & ~pulled & ~(chip->held != 0U ? SDA : 0U));
}

/* The converter is not reset with the controller: in the middle of its acknowledge it goes on holding SDA. */
static void on_reset(avr_io_t *io) {
    struct chip *chip = io->avr->custom.data;
    uint64_t into = io->avr->cycle - chip->acknowledge_at;

    chip->bytes = 0;
    if (into < BIT_CYCLES) {
        chip->held = chip->held_by_reset;
    }
}

static void on_sent(avr_irq_t *irq, uint32_t value, void *to) {
    struct chip *chip = to;

    (void)irq;
    if (chip->sent_count < OUTPUT_SIZE) {
        chip->sent[chip->sent_count++] = (uint8_t)value;
    }
}

static avr_cycle_count_t on_time(avr_t *avr, avr_cycle_count_t when, void *to) {
    (void)avr, (void)when;
    if (((struct chip *)to)->event == UINT8_MAX) {
        happen(to, TIME_IS_OVER);
    }
    return 0;
}

static void *find(avr_t *avr, const char *kind) {
    avr_io_t *io = avr->io_port;

    while (strcmp(io->kind, kind) != 0) {
        io = io->next;
    }
    return io;
}

/* Puts this file's bus between the program and simavr's, which has no lines, and a converter that can fail. */
static void take_bus(struct chip *chip) {
    avr_t *avr = chip->avr;
    avr_io_addr_t adcsra, twcr, pinc = AVR_DATA_TO_IO(0x26), ddrc = AVR_DATA_TO_IO(0x27);

    chip->bus = find(avr, "twi");
    twcr = AVR_DATA_TO_IO(chip->bus->r_twcr);
    chip->write_twcr = avr->io[twcr].w.c;
    avr->io[twcr].w.c = on_twcr;
    avr->io[ddrc].w.c = on_ddrc;
    avr->io[pinc].r.c = on_pinc;
    avr->io[twcr].w.param = avr->io[ddrc].w.param = avr->io[pinc].r.param = chip;
    chip->adc_block = find(avr, "adc");
    adcsra = AVR_DATA_TO_IO(((avr_adc_t *)chip->adc_block)->r_adcsra);
    chip->write_adcsra = avr->io[adcsra].w.c;
    avr->io[adcsra].w.c = on_adcsra;
    avr->io[adcsra].w.param = chip;
    chip->bit_cycles = BIT_CYCLES;
    chip->held_by_reset = 1; /* the acknowledge ends when SCL falls */
    chip->on_reset.kind = "reset";
    chip->on_reset.reset = on_reset;
    avr_register_io(avr, &chip->on_reset);
}

struct chip *chip_open(const uint8_t *code, uint32_t size) {
    struct chip *chip = calloc(1, sizeof *chip);
    uint32_t flags = 0;

    avr_global_logger_set(silent);
    chip->avr = avr_make_mcu_by_name("atmega328p");
    avr_init(chip->avr);
    chip->avr->frequency = F_CPU; /* avr_init sets 1 MHz */
    chip->avr->vcc = chip->avr->avcc = 5000;
    chip->avr->aref = 1023; /* so that a millivolt is a count */
    chip->avr->sleep = no_sleep;
    chip->avr->custom.data = chip;
    chip->avr->log = LOG_NONE;
    avr_loadcode(chip->avr, (uint8_t *)code, size, 0);
    chip->avr->codeend = size;
    chip->memory = chip->avr->data;
    chip->adc = avr_io_getirq(chip->avr, AVR_IOCTL_ADC_GETIRQ, 0);
    chip->twi = avr_io_getirq(chip->avr, AVR_IOCTL_TWI_GETIRQ(0), 0);
    chip->uart = avr_io_getirq(chip->avr, AVR_IOCTL_UART_GETIRQ('0'), 0);
    chip->line = find(chip->avr, "uart");
    take_bus(chip);
    avr_ioctl(chip->avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_register_notify(chip->adc + ADC_IRQ_OUT_TRIGGER, on_conversion, chip);
    avr_irq_register_notify(chip->twi + TWI_IRQ_OUTPUT, on_bus, chip);
    avr_irq_register_notify(chip->uart + UART_IRQ_OUTPUT, on_sent, chip);
    return chip;
}

void chip_close(struct chip *chip) {
    avr_terminate(chip->avr);
    free(chip);
}

/* A reset by power (RAM is lost, the converter is at what it has stored), by a dip of it (the converter kept its output), or by the
 * watchdog.  Cycles go on. */
void chip_reset(struct chip *chip, uint8_t power, uint8_t brown_out) {
    avr_t *avr = chip->avr;

    if (power || brown_out) {
        memset(avr->data + avr->ioend + 1, RAM_PATTERN, avr->ramend - avr->ioend);
    }
    avr_reset(avr);
    avr_regbit_setto(avr, avr->reset_flags.porf, power);
    avr_regbit_setto(avr, avr->reset_flags.borf, brown_out);
    avr_regbit_setto(avr, avr->reset_flags.wdrf, !power && !brown_out);
    chip->sent_count = 0;
    if (power) {
        chip->u = chip->stored & 0x0FFFU;
        chip->stored_at = 0;
        chip->held = 0;
    }
}

/* Runs to an event, at most to this cycle. */
uint8_t chip_run(struct chip *chip, uint64_t until) {
    avr_t *avr = chip->avr;

    /* A byte has 10 bits of 8 clocks of the divider each: simavr counts 11. */
    chip->line->cycles_per_byte = 80U * (1U + avr->data[chip->line->ubrrl.reg]);
    chip->event = avr->cycle < until ? UINT8_MAX : TIME_IS_OVER;
    if (chip->event == UINT8_MAX) {
        avr_cycle_timer_register(avr, until - avr->cycle, on_time, chip);
    }
    while (chip->event == UINT8_MAX) {
        int state = avr_run(avr);

        if (state == cpu_Done || state == cpu_Crashed) {
            happen(chip, CRASHED);
        }
    }
    avr_cycle_timer_cancel(avr, on_time, chip);
    if (chip->event == TIME_IS_OVER) {
        chip->cycle = avr->cycle;
    }
    return chip->event;
}

void chip_convert(struct chip *chip, uint8_t channel, uint16_t count) {
    avr_raise_irq(chip->adc + ADC_IRQ_ADC0 + channel, count);
}

void chip_receive(struct chip *chip, uint8_t byte) {
    avr_raise_irq(chip->uart + UART_IRQ_INPUT, byte);
}

/* Lets the program go on elsewhere, as soon as it admits interrupts; returns where it was. */
uint32_t chip_jump(struct chip *chip, uint32_t address) {
    uint32_t n;
    uint32_t from;

    for (n = 0; n < STEPS_AT_MOST && !chip->avr->sreg[S_I]; n++) {
        chip->avr->run_cycle_count = 1;
        avr_run(chip->avr);
    }
    from = chip->avr->pc;
    chip->avr->pc = address;
    chip->avr->state = cpu_Running;
    return from;
}

/* Lets a program that was sent to an endless loop go on where it was, as soon as no interrupt is being served. */
void chip_go_on(struct chip *chip, uint32_t loop, uint32_t address) {
    uint32_t n;

    for (n = 0; n < STEPS_AT_MOST && chip->avr->pc != loop; n++) {
        chip->avr->run_cycle_count = 1;
        avr_run(chip->avr);
    }
    chip->avr->pc = address;
}

void chip_store(struct chip *chip, const uint8_t *data, uint16_t size) {
    avr_eeprom_desc_t what = {.ee = (uint8_t *)data, .offset = 0, .size = size};

    avr_ioctl(chip->avr, AVR_IOCTL_EEPROM_SET, &what);
}

/* Bytes of RAM above `from` that the stack has never reached. */
uint16_t chip_untouched(const struct chip *chip, uint16_t from) {
    uint16_t at = from;

    while (at <= chip->avr->ramend && chip->memory[at] == RAM_PATTERN) {
        at++;
    }
    return (uint16_t)(at - from);
}
