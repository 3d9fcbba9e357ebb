"""Fault plans: what they may say, when their faults are due, and what storage makes of them."""

from __future__ import annotations

import errno
import gc

import pytest
from pydantic import ValidationError

import scanhsi
from scanhsi.clock import run_virtual
from scanhsi.devices import Role, capabilities_of, find
from scanhsi.instrument import load_instrument
from scanhsi.testing.conformance import ActuatorConformance, CameraConformance
from scanhsi.testing.faults import ABOUT, NO_FAULTS, Fault, FaultPlan, Faults, Kind
from scanhsi.testing.faulty_actuator import faulty_actuator
from scanhsi.testing.faulty_bytes import ByteFilter
from scanhsi.testing.faulty_camera import faulty_camera
from scanhsi.testing.faulty_storage import FaultyDestination, MemoryDestination
from scanhsi.testing.instrument import with_faults
from scanhsi.testing.witness import Witness
from support.small import SMALL


def plan(*faults: Fault) -> Faults:
    return Faults(FaultPlan(faults=faults))


class TestCameraWithoutFaults(CameraConformance):
    """The wrapper changes nothing as long as no fault is due."""

    virtual = True

    def make(self):
        backend = find(Role.CAMERA, "simulated")
        camera = backend.create(backend.options(bands=40, samples=64, scene="testpattern"))
        return faulty_camera(camera, Faults(NO_FAULTS))


class TestActuatorWithoutFaults(ActuatorConformance):
    virtual = True

    def make(self):
        backend = find(Role.ACTUATOR, "simulated")
        return faulty_actuator(backend.create(backend.options()), Faults(NO_FAULTS))


def test_a_wrapper_has_the_abilities_of_what_is_inside() -> None:
    for role, wrap in ((Role.CAMERA, faulty_camera), (Role.ACTUATOR, faulty_actuator)):
        backend = find(role, "simulated")
        assert capabilities_of(wrap(backend.create(backend.options()), Faults(NO_FAULTS))) == backend.capabilities
    plain = find(Role.CAMERA, "simulated")
    assert "OverlapsReadout" not in capabilities_of(
        faulty_camera(plain.create(plain.options(overlap=False)), Faults(NO_FAULTS))
    )


def test_only_a_witness_that_is_asked_for_keeps_the_pixels() -> None:
    """They take the memory of a frame for each exposure."""

    def witnesses() -> list[Witness]:
        return [thing for thing in gc.get_objects() if isinstance(thing, Witness)]

    def scan(witness: Witness | None) -> list[Witness]:
        earlier = witnesses()  # of other tests in this process
        config = with_faults(load_instrument("sensors2019", SMALL), Faults(NO_FAULTS), witness)

        async def main() -> list[Witness]:
            async with scanhsi.open_instrument(config) as hsi:
                await hsi.scan(hsi.default_plan(lines=5, exposure="10 ms"), None)
                return [one for one in witnesses() if all(one is not other for other in earlier)]

        return run_virtual(main())

    assert not any(witness.sights for witness in scan(None))
    asked = Witness()
    scan(asked)
    assert len(asked.sights) == 5


def test_every_kind_is_explained() -> None:
    assert set(ABOUT) == set(Kind)


def test_a_plan_is_json() -> None:
    written = FaultPlan(
        faults=(Fault(kind=Kind.FRAME_LATE, nth=3, for_s=0.5), Fault(kind=Kind.STEPS_LOST, at_s=2.0, by=-3)), seed=4
    )
    assert FaultPlan.model_validate_json(written.model_dump_json(exclude_defaults=True)) == written


@pytest.mark.parametrize(
    "wrong",
    [
        {"kind": "frame lost"},
        {"kind": "frame lost", "nth": 1, "at_s": 2.0},
        {"kind": "frame lost", "nth": 1, "for_s": 2.0},
        {"kind": "steps lost", "nth": 1, "after_s": 0.1},
        {"kind": "frame lost", "nth": -1},
        {"kind": "earthquake", "nth": 1},
        {"kind": "frame lost", "nth": 1, "line": 3},
    ],
)
def test_a_fault_without_meaning_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        Fault.model_validate(wrong)


