/* SPDX-License-Identifier: Apache-2.0
 *
 * The same motion core behind another front end: enough of the GRBL 1.1 interface, written from its public description, to
 * test the driver scanhsi_grbl in the emulator. It stands in for protocol.c (`make grbl.elf`). One axis, X; no planner: a
 * line that would move what moves already is refused with error:8, where GRBL queues it. Settings live in RAM only.
 */
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "config.h"
#include "protocol.h"
#include "uart.h"

#define LINE_MAX 80
#define WCO_EVERY 10 /* status reports */

enum state { IDLE, RUN, HOLD, JOG, HOME_SEEK, HOME_PULL_OFF, ALARM };
enum grbl_error { E_OK, E_LETTER = 1, E_NUMBER = 2, E_SYSTEM = 3, E_NEGATIVE = 4, E_HOMING_OFF = 5, E_NOT_IDLE = 8, E_LOCKED = 9,
                  E_OVERFLOW = 11, E_TRAVEL = 15, E_JOG = 16, E_UNSUPPORTED = 20, E_NO_FEED = 22, E_NO_AXIS = 26,
                  E_ANSWERED_LATER = 255 };

struct setting {
    uint8_t number;
    int32_t thousandths;
};

/* The unit is 1000 steps: exact, and 240 units/min are 4000 steps/s. */
static struct setting settings[] = {
    { 0, 10000 },   { 1, 255000 },  { 2, 0 },       { 3, 0 },       { 4, 0 },       { 5, 0 },       { 6, 0 },
    { 10, 1000 },   { 11, 10 },     { 12, 2 },      { 13, 0 },      { 20, 1000 },   { 21, 0 },      { 22, 1000 },
    { 23, 1000 },   { 24, 30000 },  { 25, 240000 }, { 26, 25000 },  { 27, 1000 },   { 30, 1000000 }, { 31, 0 },
    { 32, 0 },      { 100, 1000000 }, { 101, 250000 }, { 102, 250000 }, { 110, 240000 }, { 111, 500000 }, { 112, 500000 },
    { 120, 20000 }, { 121, 10000 }, { 122, 10000 }, { 130, 26000 }, { 131, 200000 }, { 132, 200000 },
};
#define SETTINGS (sizeof settings / sizeof *settings)
enum { STATUS_MASK = 10, SOFT_LIMITS = 20, HOMING = 22, HOMING_DIRECTION = 23, HOMING_SEEK = 25, PULL_OFF = 27, STEPS_PER_MM = 100,
       MAX_RATE = 110, ACCELERATION = 120, TRAVEL = 130 };

static uint8_t state;
static char line[LINE_MAX];
static uint8_t line_length;
static bool too_long;
static int32_t resume_target;
static uint8_t until_wco;

static struct setting *find(int32_t number)
{
    for (uint8_t i = 0; i < SETTINGS; i++)
        if (settings[i].number == number)
            return &settings[i];
    return NULL;
}

static int32_t value(uint8_t number) { return find(number)->thousandths; }
static bool is_on(uint8_t number) { return value(number) != 0; }
static bool homes_down(void) { return value(HOMING_DIRECTION) / 1000 & 1; }

/* --- writing ------------------------------------------------------------------------------------------------------ */

static void write_int(int32_t number)
{
    char digits[12];
    uart_write(ltoa(number, digits, 10));
}

static void write_thousandths(int32_t number)
{
    char digits[12];
    if (number < 0)
        uart_write("-");
    number = labs(number);
    write_int(number / 1000);
    uart_write(".");
    ltoa(number % 1000 + 1000, digits, 10);
    uart_write(digits + 1);
}

static void write_axes(const char *label, int32_t x)
{
    uart_write(label);
    write_thousandths(x);
    uart_write(",0.000,0.000");
}

static void write_banner(void)
{
    uart_write("\r\nGrbl 1.1h ['$' for help]\r\n");
    if (state == ALARM)
        uart_write("[MSG:'$H'|'$X' to unlock]\r\n");
}

static int32_t to_thousandths(int32_t steps)
{
    int64_t scaled = (int64_t)steps * 1000000L, per = value(STEPS_PER_MM);
    return (int32_t)((scaled + (scaled < 0 ? -per : per) / 2) / per);
}

static int32_t to_steps(int32_t ten_thousandths)
{
    int64_t scaled = (int64_t)ten_thousandths * value(STEPS_PER_MM);
    return (int32_t)((scaled + (scaled < 0 ? -5000000L : 5000000L)) / 10000000L);
}

static const char *state_name(void)
{
    switch (state) {
    case RUN: return "<Run";
    case HOLD: return motion_mode() == MODE_IDLE ? "<Hold:0" : "<Hold:1";
    case JOG: return "<Jog";
    case ALARM: return "<Alarm";
    default: return "<Idle";
    }
}

