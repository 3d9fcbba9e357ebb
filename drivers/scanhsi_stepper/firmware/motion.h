/* SPDX-License-Identifier: Apache-2.0
 * Step generator: ramped moves, position-triggered sweeps and homing. All positions are in microsteps.
 * The caller checks ranges; every start_* function needs motion_mode() == MODE_IDLE. */
#ifndef MOTION_H
#define MOTION_H

#include <stdbool.h>
#include <stdint.h>

enum mode {
    MODE_IDLE = 0,
    MODE_MOVE = 1,
    MODE_SWEEP = 2,
    MODE_STOPPING = 3,
    MODE_HOME_SEEK = 4,
    MODE_HOME_STOP = 5,
    MODE_HOME_BACK_OFF = 6,
    MODE_HOME_LATCH = 7
};

struct profile {
    uint16_t top_speed;    /* steps/s */
    uint32_t acceleration; /* steps/s2 */
    uint16_t start_speed;  /* steps/s; below it the motor starts and stops without a ramp; 0 = ramp from rest */
};

struct motion_end {
    uint8_t error; /* 0, ERR_NO_SENSOR or ERR_STOPPED */
    int32_t position;
    uint32_t us; /* from start to last step, modulo 2^32 */
    uint16_t triggers;
};

extern struct profile profile;

void motion_init(void);
uint8_t motion_mode(void);
int32_t motion_position(void);
int32_t motion_target(void);
void motion_set_position(int32_t position);
bool motion_home_sensor(void);
bool motion_is_enabled(void);
void motion_enable(bool on);

void motion_start_move(int32_t target);
void motion_start_sweep(int32_t first, int32_t every, uint16_t count, uint16_t width_us);
void motion_start_home(int8_t direction, uint32_t limit);
void motion_stop_ramped(void);
void motion_stop_now(void);

bool motion_needs_poll(void);                 /* call with interrupts off before going to sleep */
bool motion_poll(struct motion_end *end);     /* true once for each motion that has ended */

#endif
