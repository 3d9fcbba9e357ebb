"""The camera's twin and the mirror: pixels show where it stood, or that it moved; its trigger pulses expose."""

import socket
import struct
import time
from pathlib import Path

import pytest

from scanhsi_sim.scenes.testpattern import decode
from support.aravis_client import armed
from support.mirror_file import MirrorFile
from support.twins import running

pytestmark = pytest.mark.twin


@pytest.fixture
def mirror(tmp_path: Path) -> MirrorFile:
    return MirrorFile(tmp_path / "mirror", position=500)


def test_the_frame_shows_the_mirror_during_the_exposure(mirror: MirrorFile) -> None:
    with running(mirror_file=mirror.path) as twin, armed(exposure_us=400_000) as client:
        assert decode(client.shoot().reshape(32, 64), bits=8).step == 500 % 256
        mirror.move_to(508)
        client.trigger()
        time.sleep(0.1)
        mirror.move_to(510)
        moved = client.receive()
        assert moved is not None
        seen = decode(moved.payload.reshape(32, 64), bits=8)
        assert (seen.moved, seen.step) == (True, 508 % 256)
        seen = decode(client.shoot().reshape(32, 64), bits=8)
        assert (seen.moved, seen.step) == (False, 510 % 256)
        assert twin.stats()["smeared"] == 1


def test_a_mirror_beyond_half_a_turn_is_seen_from_the_other_side(tmp_path: Path) -> None:
    mirror = MirrorFile(tmp_path / "mirror", position=19_200 - 5)
    with running(mirror_file=mirror.path), armed(pixel_format="Mono12") as client:
        assert decode(client.shoot().view("<u2").reshape(32, 64)).step == -5 % 4096


def pulse(path: Path, number: int, position: int) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.sendto(struct.pack("<qqq", number, position, time.monotonic_ns()), str(path))


def test_hardware_pulses_fire_and_those_during_an_exposure_are_lost(mirror: MirrorFile, tmp_path: Path) -> None:
    trigger = tmp_path / "trigger"
    with running(mirror_file=mirror.path, trigger_socket=trigger) as twin:
        pulse(trigger, 1, 500)  # nothing is armed
        with armed(source="Line1", exposure_us=200_000) as client:
            for number in (2, 3, 4):
                pulse(trigger, number, 500)
            first = client.receive()
            client.trigger()  # by software, which is not armed
            assert client.receive(0.3) is None
            mirror.move_to(504)
            pulse(trigger, 5, 504)
            second = client.receive()
        stats = twin.stats()
    frames = [decode(frame.payload.reshape(32, 64), bits=8).step for frame in (first, second) if frame]
    assert frames == [500 % 256, 504 % 256]
    assert (stats["exposures"], stats["busy"], stats["ignored"]) == (2, 2, 2)


def test_pulses_do_not_fire_a_camera_armed_for_software(mirror: MirrorFile, tmp_path: Path) -> None:
    trigger = tmp_path / "trigger"
    with running(mirror_file=mirror.path, trigger_socket=trigger) as twin, armed() as client:
        pulse(trigger, 1, 500)
        assert client.receive(0.2) is None
        assert len(client.shoot()) == 32 * 64
        assert twin.stats()["ignored"] == 1
