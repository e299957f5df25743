"""Where records go, and what is said of them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.cli.options import EventChoice
from mbtool.cli.output import open_output
from mbtool.cli.talk import Interrupted
from mbtool.core import InputError
from mbtool.logs.writer import LogWriter
from tests.logs.samples import EVENT, transaction, write_log
from tests.packets.building import packet, pcap

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.cli.program import CommandLine


@pytest.mark.parametrize(
    ("name", "begins"),
    [("a.jsonl", '{"link"'), ("a.CSV", "request_ns,"), ("a.txt", "1970-01-01 UTC\n    # time")],
)
def test_the_name_of_the_output_says_its_format(
    mbtool: CommandLine, capture: Path, tmp_path: Path, name: str, begins: str
) -> None:
    path = tmp_path / name
    told = mbtool("decode", capture, "-o", path)
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert told.err == f"3 transactions: 3 ok -> {path}\n"
    assert path.read_text().startswith(begins)


def test_a_format_may_have_any_name(mbtool: CommandLine, capture: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    assert mbtool("decode", capture, "-o", path, "--format", "jsonl").code == exit_codes.DONE
    assert len(path.read_text().splitlines()) == 3


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("format_", ["table", "jsonl", "csv"])
def test_a_file_on_a_full_disk_is_one_line(
    mbtool: CommandLine, capture: Path, format_: str
) -> None:
    told = mbtool("decode", capture, "--format", format_, "-o", "/dev/full")
    assert told.code == exit_codes.UNREADABLE
    assert told.err == "mbtool: /dev/full: cannot be written: No space left on device\n"


_FULL = """
import resource, sys
from mbtool.cli.main import run
sys.dont_write_bytecode = True  # A module would be left cut off.
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]),) * 2)
sys.exit(run(sys.argv[2:]))
"""


def _on_a_disk_with_room_for(size: int, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", _FULL, str(size), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.skipif(sys.platform == "win32", reason="needs a limit of the system")
@pytest.mark.parametrize("name", ["a.csv", "a.jsonl", "a.txt"])
def test_a_full_disk_leaves_no_empty_file_behind(capture: Path, name: str) -> None:
    path = capture.with_name(name)
    ran = _on_a_disk_with_room_for(0, "decode", capture, "-o", path)
    assert ran.returncode == exit_codes.UNREADABLE
    assert ran.stderr == f"mbtool: {path}: cannot be written: File too large\n"
    assert not path.exists()


@pytest.mark.skipif(sys.platform == "win32", reason="needs a limit of the system")
def test_a_disk_that_runs_full_leaves_what_there_was_room_for(capture: Path) -> None:
    path = capture.with_name("a.csv")
    ran = _on_a_disk_with_room_for(100, "decode", capture, "-o", path)
    assert ran.returncode == exit_codes.UNREADABLE
    assert ran.stderr == (
        f"mbtool: {path}: cannot be written: File too large; it ends early, after 100 bytes\n"
    )
    assert path.stat().st_size == 100


@pytest.mark.skipif(sys.platform == "win32", reason="needs a limit of the system")
@pytest.mark.parametrize(
    "command",
    [("decode", "-o", "a.csv"), ("report", "-o", "a.html"), ("convert", "a.pcapng"),
     ("convert", "a.mcap")],
)  # fmt: skip
def test_a_file_that_was_there_stays_as_it_was_when_the_disk_is_full(
    capture: Path, command: tuple[str, ...]
) -> None:
    path = capture.with_name(command[-1])
    path.write_text("older")
    ran = _on_a_disk_with_room_for(100, command[0], capture, *command[1:-1], path, "--overwrite")
    assert ran.returncode == exit_codes.UNREADABLE
    assert ran.stderr == (
        f"mbtool: {path}: cannot be written: File too large; {path} stays as it was\n"
    )
    assert path.read_text() == "older"
    assert sorted(one.name for one in path.parent.iterdir()) == sorted([capture.name, path.name])


@pytest.mark.parametrize(
    "command",
    [("decode", "-o", "a.csv"), ("decode", "-o", "a.parquet"), ("check", "-o", "a.json"),
     ("convert", "a.pcapng"), ("convert", "a.mcap"), ("convert", "a.csv")],
)  # fmt: skip
def test_an_input_that_brings_nothing_leaves_a_file_that_was_there(
    mbtool: CommandLine, capture: Path, command: tuple[str, ...]
) -> None:
    capture.write_bytes(capture.read_bytes()[:30])
    path = capture.with_name(command[-1])
    path.write_text("older")
    told = mbtool(command[0], capture, *command[1:-1], path, "--overwrite")
    assert told.code == exit_codes.UNREADABLE
    assert f"{path} stays as it was\n" in told.err
    assert "->" not in told.err
    assert path.read_text() == "older"


@pytest.mark.parametrize(
    "command",
    [("decode", "a.csv"), ("decode", "a.parquet"), ("check", "a.json"), ("report", "a.html"),
     ("inventory", "a.json")],
)  # fmt: skip
def test_an_input_of_which_nothing_can_be_read_leaves_a_file_that_was_there(
    mbtool: CommandLine, capture: Path, command: tuple[str, str]
) -> None:
    capture.write_bytes(pcap([packet(b"unknown", 1_000_000_000, link_type=9999)]))
    path = capture.with_name(command[1])
    path.write_text("older")
    told = mbtool(command[0], capture, "-o", path, "--overwrite")
    assert told.code == exit_codes.UNREADABLE
    stays, why = told.err.splitlines()
    assert stays == f"{path} stays as it was"
    assert "nothing in it could be read" in why
    assert path.read_text() == "older"


@pytest.mark.parametrize("name", ["a.csv", "a.mcap"])
def test_an_input_that_is_cut_replaces_a_file_by_what_it_holds(
    mbtool: CommandLine, capture: Path, name: str
) -> None:
    capture.write_bytes(capture.read_bytes()[:-1])
    path = capture.with_name(name)
    path.write_text("older")
    path.chmod(0o640)
    told = mbtool("convert", capture, path, "--overwrite")
    assert told.code == exit_codes.UNREADABLE
    assert f"-> {path}\n" in told.err
    assert not path.read_bytes().startswith(b"older")
    assert path.stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize(
    "command", [("decode", "-o", "a.csv"), ("convert", "a.mcap"), ("recover", "-o", "a.mcap")]
)
def test_what_a_killed_run_left_beside_a_file_does_not_keep_the_next_one_from_replacing_it(
    mbtool: CommandLine, capture: Path, command: tuple[str, ...]
) -> None:
    path = capture.with_name(command[-1])
    path.write_text("older")
    left = path.with_name(f".{path.name}.{os.getpid()}.part")
    left.write_text("left")
    if command[0] == "recover":
        capture = capture.with_name("log.mcap")
        write_log(capture, [transaction()])
    told = mbtool(command[0], capture, *command[1:-1], path, "--overwrite")
    assert told.code == exit_codes.DONE
    assert not path.read_bytes().startswith(b"older")
    assert not left.exists()


def test_a_link_to_a_file_stays_a_link(mbtool: CommandLine, capture: Path) -> None:
    path, link = capture.with_name("a.csv"), capture.with_name("link.csv")
    path.write_text("older")
    link.symlink_to(path)
    assert mbtool("decode", capture, "-o", link, "--overwrite").code == exit_codes.DONE
    assert link.is_symlink()
    assert path.read_text().startswith("request_ns,")


@pytest.mark.parametrize("is_old", [True, False])
def test_ctrl_c_leaves_an_old_file_and_says_what_a_new_one_holds(
    monkeypatch: pytest.MonkeyPatch, mbtool: CommandLine, capture: Path, *, is_old: bool
) -> None:
    def interrupted(_: object, records: Iterator[object]) -> Iterator[object]:
        yield from records
        raise KeyboardInterrupt

    monkeypatch.setattr("mbtool.cli.decode.with_progress", interrupted)
    path = capture.with_name("a.csv")
    if is_old:
        path.write_text("older")
    told = mbtool("decode", capture, "-o", path, "--overwrite")
    assert told.code == exit_codes.INTERRUPTED
    if is_old:
        assert told.err == f"interrupted; {path} stays as it was\n"
        assert path.read_text() == "older"
    else:
        assert told.err == (
            f"interrupted; {path} holds only what was read so far: 3 transactions: 3 ok\n"
        )


def test_a_file_that_was_there_is_replaced_only_with_overwrite(
    mbtool: CommandLine, capture: Path
) -> None:
    path = capture.with_name("a.csv")
    path.write_text("older")
    told = mbtool("decode", capture, "-o", path)
    assert told.code == exit_codes.USAGE
    assert "a.csv: the file exists" in told.err
    assert path.read_text() == "older"
    assert mbtool("decode", capture, "-o", path, "--overwrite").code == exit_codes.DONE
    assert path.read_text().startswith("request_ns,")


def test_a_log_that_is_recorded_is_not_replaced(mbtool: CommandLine, capture: Path) -> None:
    path = capture.with_name("live.mcap")
    with LogWriter(path, capture={}):
        told = mbtool("decode", capture, "-o", path, "--format", "jsonl", "--overwrite")
        assert told.code == exit_codes.UNREADABLE
        assert "another recorder is writing to it" in told.err
    assert path.read_bytes().startswith(b"\x89MCAP")


@pytest.mark.parametrize(
    ("command", "name"), [("check", "a.json"), ("inventory", "a.csv"), ("report", "a.html")]
)
def test_what_sums_up_replaces_a_file_only_with_overwrite_too(
    mbtool: CommandLine, capture: Path, command: str, name: str
) -> None:
    path = capture.with_name(name)
    path.write_text("older")
    told = mbtool(command, capture, "-o", path)
    assert (told.code, told.out) == (exit_codes.USAGE, "")
    assert told.err.startswith(f"mbtool: {path}: the file exists; ")
    assert path.read_text() == "older"
    assert mbtool(command, capture, "-o", path, "--overwrite").code == exit_codes.DONE
    assert path.read_text() != "older"


def test_an_input_that_brings_nothing_leaves_no_empty_file_behind(
    mbtool: CommandLine, capture: Path
) -> None:
    path = capture.with_name("a.jsonl")
    capture.write_bytes(capture.read_bytes()[:30])
    assert mbtool("decode", capture, "-o", path).code == exit_codes.UNREADABLE
    assert not path.exists()


def test_a_result_without_a_row_is_a_file_all_the_same(mbtool: CommandLine, capture: Path) -> None:
    path = capture.with_name("a.jsonl")
    assert mbtool("decode", capture, "-o", path, "--where", "unit == 9").code == exit_codes.DONE
    assert path.read_bytes() == b""


@pytest.mark.parametrize("more", [[], ["--format", "csv"]])
def test_a_folder_is_no_output(mbtool: CommandLine, capture: Path, more: list[str]) -> None:
    told = mbtool("decode", capture, "-o", capture.parent, *more)
    assert (told.code, told.out) == (exit_codes.USAGE, "")
    assert told.err == (
        f"mbtool: {capture.parent}: a directory; name a file in it, or give --format parquet, "
        "which writes a file for each capture\n"
    )


@pytest.mark.skipif(not Path("/dev/null").exists(), reason="no /dev/null here")
def test_a_device_may_be_an_output_and_stays(mbtool: CommandLine, capture: Path) -> None:
    told = mbtool("decode", capture, "--format", "csv", "-o", "/dev/null")
    assert told.code == exit_codes.DONE
    assert Path("/dev/null").is_char_device()


def _print_and_fail(path: Path, error: BaseException) -> None:
    with open_output(str(path), None, EventChoice.ALL, lambda _: None, lambda _: True) as out:
        assert out.is_empty
        assert not out.on_terminal
        out.add(transaction())
        out.add(EVENT)
        raise error


@pytest.mark.parametrize("name", ["a.jsonl", "a.csv", "a.txt", "a.parquet"])
@pytest.mark.parametrize("error", [KeyboardInterrupt(), InputError("x")])
def test_an_end_before_the_first_record_leaves_no_new_file(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    name: str,
    error: BaseException,
) -> None:
    if name.endswith("parquet"):
        pytest.importorskip("pyarrow")
    monkeypatch.chdir(tmp_path)
    with (
        pytest.raises(type(error)),
        open_output(name, None, None, lambda _: None, lambda _: True),
    ):
        raise error
    is_told = isinstance(error, KeyboardInterrupt)
    assert capsys.readouterr().err == ("interrupted; nothing was written\n" if is_told else "")
    assert not Path(name).exists()


@pytest.mark.parametrize(
    ("is_old", "said"),
    [(True, "interrupted; a.jsonl is empty now\n"), (False, "interrupted; nothing was written\n")],
)
def test_ctrl_c_before_the_first_record_of_what_is_followed_says_what_became_of_an_old_file(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    *,
    is_old: bool,
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    path = Path("a.jsonl")
    if is_old:
        path.write_text("older")
    with (
        pytest.raises(Interrupted),
        open_output(
            str(path), None, None, lambda _: None, lambda _: True, overwrite=True, in_place=True
        ),
    ):
        raise KeyboardInterrupt
    assert capsys.readouterr().err == said
    assert path.exists() == is_old
    assert not is_old or path.read_text() == ""


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (InputError("cut"), "1 transaction: 1 ok; 1 event: 1 gap -> a.jsonl\n"),
        (
            KeyboardInterrupt(),
            "interrupted; a.jsonl holds only what was read so far: 1 transaction: 1 ok; "
            "1 event: 1 gap\n",
        ),
    ],
)
def test_what_was_printed_before_an_error_is_kept_and_counted(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    path = Path("a.jsonl")
    with pytest.raises(type(error)):
        _print_and_fail(path, error)
    first, second = map(json.loads, path.read_text().splitlines())
    assert (first["outcome"], second["kind"]) == ("ok", "gap")
    assert capsys.readouterr().err == said


def test_is_full_at_its_limit_and_events_do_not_count(tmp_path: Path) -> None:
    path = str(tmp_path / "a.jsonl")
    with open_output(path, None, EventChoice.ALL, lambda _: None, lambda _: True, 1) as out:
        out.add(EVENT)
        assert not out.is_full
        out.add(transaction())
        assert out.is_full


@pytest.mark.parametrize(
    "command",
    [
        ["decode", "CAPTURE", "-o", "OUT.jsonl"],
        ["check", "CAPTURE", "-o", "OUT.json"],
        ["report", "CAPTURE", "-o", "OUT.html"],
        ["convert", "CAPTURE", "OUT.pcapng"],
        ["recover", "LOG", "-o", "OUT.mcap"],
        ["demo", "-w", "OUT.mcap"],
        ["devices", "export", "wago-750", "-o", "OUT.toml"],
    ],
    ids=lambda one: one[0],
)
def test_the_missing_folder_of_an_output_is_named(
    mbtool: CommandLine, capture: Path, tmp_path: Path, command: list[str]
) -> None:
    write_log(tmp_path / "a.mcap", [transaction()])
    paths = {"CAPTURE": capture, "LOG": tmp_path / "a.mcap"}
    out = str(tmp_path / "none" / "x")
    told = mbtool(*(paths.get(one, one.replace("OUT", out)) for one in command))
    assert told.code != exit_codes.DONE
    assert told.err.endswith(f": there is no folder {tmp_path / 'none'}\n")


@pytest.mark.parametrize("name", ["-", ""])
@pytest.mark.parametrize(
    "command", [["recover", "a.mcap", "-o"], ["sniff", "net:none", "-w"], ["demo", "-w"]]
)
def test_a_log_is_not_written_to_standard_output(
    mbtool: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: list[str],
    name: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    write_log(tmp_path / "a.mcap", [transaction()])
    told = mbtool(*command, name)
    assert (told.code, told.out) == (exit_codes.USAGE, "")
    assert told.err == f"mbtool: {name!r}: a log needs a file; name one, for example site.mcap\n"
    assert not Path("-").exists()


def test_an_empty_name_of_an_output_is_told(mbtool: CommandLine, capture: Path) -> None:
    told = mbtool("decode", capture, "-o", "")
    assert told.err == (
        "mbtool: --output has an empty name; name a file, or - for standard output\n"
    )
