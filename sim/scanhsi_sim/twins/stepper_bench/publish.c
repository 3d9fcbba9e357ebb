/* SPDX-License-Identifier: Apache-2.0 */
#include <fcntl.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "bench.h"

static struct mirror_state private_state;
static struct mirror_state *state = &private_state;

bool publish_open(const char *path)
{
    int fd;
    void *map;
    if (!path)
        return true;
    fd = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0644);
    if (fd < 0)
        return false;
    if (ftruncate(fd, sizeof *state) < 0) {
        close(fd);
        return false;
    }
    map = mmap(NULL, sizeof *state, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    close(fd);
    if (map == MAP_FAILED)
        return false;
    state = map;
    memset(state, 0, sizeof *state);
    return true;
}

static void begin_write(void)
{
    __atomic_store_n(&state->seq, state->seq + 1, __ATOMIC_RELAXED);
    __atomic_thread_fence(__ATOMIC_RELEASE);
}

static void end_write(void) { __atomic_store_n(&state->seq, state->seq + 1, __ATOMIC_RELEASE); }

void publish_position(int64_t position, unsigned steps, int64_t now)
{
    begin_write();
    state->position_steps = position;
    state->last_step_host_ns = now;
    state->step_count += steps;
    end_write();
    state->history[state->changes % MIRROR_HISTORY] = (struct mirror_change){ now, position };
    __atomic_store_n(&state->changes, state->changes + 1, __ATOMIC_RELEASE);
}

void publish_time(int64_t now) { __atomic_store_n(&state->complete_ns, now, __ATOMIC_RELEASE); }

void publish_trigger(int64_t position, int64_t now)
{
    begin_write();
    state->trig_count++;
    state->last_trig_position = position;
    state->last_trig_host_ns = now;
    end_write();
}
