/* SPDX-License-Identifier: Apache-2.0
 *
 * Ramp after D. Austin, "Generate stepper-motor speed profiles in real time" (Embedded Systems Programming, 2004),
 * written from the paper's equations. Intervals c are in timer ticks, 24.8 fixed point:
 *     c_0 = 0.676 f sqrt(2/a),   up: c_k = c_(k-1) - 2 c_(k-1) / (4k + 1),   down: c_(k-1) = c_k + 2 c_k / (4k - 1)
 * Down is the exact inverse of up, so that a ramp ends at the interval at which it began, and k is at once the ramp
 * index and the number of steps needed to stop. The remainder of each division is carried to the next, which keeps the
 * slow end of 24.8 (small accelerations at high speed) from stalling.
 */
#include "motion.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <math.h>
#include <util/atomic.h>

#include "config.h"

#define INTERVAL(speed) (TICKS_PER_S * 256UL / (speed)) /* steps/s -> 24.8 ticks */
#define FIRST_STEP_TICKS 40                             /* DIR set-up: 20 us, the DRV8825 needs 0.65 */
#define LONGEST_PIECE 0xC000U                           /* longer waits are cut: the timer turns over at 0x10000 */
#define CUT_PIECE 0x8000U

struct profile profile = { SPEED_DEFAULT, ACCELERATION_DEFAULT, 0 };

/* Shared with the step interrupt; the main program touches it with interrupts off or while no step is armed. */
static volatile uint8_t mode;
static volatile bool ended;    /* the last step is done (or the motion was cut short): motion_poll() has work */
static volatile bool stopped;  /* ended by S or X */
static volatile bool found;    /* homing: this phase met its edge */
static volatile bool inside;   /* homing: back-off has (re-)entered the index window */
static volatile int32_t position;
static volatile int8_t direction;
static volatile uint32_t left; /* steps to go */
static volatile uint32_t k;    /* ramp index */
static uint32_t k_offset;      /* ramp index of the start speed */
static uint32_t c, c_first, c_top, remainder;
static uint8_t fraction;
static bool begun, at_top, slowing;
static uint32_t wait; /* ticks of the running interval not armed yet */
static uint32_t elapsed_us, elapsed_half;
static uint16_t last_tick;

static volatile int32_t next_trigger;
static int32_t trigger_every;
static volatile uint16_t triggers_left, triggers_done;
static uint16_t trigger_ticks;

static int8_t home_direction;
static uint32_t home_limit;
static volatile uint32_t overshoot;
static uint32_t phase_budget;

void motion_init(void)
{
    PORTD |= PIN_HOME;
    DDRD |= PIN_STEP | PIN_DIR | PIN_EN;
    DDRB |= PIN_TRIG;
    TCCR1A = 0;
    TCCR1B = _BV(CS11);
}

uint8_t motion_mode(void) { return mode; }

int32_t motion_position(void)
{
    int32_t now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { now = position; }
    return now;
}

int32_t motion_target(void)
{
    int32_t target;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { target = position + (direction > 0 ? (int32_t)left : -(int32_t)left); }
    return target;
}

void motion_set_position(int32_t value) { position = value; }
bool motion_home_sensor(void) { return !(PIND & PIN_HOME); }
bool motion_is_enabled(void) { return !(PORTD & PIN_EN); }

void motion_enable(bool on)
{
    if (on)
        PORTD &= (uint8_t)~PIN_EN;
    else
        PORTD |= PIN_EN;
}

/* --- the step interrupt ------------------------------------------------------------------------------------------ */

/* Arm the next piece of `wait`, counted from the last compare point so that intervals do not drift. */
static inline void arm(void)
{
    uint16_t piece = wait > LONGEST_PIECE ? CUT_PIECE : (uint16_t)wait;
    uint16_t point = OCR1A + piece;
    uint16_t ahead = point - TCNT1;
    wait -= piece;
    if (ahead > piece || ahead < 4) /* already gone by: without this the step comes a whole timer turn late */
        point = TCNT1 + 8;
    OCR1A = point;
}

/* Motion time is counted here, not with the overflow interrupt: a step interrupt comes at least every 25 ms. */
static inline void count_time(void)
{
    uint16_t now = TCNT1;
    uint16_t ticks = now - last_tick;
    last_tick = now;
    elapsed_half += ticks & 1;
    elapsed_us += (ticks >> 1) + (elapsed_half >> 1);
    elapsed_half &= 1;
}

