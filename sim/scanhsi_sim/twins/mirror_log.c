/* SPDX-License-Identifier: Apache-2.0
 *
 * Remembers where the mirror was: a thread that watches the stepper twin's mirror file and logs each change in it.
 *
 * The file tells only the present. A camera that must know where the mirror was during an exposure cannot rely on looking
 * just then: Python threads wait for each other, here for up to 40 ms on a busy machine. This one waits for nobody.
 */
#include <fcntl.h>
#include <pthread.h>
#include <stdint.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#define MIRROR_LOG_SIZE 8192 /* entries; also in mirror_log.py */
enum { PERIOD_NS = 500000, ATTEMPTS = 100 };

struct mirror { /* first fields of struct mirror_state, stepper_bench/bench.h */
    uint64_t seq;
    int64_t position_steps, last_step_host_ns;
};

struct entry {
    int64_t host_ns, position_steps; /* when it came there (CLOCK_MONOTONIC) */
};

struct entry mirror_log[MIRROR_LOG_SIZE]; /* entry number n at n % MIRROR_LOG_SIZE */
uint64_t mirror_log_count;
int64_t mirror_log_seen_ns; /* all that was published before is in the log */

static const struct mirror *published;

static int64_t now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * (int64_t)1000000000 + now.tv_nsec;
}

/* 0: it does not get consistent, because its writer is at work or was killed at work */
static int look(struct entry *seen)
{
    for (int attempt = 0; attempt < ATTEMPTS; attempt++) {
        uint64_t before = __atomic_load_n(&published->seq, __ATOMIC_ACQUIRE);
        seen->host_ns = __atomic_load_n(&published->last_step_host_ns, __ATOMIC_RELAXED);
        seen->position_steps = __atomic_load_n(&published->position_steps, __ATOMIC_RELAXED);
        __atomic_thread_fence(__ATOMIC_ACQUIRE);
        if (before % 2 == 0 && before == __atomic_load_n(&published->seq, __ATOMIC_RELAXED))
            return 1;
    }
    return 0;
}

static void *watch(void *unused)
{
    const struct timespec pause = { 0, PERIOD_NS };
    struct entry last = { -1, 0 }, seen;
    (void)unused;
    for (;;) {
        int64_t began = now_ns();
        if (look(&seen) && (seen.host_ns != last.host_ns || seen.position_steps != last.position_steps)) {
            mirror_log[mirror_log_count % MIRROR_LOG_SIZE] = last = seen;
            __atomic_store_n(&mirror_log_count, mirror_log_count + 1, __ATOMIC_RELEASE);
        }
        __atomic_store_n(&mirror_log_seen_ns, began, __ATOMIC_RELEASE);
        nanosleep(&pause, NULL);
    }
    return NULL;
}

/* Start to watch the mirror file; 0 or -1. Once a process. */
int mirror_log_start(const char *path)
{
    pthread_t thread;
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0)
        return -1;
    published = mmap(NULL, sizeof *published, PROT_READ, MAP_SHARED, fd, 0);
    close(fd);
    if (published == MAP_FAILED || pthread_create(&thread, NULL, watch, NULL) != 0)
        return -1;
    return pthread_detach(thread) == 0 ? 0 : -1;
}
