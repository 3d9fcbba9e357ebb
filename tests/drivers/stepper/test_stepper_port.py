"""Opening and closing ports, and the table of errors: every situation has its one exception."""

import asyncio
import errno
import os
import pty
from pathlib import Path

import pytest
import serial

from scanhsi.clock import run
from scanhsi.devices.errors import (
    DeviceBusy,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceUnavailable,
    MotionFailed,
    OutOfRange,
    PositionLost,
    ProtocolError,
)
from scanhsi_serial import close_port, lost_error, open_error, open_port
from scanhsi_stepper.errors import boot_error, fail_error, reply_error
from scanhsi_stepper.link import StepperLink

DEVICE = "actuator stepper P"


@pytest.mark.parametrize(
    ("error", "kind", "text"),
    [
        (open_error(serial.SerialException(errno.ENOENT, "no"), "P", DEVICE), DeviceNotFound, "no such port"),
        (open_error(serial.SerialException(errno.EACCES, "no"), "P", DEVICE), DeviceUnavailable, "dialout"),
        (open_error(serial.SerialException(errno.EAGAIN, "no"), "P", DEVICE), DeviceBusy, "in use"),
        (open_error(OSError(errno.EBUSY, "no"), "P", DEVICE), DeviceBusy, "in use"),
        (open_error(ValueError("not a port"), "P", DEVICE), DeviceNotFound, "not a port"),
        (lost_error(OSError(errno.EIO, "eio"), DEVICE), DeviceLost, "eio"),
        (lost_error(None, DEVICE), DeviceLost, "gone"),
        (boot_error("P"), PositionLost, "home the mirror"),
        (reply_error(1, "P", "K"), ProtocolError, "flash the firmware"),
        (reply_error(2, "P", "V x"), OutOfRange, "refuses the value"),
        (reply_error(3, "P", "MA 1"), DeviceBusy, "motion is under way"),
        (reply_error(4, "P", "V 0"), OutOfRange, "refuses the value"),
        (reply_error(9, "P", "V 0"), ProtocolError, "unknown error 9"),
        (fail_error(5, 0, "P", "H"), MotionFailed, "home sensor was not found"),
        (fail_error(6, 12, "P", "MA"), MotionFailed, "was stopped at step 12"),
        (fail_error(0, 12, "P", "MA"), MotionFailed, "did not reach its goal at step 12"),
    ],
)
def test_every_situation_has_its_error(error: DeviceError, kind: type[DeviceError], text: str) -> None:
    assert type(error) is kind
    assert text in str(error)
    assert error.device == DEVICE


def opens(port: Path | str) -> None:
    async def main() -> None:
        transport, link = await open_port(str(port), 115_200, lambda: StepperLink(str(port)), DEVICE)
        await close_port(transport, link.lost, 1.0)

    run(main())


def test_a_port_that_does_not_exist(tmp_path: Path) -> None:
    with pytest.raises(DeviceNotFound, match="no such port"):
        opens(tmp_path / "ttyNONE")


def test_a_file_that_is_no_port(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("hello")
    with pytest.raises(DeviceNotFound, match="is it a serial port"):
        opens(tmp_path / "file")


def test_a_port_is_open_for_one_process_alone() -> None:
    master, slave = pty.openpty()
    name = os.ttyname(slave)

    async def main() -> None:
        transport, link = await open_port(name, 115_200, lambda: StepperLink(name), DEVICE)
        with pytest.raises(DeviceBusy, match="in use by another program"):
            await open_port(name, 115_200, lambda: StepperLink(name), DEVICE)
        assert not transport.is_closing()
        await close_port(transport, link.lost, 1.0)
        await asyncio.sleep(0)
        opened_again, link = await open_port(name, 115_200, lambda: StepperLink(name), DEVICE)
        await close_port(opened_again, link.lost, 1.0)

    try:
        run(main())
    finally:
        os.close(master)
        os.close(slave)


def test_closing_does_not_wait_for_a_peer_that_does_not_read() -> None:
    master, slave = pty.openpty()
    name = os.ttyname(slave)

    async def main() -> None:
        transport, link = await open_port(name, 115_200, lambda: StepperLink(name), DEVICE)
        transport.write(b"x" * 1_000_000)
        await asyncio.sleep(0.05)
        async with asyncio.timeout(20):
            await close_port(transport, link.lost, 0.1)
        assert link.lost.is_set()

    try:
        run(main())
    finally:
        os.close(master)
        os.close(slave)


def test_unplugging_is_noticed() -> None:
    master, slave = pty.openpty()
    name = os.ttyname(slave)

    async def main() -> None:
        _, link = await open_port(name, 115_200, lambda: StepperLink(name), DEVICE)
        await asyncio.sleep(0.01)
        os.close(slave)
        os.close(master)
        async with asyncio.timeout(20):
            await link.lost.wait()

    run(main())


def test_boot_garbage_through_a_real_port_does_not_raise() -> None:
    master, slave = pty.openpty()
    name = os.ttyname(slave)
    problems: list[dict[str, object]] = []

    async def main() -> None:
        asyncio.get_running_loop().set_exception_handler(lambda _, context: problems.append(context))
        transport, link = await open_port(name, 115_200, lambda: StepperLink(name), DEVICE)
        os.write(master, b"\xfd\xff\x00!0 BO\xfd\n<\n\n<1 OK*0000\n")
        async with asyncio.timeout(20):
            while link.counters.bad_lines + link.counters.noise < 4:
                await asyncio.sleep(0.001)
        await close_port(transport, link.lost, 1.0)

    try:
        run(main())
    finally:
        os.close(master)
        os.close(slave)
    assert problems == []