static inline void fire_trigger(void)
{
    PORTB |= PIN_TRIG;
    OCR1B = TCNT1 + trigger_ticks;
    TIFR1 = _BV(OCF1B);
    TIMSK1 |= _BV(OCIE1B);
    triggers_done++;
    if (--triggers_left)
        next_trigger += trigger_every;
    else
        left = k; /* ramp down from here */
}

ISR(TIMER1_COMPB_vect)
{
    PORTB &= (uint8_t)~PIN_TRIG;
    TIMSK1 &= (uint8_t)~_BV(OCIE1B);
}

/* End the running phase as soon as the ramp allows; called before a step that will certainly be made. */
static inline void shorten(void)
{
    if (left > k + 1)
        left = k + 1;
}

/* What the index sensor means for the next step, sampled at the standing position. True = stand still here. */
static inline bool sensor_says_stop(void)
{
    bool on = motion_home_sensor();
    if (mode == MODE_HOME_SEEK && on) {
        shorten();
        overshoot = left;
        mode = MODE_HOME_STOP;
    } else if (mode == MODE_HOME_BACK_OFF && !found) {
        if (on)
            inside = true; /* seen at speed, the window may have been passed: only after re-entry does "off" count */
        else if (inside) {
            found = true;
            shorten();
        }
    } else if (mode == MODE_HOME_LATCH && on) {
        found = true;
        left = 0;
        return true;
    }
    return false;
}

/* Interval after a step, 24.8 ticks. `left` >= 1 steps follow. */
static inline uint32_t next_interval(uint32_t to_go)
{
    uint32_t index = k;
    if (!begun) {
        begun = true;
    } else if (index >= to_go) {
        uint32_t divisor = 4 * (index + k_offset) - 1, dividend;
        if (!slowing)
            remainder = 0;
        slowing = true;
        at_top = false;
        dividend = 2 * c + remainder;
        c += dividend / divisor;
        remainder = dividend % divisor;
        if (--index == 0 || c > c_first)
            c = c_first;
    } else if (index + 1 < to_go && !at_top) {
        uint32_t divisor = 4 * (index + k_offset) + 5, dividend, faster;
        if (slowing)
            remainder = 0;
        slowing = false;
        dividend = 2 * c + remainder;
        faster = c - dividend / divisor;
        if (faster < c_top) {
            at_top = true;
        } else {
            remainder = dividend % divisor;
            c = faster;
            index++;
        }
    }
    k = index;
    return at_top ? c_top : c;
}

ISR(TIMER1_COMPA_vect)
{
    uint32_t to_go, interval;
    count_time();
    if (wait) {
        arm();
        return;
    }
    if (mode >= MODE_HOME_SEEK && sensor_says_stop())
        goto end;
    PORTD |= PIN_STEP; /* the lines up to its fall take 3.5 us; the DRV8825 needs 1.9 (the emulator bench watches) */
    position += direction;
    to_go = --left;
    if (triggers_left && position == next_trigger) {
        fire_trigger();
        to_go = left;
    }
    PORTD &= (uint8_t)~PIN_STEP;
    if (to_go == 0)
        goto end;
    TIMSK1 &= (uint8_t)~_BV(OCIE1A); /* the division takes 40 us: let the serial port interrupt it, but not ourselves */
    sei();
    interval = next_interval(to_go) + fraction;
    cli();
    fraction = (uint8_t)interval;
    wait = interval >> 8;
    arm();
    TIMSK1 |= _BV(OCIE1A);
    return;
end:
    TIMSK1 &= (uint8_t)~_BV(OCIE1A);
    ended = true;
}

/* --- starting and stopping --------------------------------------------------------------------------------------- */

static void set_ramp(uint16_t top_speed)
{
    c_first = (uint32_t)(0.676f * 1.41421356f * 256.0f * TICKS_PER_S / sqrtf((float)profile.acceleration));
    k_offset = 0;
    if (profile.start_speed && INTERVAL(profile.start_speed) < c_first) {
        c_first = INTERVAL(profile.start_speed);
        k_offset = (uint32_t)profile.start_speed * profile.start_speed / (2 * profile.acceleration);
    }
    c_top = INTERVAL(top_speed);
    if (c_first < c_top)
        c_first = c_top;
}

