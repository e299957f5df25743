from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.cli.command import with_plain_json
from mbtool.cli.devices import devices
from mbtool.cli.main import CommandTable
from tests.cli.test_stats import LINE

if TYPE_CHECKING:
    from tests.cli.program import CommandLine

EVERY = [
    *((name,) for name in CommandTable() if name != "devices"),
    *(("devices", command.name) for command in devices.registered_commands if not command.hidden),
]


@pytest.mark.parametrize("command", EVERY, ids=" ".join)
def test_help_writes_arguments_as_its_usage_line_does(
    mbtool: CommandLine, command: tuple[str, ...]
) -> None:
    help_ = mbtool(*command, "--help").out
    usage, *_ = help_.splitlines()
    _, _, part = help_.partition("\nArguments:\n")
    listed = re.findall(r"^  (\S+(?: \S+)*)", part.partition("\nOptions:\n")[0], re.MULTILINE)
    assert usage == f"Usage: {' '.join(('mbtool', *command, '[OPTIONS]', *listed))}"
    assert not re.search(r"<(?:str|list|path|int|float)", help_, re.IGNORECASE)


@pytest.mark.parametrize(
    ("command", "argument"),
    [
        ("decode", "FILE..."),
        ("check", "FILE..."),
        ("sniff", "LINK..."),
        ("line", "[PATH]..."),
        ("replay", "FILE..."),
    ],
)
def test_what_takes_several_says_so(mbtool: CommandLine, command: str, argument: str) -> None:
    help_ = mbtool(command, "--help").out
    assert f"\nArguments:\n  {argument}  " in help_


def test_the_list_of_commands_has_the_help_of_each() -> None:
    table = CommandTable()
    listed = table.listed()
    assert list(listed) == list(table)
    for name, command in listed.items():
        assert command.get_short_help_str(200) == table[name].get_short_help_str(200) != ""


def test_help_without_arguments_has_no_part_for_them(mbtool: CommandLine) -> None:
    help_ = mbtool("links", "--help").out
    assert help_.startswith("Usage: mbtool links [OPTIONS]\n")
    assert ("Arguments:" in help_, "Options:" in help_) == (False, True)


@pytest.mark.parametrize("short", [["--json"], ["--format", "json"], ["--format=json"]])
@pytest.mark.parametrize(
    ("command", "usual"),
    [
        (["check", LINE], ["--format", "json"]),
        (["inventory", LINE], ["--format", "json"]),
        (["diff", LINE, LINE], ["--format", "json"]),
        (["decode", LINE], ["--format", "jsonl"]),
        (["devices"], ["--format", "jsonl"]),
        (["stats", LINE], ["--json"]),
        (["plot", LINE], ["--json"]),
    ],
)
def test_json_has_the_same_short_form_everywhere(
    mbtool: CommandLine, command: list[object], usual: list[str], short: list[str]
) -> None:
    told = mbtool(*command, *short)
    assert told.out == mbtool(*command, *usual).out
    assert told.out[0] == "{"


@pytest.mark.parametrize(
    ("command", "format_"),
    [
        (["decode", LINE], "csv"),
        (["inventory", LINE], "table"),
        (["check", LINE], "sarif"),
        (["diff", LINE, LINE], "table"),
        (["stats", LINE], "table"),
    ],
)
def test_json_and_another_format_exclude_each_other(
    mbtool: CommandLine, command: list[object], format_: str
) -> None:
    for arguments in (["--json", "--format", format_], [f"--format={format_}", "--json"]):
        told = mbtool(*command, *arguments)
        assert (told.code, told.out) == (exit_codes.USAGE, "")
        assert told.err == f"mbtool: --json and --format {format_} exclude each other\n"
    assert mbtool(*command, "--json", "--format", "json").out[0] == "{"


def test_the_help_names_the_short_form(mbtool: CommandLine) -> None:
    assert "  --json  " in mbtool("check", "--help").out
    assert "Short for --format jsonl." in mbtool("decode", "--help").out
    assert "--json" not in mbtool("sniff", "--help").out.partition("--format")[0]


def test_a_format_that_is_the_only_one_goes_without_saying() -> None:
    class Flag:
        opts = ("--json",)

    assert with_plain_json([Flag()], ["--format", "table", "x"]) == ["x"]
    assert with_plain_json([Flag()], ["--", "--json"]) == ["--", "--json"]
    assert with_plain_json([Flag()], ["--format", "csv"]) == ["--format", "csv"]
    assert with_plain_json([Flag()], ["--format"]) == ["--format"]
    assert with_plain_json([], ["--json"]) == ["--json"]
