"""The emulator bench itself: the mirror in shared memory, triggers for a camera, pacing, its process."""

import asyncio
import os
import signal
import socket
import stat
import struct
import sys
from pathlib import Path

import pytest
from stepper_twin import FAST, bench

from scanhsi.clock import now_ns, run
from scanhsi.devices import Sweep
from scanhsi.devices.errors import DeviceLost, DeviceUnavailable
from scanhsi_sim.twins import stepper_build
from scanhsi_sim.twins.mirror import MirrorReading, MirrorState
from scanhsi_sim.twins.stepper import CPU_HZ, StepperTwin, StepperTwinSettings
from scanhsi_stepper import StepperActuator

pytestmark = pytest.mark.twin


def test_the_mirror_file_follows_every_step() -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        with twin.open_mirror() as mirror:
            assert mirror.read() == MirrorReading(1234, 0, 0, 0, 0, 0)
            await actuator.home()
            assert mirror.read().position_steps == 0
            before = mirror.read()
            began = now_ns()  # also CLOCK_MONOTONIC
            await actuator.move_to(48)
            after = mirror.read()
            assert after.position_steps == 48
            assert after.step_count == before.step_count + 48
            assert began < after.last_step_host_ns <= now_ns()
            await asyncio.sleep(0.05)
            assert mirror.read() == after  # it stands

    bench(scenario, settings=StepperTwinSettings(speed=FAST))


def test_a_reading_is_consistent_while_the_mirror_moves() -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        with twin.open_mirror() as mirror:
            move = asyncio.create_task(actuator.move_to(3000))
            while not move.done():
                for _ in range(100):
                    reading = mirror.read()
                    assert reading.position_steps == reading.step_count  # only ever upwards from 0
                await asyncio.sleep(0)
            await move

    bench(scenario, settings=StepperTwinSettings(speed=5.0, start_step=0))


def test_positions_wrap_to_the_turn_around_home() -> None:
    assert [MirrorReading(p, 0, 0, 0, 0, 0).wrapped() for p in (0, 9599, 9600, -9600, 19_201)] == [
        0,
        9599,
        -9600,
        -9600,
        1,
    ]


def test_a_file_that_is_no_mirror_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"1234")
    with pytest.raises(ValueError, match="length is 4, not 131144"):
        MirrorState.open(tmp_path / "x")


def test_triggers_reach_a_socket_at_once_with_position_and_time(tmp_path: Path) -> None:
    path = tmp_path / "triggers"
    receiver = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    receiver.bind(str(path))

    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        sweep = actuator.check_sweep(Sweep(100, 20, 50, 4000, pulses=True))
        await actuator.prepare_sweep(sweep)
        began = now_ns()
        await actuator.sweep(sweep)
        received = [struct.unpack("<qqq", receiver.recv(64)) for _ in range(50)]
        assert [number for number, _, _ in received] == list(range(1, 51))
        assert [position for _, position, _ in received] == [100 + 20 * i for i in range(50)]
        assert began < received[0][2] <= received[-1][2] < now_ns()
        with twin.open_mirror() as mirror:
            state = mirror.read()
            assert (state.trig_count, state.last_trig_position, state.last_trig_host_ns) == (50, 1080, received[-1][2])

    with receiver:
        receiver.settimeout(5)
        bench(scenario, settings=StepperTwinSettings(speed=FAST, start_step=0, trigger_socket=path))


def test_triggers_without_a_listener_are_counted(tmp_path: Path) -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        sweep = actuator.check_sweep(Sweep(100, 20, 5, 4000, pulses=True))
        await actuator.prepare_sweep(sweep)
        assert (await actuator.sweep(sweep)).pulses == 5
        assert (await twin.stats())["triggers_lost"] == 5

    bench(scenario, settings=StepperTwinSettings(speed=FAST, trigger_socket=tmp_path / "nobody"))