static void start(uint8_t new_mode, int8_t towards, uint32_t steps, uint16_t top_speed)
{
    set_ramp(top_speed);
    if (towards > 0)
        PORTD |= PIN_DIR;
    else
        PORTD &= (uint8_t)~PIN_DIR;
    c = c_first;
    k = remainder = wait = 0;
    fraction = 0;
    begun = at_top = slowing = found = inside = stopped = false;
    direction = towards;
    left = phase_budget = steps;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        mode = new_mode;
        last_tick = TCNT1;
        ended = steps == 0;
        if (steps) {
            OCR1A = last_tick + FIRST_STEP_TICKS;
            TIFR1 = _BV(OCF1A);
            TIMSK1 |= _BV(OCIE1A);
        }
    }
}

static void begin_record(void)
{
    elapsed_us = elapsed_half = 0;
    triggers_left = triggers_done = 0;
}

void motion_start_move(int32_t target)
{
    int32_t from = position;
    begin_record();
    start(MODE_MOVE, target >= from ? 1 : -1, target >= from ? (uint32_t)target - from : (uint32_t)from - target,
          profile.top_speed);
}

void motion_start_sweep(int32_t first, int32_t every, uint16_t count, uint16_t width_us)
{
    int32_t last = first + every * (int32_t)(count - 1);
    uint32_t distance = every > 0 ? (uint32_t)(last - position) : (uint32_t)(position - last);
    begin_record();
    next_trigger = first;
    trigger_every = every;
    trigger_ticks = width_us * 2;
    triggers_left = count;
    start(MODE_SWEEP, every > 0 ? 1 : -1, distance + 100000000UL, profile.top_speed); /* the last trigger shortens it */
}

void motion_start_home(int8_t towards, uint32_t limit)
{
    begin_record();
    home_direction = towards;
    home_limit = limit;
    overshoot = 0;
    if (motion_home_sensor())
        start(MODE_HOME_BACK_OFF, -towards, limit, profile.top_speed);
    else
        start(MODE_HOME_SEEK, towards, limit, profile.top_speed);
}

void motion_stop_ramped(void)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        if (mode != MODE_IDLE && !ended) {
            shorten();
            triggers_left = 0;
            stopped = true;
            mode = MODE_STOPPING;
        }
    }
}

void motion_stop_now(void)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        if (mode != MODE_IDLE && !ended) {
            TIMSK1 &= (uint8_t)~_BV(OCIE1A);
            left = 0;
            triggers_left = 0;
            stopped = true;
            ended = true;
            mode = MODE_STOPPING;
        }
    }
}

/* --- the end of a motion, or of one phase of homing -------------------------------------------------------------- */

/* Start the next phase of homing; false = homing is over and `*error` says how. */
static bool next_home_phase(uint8_t *error)
{
    uint32_t travelled = phase_budget - left;
    *error = ERR_NO_SENSOR;
    switch (mode) {
    case MODE_HOME_SEEK: /* came to the limit; the sensor may have come on with the very last step */
        if (!motion_home_sensor())
            return false;
        /* fall through */
    case MODE_HOME_STOP:
        start(MODE_HOME_BACK_OFF, -home_direction, overshoot + home_limit, profile.top_speed);
        return true;
    case MODE_HOME_BACK_OFF:
        if (!found)
            return false;
        start(MODE_HOME_LATCH, home_direction, travelled + home_limit,
              profile.top_speed < LATCH_SPEED ? profile.top_speed : LATCH_SPEED);
        return true;
    default: /* MODE_HOME_LATCH */
        if (found) {
            position = 0;
            *error = 0;
        }
        return false;
    }
}

bool motion_needs_poll(void) { return ended; }

bool motion_poll(struct motion_end *end)
{
    if (!ended)
        return false;
    ended = false;
    end->error = stopped ? ERR_STOPPED : 0;
    if (!stopped && mode >= MODE_HOME_SEEK && next_home_phase(&end->error))
        return false;
    left = 0;
    end->position = position;
    end->us = elapsed_us;
    end->triggers = triggers_done;
    mode = MODE_IDLE;
    return true;
}
