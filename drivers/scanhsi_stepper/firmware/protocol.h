/* SPDX-License-Identifier: Apache-2.0
 * The line protocol: see README.md beside this file and docs/reference/stepper-protocol.md. */
#ifndef PROTOCOL_H
#define PROTOCOL_H

#include <stdint.h>

#include "motion.h"

void protocol_boot(uint8_t reset_cause);        /* send the BOOT event */
void protocol_feed(uint8_t byte);               /* one received byte; executes and answers complete lines */
void protocol_motion_ended(const struct motion_end *end);

#endif
