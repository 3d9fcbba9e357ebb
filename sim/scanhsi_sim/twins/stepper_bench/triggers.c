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

void triggers_fire(int64_t position, uint64_t cycle)
{
    int64_t now = host_ns();
    int64_t datagram[3] = { (int64_t)++number, position, now };
    publish_trigger(position, now);
    /* The camera may come and go: the address is looked up for each pulse, and a pulse nobody takes is only counted. */
    if (fd >= 0 && sendto(fd, datagram, sizeof datagram, 0, (struct sockaddr *)&address, sizeof address) < 0)
        lost++;
    if (stream)
        say("TRIG %llu %lld %llu", (unsigned long long)number, (long long)position, (unsigned long long)cycle);
}
