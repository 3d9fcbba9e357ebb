/* SPDX-License-Identifier: Apache-2.0 */
#include "protocol.h"

#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <util/crc16.h>

#include "config.h"
#include "uart.h"

#define LINE_MAX 64
#define REPLY_MAX 72
#define ARGS_MAX 4

struct request {
    uint16_t seq;
    char command[3];
    uint8_t count;
    bool bad_number; /* an argument does not fit into 32 bits, or there are too many */
    int32_t args[ARGS_MAX];
};

static char line[LINE_MAX];
static uint8_t line_length;
static bool in_line;
static char reply[REPLY_MAX]; /* the last reply, sent again when its request is repeated */
static char event[REPLY_MAX];
static uint16_t last_seq;   /* 0 = none since the start */
static uint16_t motion_seq; /* request of the running motion */
static uint16_t done_seq;   /* request of the last motion that ended with DONE */
static uint16_t naks;

/* --- writing lines ----------------------------------------------------------------------------------------------- */

static void append_text(char *out, const char *text)
{
    strcat(out, " ");
    strcat(out, text);
}

static void append_int(char *out, int32_t value)
{
    char digits[12];
    append_text(out, ltoa(value, digits, 10));
}

static void append_uint(char *out, uint32_t value)
{
    char digits[12];
    append_text(out, ultoa(value, digits, 10));
}

static void begin(char *out, char mark, uint16_t seq, const char *word)
{
    out[0] = mark;
    utoa(seq, out + 1, 10);
    append_text(out, word);
}

static uint16_t crc_of(const char *body, uint8_t length)
{
    uint16_t crc = 0;
    while (length--)
        crc = _crc_xmodem_update(crc, (uint8_t)*body++);
    return crc;
}

static char hex_digit(uint8_t nibble) { return (char)(nibble < 10 ? '0' + nibble : 'A' + nibble - 10); }

static void send(char *out)
{
    uint8_t length = (uint8_t)strlen(out);
    uint16_t crc = crc_of(out + 1, length - 1);
    out[length++] = '*';
    for (int8_t shift = 12; shift >= 0; shift -= 4)
        out[length++] = hex_digit((crc >> shift) & 15);
    out[length++] = '\n';
    out[length] = 0;
    uart_write(out);
}

static void send_nak(void)
{
    begin(event, '!', 0, "NAK");
    append_uint(event, ++naks);
    send(event);
}

/* --- commands: each fills `reply` and returns 0, or returns an error code ---------------------------------------- */

static bool between(int32_t value, int32_t low, int32_t high) { return value >= low && value <= high; }

static uint8_t identify(void)
{
    append_text(reply, FIRMWARE_NAME);
    append_int(reply, FIRMWARE_VERSION);
    append_text(reply, FIRMWARE_MCU);
    return 0;
}

static uint8_t query(void)
{
    append_int(reply, motion_mode());
    append_int(reply, motion_position());
    append_int(reply, motion_target());
    append_uint(reply, done_seq);
    append_int(reply, motion_home_sensor());
    append_int(reply, motion_is_enabled());
    append_uint(reply, uart_receive_errors());
    append_uint(reply, naks);
    return 0;
}

static uint8_t move(const struct request *request, bool relative)
{
    int32_t target = request->args[0];
    if (!between(target, -2 * POSITION_LIMIT, 2 * POSITION_LIMIT))
        return ERR_RANGE;
    if (motion_mode() != MODE_IDLE)
        return ERR_BUSY;
    if (relative) { /* |position| <= 1e9 + a ramp, so that only this sum can leave 32 bits */
        int64_t sum = (int64_t)motion_position() + target;
        if (sum > POSITION_LIMIT || sum < -POSITION_LIMIT)
            return ERR_RANGE;
        target = (int32_t)sum;
    }
    if (!between(target, -POSITION_LIMIT, POSITION_LIMIT))
        return ERR_RANGE;
    append_int(reply, target);
    motion_seq = request->seq;
    motion_start_move(target);
    return 0;
}

