/* SPDX-License-Identifier: Apache-2.0
 * What the driver chip and the mirror make of the pins: positions, the home index, and a watch on pulse timing. */
#include <stdio.h>

#include "bench.h"

/* DRV8825 data sheet, in cycles of 62.5 ns: STEP period, high and low time, set-up of DIR before STEP. */
#define LIMIT_PERIOD 61 /* 3.8 us */
#define LIMIT_HIGH 31   /* 1.9 us */
#define LIMIT_LOW 31
#define LIMIT_SETUP 11 /* 650 ns */

struct mirror_stats mirror_stats;

static int64_t position, window_low, window_steps;
static bool dir, step, powered = true;
static uint64_t rise, fall, turned, trigger_rise; /* cycles of the last edges; 0 = none */
static uint64_t lose;
static FILE *trace;

static bool in_window(void)
{
    int64_t offset = (position - window_low) % STEPS_PER_TURN;
    return (offset < 0 ? offset + STEPS_PER_TURN : offset) < window_steps;
}

void mirror_start(const struct options *from)
{
    position = from->start;
    window_low = from->window_low;
    window_steps = from->window_steps;
    trace = from->trace ? fopen(from->trace, "wb") : NULL;
    mirror_stats_reset();
    publish_position(position, 0, 0);
}

void mirror_stats_reset(void)
{
    mirror_stats = (struct mirror_stats){ .min_period = UINT64_MAX, .min_high = UINT64_MAX, .min_low = UINT64_MAX,
                                          .min_setup = UINT64_MAX, .min_trigger = UINT64_MAX };
    rise = fall = 0; /* the pause since the last pulse belongs to no motion */
}

static void watch(uint64_t *shortest, uint64_t *breaches, uint64_t since, uint64_t limit)
{
    uint64_t span = cpu_cycle() - since;
    if (since == 0)
        return;
    if (span < *shortest)
        *shortest = span;
    if (span < limit)
        ++*breaches;
}

static void turn(void)
{
    uint64_t record[2];
    bool was_in = in_window();
    if (lose && --lose == 0) {
        mirror_stats.lost++;
        return;
    }
    position += dir ? 1 : -1;
    if (in_window() != was_in)
        cpu_set_home_sensor(in_window());
    publish_position(position, 1, paced_ns());
    if (trace) {
        record[0] = cpu_cycle();
        record[1] = (uint64_t)position;
        fwrite(record, sizeof record, 1, trace);
    }
}

void mirror_step_pin(bool high)
{
    if (high == step)
        return;
    step = high;
    if (!high) {
        watch(&mirror_stats.min_high, &mirror_stats.breach_high, rise, LIMIT_HIGH);
        fall = cpu_cycle();
        return;
    }
    watch(&mirror_stats.min_period, &mirror_stats.breach_period, rise, LIMIT_PERIOD);
    watch(&mirror_stats.min_low, &mirror_stats.breach_low, fall, LIMIT_LOW);
    watch(&mirror_stats.min_setup, &mirror_stats.breach_setup, turned, LIMIT_SETUP);
    rise = cpu_cycle();
    mirror_stats.last_step = rise;
    if (!mirror_stats.first_step)
        mirror_stats.first_step = rise;
    if (dir)
        mirror_stats.up++;
    else
        mirror_stats.down++;
    if (powered)
        turn();
    else
        mirror_stats.unpowered++;
}

void mirror_dir_pin(bool high)
{
    if (high != dir)
        turned = cpu_cycle();
    dir = high;
}

void mirror_enable_pin(bool high) { powered = !high; }

void mirror_trigger_pin(bool high)
{
    if (high) {
        trigger_rise = cpu_cycle();
        mirror_stats.triggers++;
        triggers_fire(position, trigger_rise);
    } else if (trigger_rise) {
        uint64_t width = cpu_cycle() - trigger_rise;
        if (width < mirror_stats.min_trigger)
            mirror_stats.min_trigger = width;
        if (width > mirror_stats.max_trigger)
            mirror_stats.max_trigger = width;
    }
}

int64_t mirror_position(void) { return position; }
bool mirror_is_powered(void) { return powered; }
void mirror_lose(uint64_t nth) { lose = nth; }

void mirror_put(int64_t where)
{
    if (where != position) {
        position = where;
        publish_position(position, 0, paced_ns());
    }
    cpu_set_home_sensor(in_window());
}
