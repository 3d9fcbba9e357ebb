/* SPDX-License-Identifier: Apache-2.0
 * Interrupt-driven USART0 with a ring of 128 bytes each way. */
#ifndef UART_H
#define UART_H

#include <stdbool.h>
#include <stdint.h>

void uart_init(void);
bool uart_has_input(void);
uint8_t uart_read(void);               /* only when uart_has_input() */
void uart_write(const char *text);     /* sleeps while the ring is full */
uint16_t uart_receive_errors(void);    /* framing errors, overruns and lost ring entries, modulo 65536 */

#endif
