from __future__ import annotations

import json
from functools import partialmethod
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.values.values import Values
from tests.cli.test_stats import LINE

if TYPE_CHECKING:
    from pathlib import Path

    from tests.cli.program import CommandLine


def test_without_a_reference_what_there_is_is_listed(mbtool: CommandLine) -> None:
    told = mbtool("plot", LINE)
    assert told.code == exit_codes.DONE
    assert told.lines[0].split()[:4] == ["value", "unit", "changes", "least"]
    assert told.err.endswith("never changed; --json has them\n")


def test_a_value_is_drawn_and_given_as_json(mbtool: CommandLine) -> None:
    told = mbtool("plot", LINE, "HR400001")
    assert told.lines[0] == "HR400001, unit 1: 100 to 4660, 1 change"
    assert len(told.lines) == 10
    (value,) = json.loads(mbtool("plot", LINE, "HR400001", "--json").out)["values"]
    assert [sample[1] for sample in value["samples"]] == [100, 4660]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nonsense"], "'nonsense': no value of that name or address"),
        (["holding", "0"], "put its address into the same quotes: 'holding 0'"),
        (["holding 5..1"], "a range runs from the lower to the higher"),
        (["holding -1"], "'holding -1' is no range of registers"),
        (["holding 999"], "'holding 999': no value of that name or address"),
        (["HR400001", LINE], "name all files first, then what to plot"),
        (["--overwrite"], "--overwrite replaces a file, and none is named"),
        (["-o", "x.png"], "name what to plot behind the files"),
        (["HR400001", "-o", "x.bmp"], "x.bmp: a picture ends in .png, .svg, .pdf"),
        (["HR400001", "-o", "x.png", "--json"], "--output writes a picture"),
    ],
)
def test_what_cannot_be_plotted_is_one_line(
    mbtool: CommandLine, arguments: list[str], said: str
) -> None:
    told = mbtool("plot", LINE, *arguments)
    assert told.code == exit_codes.USAGE
    assert said in told.err
    assert told.err.count("\n") == 1


def test_a_missing_file_is_said(mbtool: CommandLine, tmp_path: Path) -> None:
    for arguments in (["absent.mcap", "HR400001"], [LINE, "HR400001", "absent.mcap"]):
        told = mbtool("plot", *arguments)
        assert told.code == exit_codes.UNREADABLE
        assert told.err == "mbtool: absent.mcap: there is no such file\n"


@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_a_picture_is_written(mbtool: CommandLine, tmp_path: Path, suffix: str) -> None:
    pytest.importorskip("matplotlib")
    out = tmp_path / f"a.{suffix}"
    told = mbtool("plot", LINE, "HR400001", "C1", "-o", out)
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert told.err == f"1 value -> {out}\n" or told.err == f"2 values -> {out}\n"
    begin = out.read_bytes()[:100]
    assert begin.startswith(b"\x89PNG" if suffix == "png" else b"<?xml")
    assert "exists" in mbtool("plot", LINE, "HR400001", "-o", out).err


def test_a_capture_without_values_says_so(mbtool: CommandLine) -> None:
    told = mbtool("plot", LINE, "--where", "unit == 9")
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert told.err == "no value was read or written\n"


def test_a_list_without_any_change_is_one_line(mbtool: CommandLine) -> None:
    told = mbtool("plot", LINE, "--end", "0.1")
    assert told.out == ""
    assert told.err.startswith("nothing to plot: ")
    assert told.err.endswith(" never changed; --json has them\n")


def test_what_is_left_out_is_counted_also_in_json(
    mbtool: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Values, "__init__", partialmethod(Values.__init__, most=3))
    told = mbtool("plot", LINE)
    assert json.loads(mbtool("plot", LINE, "--json").out)["left_out"] == 22
    assert told.err.endswith("22 more values are left out; name those that you want\n")
