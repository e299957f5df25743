"""mbtool replay --as-master."""

from __future__ import annotations

import json
from contextlib import nullcontext
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.core import parse_link
from mbtool.modbus import Response
from mbtool.slave.shells import open_shell
from tests.slave.scripted import Scripted
from tests.workflows.evidence import VALUES, capture_file, capture_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.cli.program import CommandLine

WRONG = bytes.fromhex("03 04 1234 0001")


@pytest.fixture
def right() -> Iterator[str]:
    with open_shell(parse_link("tcp:127.0.0.1:0"), Scripted(lambda *_: Response(VALUES))) as shell:
        yield shell.place


@pytest.fixture
def wrong() -> Iterator[str]:
    with open_shell(parse_link("tcp:127.0.0.1:0"), Scripted(lambda *_: Response(WRONG))) as shell:
        yield shell.place


def test_right_answers_exit_with_0(mbtool: CommandLine, capture: Path, right: str) -> None:
    told = mbtool("replay", capture, "--as-master", "--to", right, "--speed", "max")
    assert (told.code, told.out) == (exit_codes.DONE, "")
    begin, end = told.err.splitlines()
    assert begin.startswith(f"{capture}: ")
    assert begin.endswith(f" to unit 1 on {right}, as fast as answers come; Ctrl-C ends")
    assert end.endswith("; 0 answers not as recorded")


def test_wrong_answers_are_a_table_and_exit_with_1(
    mbtool: CommandLine, capture: Path, wrong: str
) -> None:
    told = mbtool("replay", capture, "--as-master", "--to", wrong, "--speed", "max")
    assert told.code == exit_codes.NO
    assert [line.rstrip() for line in told.lines] == [
        "unit 1",
        "differs  function  what       recorded  answered",
        "value    read      holding 1  22136     1",
        "",
    ]


@pytest.mark.parametrize("suffix", ["json", "xml"])
def test_a_report_is_written(
    mbtool: CommandLine, capture: Path, wrong: str, tmp_path: Path, suffix: str
) -> None:
    file = tmp_path / f"report.{suffix}"
    told = mbtool(
        "replay", capture, "--as-master", "--to", wrong, "--speed", "max", "--report", file
    )
    assert told.code == exit_codes.NO
    text = file.read_text()
    if suffix == "json":
        assert json.loads(text)["different"] > 0
    else:
        assert "recorded 22136, answered 1" in text


def test_what_differs_is_learned_and_left_out_the_next_time(
    mbtool: CommandLine, capture: Path, wrong: str, tmp_path: Path
) -> None:
    ranges = tmp_path / "ranges.txt"
    play = ("replay", capture, "--as-master", "--to", wrong, "--speed", "max")
    assert mbtool(*play, "--learn", ranges).code == exit_codes.DONE
    assert ranges.read_text() == "holding 1\n"
    assert mbtool(*play, "--ignore-from", ranges).code == exit_codes.DONE
    assert mbtool(*play).code == exit_codes.NO


def test_ctrl_c_says_that_requests_were_not_asked(
    mbtool: CommandLine, capture: Path, right: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "mbtool.cli.replay_master.controlled", lambda: nullcontext((None, lambda: True))
    )
    file = tmp_path / "x.xml"
    told = mbtool("replay", capture, "--as-master", "--to", right, "--report", file)
    assert (told.code, told.out) == (exit_codes.INTERRUPTED, "")
    assert told.err.splitlines()[-1] == (
        "interrupted after 0 of 3 requests; 0 answers not as recorded"
    )
    assert 'tests="1" failures="0" errors="1"' in file.read_text()


def test_the_last_line_says_that_only_the_times_failed(mbtool: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file(8))
    slow = Scripted(lambda *_: Response(VALUES, 30_000_000))
    with open_shell(parse_link("tcp:127.0.0.1:0"), slow) as shell:
        play = ("replay", path, "--as-master", "--to", shell.place, "--speed", "max")
        told = mbtool(*play, "--latency-tolerance", "10")
    assert told.code == exit_codes.NO
    assert told.err.splitlines()[-1] == (
        "8 requests; answers later than allowed to unit 1 03 read holding 0..1"
    )


def test_ranges_are_learned_from_several_recordings(
    mbtool: CommandLine, capture: Path, wrong: str, tmp_path: Path
) -> None:
    other, ranges = tmp_path / "other.pcap", tmp_path / "ranges.txt"
    read, values = bytes.fromhex("03 0007 0002"), bytes.fromhex("03 04 0000 0001")
    other.write_bytes(capture_of([(read, values)]))
    play = ("--as-master", "--to", wrong, "--speed", "max")
    assert mbtool("replay", capture, other, *play, "--learn", ranges).code == exit_codes.DONE
    assert ranges.read_text() == "holding 1\nholding 7\n"
    told = mbtool("replay", capture, other, *play)
    assert told.code == exit_codes.USAGE
    assert "one FILE is played; several go with --as-master --learn" in told.err


def test_the_unit_that_is_asked_is_told(mbtool: CommandLine, capture: Path, right: str) -> None:
    play = ("replay", capture, "--as-master", "--to", right, "--speed", "max", "--unit")
    told = mbtool(*play, "1=9")
    assert told.code == exit_codes.DONE
    assert f"to unit 1 (as 9) on {right}" in told.err
    assert mbtool(*play, "9").err == "mbtool: --unit 9: write RECORDED=UNIT, as in 7=1\n"


