"""`scanhsi twin`: the instrument's twins, and a command or a shell beside them, in a private network of their own.

The camera answers at `ADDRESS`, the stepper at `PORT`: the shipped instrument ``twin`` names both. The path is fixed, so that a
file can name it; one launcher at a time may have it.
"""

import argparse
import asyncio
import fcntl
import os
import signal
import sys
from collections.abc import Awaitable, Generator, Sequence
from contextlib import contextmanager, suppress
from ctypes.util import find_library
from importlib.util import find_spec
from pathlib import Path

from scanhsi.devices.errors import DeviceError
from scanhsi_sim.scenes import SCENES
from scanhsi_sim.twins import netns
from scanhsi_sim.twins.rig import TwinRig
from scanhsi_sim.twins.stepper_build import missing_tools

ADDRESS = "127.0.0.1"
PORT = Path("/tmp/scanhsi-twin/port")
LOCK = PORT.with_name("lock")
_GRACE_S = 10.0


def missing() -> str:
    """What this computer lacks to run the twins and the real drivers beside them; empty when nothing."""
    lacking: list[str] = []
    if find_spec("gi") is None:
        lacking.append("PyGObject missing: apt-get install python3-gi")
    if find_library("aravis-0.8") is None:
        lacking.append("Aravis missing: apt-get install gir1.2-aravis-0.8")
    if tools := missing_tools():
        lacking.append(tools)
    return "\n  ".join(lacking)


def run(command: Sequence[str] | None = None, *, scene: str = "testpattern", seed: int = 0) -> int:
    """Start the twins, run a command beside them, end them.

    Outside a private network this *replaces the process* by one inside, and does not return.

    Args:
        command: The command and its arguments; None for a shell, or, where standard input is no terminal, for nothing: then
            the twins run until SIGINT or SIGTERM.
        scene: What the camera looks at.
        seed: Of the scene and of the camera's noise.

    Returns:
        The command's exit code; 128 + the signal's number if a signal ended it; 1 if the twins do not start.
    """
    if lacking := missing():
        return _fail(f"the twins need what is not installed here:\n  {lacking}")
    if not netns.in_private_network():
        options = [f"--scene={scene}", f"--seed={seed}", *(["--", *command] if command else [])]
        inside = [*netns.prefix(), sys.executable, "-m", "scanhsi_sim.twins.launcher", *options]
        sys.stdout.flush()
        os.execv(inside[0], inside)
    # Ctrl-C goes to every process of the terminal. It is the command's business: the twins must outlive it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        return asyncio.run(_run(command, TwinRig(scene, seed)))
    except (DeviceError, OSError) as error:
        return _fail(str(error))


async def _run(command: Sequence[str] | None, rig: TwinRig) -> int:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    shell = command is None and sys.stdin.isatty()
    if shell:
        command = [os.environ.get("SHELL", "/bin/sh")]
    for number in (signal.SIGTERM, signal.SIGHUP, *([signal.SIGINT] if command is None else [])):
        loop.add_signal_handler(number, stop.set)
    async with rig:
        with _port_at(rig.port):
            _say(f"camera at {ADDRESS}, stepper at {PORT}, scene {rig.scene}")
            if shell:
                _say("they end with this shell")
            if command is not None:
                return await _beside(command, rig, stop)
            await stop.wait()
    return 0


async def _beside(command: Sequence[str], rig: TwinRig, stop: asyncio.Event) -> int:
    """Run the command; return its exit code. `stop` ends it early."""
    try:
        process = await asyncio.create_subprocess_exec(*command, preexec_fn=_obey_interrupts)
    except OSError as error:
        _fail(f"cannot run {command[0]!r}: {error.strerror}")
        return 127
    ended = asyncio.create_task(process.wait())
    stopped = asyncio.create_task(stop.wait())
    watchers = [asyncio.create_task(_tell_end(rig.camera.wait_ended(), "camera"))]
    watchers.append(asyncio.create_task(_tell_end(rig.stepper.wait_ended(), "stepper")))
    try:
        await asyncio.wait([ended, stopped], return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in (stopped, *watchers):
            task.cancel()
        if process.returncode is None:
            await _end(process)
    code = await ended
    return code if code >= 0 else 128 - code


async def _tell_end(ended: Awaitable[int], name: str) -> None:
    code = await ended
    _say(f"the {name} twin has ended with code {code}")


async def _end(process: asyncio.subprocess.Process) -> None:
    process.terminate()
    try:
        async with asyncio.timeout(_GRACE_S):
            await process.wait()
    except TimeoutError:
        process.kill()


def _obey_interrupts() -> None:
    """In the command's process: take Ctrl-C as usual again."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@contextmanager
def _port_at(port: str) -> Generator[None]:
    """Let `PORT` lead to the stepper's serial port.

    Raises:
        FileExistsError: another launcher is running.
        PermissionError: the folder is somebody else's.
    """
    PORT.parent.mkdir(mode=0o700, exist_ok=True)
    if PORT.parent.stat().st_uid != os.getuid():
        raise PermissionError(
            f"{PORT.parent} belongs to another user, who runs the twins or was killed doing so: "
            f"the twins cannot put their serial port there. Try: sudo rm -r {PORT.parent}"
        )
    with LOCK.open("w") as lock:  # let go by the kernel, whatever ends the launcher
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise FileExistsError(f"{PORT} is in use: another `scanhsi twin` is running") from None
        PORT.unlink(missing_ok=True)  # left by one that was killed
        PORT.symlink_to(port)
        try:
            yield
        finally:
            PORT.unlink(missing_ok=True)
            LOCK.unlink(missing_ok=True)
            with suppress(OSError):
                PORT.parent.rmdir()  # or the next user may not make it


def _say(text: str) -> None:
    sys.stderr.write(f"twins: {text}\n")
    sys.stderr.flush()


def _fail(text: str) -> int:
    sys.stderr.write(f"error: {text}\n")
    return 1


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of `python -m scanhsi_sim.twins.launcher [--scene NAME] [--seed N] [-- COMMAND ...]`."""
    parser = argparse.ArgumentParser(prog="scanhsi twin", description=__doc__, allow_abbrev=False)
    parser.add_argument("--scene", default="testpattern", choices=sorted(SCENES))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("command", nargs="*", help="what to run beside the twins, after --")
    arguments = parser.parse_args(argv)
    return run(arguments.command or None, scene=arguments.scene, seed=arguments.seed)


if __name__ == "__main__":
    sys.exit(main())
