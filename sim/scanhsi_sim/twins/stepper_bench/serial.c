/* SPDX-License-Identifier: Apache-2.0
 * The USB serial adapter: a pty whose bytes take the time they take on the wire, with faults on request. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <pty.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <unistd.h>

#include "bench.h"

#define QUEUE 65536 /* bytes, a power of two */
#define BAUD_TOLERANCE 0.045

struct timed {
    uint64_t due;
    uint8_t byte;
    bool bad;
};
struct queue {
    struct timed item[QUEUE];
    unsigned head, tail;
    uint64_t free_at; /* cycle at which the line is free again */
};

struct serial_stats serial_stats;

static struct queue to_firmware, to_host;
static int master = -1;
static const char *symlink_path;
static bool attached, dtr;
static unsigned garble_rate, drop_rate;
static uint64_t flip_in[2]; /* [towards firmware]: bytes to go */
static uint64_t noise_state = 1;

void cpu_expect_byte(void);

/* --- the pty ----------------------------------------------------------------------------------------------------- */

static void set_raw(int fd)
{
    struct termios line;
    tcgetattr(fd, &line);
    cfmakeraw(&line);
    cfsetspeed(&line, B115200);
    line.c_cflag |= HUPCL | CLOCAL;
    tcsetattr(fd, TCSANOW, &line);
}

bool serial_plug(const char *link)
{
    int slave;
    char name[128];
    if (master >= 0)
        return false;
    if (openpty(&master, &slave, name, NULL, NULL) < 0)
        return false;
    set_raw(slave);
    close(slave); /* from now on poll() on the master reports a hang-up until somebody opens the port */
    fcntl(master, F_SETFL, O_NONBLOCK);
    fcntl(master, F_SETFD, FD_CLOEXEC);
    attached = dtr = false;
    symlink_path = link;
    if (link) {
        unlink(link);
        if (symlink(name, link) < 0)
            return false;
    }
    say("PORT %s", name);
    return true;
}

void serial_unplug(void)
{
    if (symlink_path)
        unlink(symlink_path);
    if (master >= 0)
        close(master);
    master = -1;
    attached = false;
    serial_reset();
}

void serial_reset(void)
{
    to_firmware.head = to_firmware.tail = to_host.head = to_host.tail = 0;
    to_firmware.free_at = to_host.free_at = 0;
}

int serial_fd(void) { return attached ? master : -1; }
bool serial_is_attached(void) { return attached; }

/* The Uno resets when DTR rises. With HUPCL set DTR falls at each close; without, only the first open resets. */
bool serial_notice_open(void)
{
    struct pollfd probe = { .fd = master, .events = 0 };
    struct termios line;
    bool was = attached;
    if (master < 0 || poll(&probe, 1, 0) < 0)
        return false;
    attached = !(probe.revents & POLLHUP);
    if (was && !attached && tcgetattr(master, &line) == 0 && (line.c_cflag & HUPCL))
        dtr = false;
    if (!was && attached)
        serial_stats.opened++;
    if (!attached || dtr)
        return false;
    dtr = true;
    return true;
}

/* --- noise ------------------------------------------------------------------------------------------------------- */

static uint32_t noise(uint32_t below)
{
    noise_state = noise_state * 6364136223846793005ULL + 1442695040888963407ULL;
    return (uint32_t)((noise_state >> 33) % below);
}

void serial_seed(uint64_t seed) { noise_state = seed * 2 + 1; }

void serial_faults(unsigned garble, unsigned drop)
{
    garble_rate = garble;
    drop_rate = drop;
}

void serial_flip(bool towards_firmware, uint64_t nth) { flip_in[towards_firmware] = nth; }

/* Put one byte on the line, if it survives. */
static void enqueue(struct queue *queue, bool towards_firmware, uint8_t byte, uint64_t byte_cycles, bool bad)
{
    uint64_t now = cpu_cycle(), start = now > queue->free_at ? now : queue->free_at;
    queue->free_at = start + byte_cycles;
    if (flip_in[towards_firmware] && --flip_in[towards_firmware] == 0) {
        byte ^= 1 << 4;
        serial_stats.garbled++;
    }
    if (drop_rate && noise(10000) < drop_rate) {
        serial_stats.dropped++;
        return;
    }
    if (garble_rate && noise(10000) < garble_rate) {
        byte ^= (uint8_t)(1 << noise(8));
        serial_stats.garbled++;
    }
    if (queue->head - queue->tail == QUEUE)
        return;
    /* The emulated USART takes a byte at its start bit; the host gets one after its stop bit. */
    queue->item[queue->head++ % QUEUE] = (struct timed){ towards_firmware ? start : start + byte_cycles, byte, bad };
}

