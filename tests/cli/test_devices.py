"""mbtool devices."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.devices import builtin_profiles

if TYPE_CHECKING:
    from tests.cli.program import CommandLine

CAPTURES = Path(__file__).parents[2] / "captures"


def test_lists_the_built_in_profiles(mbtool: CommandLine) -> None:
    told = mbtool("devices")
    assert (told.code, told.err) == (exit_codes.DONE, "")
    # A long title goes on below; its line begins with a space.
    names = [line.split()[0] for line in told.lines if not line.startswith(" ")]
    assert names == ["name", *builtin_profiles()]
    assert max(map(len, told.lines)) <= 100


def test_help_lists_the_commands_in_whole_sentences(mbtool: CommandLine) -> None:
    shown = mbtool("devices", "--help").out.partition("\nExamples:")[0]
    listed = shown.partition("Commands:\n")[2].splitlines()
    assert [line.split()[0] for line in listed] == ["new", "import", "draft", "export", "schema"]
    assert all(line.endswith(".") and not line.endswith("...") for line in listed)


def test_shows_one_in_full(mbtool: CommandLine) -> None:
    told = mbtool("devices", "idec-ft1a-touch")
    assert told.lines[0] == "FT1A Touch operator interface, Modbus RTU slave"
    assert "holding register  HR400001..404096  0000..0FFF  holding registers  read, write" in (
        told.out
    )


def test_a_file_that_is_called_as_a_command_is_shown_by_its_path(
    mbtool: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    mbtool("devices", "new", "./new.toml")
    assert mbtool("devices", "./new.toml").lines[1] == "new, by Maker; rtu"
    assert mbtool("devices", "new.toml").lines[1] == "new, by Maker; rtu"


def test_a_name_that_is_neither_a_profile_nor_a_command_is_told_what_there_is(
    mbtool: CommandLine,
) -> None:
    told = mbtool("devices", "show")
    assert told.code == exit_codes.USAGE
    assert told.err.startswith("mbtool: profile 'show': there is none of that name")
    assert mbtool("devices", "a", "b").err == (
        "mbtool: one profile is shown at a time, not 2: a, b\n"
    )


def test_the_help_shows_all_ways_to_call_it(mbtool: CommandLine) -> None:
    told = mbtool("devices", "--help")
    assert told.code == exit_codes.DONE
    assert told.lines[:3] == [
        "Usage: mbtool devices [NAME]",
        "Usage: mbtool devices --match FILE [NAME]...",
        "Usage: mbtool devices COMMAND [ARGS]...",
    ]
    commands = told.out.partition("\nExamples:")[0].partition("Commands:")[2].split("\n  ")[1:]
    assert [line.split()[0] for line in commands] == ["new", "import", "draft", "export", "schema"]


def test_match_says_which_profile_explains_a_slave_and_why(mbtool: CommandLine) -> None:
    told = mbtool("devices", "--match", CAPTURES / "fa3-at1m8x-setup.pcap")
    assert told.code == exit_codes.DONE
    assert told.lines[0] == "unit 0 at 127.0.0.1:502: explained best by fa3-at1m8x"
    assert "+ 42H was answered 0016H, its model code" in told.lines[2]
    assert max(map(len, told.lines)) <= 100


def test_match_takes_a_profile_of_the_users_own(mbtool: CommandLine, tmp_path: Path) -> None:
    own = tmp_path / "mine.toml"
    capture = CAPTURES / "broadcast-write.mcap"
    assert mbtool("devices", "draft", capture, "--unit", 1, "-o", own).code == exit_codes.DONE
    told = mbtool("devices", "--match", capture, own)
    assert told.lines[0].startswith("unit 1 at rs485: a tie of mine, chino-lt830, ")


def test_match_can_be_read_by_programs(mbtool: CommandLine) -> None:
    told = mbtool("devices", "--match", CAPTURES / "ft1a-touch-line.mcap", "--format", "jsonl")
    (record,) = map(json.loads, told.lines)
    assert record["best"] == ["idec-ft1a-touch"]
    assert len(record["profiles"]) == len(builtin_profiles())


def test_match_of_a_capture_without_modbus_says_so(mbtool: CommandLine, tmp_path: Path) -> None:
    empty = tmp_path / "empty.csv"
    empty.write_bytes(b"\xd4\xc3\xb2\xa1\x02\0\x04\0" + bytes(8) + b"\xff\xff\0\0\x01\0\0\0")
    told = mbtool("devices", "--match", empty)
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert "no transaction in it" in told.err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--format", "jsonl", "schema"], "goes with the list of profiles"),
        (["wago-750", "--nonsense"], "see mbtool devices --help"),
        (["--port", "any", "wago-750"], "go with --match FILE"),
        (["--match", "x.pcap", "schema"], "--match does not go with schema"),
        (["--nonsense"], "see mbtool devices --help"),
    ],
)
def test_what_does_not_go_together_is_told(
    mbtool: CommandLine, arguments: list[str], said: str
) -> None:
    told = mbtool("devices", *arguments)
    assert told.code == exit_codes.USAGE
    assert said in told.err
    assert told.out == ""


def test_a_capture_that_is_not_there_is_told(mbtool: CommandLine) -> None:
    told = mbtool("devices", "--match", "nosuch.pcap")
    assert told.code == exit_codes.UNREADABLE
    assert "nosuch.pcap" in told.err


def test_the_list_as_json_has_what_the_table_shows(mbtool: CommandLine) -> None:
    profiles = {one["name"]: one for one in map(json.loads, mbtool("devices", "--json").lines)}
    assert profiles["fa3-at1m8x"]["transports"] == ["tcp"]
    assert (profiles["fa3-at1m8x"]["areas"], profiles["fa3-at1m8x"]["points"]) == (5, 53)


def test_a_profile_is_printed_as_json_wherever_the_option_stands(mbtool: CommandLine) -> None:
    exported = json.loads(mbtool("devices", "export", "wago-750", "--json").out)
    for arguments in (["wago-750", "--json"], ["--json", "wago-750"],
                      ["wago-750", "--format", "jsonl"]):  # fmt: skip
        assert json.loads(mbtool("devices", *arguments).out) == exported