static uint8_t sweep(const struct request *request)
{
    int32_t first = request->args[0], every = request->args[1], count = request->args[2], width = request->args[3];
    int64_t last;
    if (every == 0)
        return ERR_ARGUMENT;
    if (!between(count, 1, TRIGGER_COUNT_MAX) || !between(width, TRIGGER_WIDTH_MIN_US, TRIGGER_WIDTH_MAX_US) ||
        !between(first, -POSITION_LIMIT, POSITION_LIMIT))
        return ERR_RANGE;
    last = first + (int64_t)every * (count - 1);
    if (last > POSITION_LIMIT || last < -POSITION_LIMIT)
        return ERR_RANGE;
    if (motion_mode() != MODE_IDLE)
        return ERR_BUSY;
    if (every > 0 ? first <= motion_position() : first >= motion_position())
        return ERR_RANGE; /* the first trigger position must lie ahead */
    motion_seq = request->seq;
    motion_start_sweep(first, every, (uint16_t)count, (uint16_t)width);
    return 0;
}

static uint8_t home(const struct request *request)
{
    int32_t direction = request->args[0], limit = request->args[1];
    if (direction != 1 && direction != -1)
        return ERR_ARGUMENT;
    if (!between(limit, 1, POSITION_LIMIT))
        return ERR_RANGE;
    if (motion_mode() != MODE_IDLE)
        return ERR_BUSY;
    motion_seq = request->seq;
    motion_start_home((int8_t)direction, (uint32_t)limit);
    return 0;
}

/* V, A and B: with an argument set, always answer the value. Settings change only at rest. */
static uint8_t setting(const struct request *request)
{
    int32_t value = request->args[0];
    char which = request->command[0];
    if (request->count) {
        if (!(which == 'V'   ? between(value, SPEED_MIN, SPEED_MAX)
              : which == 'A' ? between(value, ACCELERATION_MIN, ACCELERATION_MAX)
                             : between(value, 0, START_SPEED_MAX)))
            return ERR_RANGE;
        if (motion_mode() != MODE_IDLE)
            return ERR_BUSY;
        if (which == 'V')
            profile.top_speed = (uint16_t)value;
        else if (which == 'A')
            profile.acceleration = (uint32_t)value;
        else
            profile.start_speed = (uint16_t)value;
    }
    append_int(reply, which == 'V'   ? (int32_t)profile.top_speed
                      : which == 'A' ? (int32_t)profile.acceleration
                                     : (int32_t)profile.start_speed);
    return 0;
}

static uint8_t set_position(int32_t value)
{
    if (!between(value, -POSITION_LIMIT, POSITION_LIMIT))
        return ERR_RANGE;
    if (motion_mode() != MODE_IDLE)
        return ERR_BUSY;
    motion_set_position(value);
    return 0;
}

static uint8_t enable(int32_t value)
{
    if (value != 0 && value != 1)
        return ERR_ARGUMENT;
    if (motion_mode() != MODE_IDLE)
        return ERR_BUSY;
    motion_enable(value);
    return 0;
}

static uint8_t execute(const struct request *request)
{
    const char *name = request->command;
    uint8_t count = request->count;
    uint16_t key = (uint16_t)((uint8_t)name[0] << 8 | (uint8_t)name[1]);
    int32_t first = request->args[0];
    if (request->bad_number)
        return ERR_ARGUMENT;
    switch (key) {
    case 'I' << 8: return count ? ERR_ARGUMENT : identify();
    case 'P' << 8:
        if (count)
            return ERR_ARGUMENT;
        append_int(reply, motion_position());
        return 0;
    case 'Q' << 8: return count ? ERR_ARGUMENT : query();
    case 'S' << 8:
        if (count)
            return ERR_ARGUMENT;
        motion_stop_ramped();
        return 0;
    case 'X' << 8:
        if (count)
            return ERR_ARGUMENT;
        motion_stop_now();
        return 0;
    case 'M' << 8 | 'A':
    case 'M' << 8 | 'R': return count == 1 ? move(request, name[1] == 'R') : ERR_ARGUMENT;
    case 'V' << 8:
    case 'A' << 8:
    case 'B' << 8: return count <= 1 ? setting(request) : ERR_ARGUMENT;
    case 'Z' << 8: return count == 1 ? set_position(first) : ERR_ARGUMENT;
    case 'E' << 8: return count == 1 ? enable(first) : ERR_ARGUMENT;
    case 'H' << 8: return count == 2 ? home(request) : ERR_ARGUMENT;
    case 'W' << 8: return count == 4 ? sweep(request) : ERR_ARGUMENT;
    default: return ERR_UNKNOWN;
    }
}