/* --- the wire ---------------------------------------------------------------------------------------------------- */

/* Baud rate the host has set, read from the master; 0 = a rate that termios cannot name, taken as right. */
static double host_baud(void)
{
    static const struct { speed_t code; double baud; } rates[] = {
        { B1200, 1200 }, { B2400, 2400 }, { B4800, 4800 }, { B9600, 9600 }, { B19200, 19200 }, { B38400, 38400 },
        { B57600, 57600 }, { B115200, 115200 }, { B230400, 230400 }, { B460800, 460800 }, { B500000, 500000 },
        { B921600, 921600 }, { B1000000, 1e6 }, { B2000000, 2e6 },
    };
    struct termios line;
    if (tcgetattr(master, &line) == 0)
        for (size_t i = 0; i < sizeof rates / sizeof *rates; i++)
            if (cfgetospeed(&line) == rates[i].code)
                return rates[i].baud;
    return 0;
}

static bool rates_agree(double host)
{
    double ours = cpu_baud();
    return host == 0 || ours == 0 || fabs(host / ours - 1) <= BAUD_TOLERANCE;
}

void serial_read(void)
{
    uint8_t bytes[4096];
    ssize_t count;
    double baud = host_baud();
    bool good = rates_agree(baud);
    uint64_t byte_cycles = (uint64_t)(10 * CPU_HZ / (baud ? baud : cpu_baud() ? cpu_baud() : 115200));
    bool was_empty = to_firmware.head == to_firmware.tail;
    if (!attached || to_firmware.head - to_firmware.tail > QUEUE - sizeof bytes)
        return;
    count = read(master, bytes, sizeof bytes);
    if (count <= 0 || cpu_is_deaf())
        return;
    for (ssize_t i = 0; i < count; i++) {
        serial_stats.rx_bytes++;
        serial_stats.wrong_baud += !good;
        enqueue(&to_firmware, true, good ? bytes[i] : (uint8_t)noise(256), byte_cycles, !good);
    }
    if (was_empty && to_firmware.head != to_firmware.tail)
        cpu_expect_byte();
}

uint64_t serial_byte_due(void)
{
    return to_firmware.head == to_firmware.tail ? 0 : to_firmware.item[to_firmware.tail % QUEUE].due;
}

void serial_deliver(void)
{
    struct timed *next = &to_firmware.item[to_firmware.tail % QUEUE];
    if (to_firmware.head == to_firmware.tail)
        return;
    to_firmware.tail++;
    cpu_receive(next->byte, next->bad);
}

/* simavr shows a byte when the data register is written: it reaches the host one byte time later. */
void serial_transmit(uint8_t byte)
{
    double baud = cpu_baud();
    bool good = rates_agree(attached ? host_baud() : 0);
    serial_stats.tx_bytes++;
    serial_stats.wrong_baud += !good;
    enqueue(&to_host, false, good ? byte : (uint8_t)noise(256), (uint64_t)(10 * CPU_HZ / (baud ? baud : 115200)), false);
}

void serial_flush(void)
{
    uint8_t bytes[4096];
    size_t count = 0;
    while (to_host.tail != to_host.head && count < sizeof bytes && to_host.item[to_host.tail % QUEUE].due <= cpu_cycle())
        bytes[count++] = to_host.item[to_host.tail++ % QUEUE].byte;
    /* A port that nobody has open, or nobody reads, loses what comes: as on a real adapter. */
    if (count && attached && write(master, bytes, count) < 0 && errno != EAGAIN && errno != EIO)
        perror("stepper_bench: pty");
}

bool serial_is_busy(void) { return to_host.head != to_host.tail || to_firmware.head != to_firmware.tail; }
