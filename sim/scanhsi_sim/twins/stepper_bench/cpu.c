/* SPDX-License-Identifier: Apache-2.0
 * libsimavr behind a small interface. It has habits that would falsify the bench; each workaround says which. */
#include <simavr/avr_extint.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_timer.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "bench.h"

#define TICK_CYCLES 1600 /* 0.1 ms: no sleep of the emulated CPU jumps further than this */
#define UCSR0A 0xC0
#define UBRR0L 0xC4
#define UBRR0H 0xC5
#define DOR0 3
#define U2X0 1
#define USART_FIFO 3 /* two bytes of buffer and one in the shift register */
#define OCR1AL 0x88
#define OCR1AH 0x89
#define OCR1BL 0x8A
#define OCR1BH 0x8B
#define TCCR1B 0x81
#define WGM12 3
#define TIMSK1 0x6F
#define OCIE1A 1
#define OCIE1B 2

/* Where the signals are: on our own firmware's board, and on a GRBL shield (X axis). */
struct pin {
    char port;
    int bit;
};
static const struct pins {
    struct pin home, step, dir, enable, trigger;
} boards[] = {
    { { 'D', 2 }, { 'D', 3 }, { 'D', 4 }, { 'D', 5 }, { 'B', 0 } },
    { { 'B', 1 }, { 'D', 2 }, { 'D', 5 }, { 'B', 0 }, { 'C', 3 } /* coolant: the nearest it has to a trigger */ },
};
static const struct pins *pins = &boards[0];

static avr_t *avr;
static avr_uart_t *uart;
static avr_timer_t *timer1;
static uint64_t deaf_until;
static uint64_t overruns;

/* simavr prints to stdout, where our answers go. */
static void log_to_stderr(avr_t *core, const int level, const char *format, va_list args)
{
    (void)core;
    if (level <= LOG_ERROR)
        vfprintf(stderr, format, args);
}

/* simavr sleeps on its own when the CPU does. Pacing is the business of main.c. */
static void no_sleep(avr_t *core, avr_cycle_count_t how_long)
{
    (void)core;
    (void)how_long;
}

static unsigned bit_cycles(void)
{
    unsigned divisor = avr->data[UBRR0L] | (avr->data[UBRR0H] & 15) << 8;
    return (divisor + 1) * (avr->data[UCSR0A] & (1 << U2X0) ? 8 : 16);
}

/* simavr counts 8N1 as 11 bits; and it computes this only on a write of UBRR0L. Set it right, again and again. */
static void correct_baud(void) { uart->cycles_per_byte = bit_cycles() * 10; }

/* The two compare units of timer 1 that firmware uses. */
static const struct compare {
    int unit, low, high, enable;
} compares[] = { { AVR_TIMER_COMPA, OCR1AL, OCR1AH, OCIE1A }, { AVR_TIMER_COMPB, OCR1BL, OCR1BH, OCIE1B } };

static avr_cycle_count_t match_zero(avr_t *core, avr_cycle_count_t when, void *param)
{
    const struct compare *compare = param;
    (void)when;
    if (core->data[TIMSK1] & (1 << compare->enable) && !core->data[compare->low] && !core->data[compare->high])
        avr_raise_interrupt(core, &timer1->comp[compare->unit].interrupt);
    return 0;
}

/* A compare value of 0 never matches in simavr. GRBL begins each motion with one, in a mode that counts no further: it matches
 * at once. A counter that runs freely, our own firmware's, matches as it overflows. */
static void mend_timer1(void)
{
    uint64_t overflow = timer1->tov_base + timer1->tov_cycles;
    for (int i = 0; i < 2; i++)
        if (avr->data[TCCR1B] & (1 << WGM12))
            match_zero(avr, avr->cycle, (void *)&compares[i]);
        else if (overflow > avr->cycle && overflow - avr->cycle <= TICK_CYCLES)
            avr_cycle_timer_register(avr, overflow - avr->cycle, match_zero, (void *)&compares[i]);
}

static avr_cycle_count_t tick(avr_t *core, avr_cycle_count_t when, void *param)
{
    (void)core;
    (void)param;
    correct_baud();
    mend_timer1();
    return when + TICK_CYCLES;
}

static avr_cycle_count_t deliver(avr_t *core, avr_cycle_count_t when, void *param)
{
    uint64_t due;
    (void)when;
    (void)param;
    serial_deliver();
    due = serial_byte_due();
    return due > core->cycle ? due : due ? core->cycle + 1 : 0;
}

static void on_transmit(struct avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq;
    (void)param;
    correct_baud();
    serial_transmit((uint8_t)value);
}

static void on_pin(struct avr_irq_t *irq, uint32_t value, void *param)
{
    void (*handler)(bool) = param;
    (void)irq;
    handler(value != 0);
}

