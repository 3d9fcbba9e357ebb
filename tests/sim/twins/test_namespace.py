"""The private network that everything with Aravis runs in, and the plugin that puts marked tests there."""

import socket
import subprocess
import sys

import pytest

from scanhsi_sim.twins import netns


@pytest.mark.twin
@pytest.mark.parametrize("number", [1, 2])
def test_marked_tests_see_nothing_but_loopback(number: int) -> None:
    assert [name for _, name in socket.if_nameindex()] == ["lo"]
    netns.require_private_network()


def run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*netns.prefix(), *command], capture_output=True, text=True, check=False)


def test_exit_code_and_output_pass_through() -> None:
    done = run("sh", "-c", "echo hello; exit 7")
    assert (done.stdout, done.returncode) == ("hello\n", 7)


def test_loopback_works_inside() -> None:
    assert run(sys.executable, "-c", "import socket; socket.create_server(('127.0.0.1', 0))").returncode == 0


def test_unknown_command_is_named() -> None:
    done = run("no-such-command-here")
    assert done.returncode == 127
    assert "no-such-command-here" in done.stderr


def test_the_machines_own_network_is_refused() -> None:
    if netns.in_private_network():
        pytest.skip("started in a private network")
    with pytest.raises(RuntimeError, match="scanhsi twin"):
        netns.require_private_network()
