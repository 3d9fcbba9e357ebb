/* SPDX-License-Identifier: Apache-2.0
 * Firmware of the mirror drive: Arduino Uno (ATmega328P, 16 MHz), DRV8825, NEMA 17. See README.md. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <stdbool.h>

#include "config.h"
#include "motion.h"
#include "protocol.h"
#include "uart.h"

static uint8_t reset_cause __attribute__((section(".noinit")));

/* A watchdog left on by a reset keeps resetting the chip: switch it off before anything else. The cause of the reset
 * must be read and cleared first. (Bootloaders that clear MCUSR themselves leave a 0.) */
void keep_reset_cause(void) __attribute__((naked, used, section(".init3")));
void keep_reset_cause(void)
{
    reset_cause = MCUSR;
    MCUSR = 0;
    wdt_disable();
}

int main(void)
{
    motion_init();
    uart_init();
    set_sleep_mode(SLEEP_MODE_IDLE);
    sei();
    protocol_boot(reset_cause);
    for (;;) {
        struct motion_end end;
        if (motion_poll(&end))
            protocol_motion_ended(&end);
        if (uart_has_input()) {
            protocol_feed(uart_read());
            continue;
        }
        cli(); /* sei takes effect one instruction later, so that no interrupt slips in between the test and the sleep */
        if (!uart_has_input() && !motion_needs_poll()) {
            sleep_enable();
            sei();
            sleep_cpu();
            sleep_disable();
        }
        sei();
    }
}
