from __future__ import annotations

import socket
from io import StringIO
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from mbtool.cli import exit_codes
from mbtool.cli.progress import with_progress
from tests.logs.samples import chunk, transaction, write_log
from tests.packets.building import pcap
from tests.workflows.evidence import captured

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.cli.program import CommandLine

MANY = 5000


class Screen(StringIO):
    """A standard error that is a terminal, or none."""

    def __init__(self, *, is_terminal: bool) -> None:
        super().__init__()
        self._is_terminal = is_terminal

    def isatty(self) -> bool:
        return self._is_terminal


class Halfway:
    """A reading that has come to its half."""

    fraction = 0.5
    progress_text = "file 1 of 2"
    noun = "transactions"


class Strange(Halfway):
    """A reading of a file whose name has markup of the bar, and orders for the terminal."""

    progress_text = "[/] [red] a\x1b]0;title\x07.pcap"


def _passed(
    monkeypatch: pytest.MonkeyPatch, screen: Screen, *times_s: float, reading: Any = None
) -> list[int]:
    """What comes of MANY records, where the clock is looked at at these times, then at the last."""
    left = list(times_s)
    clock = SimpleNamespace(monotonic=lambda: left.pop(0) if len(left) > 1 else left[0])
    monkeypatch.setattr("mbtool.cli.progress.time", clock)
    monkeypatch.setattr("sys.stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    records: Any = iter(range(MANY))
    shown: Any = reading or Halfway()
    return [*with_progress(shown, records)]


def test_a_files_name_is_no_markup_and_no_order_for_the_terminal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    screen = Screen(is_terminal=True)
    _passed(monkeypatch, screen, 10.0, 10.5, 11.0, reading=Strange())
    assert "[/] [red] a\\x1b]0;title\\x07.pcap" in screen.getvalue()


def test_after_a_second_a_terminal_shows_how_far_reading_has_come(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    screen = Screen(is_terminal=True)
    assert _passed(monkeypatch, screen, 10.0, 10.5, 11.0) == [*range(MANY)]
    assert " 50%" in screen.getvalue()
    assert "file 1 of 2" in screen.getvalue()


def test_what_is_read_within_a_second_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Screen(is_terminal=True)
    assert _passed(monkeypatch, screen, 10.0, 10.9) == [*range(MANY)]
    assert screen.getvalue() == ""


def test_a_file_or_a_pipe_is_shown_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Screen(is_terminal=False)
    assert _passed(monkeypatch, screen, 10.0, 99.0) == [*range(MANY)]
    assert screen.getvalue() == ""


@pytest.mark.parametrize(("side", "where"), [("slave", "on"), ("master", "to"), ("bus", "on")])
def test_a_recording_that_is_to_be_played_is_read_with_it(
    mbtool: CommandLine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, side: str, where: str
) -> None:
    passed: list[object] = []

    def note(_: object, records: Iterator[object]) -> Iterator[object]:
        for record in records:
            passed.append(record)
            yield record

    monkeypatch.setattr(f"mbtool.cli.replay_{side}.with_progress", note)
    path = tmp_path / "plant.pcap"
    path.write_bytes(pcap(captured(3)))
    # The port is not there; by then the recording was read.
    told = mbtool("replay", path, f"--as-{side}", f"--{where}", "rtu:/dev/absent@9600-8E1")
    assert told.code == exit_codes.UNREADABLE
    assert "/dev/absent" in told.err
    assert len(passed) >= 3


class Part:
    """Several rows at once."""

    row_count = 250


def test_parts_count_with_all_their_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    screen, left = Screen(is_terminal=True), [10.0, 11.0, 12.0, 12.0]
    clock = SimpleNamespace(monotonic=lambda: left.pop(0) if len(left) > 1 else left[0])
    monkeypatch.setattr("mbtool.cli.progress.time", clock)
    monkeypatch.setattr("sys.stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    reading: Any = Halfway()
    assert len([*with_progress(reading, iter([Part(), Part()]))]) == 2
    assert "250 transactions/s" in screen.getvalue()
    assert "left" in screen.getvalue()


@pytest.mark.parametrize(
    "command",
    [
        ["check", "{}"], ["diff", "{}", "{}"], ["convert", "{}", "x.mcap"], ["report", "{}", "-o",
        "x.html"], ["plot", "{}"], ["inventory", "{}"], ["stats", "{}"], ["decode", "{}"],
    ],
)  # fmt: skip
def test_ctrl_c_says_what_was_kept_of_a_file(
    mbtool: CommandLine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, command: list[str]
) -> None:
    def interrupted(_: object, records: Iterator[object]) -> Iterator[object]:
        yield next(records)
        raise KeyboardInterrupt

    monkeypatch.setattr(f"mbtool.cli.{command[0]}.with_progress", interrupted)
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "plant.pcap"
    path.write_bytes(pcap(captured(3)))
    told = mbtool(*(one.replace("{}", str(path)) for one in command))
    assert told.code == exit_codes.INTERRUPTED
    assert "interrupted; " in told.err
    assert not list(tmp_path.glob("x.*"))


def _stop(*_: object, **__: object) -> Any:
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("command", "stopped", "told"),
    [
        (["recover", "{}", "-o", "y.mcap"], "mbtool.logs.recovery.Recovery._finish",
         "interrupted; y.mcap ends early"),
        (["devices", "--match", "{}"], "mbtool.workflows.shared.reading.Reading.records",
         "interrupted; nothing was written"),
        (["devices", "draft", "{}"], "mbtool.workflows.shared.reading.Reading.records",
         "interrupted; nothing was written"),
        (["decode", "{}", "--format", "parquet", "-o", "out/"],
         "mbtool.workflows.decode_job.DecodeJob.run",
         "interrupted; what is decoded is in out/, and the same command does the rest"),
        (["decode", "{}", "--raw", "--where", "unit == 9"], "mbtool.cli.output.RecordOutput.add",
         "interrupted; nothing was written"),
        (["demo"], "mbtool.workflows.demo.Demo.record", "interrupted; nothing was written"),
        (["links"], "mbtool.cli.links._print_tables", "interrupted"),
        (["doctor"], "mbtool.workflows.doctor.machine_checks", "interrupted"),
        (["status", "{}"], "mbtool.workflows.status.recording_of", "interrupted"),
    ],
)  # fmt: skip
def test_ctrl_c_is_told_once_by_each_command(
    mbtool: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    command: list[str],
    stopped: str,
    told: str,
) -> None:
    monkeypatch.setattr(stopped, _stop)
    monkeypatch.chdir(tmp_path)
    path = write_log(tmp_path / "x.mcap", [chunk(1), transaction(1)])
    ended = mbtool(*(one.replace("{}", str(path)) for one in command))
    assert ended.code == exit_codes.INTERRUPTED
    assert [line for line in ended.err.splitlines() if line.startswith("interrupted")] == [told]


def test_ctrl_c_while_a_slave_is_asked_says_what_it_may_have_taken(
    mbtool: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mbtool.cli.ask.print_asked", _stop)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        link = f"tcp:127.0.0.1:{silent.getsockname()[1]}"
        assert mbtool("read", link, "holding 0").err == "interrupted\n"
        told = mbtool("write", link, "holding 0=5", "--yes")
    assert told.code == exit_codes.INTERRUPTED
    assert told.err == "interrupted; the slave may have taken what was sent, or may take it yet\n"


@pytest.mark.parametrize(
    "command",
    [
        ["decode", "{}", "-o", "x.jsonl"],
        ["decode", "{}", "-o", "x.csv", "--jobs", "2"],
        ["decode", "{}", "-o", "x.parquet"],
        ["decode", "{}", "-o", "x.jsonl", "--where", "unit == 1"],
        ["convert", "{}", "x.jsonl"],
        ["convert", "{}", "x.csv"],
        ["convert", "{}", "x.mcap"],
        ["decode", "*.pcap", "--format", "parquet", "-o", "out/"],
        ["report", ".", "-o", "x.html"],
        ["convert", "{}", "x.pcap", "--anonymous"],
        ["devices", "--match", "{}"],
        ["devices", "draft", "{}"],
    ],
    ids=" ".join,
)
def test_whatever_is_made_of_a_capture_its_reading_is_shown(
    mbtool: CommandLine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, command: list[str]
) -> None:
    passed: list[object] = []

    def note(_: object, records: Iterator[object]) -> Iterator[object]:
        for record in records:
            passed.append(record)
            yield record

    for module in ("column_output", "convert", "decode", "devices_own", "report"):
        monkeypatch.setattr(f"mbtool.cli.{module}.with_progress", note)
    monkeypatch.setattr("mbtool.workflows.shared.reading_choice.WORTH_BYTES", 0)
    monkeypatch.setattr("mbtool.cli.column_output.WORTH_PROCESSES", 0)
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "plant.pcap"
    path.write_bytes(pcap(captured(3)))
    for number in range(2):
        (tmp_path / f"{number}.pcap").write_bytes(path.read_bytes())
    assert mbtool(*(one.replace("{}", str(path)) for one in command)).code == exit_codes.DONE
    assert sum(getattr(record, "row_count", 1) for record in passed) >= 3
