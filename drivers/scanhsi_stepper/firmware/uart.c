/* SPDX-License-Identifier: Apache-2.0 */
#include "uart.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <util/atomic.h>

#ifndef BAUD
#define BAUD 115200UL
#endif
/* Double speed, nearest divisor: 16 at 115200 baud (117647, +2.1 %). */
#define DIVISOR ((F_CPU + BAUD * 4UL) / (BAUD * 8UL) - 1UL)

#define RING 128
#define NEXT(i) ((uint8_t)((i) + 1) & (RING - 1))

static volatile uint8_t rx_ring[RING], rx_head, rx_tail;
static volatile uint8_t tx_ring[RING], tx_head, tx_tail;
static volatile uint16_t rx_errors;

void uart_init(void)
{
    UCSR0A = _BV(U2X0); /* before UBRR: some models of the chip compute the rate when UBRR0L is written */
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UBRR0H = (uint8_t)(DIVISOR >> 8);
    UBRR0L = (uint8_t)DIVISOR;
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

ISR(USART_RX_vect)
{
    uint8_t status = UCSR0A; /* must be read before the data register */
    uint8_t byte = UDR0;
    uint8_t next = NEXT(rx_head);
    if (status & (_BV(FE0) | _BV(DOR0)))
        rx_errors++;
    if (next == rx_tail) {
        rx_errors++;
        return;
    }
    rx_ring[rx_head] = byte;
    rx_head = next;
}

ISR(USART_UDRE_vect)
{
    UDR0 = tx_ring[tx_tail];
    tx_tail = NEXT(tx_tail);
    if (tx_tail == tx_head) /* off with the last byte, so that it never runs on an empty ring */
        UCSR0B &= (uint8_t)~_BV(UDRIE0);
}

bool uart_has_input(void) { return rx_head != rx_tail; }

uint8_t uart_read(void)
{
    uint8_t byte = rx_ring[rx_tail];
    rx_tail = NEXT(rx_tail);
    return byte;
}

static void put(uint8_t byte)
{
    uint8_t next = NEXT(tx_head);
    while (next == tx_tail)
        sleep_mode(); /* the transmit interrupt wakes us */
    tx_ring[tx_head] = byte;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        tx_head = next;
        UCSR0B |= _BV(UDRIE0);
    }
}

void uart_write(const char *text)
{
    while (*text)
        put((uint8_t)*text++);
}

uint16_t uart_receive_errors(void)
{
    uint16_t errors;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { errors = rx_errors; }
    return errors;
}
