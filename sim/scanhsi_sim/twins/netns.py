"""A private network namespace: a network with nothing in it but loopback.

Aravis broadcasts GigE Vision discovery on every network interface. Whatever starts it beside a twin therefore runs
in a namespace of its own, where no packet can reach a real camera or a real network::

    python -m scanhsi_sim.twins.netns COMMAND [ARGUMENT ...]

Root gets a new network namespace; anyone else gets one through a new user namespace, in which the caller looks like
root (packet sockets need that) while files still belong to the caller.
"""

import ctypes
import errno
import fcntl
import os
import socket
import struct
import sys
from collections.abc import Sequence
from pathlib import Path

_CLONE_NEWUSER = 0x10000000
_CLONE_NEWNET = 0x40000000
_SIOCGIFFLAGS = 0x8913
_SIOCSIFFLAGS = 0x8914
_IFF_UP = 0x1
_IFREQ = "16sh14x"  # interface name, flags; the rest of the kernel's union is not used here


class NamespaceNotPermitted(RuntimeError):
    """This machine lets this user make no network namespace."""


def in_private_network() -> bool:
    """Whether this process sees no network but loopback, and loopback is up."""
    up = {name for _, name in socket.if_nameindex() if _flags(name) & _IFF_UP}
    return up == {"lo"}


def require_private_network() -> None:
    """Refuse to go on where a packet could leave the machine.

    Raises:
        RuntimeError: an interface other than loopback is up, or loopback is down.
    """
    if not in_private_network():
        names = ", ".join(name for _, name in socket.if_nameindex())
        raise RuntimeError(
            f"the camera twin runs only in a private network namespace with nothing but 'lo' up, this one has: {names}. "
            "Use `scanhsi twin -- COMMAND` or `python -m scanhsi_sim.twins.netns COMMAND`"
        )


def enter() -> None:
    """Move this process into a new private network and bring loopback up.

    Call it early: the kernel refuses a new user namespace to a process that already has a second thread.

    Raises:
        NamespaceNotPermitted: the kernel or the container refuses; says what to change.
    """
    uid, gid = os.getuid(), os.getgid()
    refusal = _unshare(_CLONE_NEWNET)
    if refusal:
        refusal = _unshare(_CLONE_NEWUSER | _CLONE_NEWNET)
        if refusal:
            raise NamespaceNotPermitted(_explain(refusal))
        _look_like_root(uid, gid)
    _bring_loopback_up()


def prefix() -> list[str]:
    """The words to put before a command so that it runs in a private network.

    They name this file, not the module: importing the package may start threads, and then the kernel refuses.
    """
    return [sys.executable, "-P", __file__]


def run(command: Sequence[str]) -> None:
    """Replace this process by `command` in a private network, a new one unless it already is in one.

    Raises:
        RuntimeError: no namespace can be made (`NamespaceNotPermitted`), or it is not private.
        OSError: the command cannot be started.
    """
    if not in_private_network():
        enter()
        require_private_network()
    sys.stdout.flush()
    sys.stderr.flush()
    os.execvp(command[0], list(command))


def _unshare(flags: int) -> int:
    """0, or the errno of the kernel's refusal (`os.unshare` only came with Python 3.12)."""
    libc = ctypes.CDLL(None, use_errno=True)
    return 0 if libc.unshare(flags) == 0 else ctypes.get_errno()


def _look_like_root(uid: int, gid: int) -> None:
    Path("/proc/self/setgroups").write_text("deny")  # the kernel asks for this before a gid map may be written
    Path("/proc/self/uid_map").write_text(f"0 {uid} 1")
    Path("/proc/self/gid_map").write_text(f"0 {gid} 1")


def _flags(name: str) -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        request = struct.pack(_IFREQ, name.encode(), 0)
        return struct.unpack(_IFREQ, fcntl.ioctl(control, _SIOCGIFFLAGS, request))[1]


def _bring_loopback_up() -> None:
    flags = _flags("lo") | _IFF_UP
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        fcntl.ioctl(control, _SIOCSIFFLAGS, struct.pack(_IFREQ, b"lo", flags))


def _explain(refusal: int) -> str:
    why = f"no private network namespace: the kernel says {errno.errorcode.get(refusal, refusal)}"
    knobs = {
        "/proc/sys/kernel/unprivileged_userns_clone": "0",
        "/proc/sys/kernel/apparmor_restrict_unprivileged_userns": "1",
        "/proc/sys/user/max_user_namespaces": "0",
    }
    for path, closed in knobs.items():
        if Path(path).exists() and Path(path).read_text().strip() == closed:
            return f"{why}, because {path} is {closed}. Change it with sysctl, or run as root"
    if refusal == errno.EINVAL:
        return f"{why}, because this process already has more than one thread"
    return f"{why}. Run as root, or in a container that allows namespaces (docker: --cap-add SYS_ADMIN)"


def main() -> int:
    """Entry point of `python -m scanhsi_sim.twins.netns`."""
    command = sys.argv[1:]
    if not command:
        sys.stderr.write("usage: python -m scanhsi_sim.twins.netns COMMAND [ARGUMENT ...]\n")
        return 2
    try:
        run(command)
    except RuntimeError as error:  # NamespaceNotPermitted, above all
        sys.stderr.write(f"error: {error}\n")
        return 77
    except OSError as error:
        sys.stderr.write(f"error: cannot run {command[0]!r}: {error.strerror}\n")
        return 127
    return 0  # never reached: execvp does not return


if __name__ == "__main__":
    sys.exit(main())
