"""Where records go, and what is said of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.cli.options import EventChoice
from mbtool.cli.output import open_output
from mbtool.core import InputError
from tests.logs.samples import EVENT, transaction

if TYPE_CHECKING:
    from tests.cli.program import CommandLine


@pytest.mark.parametrize(
    ("name", "begins"), [("a.jsonl", '{"link"'), ("a.CSV", "request_ns,"), ("a.txt", " #  time")]
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


def _print_and_fail(path: Path, error: BaseException) -> None:
    with open_output(str(path), None, EventChoice.ALL, lambda _: None, lambda _: True) as out:
        assert out.is_empty
        assert not out.on_terminal
        out.add(transaction())
        out.add(EVENT)
        raise error


@pytest.mark.parametrize("error", [InputError("cut"), KeyboardInterrupt()])
def test_what_was_printed_before_an_error_is_kept_and_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], error: BaseException
) -> None:
    path = tmp_path / "a.jsonl"
    with pytest.raises(type(error)):
        _print_and_fail(path, error)
    first, second = map(json.loads, path.read_text().splitlines())
    assert (first["outcome"], second["kind"]) == ("ok", "gap")
    assert capsys.readouterr().err == "1 transaction: 1 ok; 1 event: 1 gap\n"


def test_is_full_at_its_limit_and_events_do_not_count(tmp_path: Path) -> None:
    path = str(tmp_path / "a.jsonl")
    with open_output(path, None, EventChoice.ALL, lambda _: None, lambda _: True, 1) as out:
        out.add(EVENT)
        assert not out.is_full
        out.add(transaction())
        assert out.is_full
