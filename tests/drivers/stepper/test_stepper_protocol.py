"""Lines of the stepper protocol: the reference's examples, and parsing that never raises."""

import binascii
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanhsi_stepper.protocol import (
    BadLine,
    Boot,
    Ended,
    Err,
    LineSplitter,
    Nak,
    Noise,
    Ok,
    Status,
    encode,
    next_seq,
    parse,
)

MESSAGES = [
    (b"<7 OK 8*09EA", Ok(7, ("8",))),
    (b"!7 DONE 8 30658 0*E16D", Ended(7, 0, 8, 30658, 0)),
]


def checked(mark: str, body: str) -> bytes:
    return f"{mark}{body}*{binascii.crc_hqx(body.encode(), 0):04X}".encode()


def test_checksum_is_the_one_of_the_firmware() -> None:
    assert binascii.crc_hqx(b"123456789", 0) == 0x31C3
    assert encode(7, "MR 8") == b">7 MR 8*3970\n"


@pytest.mark.parametrize(
    ("line", "message"),
    [
        *MESSAGES,
        (checked("<", "65535 ERR 3"), Err(65535, 3)),
        (checked("!", "9 FAIL 6 -120 1000 2"), Ended(9, 6, -120, 1000, 2)),
        (checked("!", "0 BOOT scanhsi-stepper 1 2"), Boot("scanhsi-stepper", 1, 2)),
        (checked("!", "0 NAK 12"), Nak(12)),
        (b"\xfd\x00gar<bage!" + MESSAGES[0][0], MESSAGES[0][1]),
        (b"<12 OK 1!" + MESSAGES[1][0][1:], MESSAGES[1][1]),
    ],
)
def test_parse_known_lines(line: bytes, message: object) -> None:
    assert parse(line) == message


@pytest.mark.parametrize(
    ("line", "kind"),
    [
        (b"", Noise),
        (b"optiboot\xfd", Noise),
        (b"<", BadLine),
        (b"<7 OK 8*09EB", BadLine),
        (checked("<", "7 MAYBE"), BadLine),
        (checked("<", "x OK"), BadLine),
        (checked("<", ""), BadLine),
        (checked("!", "7 DONE 8"), BadLine),
        (checked("!", "7 DONE 8 9 ten"), BadLine),
        (checked("<", "7 OK " + "9" * 200), BadLine),
    ],
)
def test_what_is_no_message_is_told_apart(line: bytes, kind: type) -> None:
    assert isinstance(parse(line), kind)


@given(st.binary(max_size=300))
def test_parse_is_total(line: bytes) -> None:
    parse(line)


@given(st.sampled_from([line for line, _ in MESSAGES]), st.integers(0, 10), st.integers(0, 7))
def test_a_flipped_bit_never_passes_for_another_message(line: bytes, index: int, bit: int) -> None:
    damaged = bytearray(line)
    damaged[index] ^= 1 << bit
    assert not isinstance(parse(bytes(damaged)), Ok | Err | Ended) or parse(bytes(damaged)) == parse(line)


@given(st.lists(st.binary(max_size=60).filter(lambda part: b"\n" not in part), max_size=8), st.integers(1, 20))
def test_lines_do_not_depend_on_how_the_bytes_arrive(lines: list[bytes], size: int) -> None:
    stream = b"".join(part + b"\n" for part in lines)
    splitter = LineSplitter()
    assert [line for i in range(0, len(stream), size) for line in splitter.feed(stream[i : i + size])] == lines


def test_an_endless_line_is_kept_in_bounded_memory_and_the_next_line_is_found() -> None:
    splitter = LineSplitter()
    for _ in range(1000):
        assert splitter.feed(b"x" * 100) == []
    assert len(splitter._rest) < 1000
    (line,) = splitter.feed(b"<7 OK 8*09EA\n")
    assert parse(line[-12:]) == Ok(7, ("8",))


def test_sequence_numbers_wrap_past_zero() -> None:
    assert next_seq(65_534) == 65_535
    assert next_seq(65_535) == 1


def test_status_reads_eight_numbers() -> None:
    assert Status.of(("2", "-5", "100", "7", "1", "0", "3", "4")) == Status(2, -5, 100, 7, True, False, 3, 4)
    with pytest.raises(ValueError):
        Status.of(("1", "2"))


def test_lines_shown_in_the_documents_carry_their_true_checksums() -> None:
    root = Path(__file__).parents[3]
    documents = [root / "docs/reference/stepper-protocol.md", root / "drivers/scanhsi_stepper/firmware/README.md"]
    shown = [
        match for path in documents for match in re.findall(r"[<>!](\d+ [A-Z][^*`.]*)\*([0-9A-F]{4})", path.read_text())
    ]
    assert len(shown) >= 6
    for body, crc in shown:
        assert f"{binascii.crc_hqx(body.encode(), 0):04X}" == crc, body
