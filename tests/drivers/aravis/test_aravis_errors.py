"""Aravis' errors and ours: the tables against the enumerations of the Aravis that is installed."""

import asyncio
import importlib
import subprocess
import sys
from typing import Any

import pytest
from pydantic import ValidationError

import scanhsi_aravis
from scanhsi.devices.errors import (
    DeviceBusy,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceUnavailable,
    OutOfRange,
    UnsupportedFeature,
)
from scanhsi_aravis import AravisCamera, AravisOptions, backend, lib
from scanhsi_aravis.camera import is_simulated
from scanhsi_aravis.errors import DEVICE_ERRORS, GENICAM_ERRORS, classify, translate, translated


def members(enumeration: Any) -> dict[str, int]:
    """Nickname -> code."""
    return {member.value_nick: int(code) for code, member in enumeration.__enum_values__.items()}


@pytest.mark.twin
def test_every_code_of_aravis_is_mapped() -> None:
    aravis = lib.load().aravis
    assert set(members(aravis.DeviceError)) == set(DEVICE_ERRORS)
    assert set(members(aravis.GcError)) == set(GENICAM_ERRORS)


@pytest.mark.twin
def test_codes_are_found_in_their_domain() -> None:
    aravis = lib.load().aravis
    for enumeration, domain, table in (
        (aravis.DeviceError, "arv-device-error-quark", DEVICE_ERRORS),
        (aravis.GcError, "arv-gc-error-quark", GENICAM_ERRORS),
    ):
        for nick, code in members(enumeration).items():
            assert classify(domain, code) is table[nick]
            assert issubclass(table[nick], DeviceError)
            assert table[nick] is not DeviceError
    assert classify("arv-device-error-quark", 999) is DeviceError
    assert classify("g-io-error-quark", 1) is DeviceError


@pytest.mark.twin
@pytest.mark.parametrize(
    ("domain", "nick", "kind"),
    [
        ("device", "not-found", DeviceNotFound),
        ("device", "timeout", DeviceLost),
        ("device", "not-controller", DeviceBusy),
        ("device", "protocol-error-access-denied", DeviceBusy),
        ("device", "feature-not-found", UnsupportedFeature),
        ("gc", "out-of-range", OutOfRange),
        ("gc", "read-only", UnsupportedFeature),
    ],
)
def test_what_matters_most(domain: str, nick: str, kind: type[DeviceError]) -> None:
    """The behaviours that callers rely on, beside the table that implements them."""
    aravis = lib.load().aravis
    code = members(aravis.DeviceError if domain == "device" else aravis.GcError)[nick]
    glib = importlib.import_module("gi.repository.GLib")
    original = glib.Error.new_literal(
        aravis.device_error_quark() if domain == "device" else aravis.gc_error_quark(), "it went wrong", code
    )
    with (
        pytest.raises(kind, match=r"camera x, expose: Aravis says: it went wrong\.") as caught,
        translated("camera x", "expose"),
    ):
        raise original
    assert caught.value.__cause__ is original
    assert original.__traceback__ is None, "a traceback would keep the camera alive"
    assert type(translate(original, device="d", operation="o")) is kind


def test_importing_the_driver_loads_no_hardware_library() -> None:
    code = "import sys, scanhsi_aravis; sys.exit('gi' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_missing_library_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gi", None)  # Python's way to say: cannot be imported
    lib.load.cache_clear()
    try:
        problem = backend.missing()
        assert problem is not None
        assert "python3-gi gir1.2-aravis-0.8" in problem
        assert "--system-site-packages" in problem
        with pytest.raises(DeviceUnavailable, match="apt install"):
            asyncio.run(AravisCamera(AravisOptions(address="127.0.0.1")).connect())
    finally:
        lib.load.cache_clear()


def test_backend() -> None:
    abilities = {"HardwareTriggered", "FreeRunning", "OverlapsReadout", "ForetellsEnd", "MeasuresTemperature"}
    assert set(backend.capabilities) == abilities
    assert isinstance(backend.create(AravisOptions(address="127.0.0.1")), AravisCamera)
    assert set(scanhsi_aravis.__all__) <= set(vars(scanhsi_aravis))
    fields = backend.options.model_fields
    assert all(field.description for field in fields.values())
    with pytest.raises(ValidationError, match="adress"):
        AravisOptions.model_validate({"adress": "127.0.0.1"})


@pytest.mark.parametrize(
    ("vendor", "model", "simulated"),
    [
        ("Aravis", "Fake", True),
        ("Allied Vision Technologies", "Mako G-223B (twin)", True),
        ("Allied Vision Technologies", "Mako G-223B NIR", False),
    ],
)
def test_a_twin_is_never_taken_for_a_camera(vendor: str, model: str, simulated: bool) -> None:
    assert is_simulated(vendor, model) is simulated
