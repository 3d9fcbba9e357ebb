/* SPDX-License-Identifier: Apache-2.0
 *
 * Makes Aravis' fake camera wait for events instead of the clock.
 *
 * Its loop polls its sockets until the next frame is due, then looks whether a trigger is set. Below a millisecond it
 * spins: looking often keeps a core busy, looking rarely delays frames. Loaded before libaravis with its symbols global,
 * this file answers the loop's two calls. g_poll() sleeps where the loop would spin, and ends when `event_poll_fd` (an
 * eventfd) is written to; the g_get_real_time() that follows, which asks whether the frame is due, then says yes.
 */
#include <poll.h>
#include <stdint.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

int event_poll_fd = -1;
volatile int event_poll_frozen; /* answer nothing, send nothing */

enum { MAX_FDS = 8, SLICE_MS = 100 };

static __thread int due;

int64_t g_get_real_time(void)
{
    struct timespec now;
    int64_t ahead_us = due ? 1000000 : 0;
    due = 0;
    clock_gettime(CLOCK_REALTIME, &now);
    return now.tv_sec * (int64_t)1000000 + now.tv_nsec / 1000 + ahead_us;
}

int g_poll(struct pollfd *fds, unsigned count, int timeout_ms)
{
    struct pollfd all[MAX_FDS + 1];
    const struct timespec pause = { 0, 5000000 };
    uint64_t events;
    int ready;

    if (count > MAX_FDS)
        return poll(fds, count, timeout_ms);
    memcpy(all, fds, count * sizeof *fds);
    all[count] = (struct pollfd){ .fd = event_poll_fd, .events = POLLIN };
    do {
        while (event_poll_frozen)
            nanosleep(&pause, NULL);
        ready = poll(all, count + 1, timeout_ms == 0 ? SLICE_MS : timeout_ms);
    } while (event_poll_frozen);
    for (unsigned i = 0; i < count; i++)
        fds[i].revents = all[i].revents;
    if (ready <= 0 || !all[count].revents)
        return ready;
    if (ready > 1) /* packets first: the loop asks for the time in between. The eventfd stays readable until then */
        return ready - 1;
    due = read(event_poll_fd, &events, sizeof events) == sizeof events;
    return 0;
}