static void report_status(void)
{
    if (state == HOME_SEEK || state == HOME_PULL_OFF)
        return; /* GRBL does not answer while it homes */
    uart_write(state_name());
    write_axes(value(STATUS_MASK) / 1000 & 1 ? "|MPos:" : "|WPos:", to_thousandths(motion_position()));
    uart_write("|FS:0,0");
    if (motion_home_sensor())
        uart_write("|Pn:X");
    if (until_wco-- == 0) {
        write_axes("|WCO:", 0);
        until_wco = WCO_EVERY - 1;
    }
    uart_write(">\r\n");
}

static void report_settings(void)
{
    for (uint8_t i = 0; i < SETTINGS; i++) {
        uint8_t number = settings[i].number;
        uart_write("$");
        write_int(number);
        uart_write("=");
        if (number == 11 || number == 12 || number == 24 || number == 25 || number == 27 || number >= STEPS_PER_MM)
            write_thousandths(settings[i].thousandths);
        else
            write_int(settings[i].thousandths / 1000);
        uart_write("\r\n");
    }
}

/* --- alarms and resets -------------------------------------------------------------------------------------------- */

static void alarm(uint8_t code)
{
    state = ALARM;
    uart_write("ALARM:");
    write_int(code);
    uart_write("\r\n");
}

static void reset(void)
{
    bool homing = state == HOME_SEEK || state == HOME_PULL_OFF;
    if (motion_mode() != MODE_IDLE) {
        motion_stop_now();
        alarm(homing ? 6 : 3);
    } else if (state == HOLD) {
        state = IDLE;
    }
    line_length = 0;
    too_long = false;
    until_wco = 0;
    write_banner();
}

/* --- motion ------------------------------------------------------------------------------------------------------- */

static uint16_t speed_of(int32_t ten_thousandths_per_min)
{
    int64_t speed = (int64_t)ten_thousandths_per_min * value(STEPS_PER_MM) / 600000000L;
    return speed < SPEED_MIN ? SPEED_MIN : speed > SPEED_MAX ? SPEED_MAX : (uint16_t)speed;
}

static void start(int32_t target, int32_t feed, uint8_t new_state)
{
    int32_t top = value(MAX_RATE) * 10;
    profile.top_speed = speed_of(feed && feed < top ? feed : top);
    profile.acceleration = (uint32_t)((int64_t)value(ACCELERATION) * value(STEPS_PER_MM) / 1000000L);
    if (target != motion_position()) { /* else nothing is queued, and nothing changes */
        state = new_state;
        motion_start_move(target);
    }
}

static uint8_t home(void)
{
    if (!is_on(HOMING))
        return E_HOMING_OFF;
    if (state != IDLE && state != ALARM)
        return E_NOT_IDLE;
    state = HOME_SEEK;
    profile.top_speed = speed_of(value(HOMING_SEEK) * 10);
    profile.acceleration = (uint32_t)((int64_t)value(ACCELERATION) * value(STEPS_PER_MM) / 1000000L);
    motion_start_home(homes_down() ? -1 : 1, (uint32_t)to_steps(value(TRAVEL) * 15)); /* 1.5 times the travel */
    return E_ANSWERED_LATER;
}

static void home_ended(uint8_t error)
{
    int32_t away = to_steps(value(PULL_OFF) * 10);
    if (error) {
        alarm(error == ERR_STOPPED ? 6 : 9);
        write_banner();
    } else if (state == HOME_SEEK) {
        state = HOME_PULL_OFF;
        motion_start_move(homes_down() ? away : -away);
    } else {
        motion_set_position(homes_down() ? away - to_steps(value(TRAVEL) * 10) : -away);
        state = IDLE;
        uart_write("ok\r\n");
    }
}

void protocol_motion_ended(const struct motion_end *end)
{
    if (state == HOME_SEEK || state == HOME_PULL_OFF)
        home_ended(end->error);
    else if (state == JOG || state == RUN)
        state = IDLE;
}

/* --- lines -------------------------------------------------------------------------------------------------------- */

/* A decimal number at *text in ten-thousandths; further digits are dropped. */
static bool parse_number(const char **text, int32_t *number)
{
    const char *at = *text;
    bool negative = *at == '-', any = false;
    int8_t decimals = -1;
    int32_t digits = 0;
    at += negative;
    for (; (*at >= '0' && *at <= '9') || (*at == '.' && decimals < 0); at++) {
        if (*at == '.') {
            decimals = 0;
            continue;
        }
        any = true;
        if (decimals >= 4)
            continue;
        if (digits > 200000000L)
            return false;
        digits = digits * 10 + (*at - '0');
        decimals += decimals >= 0;
    }
    for (decimals = decimals < 0 ? 0 : decimals; decimals < 4; decimals++) {
        if (digits > 200000000L)
            return false;
        digits *= 10;
    }
    *text = at;
    *number = negative ? -digits : digits;
    return any;
}