def test_learned_ranges_are_added_behind_what_a_list_holds(
    mbtool: CommandLine, capture: Path, wrong: str, tmp_path: Path
) -> None:
    ranges = tmp_path / "ranges.txt"
    play = ("replay", capture, "--as-master", "--to", wrong, "--speed", "max", "--learn", ranges)
    ranges.write_text("# by hand\nholding 9  # the clock")
    assert mbtool(*play).code == exit_codes.DONE
    assert ranges.read_text() == "# by hand\nholding 9  # the clock\nholding 1\n"
    assert mbtool(*play).code == exit_codes.DONE
    assert ranges.read_text() == "# by hand\nholding 9  # the clock\nholding 1\n"


@pytest.mark.parametrize("content", [b"\xd4\xc3\xb2\xa1", b"my notes\n"])
def test_ranges_are_added_to_nothing_but_a_list(
    mbtool: CommandLine, capture: Path, tmp_path: Path, content: bytes
) -> None:
    scripted = Scripted(lambda *_: Response(WRONG))
    other = tmp_path / "other"
    other.write_bytes(content)
    with open_shell(parse_link("tcp:127.0.0.1:0"), scripted) as shell:
        told = mbtool("replay", capture, "--as-master", "--to", shell.place, "--learn", other)
    assert (told.code, scripted.asked) == (exit_codes.USAGE, [])
    assert f"{other}: is no list of ranges" in told.err
    assert other.read_bytes() == content


@pytest.mark.parametrize("option", ["--learn", "--report"])
def test_an_input_is_not_overwritten(
    mbtool: CommandLine, capture: Path, tmp_path: Path, option: str
) -> None:
    recording = capture.rename(tmp_path / "capture.json")
    bytes_before = recording.read_bytes()
    again = tmp_path / ".." / tmp_path.name / "capture.json"
    told = mbtool("replay", recording, "--as-master", "--to", "tcp:127.0.0.1:1", option, again)
    assert (told.code, told.err) == (
        exit_codes.USAGE,
        f"mbtool: {again}: is an input and would be overwritten; name another file\n",
    )
    assert recording.read_bytes() == bytes_before


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "say which side to play: --as-slave --on LINK, --as-master --to LINK, or"),
        (["--as-slave", "--as-master"], "say which side to play"),
        (["--as-master"], "--as-master goes with --to LINK"),
        (["--as-master", "--on", "tcp:127.0.0.1:1"], "--as-master goes with --to LINK"),
        (["--as-slave", "--to", "tcp:127.0.0.1:1"], "--as-slave goes with --on LINK"),
        (["--as-master", "--to", "net:eth0"], "a master needs rtu:PORT"),
        (["--as-master", "--to", "tcp:127.0.0.1:1", "--speed", "0"], "--speed '0': write a factor"),
        (["--as-master", "--to", "tcp:127.0.0.1:1", "--speed", "1/0"], "--speed '1/0': write"),
        (["--as-master", "--to", "tcp:127.0.0.1:1", "--speed", "1e-400"], "write a factor from"),
        (["--as-bus", "--on", "tcp:127.0.0.1:1", "--speed", "1001"], "write a factor from 0.001"),
        (["--as-master", "--to", "tcp:127.0.0.1:1", "--report", "a.txt"], "name a .json file"),
    ],
)
def test_wrong_usage_is_told(
    mbtool: CommandLine, capture: Path, arguments: list[str], says: str
) -> None:
    told = mbtool("replay", capture, *arguments)
    assert (told.code, told.out) == (exit_codes.USAGE, "")
    assert says in told.err


@pytest.mark.parametrize("option", ["--report", "--learn"])
def test_what_cannot_be_written_is_told_before_the_first_request(
    mbtool: CommandLine, capture: Path, tmp_path: Path, option: str
) -> None:
    scripted = Scripted(lambda *_: Response(VALUES))
    for file, why in (
        (tmp_path / "absent" / "x.json", f"there is no folder {tmp_path / 'absent'}"),
        (tmp_path / "folder.json", "Is a directory"),
    ):
        (tmp_path / "folder.json").mkdir(exist_ok=True)
        with open_shell(parse_link("tcp:127.0.0.1:0"), scripted) as shell:
            told = mbtool("replay", capture, "--as-master", "--to", shell.place, option, file)
        assert told.code == exit_codes.USAGE
        assert told.err == f"mbtool: {file}: cannot be written: {why}\n"
    assert scripted.asked == []


@pytest.mark.parametrize("suffix", ["json", "xml"])
def test_a_report_is_written_although_the_slave_cannot_be_reached(
    mbtool: CommandLine, capture: Path, tmp_path: Path, suffix: str
) -> None:
    file, known = tmp_path / f"a.{suffix}", tmp_path / "ranges.txt"
    known.write_text("holding 9\n")
    told = mbtool(
        "replay", capture, "--as-master", "--to", "tcp:127.0.0.1:1", "--report", file,
        "--learn", known,
    )  # fmt: skip
    assert told.code == exit_codes.UNREADABLE
    (problem,) = told.err.splitlines()
    assert "does a slave listen there" in problem
    assert problem.removeprefix("mbtool: ") in file.read_text()
    assert known.read_text() == "holding 9\n"


def test_what_cannot_be_read_or_reached_is_told(
    mbtool: CommandLine, capture: Path, right: str, tmp_path: Path
) -> None:
    away = mbtool("replay", capture, "--as-master", "--to", "tcp:127.0.0.1:1")
    assert (away.code, "does a slave listen there" in away.err) == (exit_codes.UNREADABLE, True)
    none = mbtool(
        "replay", capture, "--as-master", "--to", right, "--ignore-from", tmp_path / "none"
    )
    assert (none.code, "cannot be read" in none.err) == (exit_codes.UNREADABLE, True)