static void answer(const struct request *request)
{
    uint8_t error;
    if (request->seq == last_seq) { /* a retry: the same answer, nothing is executed twice */
        uart_write(reply);
        return;
    }
    begin(reply, '<', request->seq, "OK");
    error = execute(request);
    if (error) {
        begin(reply, '<', request->seq, "ERR");
        append_int(reply, error);
    }
    last_seq = request->seq;
    send(reply);
}

/* --- reading lines ----------------------------------------------------------------------------------------------- */

static int8_t hex_value(char digit)
{
    if (digit >= '0' && digit <= '9')
        return (int8_t)(digit - '0');
    if (digit >= 'A' && digit <= 'F')
        return (int8_t)(digit - 'A' + 10);
    return -1;
}

/* Cut "*CRC" off the line and compare. */
static bool check_crc(void)
{
    uint16_t crc = 0;
    uint8_t body = line_length - 5;
    if (line_length < 8 || line[body] != '*')
        return false;
    for (uint8_t i = body + 1; i < line_length; i++) {
        int8_t value = hex_value(line[i]);
        if (value < 0)
            return false;
        crc = (uint16_t)(crc << 4) | (uint8_t)value;
    }
    line[body] = 0;
    return crc == crc_of(line, body);
}

/* A decimal integer at *text, which moves behind it; false = not a number. *fits = it is within +-2147483647. */
static bool parse_int(char **text, int32_t *value, bool *fits)
{
    uint32_t magnitude = 0;
    bool negative = **text == '-';
    char *digit = *text + negative;
    if (*digit < '0' || *digit > '9')
        return false;
    for (*fits = true; *digit >= '0' && *digit <= '9'; digit++) {
        if (magnitude > 214748364UL)
            *fits = false;
        magnitude = magnitude * 10 + (uint8_t)(*digit - '0');
        if (magnitude > 2147483647UL)
            *fits = false;
    }
    *text = digit;
    *value = negative ? -(int32_t)magnitude : (int32_t)magnitude;
    return true;
}

static bool parse(struct request *request)
{
    char *text = line;
    int32_t value;
    bool fits;
    uint8_t letters = 0;
    memset(request, 0, sizeof *request);
    if (!parse_int(&text, &value, &fits) || !fits || !between(value, 1, 65535) || *text++ != ' ')
        return false;
    request->seq = (uint16_t)value;
    for (; *text && *text != ' '; text++, letters++)
        if (letters < 2)
            request->command[letters] = *text;
    if (letters == 0)
        return false;
    if (letters > 2)
        request->command[0] = 0; /* no such command */
    while (*text) {
        if (*text++ != ' ' || !parse_int(&text, &value, &fits))
            return false;
        if (!fits || request->count == ARGS_MAX)
            request->bad_number = true;
        else
            request->args[request->count++] = value;
    }
    return true;
}

void protocol_feed(uint8_t byte)
{
    if (byte == '>') { /* always a new beginning, whatever was lost before */
        in_line = true;
        line_length = 0;
    } else if (!in_line) {
        return; /* noise between lines */
    } else if (byte == '\n') {
        struct request request;
        in_line = false;
        line[line_length] = 0;
        if (check_crc() && parse(&request))
            answer(&request);
        else
            send_nak();
    } else if (line_length < LINE_MAX - 1) {
        line[line_length++] = (char)byte;
    } else {
        in_line = false;
        send_nak();
    }
}

void protocol_boot(uint8_t reset_cause)
{
    begin(event, '!', 0, "BOOT");
    append_text(event, FIRMWARE_NAME);
    append_int(event, FIRMWARE_VERSION);
    append_uint(event, reset_cause);
    send(event);
}

void protocol_motion_ended(const struct motion_end *end)
{
    begin(event, '!', motion_seq, end->error ? "FAIL" : "DONE");
    if (end->error)
        append_int(event, end->error);
    else
        done_seq = motion_seq;
    append_int(event, end->position);
    append_uint(event, end->us);
    append_uint(event, end->triggers);
    send(event);
}
