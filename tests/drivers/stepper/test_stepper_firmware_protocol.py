"""The real firmware in the emulator: every command, every error, and lines that are damaged in every way."""

import asyncio
import os
from collections.abc import Awaitable, Callable

import pytest
from stepper_peer import line
from stepper_twin import FAST

from scanhsi.clock import run
from scanhsi_serial import close_port, open_port
from scanhsi_sim.twins.stepper import StepperTwin, StepperTwinSettings
from scanhsi_stepper.link import StepperLink
from scanhsi_stepper.protocol import Boot, Err, Message, Nak, Ok, encode, parse

pytestmark = pytest.mark.twin


class Wire(StepperLink):
    """Keeps every message that arrives, in order."""

    def __init__(self, port: str) -> None:
        super().__init__(port)
        self.heard: asyncio.Queue[Message] = asyncio.Queue()

    def data_received(self, data: bytes) -> None:
        for text in self._splitter.feed(data):
            self.heard.put_nowait(parse(text))

    def send(self, data: bytes) -> None:
        assert self._transport is not None
        self._transport.write(data)

    async def hear(self) -> Message:
        async with asyncio.timeout(10):
            return await self.heard.get()

    async def ask(self, seq: int, command: str) -> Message:
        self.send(encode(seq, command))
        return await self.hear()


def talk(scenario: Callable[[Wire, StepperTwin], Awaitable[None]]) -> None:
    async def main() -> None:
        async with StepperTwin(StepperTwinSettings(speed=FAST, start_step=0)) as twin:
            while (await twin.stats())["cycle"] < 200_000:  # its BOOT line is out, and lost: nobody had the port open
                await asyncio.sleep(0.001)
            transport, wire = await open_port(twin.port, 115_200, lambda: Wire(twin.port), "wire")
            wire.attach(transport)
            try:
                await scenario(wire, twin)
            finally:
                await close_port(transport, wire.lost, 1.0)

    run(main())


def test_every_command_answers_as_the_protocol_says() -> None:
    async def scenario(wire: Wire, twin: StepperTwin) -> None:
        for seq, (command, answer) in enumerate(
            [
                ("I", Ok(1, ("scanhsi-stepper", "1", "328P"))),
                ("P", Ok(2, ("0",))),
                ("Q", Ok(3, ("0", "0", "0", "0", "1", "1", "0", "0"))),
                ("S", Ok(4, ())),
                ("X", Ok(5, ())),
                ("V", Ok(6, ("4000",))),
                ("A", Ok(7, ("20000",))),
                ("B", Ok(8, ("0",))),
                ("V 12000", Ok(9, ("12000",))),
                ("A 2000000", Ok(10, ("2000000",))),
                ("B 4000", Ok(11, ("4000",))),
                ("Z -1000000000", Ok(12, ())),
                ("P", Ok(13, ("-1000000000",))),
                ("E 0", Ok(14, ())),
                ("Q", Ok(15, ("0", "-1000000000", "-1000000000", "0", "1", "0", "0", "0"))),
                ("E 1", Ok(16, ())),
            ],
            start=1,
        ):
            assert await wire.ask(seq, command) == answer

    talk(scenario)


@pytest.mark.parametrize(
    ("code", "commands"),
    [
        (1, ["K", "PP", "MAX 3", "m", "i"]),
        (2, ["P 1", "MA", "MA 1 2", "MA 99999999999", "E 2", "H 0 5", "H 1", "W 5 0 1 50", "W 1 2 3", "V 1 2", "Z"]),
        (
            4,
            ["V 0", "V 12001", "A 9", "A 2000001", "B -1", "B 4001", "Z 1000000001", "MA 1000000001", "MR -1000000001"],
        ),
        (4, ["W 0 1 5 50", "W 5 -1 5 50", "W 5 1 0 50", "W 5 1 65536 50", "W 5 1 5 4", "W 5 1 5 10001"]),
        (4, ["W 1000000000 1000 5 50", "W 100 2147483647 65535 50", "H 1 0", "H 1 1000000001"]),
    ],
)
def test_wrong_commands_are_refused(code: int, commands: list[str]) -> None:
    async def scenario(wire: Wire, twin: StepperTwin) -> None:
        for seq, command in enumerate(commands, start=1):
            assert await wire.ask(seq, command) == Err(seq, code), command
        assert (await twin.stats())["up"] == 0

    talk(scenario)


def test_everything_but_asking_and_stopping_is_busy_while_it_moves() -> None:
    async def scenario(wire: Wire, twin: StepperTwin) -> None:
        assert await wire.ask(1, "MA 100000") == Ok(1, ("100000",))
        commands = ["MA 5", "MR 1", "V 5", "A 50", "B 5", "Z 0", "E 0", "H 1 5", "W 200000 1 1 50"]
        for seq, command in enumerate(commands, start=2):
            assert await wire.ask(seq, command) == Err(seq, 3), command
        answer = await wire.ask(100, "Q")
        assert isinstance(answer, Ok)
        assert answer.words[0] == "1"
        assert await wire.ask(101, "X") == Ok(101, ())
        assert "code=6" in repr(await wire.hear())

    talk(scenario)


def test_a_repeated_request_gets_the_stored_answer_and_moves_once() -> None:
    async def scenario(wire: Wire, twin: StepperTwin) -> None:
        wire.send(encode(7, "MR 3") * 3)
        heard = [await wire.hear() for _ in range(4)]
        assert heard.count(Ok(7, ("3",))) == 3
        assert await wire.ask(8, "P") == Ok(8, ("3",))

    talk(scenario)


@pytest.mark.parametrize(
    "damaged",
    [
        b">7 MR 8*3971\n",
        b">7 MR 8\n",
        b">\n",
        b">*0000\n",
        line(">", "0 I"),
        line(">", "65536 I"),
        line(">", "x I"),
        line(">", "5"),
        line(">", "5 "),
        line(">", "5 MA  3"),
        line(">", "5 MA 3x"),
        line(">", "5 MA -"),
        b">" + b"9" * 100 + b"\n",
    ],
)
def test_a_damaged_request_gets_a_nak_and_the_next_is_understood(damaged: bytes) -> None:
    async def scenario(wire: Wire, twin: StepperTwin) -> None:
        wire.send(damaged)
        assert await wire.hear() == Nak(1)
        assert await wire.ask(9, "P") == Ok(9, ("0",))

    talk(scenario)


def test_noise_between_lines_is_skipped_and_a_mark_begins_anew() -> None:
    async def scenario(wire: Wire, twin: StepperTwin) -> None:
        wire.send(b"\n\nAT+GMM\r\n\xfd\x00" + b">12 MR 9" + encode(13, "MR 2"))
        assert await wire.hear() == Ok(13, ("2",))

    talk(scenario)


def test_random_bytes_never_crash_it_nor_move_it() -> None:
    async def scenario(wire: Wire, twin: StepperTwin) -> None:
        wire.send(os.urandom(3000))
        wire.send(b"\n")
        for attempt in range(200):
            wire.send(encode(40_000 + attempt, "P"))
            if await wire.hear() == Ok(40_000 + attempt, ("0",)):
                break
        assert (await twin.stats())["up"] + (await twin.stats())["down"] == 0

    talk(scenario)


def test_reset_causes_are_told() -> None:
    async def scenario(wire: Wire, twin: StepperTwin) -> None:
        await twin.command("reset")
        assert await wire.hear() == Boot("scanhsi-stepper", 1, 2)
        assert await wire.ask(1, "P") == Ok(1, ("0",))

    talk(scenario)