static uint8_t move(const char *text, bool jog)
{
    int32_t x = 0, feed = 0, number;
    bool has_x = false, relative = false;
    while (*text) {
        char letter = *text++;
        if (letter < 'A' || letter > 'Z')
            return E_LETTER;
        if (!parse_number(&text, &number))
            return E_NUMBER;
        if (letter == 'X') {
            x = number;
            has_x = true;
        } else if (letter == 'F') {
            feed = number;
        } else if (letter == 'G' && (number == 910000L || number == 900000L)) {
            relative = number == 910000L;
        } else if (letter != 'G' || !(number == 0 || number == 10000L || number == 210000L || number == 530000L || number == 940000L)) {
            return E_UNSUPPORTED;
        }
    }
    if (jog && feed <= 0)
        return E_NO_FEED;
    if (!has_x)
        return jog ? E_NO_AXIS : E_OK;
    x = to_steps(x) + (relative ? motion_position() : 0);
    if (is_on(SOFT_LIMITS) && (x > 0 || x < -to_steps(value(TRAVEL) * 10))) {
        if (jog)
            return E_TRAVEL;
        alarm(2);
        return E_ANSWERED_LATER;
    }
    start(x, feed, jog ? JOG : RUN);
    return E_OK;
}

static uint8_t set(const char *text)
{
    int32_t number, wanted;
    struct setting *which;
    if (!parse_number(&text, &number) || *text++ != '=' || !parse_number(&text, &wanted) || *text)
        return E_SYSTEM;
    if (state != IDLE && state != ALARM)
        return E_NOT_IDLE;
    which = find(number / 10000);
    if (!which)
        return E_SYSTEM;
    if (wanted < 0)
        return E_NEGATIVE;
    which->thousandths = wanted / 10;
    return E_OK;
}

static uint8_t execute(void)
{
    if (line[0] != '$')
        return state == ALARM || state == JOG ? E_LOCKED : state != IDLE && line[0] ? E_NOT_IDLE : move(line, false);
    switch (line[1]) {
    case 'J':
        if (state != IDLE)
            return E_NOT_IDLE;
        return line[2] == '=' ? move(line + 3, true) : E_JOG;
    case '$': report_settings(); return E_OK;
    case 'I': uart_write("[VER:1.1h.20190830:]\r\n[OPT:V,1,128]\r\n"); return E_OK;
    case 'H': return home();
    case 'X':
        if (state == ALARM) {
            state = IDLE;
            uart_write("[MSG:Caution: Unlocked]\r\n");
        }
        return E_OK;
    default: return set(line + 1);
    }
}

static void answer(void)
{
    uint8_t error = too_long ? E_OVERFLOW : execute();
    line_length = 0;
    too_long = false;
    if (error == E_ANSWERED_LATER)
        return;
    if (error == E_OK) {
        uart_write("ok\r\n");
        return;
    }
    uart_write("error:");
    write_int(error);
    uart_write("\r\n");
}

static void feed_hold(void)
{
    if (state == JOG) {
        motion_stop_ramped();
    } else if (state == RUN) {
        resume_target = motion_target();
        state = HOLD;
        motion_stop_ramped();
    }
}

/* Realtime characters act at once, wherever in a line they stand. */
static bool is_realtime(uint8_t byte)
{
    switch (byte) {
    case '?': report_status(); return true;
    case '!': feed_hold(); return true;
    case '~':
        if (state == HOLD && motion_mode() == MODE_IDLE) {
            state = IDLE;
            start(resume_target, 0, RUN);
        }
        return true;
    case 0x18: reset(); return true;
    case 0x85:
        if (state == JOG)
            motion_stop_ramped();
        return true;
    default: return byte >= 0x80;
    }
}

void protocol_feed(uint8_t byte)
{
    if (is_realtime(byte))
        return;
    if (byte == '\n' || byte == '\r') {
        line[line_length] = 0;
        answer();
    } else if (line_length >= LINE_MAX - 1) {
        too_long = true;
    } else if (byte > ' ') {
        line[line_length++] = (char)(byte >= 'a' && byte <= 'z' ? byte - 32 : byte);
    }
}

void protocol_boot(uint8_t reset_cause)
{
    (void)reset_cause;
    state = is_on(HOMING) ? ALARM : IDLE; /* where it stands is not known before it has homed */
    write_banner();
}