/* The first peripheral of a kind and name. */
static void *find(const char *kind, char name)
{
    for (avr_io_t *io = avr->io_port; io; io = io->next)
        if (!strcmp(io->kind, kind) && (kind[0] == 'u' ? ((avr_uart_t *)io)->name : ((avr_timer_t *)io)->name) == name)
            return io;
    return NULL;
}

static void hook_pin(struct pin pin, void (*handler)(bool))
{
    avr_irq_t *irq = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(pin.port), pin.bit);
    avr_irq_register_notify(irq, on_pin, handler);
}

bool cpu_load(const char *elf, bool grbl_shield)
{
    static elf_firmware_t firmware; /* large, and all of it must begin as zero */
    uint32_t flags = 0;
    avr_global_logger_set(log_to_stderr); /* before the ELF file is read: that prints too */
    if (elf_read_firmware(elf, &firmware) < 0 || !firmware.flash)
        return false;
    avr = avr_make_mcu_by_name("atmega328p");
    if (!avr)
        return false;
    avr_init(avr);
    firmware.frequency = CPU_HZ;
    avr_load_firmware(avr, &firmware);
    avr->frequency = CPU_HZ;
    avr->sleep = no_sleep;
    uart = find("uart", '0');
    timer1 = find("timer", '1');
    pins = &boards[grbl_shield];
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags); /* no echo of lines to stdout, no usleep while polled */
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_transmit, NULL);
    hook_pin(pins->step, mirror_step_pin);
    hook_pin(pins->dir, mirror_dir_pin);
    hook_pin(pins->enable, mirror_enable_pin);
    hook_pin(pins->trigger, mirror_trigger_pin);
    return true;
}

void cpu_reset(enum reset_cause cause, uint64_t deaf_cycles)
{
    avr_reset(avr); /* drops every cycle timer, ours too */
    avr_regbit_set(avr, cause == RESET_POWER_ON ? avr->reset_flags.porf : avr->reset_flags.extrf);
    avr->run_cycle_limit = TICK_CYCLES;
    for (int i = 0; i < 2; i++) /* a low INT pin (home sensor, STEP) would be polled every cycle; reset brings it back */
        avr_extint_set_strict_lvl_trig(avr, (uint8_t)i, 0);
    avr_cycle_timer_register(avr, TICK_CYCLES, tick, NULL);
    deaf_until = avr->cycle + deaf_cycles;
    mirror_enable_pin(false); /* pull-down inside the DRV8825: powered while nobody drives the pin */
    cpu_set_home_sensor(true); /* reset has cleared the pin, but an unchanged level is not passed on: change it, ... */
    mirror_put(mirror_position()); /* ... then set it as it really is */
}

bool cpu_run_until(uint64_t cycle)
{
    if (cpu_is_deaf()) {
        avr->cycle = cycle < deaf_until ? cycle : deaf_until;
        if (cpu_is_deaf())
            return true;
        avr_cycle_timer_register(avr, TICK_CYCLES, tick, NULL);
    }
    while (avr->cycle < cycle) {
        int state = avr_run(avr);
        if (state == cpu_Crashed || state == cpu_Done)
            return false;
    }
    return true;
}

uint64_t cpu_cycle(void) { return avr->cycle; }
bool cpu_is_deaf(void) { return avr->cycle < deaf_until; }
double cpu_baud(void) { return avr->data[UBRR0L] || avr->data[UBRR0H] ? (double)CPU_HZ / bit_cycles() : 0; }
uint64_t cpu_overruns(void) { return overruns; }

/* simavr buffers 64 received bytes, the chip two: a third one that waits is lost, and the data overrun flag says so. */
void cpu_receive(uint8_t byte, bool bad)
{
    avr_irq_t *input = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    unsigned waiting = (unsigned)(uart->input.write - uart->input.read) & 63;
    correct_baud();
    if (waiting >= USART_FIFO) {
        overruns++;
        avr->data[UCSR0A] |= 1 << DOR0;
        return;
    }
    avr_raise_irq(input, byte | (bad ? UART_INPUT_FE : 0));
}

void cpu_expect_byte(void)
{
    uint64_t due = serial_byte_due();
    avr_cycle_timer_register(avr, due > avr->cycle ? due - avr->cycle : 1, deliver, NULL);
}

/* An input with pull-up goes back to 1 at every write to its port, unless it is also an "external" level. */
void cpu_set_home_sensor(bool on)
{
    struct pin home = pins->home;
    avr_ioport_external_t level = { .name = home.port, .mask = 1 << home.bit, .value = on ? 0 : 1 << home.bit };
    avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL(home.port), &level);
    avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(home.port), home.bit), on ? 0 : 1);
}
