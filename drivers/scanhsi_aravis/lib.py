"""The two doors into libaravis: PyGObject for cameras and features, ctypes for streams and buffers.

PyGObject copies a buffer's memory and wraps each buffer in a new object; ctypes does neither, so frames go through ctypes.
Both use the same shared object, whose path is read from the memory map after PyGObject has loaded it. A camera or stream of
PyGObject is passed to ctypes as ``hash(wrapper)``, its address.

Nothing here is loaded before `load` is called, so importing the driver needs neither library.
"""

from __future__ import annotations

import ctypes
import importlib
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from scanhsi.devices.errors import DeviceUnavailable

INSTALL_HINT = (
    "on Debian or Ubuntu `sudo apt install python3-gi gir1.2-aravis-0.8`, and let the virtual environment see it: make it "
    "with `--system-site-packages`, or link /usr/lib/python3/dist-packages/gi into its site-packages (same Python version)."
)

_POINTER = ctypes.c_void_p


@dataclass(frozen=True, slots=True)
class Calls:
    """The functions of libaravis that the frame path needs. Pointers are plain integers; 0 or None is NULL.

    Attributes:
        buffer_new: (bytes, address) -> buffer over memory that we own.
        buffer_status, buffer_frame_id, buffer_device_ns, buffer_wall_ns: (buffer) -> number. ``wall_ns`` is the host's wall
            clock when the first packet came.
        buffer_data: (buffer, size out) -> address of the data.
        push: (stream, buffer): gives the buffer, and our reference, to the stream.
        pop: (stream, us) -> buffer or None: waits, without the GIL; the reference is ours.
        ref, unref: (object).
        release: (object): unref without the GIL, for what joins threads.
    """

    buffer_new: Callable[[int, int], int]
    buffer_status: Callable[[int], int]
    buffer_frame_id: Callable[[int], int]
    buffer_device_ns: Callable[[int], int]
    buffer_wall_ns: Callable[[int], int]
    buffer_data: Callable[[int, Any], int]
    push: Callable[[int, int], None]
    pop: Callable[[int, int], int | None]
    ref: Callable[[int], int]
    unref: Callable[[int], None]
    release: Callable[[int], None]


@dataclass(frozen=True, slots=True)
class Library:
    """libaravis, loaded.

    Attributes:
        aravis: The module ``gi.repository.Aravis``, untyped as all of PyGObject is.
        error: ``GLib.Error``, what every failing call of it raises.
        calls: The frame path.
    """

    aravis: Any
    error: type[Exception]
    calls: Calls


@cache
def load() -> Library:
    """Load PyGObject, the Aravis 0.8 typelib and libaravis.

    Raises:
        DeviceUnavailable: One of them is missing; the hint says how to get it.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore", ImportWarning
            )  # PyGObject < 3.44 imports in a way that Python 3.11 deprecates
            importlib.import_module("gi").require_version("Aravis", "0.8")
            aravis = importlib.import_module("gi.repository.Aravis")
            glib = importlib.import_module("gi.repository.GLib")
            importlib.import_module("gi.repository.Gio")  # for the addresses of devices
        path = _loaded_path(aravis)
    except (ImportError, ValueError, OSError) as error:
        raise DeviceUnavailable(
            f"Aravis cannot be loaded: {error}.", device="driver aravis", hint=INSTALL_HINT
        ) from error
    return Library(aravis, glib.Error, _calls(path))


def missing() -> str | None:
    """What this driver lacks on this computer and how to get it, or None."""
    try:
        load()
    except DeviceUnavailable as error:
        return f"{error.message} {error.hint}"
    return None


def _loaded_path(aravis: Any) -> str:
    """Path of the libaravis that PyGObject uses: from the distribution, or from a wheel that brings its own."""
    aravis.Camera.__gtype__  # noqa: B018 (touching a class loads the shared object)
    for line in Path("/proc/self/maps").read_text().splitlines():
        if "libaravis" in line:
            return line.split(maxsplit=5)[5]
    raise OSError("PyGObject knows Aravis, but loaded no libaravis")


def _calls(path: str) -> Calls:
    # PyDLL keeps the GIL: for what returns at once. Giving it up in each of ten getters a frame would let another busy thread
    # take 5 ms each time.
    quick, blocking = ctypes.PyDLL(path), ctypes.CDLL(path)
    number, size = ctypes.c_uint64, ctypes.c_size_t

    def declare(library: ctypes.CDLL, name: str, result: Any, *arguments: Any) -> Any:
        function = library[name]  # finds those of GObject too: dlsym looks into what libaravis is linked with
        function.restype, function.argtypes = result, arguments
        return function

    return Calls(
        buffer_new=declare(quick, "arv_buffer_new", _POINTER, size, _POINTER),
        buffer_status=declare(quick, "arv_buffer_get_status", ctypes.c_int, _POINTER),
        buffer_frame_id=declare(quick, "arv_buffer_get_frame_id", number, _POINTER),
        buffer_device_ns=declare(quick, "arv_buffer_get_timestamp", number, _POINTER),
        buffer_wall_ns=declare(quick, "arv_buffer_get_system_timestamp", number, _POINTER),
        buffer_data=declare(quick, "arv_buffer_get_data", _POINTER, _POINTER, ctypes.POINTER(size)),
        push=declare(quick, "arv_stream_push_buffer", None, _POINTER, _POINTER),
        pop=declare(blocking, "arv_stream_timeout_pop_buffer", _POINTER, _POINTER, number),
        ref=declare(quick, "g_object_ref", _POINTER, _POINTER),
        unref=declare(quick, "g_object_unref", None, _POINTER),
        release=declare(blocking, "g_object_unref", None, _POINTER),
    )
