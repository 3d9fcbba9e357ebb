"""Logging: context, readable text, JSON, no secrets, quiet as a library."""

import json
import logging
from collections.abc import Generator
from pathlib import Path

import pytest
import structlog
from structlog.contextvars import bound_contextvars

from scanhsi import log

ours = log.get_logger("scanhsi.tests")


@pytest.fixture(autouse=True)
def _reset() -> Generator[None]:
    yield
    log.reset()


def events(capsys: pytest.CaptureFixture[str]) -> list[dict[str, object]]:
    return [json.loads(line) for line in capsys.readouterr().err.splitlines()]


def test_events_carry_run_device_and_operation(capsys: pytest.CaptureFixture[str]) -> None:
    log.configure(as_json=True)
    with bound_contextvars(run="r1", device="camera x", operation="arm"):
        ours.info("armed", buffers=16)
    (event,) = events(capsys)
    assert list(event) == ["time", "level", "logger", "event", "run", "device", "operation", "buffers"]
    assert event["level"] == "info"
    assert str(event["time"]).endswith("+00:00")
    assert (event["run"], event["device"], event["operation"], event["buffers"]) == ("r1", "camera x", "arm", 16)


def test_text_is_readable(capsys: pytest.CaptureFixture[str]) -> None:
    log.configure()
    ours.warning("did not close", device="camera x", percent="100 %s")
    assert capsys.readouterr().err.endswith("WARNING did not close device='camera x' percent='100 %s'\n")


def test_level(capsys: pytest.CaptureFixture[str]) -> None:
    log.configure(level="warning")
    ours.info("hidden")
    ours.warning("seen")
    assert "hidden" not in capsys.readouterr().err
    log.configure(level="debug")
    ours.debug("seen")
    assert capsys.readouterr().err.count("\n") == 1


def test_plain_structlog_and_plain_logging_are_heard_too(capsys: pytest.CaptureFixture[str]) -> None:
    log.configure(as_json=True, level="debug")
    structlog.get_logger("other").info("structured", device="x")
    logging.getLogger("library").warning("plain %s", "words")
    logging.getLogger("library").info("chatter")
    assert [(event["event"], event.get("device")) for event in events(capsys)] == [
        ("structured", "x"),
        ("plain words", None),
    ]


def test_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "log.jsonl"
    log.configure(file=file)
    ours.info("one", path=tmp_path)
    log.configure(file=file)
    ours.info("two")
    assert [json.loads(line)["event"] for line in file.read_text().splitlines()] == ["one", "two"]
    assert capsys.readouterr().err.count("\n") == 2


def test_exceptions(capsys: pytest.CaptureFixture[str]) -> None:
    log.configure(as_json=True)
    try:
        raise ValueError("inside")
    except ValueError:
        ours.exception("failed")
    (event,) = events(capsys)
    assert "ValueError: inside" in str(event["exception"])


def test_credentials_are_never_logged(capsys: pytest.CaptureFixture[str]) -> None:
    log.configure()
    ours.info(
        "opened", password="hunter2", api_key="hunter2", url="https://me:hunter2@example.org/bucket", Token="hunter2"
    )
    text = capsys.readouterr().err
    assert "hunter2" not in text
    assert "https://me:***@example.org/bucket" in text


def test_names_of_log_record_fields_are_fine(capsys: pytest.CaptureFixture[str]) -> None:
    log.configure(as_json=True)
    ours.info("x", name="n", args=(1,), module="m", msg="text")
    (event,) = events(capsys)
    assert event["name"] == "n"


def test_a_library_says_nothing_below_warning(
    capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    ours.info("quiet")
    ours.warning("loud", device="x")
    captured = capsys.readouterr()
    assert captured.out == ""
    assert [record.getMessage() for record in caplog.records] == ["loud device='x'"]