def test_faults_are_due_by_number_and_by_time() -> None:
    times = iter((0, 1, 2, 3, 4, 1_500_000_000, 1_600_000_000))
    faults = Faults(
        FaultPlan(
            faults=(
                Fault(kind=Kind.FRAME_LOST, nth=2, lasts=2),
                Fault(kind=Kind.FRAME_LOST, at_s=1.0),
                Fault(kind=Kind.FRAME_TWICE, nth=0),
            )
        ),
        clock_ns=lambda: next(times),
    )
    assert [faults.due(Kind.FRAME_LOST) is not None for _ in range(7)] == [False, False, True, True, False, True, False]
    assert faults.kinds() == {Kind.FRAME_LOST}
    assert [happened.opportunity for happened in faults.happened] == [2, 3, 5]


def test_storage_fails_with_the_errors_of_a_disk() -> None:
    inner = MemoryDestination()
    faults = plan(Fault(kind=Kind.DISK_FULL, nth=1), Fault(kind=Kind.IO_ERROR, nth=2))
    place = FaultyDestination(inner, faults)
    place.create({"a": b"1"})
    with pytest.raises(OSError) as full:
        place.put("b", [memoryview(b"2")], durable=True)
    assert full.value.errno == errno.ENOSPC
    with pytest.raises(OSError) as broken:
        place.put_all({"c": b"3", "d": b"4"}, durable=True)
    assert broken.value.errno == errno.EIO
    place.put("e", [memoryview(b"5")], durable=True)
    assert inner.files == {"a": b"1", "c": b"3", "e": b"5"}


@pytest.mark.parametrize(("kind", "left"), [(Kind.KILLED, b"new"), (Kind.POWER_CUT, b"old")])
def test_what_a_killed_process_and_a_power_cut_leave(kind: Kind, left: bytes) -> None:
    ended: list[bool] = []
    inner = MemoryDestination()
    place = FaultyDestination(inner, plan(Fault(kind=kind, nth=4)), on_end=lambda: ended.append(True))
    place.create({"status": b"old"})
    place.put("synced", [memoryview(b"1")], durable=True)
    place.put("status", [memoryview(b"new")], durable=False)
    place.put("fresh", [memoryview(b"2")], durable=False)
    assert not ended
    place.put("too late", [memoryview(b"3")], durable=True)
    place.settle()
    assert ended == [True]
    assert inner.get("status") == left
    assert inner.get("synced") == b"1"
    assert (inner.get("fresh") is None) == (kind is Kind.POWER_CUT)
    assert inner.get("too late") is None


def test_slow_writes_sleep_as_they_are_told_to() -> None:
    slept: list[float] = []
    faults = plan(Fault(kind=Kind.WRITE_SLOW, nth=1, lasts=2, for_s=0.25))
    place = FaultyDestination(MemoryDestination(), faults, sleep=slept.append)
    place.create({})
    for number in range(4):
        place.put(str(number), [], durable=True)
    assert slept == [0.25, 0.25]


def test_bytes_on_a_bad_line() -> None:
    damage = ByteFilter(
        plan(
            Fault(kind=Kind.BYTE_DROPPED, nth=0),
            Fault(kind=Kind.BYTE_TWICE, nth=2),
            Fault(kind=Kind.BYTE_GARBLED, nth=4),
        )
    )
    passed = damage(b"abc") + damage(b"def")
    assert passed[:4] == b"bccd"
    assert len(passed) == 6
    assert bin(passed[4] ^ ord("e")).count("1") == 1
    assert damage.damaged == 3
    noisy = ByteFilter(Faults(NO_FAULTS), rate=0.1, seed=1)
    assert noisy(bytes(1000)) != bytes(1000)
    assert 50 < noisy.damaged < 200
