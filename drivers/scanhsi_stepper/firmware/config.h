/* SPDX-License-Identifier: Apache-2.0
 * Pins, limits and default values of the mirror stepper firmware (ATmega328P, 16 MHz). */
#ifndef CONFIG_H
#define CONFIG_H

#include <avr/io.h>
#include <stdint.h>

#define FIRMWARE_NAME "scanhsi-stepper"
#define FIRMWARE_VERSION 1
#define FIRMWARE_MCU "328P"

/* All signals but TRIG are on port D. Arduino Uno names: D2 .. D5 and D8. */
#define PIN_HOME _BV(PD2) /* index switch, active low, internal pull-up */
#define PIN_STEP _BV(PD3)
#define PIN_DIR _BV(PD4) /* high = positive positions */
#define PIN_EN _BV(PD5)  /* nENBL of the DRV8825: low = motor powered */
#define PIN_TRIG _BV(PB0)

#define TICKS_PER_S 2000000UL /* Timer1: F_CPU / 8, 0.5 us a tick */

#define POSITION_LIMIT 1000000000L
#define SPEED_MIN 1
#define SPEED_MAX 12000 /* steps/s; the step interrupt takes up to 78 us */
#define SPEED_DEFAULT 4000
#define LATCH_SPEED 500 /* steps/s; slow enough to stop dead on the index edge */
#define ACCELERATION_MIN 10
#define ACCELERATION_MAX 2000000L
#define ACCELERATION_DEFAULT 20000
#define START_SPEED_MAX 4000
#define TRIGGER_COUNT_MAX 65535L
#define TRIGGER_WIDTH_MIN_US 5
#define TRIGGER_WIDTH_MAX_US 10000

enum error { ERR_UNKNOWN = 1, ERR_ARGUMENT = 2, ERR_BUSY = 3, ERR_RANGE = 4, ERR_NO_SENSOR = 5, ERR_STOPPED = 6 };

#endif