def test_simulated_time_keeps_up_with_the_clock_and_never_runs_ahead() -> None:
    async def main() -> None:
        async with StepperTwin() as twin:
            earliest = now_ns()
            first = await twin.stats()
            latest = now_ns()
            await asyncio.sleep(0.5)
            least_s = (now_ns() - latest) / 1e9
            second = await twin.stats()
            most_s = (now_ns() - earliest) / 1e9
            simulated_s = (second["cycle"] - first["cycle"]) / CPU_HZ
            assert simulated_s < most_s + 0.01
            if second["skips"] == 0:  # else this machine stalled, and the bench rightly did not race after it
                assert simulated_s > least_s - 0.06

    run(main())


def test_an_idle_bench_uses_little_cpu() -> None:
    async def main() -> None:
        async with StepperTwin() as twin:
            await asyncio.sleep(1.0)
            fields = Path(f"/proc/{twin.pid}/stat").read_text().rpartition(")")[2].split()
            used_s = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
            assert used_s < 0.5

    run(main())


def test_driver_switched_off_turns_no_mirror() -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        link = actuator._link
        assert link is not None
        await link.request("E 0")
        await actuator.move_to(10)
        stats = await twin.stats()
        assert (stats["position"], stats["unpowered"]) == (0, 10)

    bench(scenario, settings=StepperTwinSettings(speed=FAST, start_step=0))


def test_the_port_is_a_terminal_and_gone_afterwards() -> None:
    async def main() -> None:
        async with StepperTwin() as twin:
            assert stat.S_ISCHR(os.stat(twin.port).st_mode)
            first = os.path.realpath(twin.port)
            await twin.command("unplug")
            assert not os.path.lexists(twin.port)
            assert (await twin.command("plug")).startswith("PORT /dev/pts/")
            assert stat.S_ISCHR(os.stat(twin.port).st_mode)
            directory, pid = twin.directory, twin.pid
            assert first
        assert not directory.exists()
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
        with pytest.raises(RuntimeError, match="not running"):
            _ = twin.port

    run(main())


def test_an_unknown_command_is_answered() -> None:
    async def main() -> None:
        async with StepperTwin() as twin:
            with pytest.raises(ValueError, match="commands: stats"):
                await twin.command("fly")

    run(main())


def test_a_killed_bench_is_noticed() -> None:
    async def main() -> None:
        async with StepperTwin() as twin:
            os.kill(twin.pid, signal.SIGKILL)
            assert await twin.wait_ended() == -signal.SIGKILL
            with pytest.raises(DeviceLost, match="has ended with code -9"):
                await twin.command("stats")

    run(main())


def test_the_bench_ends_with_its_parent() -> None:
    program = (
        "import asyncio, os\n"
        "from scanhsi_sim.twins.stepper import StepperTwin\n"
        "async def main():\n"
        "    async with StepperTwin() as twin:\n"
        "        print(twin.pid, flush=True)\n"
        "        os._exit(0)\n"
        "asyncio.run(main())\n"
    )

    async def main() -> None:
        parent = await asyncio.create_subprocess_exec(sys.executable, "-c", program, stdout=asyncio.subprocess.PIPE)
        assert parent.stdout is not None
        pid = int(await parent.stdout.readline())
        await parent.wait()
        async with asyncio.timeout(20):
            while Path(f"/proc/{pid}/cmdline").exists() and Path(f"/proc/{pid}/cmdline").read_bytes():
                await asyncio.sleep(0.02)

    run(main())


def test_a_firmware_that_cannot_be_loaded_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "x.elf").write_bytes(b"no ELF file")

    async def main() -> None:
        with pytest.raises(DeviceUnavailable, match="does not start"):
            async with StepperTwin(StepperTwinSettings(firmware=tmp_path / "x.elf")):
                pass

    run(main())


def test_missing_tools_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(DeviceUnavailable, match="gcc missing: apt-get install libsimavr-dev libelf-dev gcc"):
        stepper_build.build_bench()


def test_the_bench_is_built_once_per_version(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    program = stepper_build.build_bench()
    built = program.stat().st_mtime_ns
    assert stepper_build.build_bench() == program
    assert program.stat().st_mtime_ns == built
    assert list(program.parent.iterdir()) == [program]
