/* SPDX-License-Identifier: Apache-2.0
 *
 * Emulator bench of the mirror stepper: the real firmware in an AVR emulator behind a pty, with a model of the mirror.
 *
 * This source is under the Apache-2.0 licence. The program built from it links libsimavr, which is under the GPL
 * version 3: it is therefore only ever built on the machine that uses it, as a test tool in a process of its own, and
 * never distributed.
 *
 * One thread, one loop (main.c): run the emulator up to the present (cpu.c), hand bytes over (serial.c), answer commands
 * (control.c), sleep. Pin changes call into mirror.c while the emulator runs; triggers.c and publish.c tell others.
 */
#ifndef BENCH_H
#define BENCH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define CPU_HZ 16000000ULL
#define STEPS_PER_TURN 19200

struct options {
    const char *firmware;       /* ELF file */
    const char *link;           /* symlink to the pty, or NULL */
    const char *mirror_file;    /* memory-mapped mirror state, or NULL */
    const char *trigger_socket; /* unix datagram socket that gets each trigger, or NULL */
    const char *trace;          /* file of (u64 cycle, i64 position) pairs, or NULL */
    double speed;               /* simulated seconds per second; 0 = as fast as possible */
    int64_t start;              /* where the mirror stands when the firmware starts counting at 0 */
    int64_t window_low;         /* lowest position of the home index window */
    int64_t window_steps;
    int auto_reset_ms;          /* time in the bootloader after the port is opened; -1 = no auto-reset */
    uint64_t seed;              /* of the injected noise */
    bool trigger_stream;        /* print TRIG lines */
    bool grbl_shield;           /* the pins are those of GRBL, X axis */
};

/* --- cpu.c: libsimavr and the workarounds for it ----------------------------------------------------------------- */
enum reset_cause { RESET_POWER_ON, RESET_EXTERNAL };

bool cpu_load(const char *elf, bool grbl_shield);
void cpu_reset(enum reset_cause cause, uint64_t deaf_cycles); /* deaf: time spent in the bootloader */
bool cpu_run_until(uint64_t cycle);                           /* false = the firmware crashed */
uint64_t cpu_cycle(void);
bool cpu_is_deaf(void);
double cpu_baud(void);                    /* what the USART is set to; 0 before it is set up */
void cpu_receive(uint8_t byte, bool bad); /* start bit of a byte towards the firmware; bad = framing error */
void cpu_set_home_sensor(bool on);
uint64_t cpu_overruns(void);

/* --- mirror.c: what the pins do, and what the mirror makes of it ------------------------------------------------- */
struct mirror_stats {
    uint64_t up, down, unpowered, lost; /* step pulses by direction; those without power; those lost on purpose */
    uint64_t breach_period, breach_high, breach_low, breach_setup; /* of the DRV8825's timing limits */
    uint64_t min_period, min_high, min_low, min_setup;             /* cycles; UINT64_MAX = none yet */
    uint64_t first_step, last_step;                                /* cycle of the first and last step pulse */
    uint64_t triggers, min_trigger, max_trigger;                   /* pulses and their widths in cycles */
};
extern struct mirror_stats mirror_stats;

void mirror_start(const struct options *options);
void mirror_stats_reset(void);
void mirror_step_pin(bool high);
void mirror_dir_pin(bool high);
void mirror_enable_pin(bool high);
void mirror_trigger_pin(bool high);
int64_t mirror_position(void);
bool mirror_is_powered(void);
void mirror_put(int64_t position);  /* turn it by hand */
void mirror_lose(uint64_t nth);     /* the motor will not follow the nth step pulse from now; 0 = forget it */

/* --- publish.c: the mirror's state in a memory-mapped file ------------------------------------------------------- */
/* Layout of the file, little endian, all fields aligned. A writer (the bench) and any number of readers.
 * The present: `seq` is odd while the writer is at work; a reader takes `seq`, the fields and `seq` again, and starts over
 * when the two differ or are odd.
 * The past: `changes` is raised after entry number `changes` was written, at `changes` % MIRROR_HISTORY; a reader takes
 * `changes`, the entries and `changes` again, and believes those before the first that were not overwritten meanwhile.
 * Times are CLOCK_MONOTONIC of this host at which the emulated event happens on the bench's paced clock. It appears here later
 * than that, by up to one slice of emulation and by more when the host stalls: `complete_ns` tells up to when all is here. */
#define MIRROR_HISTORY 8192 /* entries; also in mirror.py */
struct mirror_change {
    int64_t host_ns, position_steps; /* when it came where */
};
struct mirror_state {
    uint64_t seq;
    int64_t position_steps;       /* of the mirror itself: 0 = home index edge, whatever the firmware counts */
    int64_t last_step_host_ns;    /* 0 = it has not moved yet */
    uint64_t step_count;          /* steps the mirror has made, both directions */
    uint64_t trig_count;          /* trigger pulses since the start */
    int64_t last_trig_position;
    int64_t last_trig_host_ns;    /* 0 = none yet */
    int64_t complete_ns;
    uint64_t changes;
    struct mirror_change history[MIRROR_HISTORY];
};

bool publish_open(const char *path);
void publish_position(int64_t position, unsigned steps, int64_t host_ns); /* steps: 1, or 0 = turned by hand */
void publish_trigger(int64_t position, int64_t host_ns);
void publish_time(int64_t host_ns); /* all until then is published */

/* --- triggers.c -------------------------------------------------------------------------------------------------- */
bool triggers_open(const char *socket_path, bool stream);
void triggers_stream(bool on);
void triggers_fire(int64_t position, uint64_t cycle);
void triggers_flush(void); /* what a late reader has left no room for */
bool triggers_are_waiting(void);
uint64_t triggers_lost(void); /* datagrams that nobody took */

/* --- serial.c: the pty and the wire ------------------------------------------------------------------------------ */
struct serial_stats {
    uint64_t rx_bytes, tx_bytes, garbled, dropped, wrong_baud, opened;
};
extern struct serial_stats serial_stats;

bool serial_plug(const char *link);
void serial_unplug(void);
void serial_faults(unsigned garble, unsigned drop);       /* each per 10,000 bytes, both ways */
void serial_flip(bool towards_firmware, uint64_t nth);    /* flip a bit of the nth byte from now */
void serial_seed(uint64_t seed);
int serial_fd(void);                                      /* to poll; -1 while nobody has the port open */
bool serial_is_attached(void);
bool serial_notice_open(void);                            /* true once each time DTR rises: the Uno resets */
void serial_read(void);                                   /* take what the host has sent */
void serial_transmit(uint8_t byte);                       /* the firmware wrote its data register */
void serial_flush(void);                                  /* hand bytes to the host whose last bit is out */
void serial_reset(void);
bool serial_is_busy(void);
uint64_t serial_byte_due(void);                           /* cycle of the next byte for the firmware; 0 = none */
void serial_deliver(void);

/* --- control.c: commands on stdin -------------------------------------------------------------------------------- */
enum control_result { CONTROL_GO_ON, CONTROL_QUIT };
enum control_result control_read(void);
void say(const char *format, ...) __attribute__((format(printf, 1, 2))); /* one line on stdout, at once */

/* --- main.c ------------------------------------------------------------------------------------------------------ */
extern struct options options;
void set_speed(double speed);
double get_speed(void);
uint64_t clock_skips(void);
int64_t host_ns(void);
int64_t paced_ns(void);
void power_on(void);

#endif
