/* SPDX-License-Identifier: Apache-2.0
 * Each rising edge of TRIG goes at once to a datagram socket (for a camera) and to stdout (for tests). */
#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "bench.h"

static int fd = -1;
static struct sockaddr_un address = { .sun_family = AF_UNIX };
static bool stream;
static uint64_t number, lost;

/* The kernel queues only about 10 datagrams for a reader that is late: the rest waits here. */
#define WAITING 4096 /* a power of two */
struct trigger {
    int64_t number, position, host_ns;
};
static struct trigger waiting[WAITING];
static unsigned head, tail;

bool triggers_open(const char *socket_path, bool print)
{
    stream = print;
    if (!socket_path)
        return true;
    if (strlen(socket_path) >= sizeof address.sun_path)
        return false;
    strcpy(address.sun_path, socket_path);
    fd = socket(AF_UNIX, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    return fd >= 0;
}

void triggers_stream(bool on) { stream = on; }
uint64_t triggers_lost(void) { return lost; }

/* The camera may come and go: the address is looked up for each pulse, and a pulse without a listener is only counted. */
void triggers_flush(void)
{
    for (; tail != head; tail++) {
        if (sendto(fd, &waiting[tail % WAITING], sizeof *waiting, 0, (struct sockaddr *)&address, sizeof address) >= 0)
            continue;
        if (errno == EAGAIN)
            return;
        lost++;
    }
}

bool triggers_are_waiting(void) { return tail != head; }

void triggers_fire(int64_t position, uint64_t cycle)
{
    int64_t now = paced_ns();
    number++;
    publish_trigger(position, now);
    if (fd >= 0 && head - tail < WAITING)
        waiting[head++ % WAITING] = (struct trigger){ (int64_t)number, position, now };
    else if (fd >= 0)
        lost++;
    triggers_flush();
    if (stream)
        say("TRIG %llu %lld %llu", (unsigned long long)number, (long long)position, (unsigned long long)cycle);
}
