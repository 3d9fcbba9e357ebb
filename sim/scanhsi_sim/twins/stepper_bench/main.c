/* SPDX-License-Identifier: Apache-2.0
 * Options, and the loop that keeps the emulated CPU in step with the clock of this host. */
#define _GNU_SOURCE
#include <getopt.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

#include "bench.h"

#define SLICE_NS 200000      /* while something happens */
#define IDLE_SLICE_NS 2000000 /* while the motor stands and the line is silent; a byte from the host wakes us at once */
#define STALL_NS 50000000LL  /* of the host: after that the clock is re-based instead of raced after */
#define CHUNK_CYCLES 16000   /* 1 ms: bytes are handed over at least this often in simulated time */
#define ACTIVE_CYCLES 800000 /* 50 ms after the last step the motor counts as standing */

struct options options = { .speed = 1, .start = 1234, .window_low = -39, .window_steps = 40, .auto_reset_ms = -1,
                           .seed = 1 };
static double speed;
static int64_t base_ns;
static uint64_t base_cycle, skips;

int64_t host_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000000000LL + now.tv_nsec;
}

/* When the present cycle happens on the paced clock: never later than now, and free of this host's lateness. */
int64_t paced_ns(void)
{
    int64_t now = host_ns(), due;
    if (speed <= 0)
        return now;
    due = base_ns + (int64_t)((double)(cpu_cycle() - base_cycle) / CPU_HZ / speed * 1e9);
    return due < now ? due : now;
}

static void rebase(void)
{
    base_ns = host_ns();
    base_cycle = cpu_cycle();
}

void set_speed(double value)
{
    speed = value;
    rebase();
}

double get_speed(void) { return speed; }
uint64_t clock_skips(void) { return skips; }

void power_on(void)
{
    cpu_reset(RESET_POWER_ON, 0);
    rebase();
}

/* Cycle that the emulator should have reached by now. */
static uint64_t present_cycle(void)
{
    int64_t passed;
    uint64_t target;
    if (speed <= 0)
        return cpu_cycle() + CHUNK_CYCLES;
    passed = host_ns() - base_ns;
    target = base_cycle + (uint64_t)((double)passed * 1e-9 * CPU_HZ * speed);
    if (target > cpu_cycle() && (double)(target - cpu_cycle()) / CPU_HZ / speed * 1e9 > STALL_NS) {
        skips++;
        rebase();
        return cpu_cycle();
    }
    return target;
}

static bool run_to_present(void)
{
    uint64_t target = present_cycle();
    while (cpu_cycle() < target) {
        uint64_t next = cpu_cycle() + CHUNK_CYCLES;
        if (!cpu_run_until(next < target ? next : target))
            return false;
        serial_flush();
    }
    return true;
}

static bool is_active(void)
{
    return serial_is_busy() || triggers_are_waiting() || (mirror_stats.last_step && cpu_cycle() - mirror_stats.last_step < ACTIVE_CYCLES);
}

static int loop(void)
{
    for (;;) {
        struct pollfd wait[2] = { { .fd = STDIN_FILENO, .events = POLLIN }, { .fd = serial_fd(), .events = POLLIN } };
        struct timespec slice = { 0, speed <= 0 ? 0 : is_active() ? SLICE_NS : IDLE_SLICE_NS };
        ppoll(wait, 2, &slice, NULL);
        if (!run_to_present()) {
            fprintf(stderr, "stepper_bench: the firmware crashed\n");
            return 3;
        }
        publish_time(paced_ns());
        if (serial_notice_open() && options.auto_reset_ms >= 0) {
            serial_reset();
            cpu_reset(RESET_EXTERNAL, CPU_HZ / 1000 * (uint64_t)options.auto_reset_ms);
        }
        triggers_flush();
        serial_read();
        if (wait[0].revents && control_read() == CONTROL_QUIT)
            return 0;
    }
}

static bool parse(int argc, char **argv)
{
    static const struct option names[] = {
        { "firmware", 1, 0, 'f' }, { "link", 1, 0, 'l' }, { "mirror-file", 1, 0, 'm' }, { "trigger-socket", 1, 0, 't' },
        { "trace", 1, 0, 'T' }, { "speed", 1, 0, 's' }, { "start", 1, 0, 'p' }, { "window-low", 1, 0, 'w' },
        { "window-steps", 1, 0, 'W' }, { "auto-reset", 1, 0, 'a' }, { "seed", 1, 0, 'S' }, { "trigger-stream", 0, 0, 'x' },
        { "grbl-shield", 0, 0, 'g' }, { 0, 0, 0, 0 },
    };
    int option;
    while ((option = getopt_long(argc, argv, "", names, NULL)) != -1) {
        switch (option) {
        case 'f': options.firmware = optarg; break;
        case 'l': options.link = optarg; break;
        case 'm': options.mirror_file = optarg; break;
        case 't': options.trigger_socket = optarg; break;
        case 'T': options.trace = optarg; break;
        case 's': options.speed = strtod(optarg, NULL); break;
        case 'p': options.start = strtoll(optarg, NULL, 10); break;
        case 'w': options.window_low = strtoll(optarg, NULL, 10); break;
        case 'W': options.window_steps = strtoll(optarg, NULL, 10); break;
        case 'a': options.auto_reset_ms = atoi(optarg); break;
        case 'S': options.seed = strtoull(optarg, NULL, 10); break;
        case 'x': options.trigger_stream = true; break;
        case 'g': options.grbl_shield = true; break;
        default: return false;
        }
    }
    return options.firmware != NULL && optind == argc;
}

static int fail(const char *what)
{
    fprintf(stderr, "stepper_bench: %s\n", what);
    return 2;
}

int main(int argc, char **argv)
{
    if (!parse(argc, argv))
        return fail("usage: stepper_bench --firmware ELF [--link PATH] [--mirror-file PATH] [--trigger-socket PATH] "
                    "[--trigger-stream] [--trace PATH] [--speed F] [--start N] [--window-low N] [--window-steps N] "
                    "[--auto-reset MS] [--seed N] [--grbl-shield]");
    prctl(PR_SET_TIMERSLACK, 1000UL, 0, 0, 0);
    signal(SIGPIPE, SIG_IGN);
    if (!publish_open(options.mirror_file))
        return fail("cannot create the mirror file");
    if (!triggers_open(options.trigger_socket, options.trigger_stream))
        return fail("cannot use that trigger socket: the path is too long");
    if (!cpu_load(options.firmware, options.grbl_shield))
        return fail("cannot load the firmware: not an AVR ELF file");
    serial_seed(options.seed);
    mirror_start(&options);
    if (!serial_plug(options.link))
        return fail("cannot open a pty, or make the link to it");
    set_speed(options.speed);
    power_on();
    int code = loop();
    serial_unplug();
    return code;
}
