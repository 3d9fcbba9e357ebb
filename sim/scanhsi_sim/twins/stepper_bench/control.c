/* SPDX-License-Identifier: Apache-2.0
 * Commands on stdin, one a line; each is answered by one line, "OK ..." or "ERR ...". */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "bench.h"

static char line[256];
static size_t length;

void say(const char *format, ...)
{
    char text[1024];
    va_list args;
    int count;
    va_start(args, format);
    count = vsnprintf(text, sizeof text - 1, format, args);
    va_end(args);
    text[count++] = '\n';
    for (int done = 0; done < count;) {
        ssize_t part = write(STDOUT_FILENO, text + done, (size_t)(count - done));
        if (part <= 0)
            return;
        done += (int)part;
    }
}

static long long or_minus_one(uint64_t value) { return value == UINT64_MAX ? -1 : (long long)value; }

static void stats(void)
{
    const struct mirror_stats *m = &mirror_stats;
    const struct serial_stats *s = &serial_stats;
    say("OK cycle=%llu skips=%llu position=%lld powered=%d attached=%d opened=%llu up=%llu down=%llu unpowered=%llu "
        "lost=%llu breach_period=%llu breach_high=%llu breach_low=%llu breach_setup=%llu min_period=%lld min_high=%lld "
        "min_low=%lld min_setup=%lld first_step=%llu last_step=%llu triggers=%llu min_trigger=%lld max_trigger=%llu "
        "triggers_lost=%llu rx_bytes=%llu tx_bytes=%llu garbled=%llu dropped=%llu wrong_baud=%llu overruns=%llu",
        (unsigned long long)cpu_cycle(), (unsigned long long)clock_skips(), (long long)mirror_position(),
        mirror_is_powered(), serial_is_attached(), (unsigned long long)s->opened, (unsigned long long)m->up,
        (unsigned long long)m->down, (unsigned long long)m->unpowered, (unsigned long long)m->lost,
        (unsigned long long)m->breach_period, (unsigned long long)m->breach_high, (unsigned long long)m->breach_low,
        (unsigned long long)m->breach_setup, or_minus_one(m->min_period), or_minus_one(m->min_high),
        or_minus_one(m->min_low), or_minus_one(m->min_setup), (unsigned long long)m->first_step,
        (unsigned long long)m->last_step, (unsigned long long)m->triggers, or_minus_one(m->min_trigger),
        (unsigned long long)m->max_trigger, (unsigned long long)triggers_lost(), (unsigned long long)s->rx_bytes,
        (unsigned long long)s->tx_bytes, (unsigned long long)s->garbled, (unsigned long long)s->dropped,
        (unsigned long long)s->wrong_baud, (unsigned long long)cpu_overruns());
}

/* Everything but `stats` and `plug`, which print their own line. True = understood. */
static bool simple(const char *name, const char *word, const long long *number, int count)
{
    if (!strcmp(name, "stats-reset")) {
        mirror_stats_reset();
    } else if (!strcmp(name, "mirror") && count == 1) {
        mirror_put(number[0]);
    } else if (!strcmp(name, "lose") && count == 1 && number[0] >= 0) {
        mirror_lose((uint64_t)number[0]);
    } else if (!strcmp(name, "noise") && count == 2) {
        serial_faults((unsigned)number[0], (unsigned)number[1]);
    } else if (!strcmp(name, "flip") && count == 1 && (!strcmp(word, "rx") || !strcmp(word, "tx"))) {
        serial_flip(!strcmp(word, "rx"), (uint64_t)number[0]);
    } else if (!strcmp(name, "unplug")) {
        serial_unplug();
    } else if (!strcmp(name, "reset")) {
        serial_reset();
        cpu_reset(RESET_EXTERNAL, 0);
    } else if (!strcmp(name, "triggers") && (!strcmp(word, "on") || !strcmp(word, "off"))) {
        triggers_stream(!strcmp(word, "on"));
    } else {
        return false;
    }
    return true;
}

static enum control_result execute(char *text)
{
    char *words[4] = { "", "", "", "" };
    long long number[2] = { 0, 0 };
    int count = 0, numbers = 0;
    for (char *word = strtok(text, " "); word && count < 4; word = strtok(NULL, " ")) {
        char *rest;
        long long value = strtoll(word, &rest, 10);
        if (*word && !*rest && numbers < 2)
            number[numbers++] = value;
        words[count++] = word;
    }
    if (!strcmp(words[0], "quit")) {
        say("OK");
        return CONTROL_QUIT;
    }
    if (!strcmp(words[0], "stats"))
        stats();
    else if (!strcmp(words[0], "plug")) {
        if (serial_plug(options.link))
            power_on(); /* serial_plug has said "PORT name": that is the answer */
        else
            say("ERR it is plugged in already, or no pty is to be had");
    } else if (!strcmp(words[0], "speed") && count == 2) {
        set_speed(strtod(words[1], NULL));
        say("OK");
    } else if (simple(words[0], words[1], number, numbers))
        say("OK");
    else
        say("ERR commands: stats | stats-reset | mirror N | lose N | noise GARBLE DROP | flip rx|tx N | unplug | plug | "
            "reset | triggers on|off | speed F | quit");
    return CONTROL_GO_ON;
}

enum control_result control_read(void)
{
    char bytes[256];
    ssize_t count = read(STDIN_FILENO, bytes, sizeof bytes);
    if (count <= 0)
        return CONTROL_QUIT; /* whoever started us is gone */
    for (ssize_t i = 0; i < count; i++) {
        if (bytes[i] != '\n') {
            if (length < sizeof line - 1)
                line[length++] = bytes[i];
            continue;
        }
        line[length] = 0;
        length = 0;
        if (execute(line) == CONTROL_QUIT)
            return CONTROL_QUIT;
    }
    return CONTROL_GO_ON;
}
