"""Every command in environments that are broken: one line, a code, never a traceback."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from mbtool.cli import exit_codes
from mbtool.cli.main import CommandTable
from tests.cli.forked import ENVIRONMENTS

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="forks processes")

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
LOG, CAPTURE = CAPTURES / "fa3-at1m8x-setup.mcap", CAPTURES / "fa3-at1m8x-setup.pcapng"
TAP = "tap:127.0.0.1:0=127.0.0.1:1"
COMMANDS: dict[str, list[str | Path]] = {
    "": ["--help"],
    "version": ["--version"],
    "sniff": ["sniff", TAP, "--duration", "0"],
    "sniff -w": ["sniff", TAP, "--duration", "0", "-w", "sniff.mcap"],
    "sniff of a port": ["sniff", "rtu:/dev/tty-no@19200-8E1", "--duration", "0"],
    "status": ["status", LOG],
    "decode": ["decode", LOG],
    "decode of packets": ["decode", CAPTURE, "--format", "csv"],
    "decode of standard input": ["decode", "-"],
    "inventory": ["inventory", CAPTURE],
    "check": ["check", LOG],
    "stats": ["stats", CAPTURE],
    "convert": ["convert", CAPTURE, "convert.mcap"],
    "recover": ["recover", LOG, "-o", "recover.mcap"],
    "replay --as-slave": ["replay", LOG, "--as-slave", "--on", "tcp:127.0.0.1:0"],
    "replay --as-master": ["replay", LOG, "--as-master", "--to", "tcp:127.0.0.1:1"],
    "diff": ["diff", LOG, LOG],
    "slave": ["slave", "fa3-at1m8x", "--on", "tcp:127.0.0.1:0"],
    "slave --state": ["slave", "fa3-at1m8x", "--on", "tcp:127.0.0.1:0", "--state", "state.toml"],
    "watch": ["watch", CAPTURE],
    "report": ["report", CAPTURE, "-o", "report.html"],
    "plot": ["plot", CAPTURE],
    "find": ["find", CAPTURE, "7"],
    "extcap": ["extcap", "--help"],
    "read": ["read", "tcp:127.0.0.1:1", "holding 0..9"],
    "write": ["write", "tcp:127.0.0.1:1", "holding 0=1", "--yes"],
    "poll": ["poll", "tcp:127.0.0.1:1", "holding 0..9", "--count", "1"],
    "scan": ["scan", "tcp:127.0.0.1:1"],
    "test": ["test", "fa3-at1m8x", "tcp:127.0.0.1:1"],
    "devices": ["devices"],
    "devices NAME": ["devices", "fa3-at1m8x"],
    "devices --match": ["devices", "--match", CAPTURE],
    "devices new": ["devices", "new", "pump.toml"],
    "devices draft": ["devices", "draft", LOG],
    "devices schema": ["devices", "schema"],
    "links": ["links"],
    "line": ["line", "left", "right"],
    "demo": ["demo"],
    "doctor": ["doctor"],
}
STARTS_PROCESSES = {"line", "demo"}
"""The commands that start processes where they can, which takes long."""
RUNS = {"replay --as-slave", "replay --as-master", "slave", "slave --state", *STARTS_PROCESSES}
"""The commands that run until they are stopped, once they have said that they run."""
EACH = 3
"""In each environment, every third command is tried: another third in the next environment."""
PRINTING = {"", "version", "decode", "check", "stats", "devices", "doctor", "links", "line"}
"""The commands that cannot do without standard output."""
FAILS = {
    "full output": "standard output: cannot be written: No space left on device",
    "deleted folder": "the current folder has been deleted",
    "8 files": "too many files are open",
    "no file may grow": "cannot be written: File too large",
    "no process": "cannot be started: Resource temporarily unavailable",
}
"""What at least one command says in an environment."""


def test_there_is_a_case_of_each_command() -> None:
    tried = {str(line[0]) for line in COMMANDS.values()}
    assert set(CommandTable()) <= tried


def test_a_command_ends_with_a_code_and_at_most_one_line_of_error(tmp_path: Path) -> None:
    commands = {
        environment: {
            name: [str(each) for each in line]
            for number, (name, line) in enumerate(COMMANDS.items())
            if name not in _left_out(environment)
            and (
                (number + turn) % EACH == 0
                or (name in PRINTING and environment == "full output")
                or (name in STARTS_PROCESSES and environment == "no process")
            )
        }
        for turn, environment in enumerate(ENVIRONMENTS)
    }
    told = _run(tmp_path, commands)
    assert {one: ends.keys() for one, ends in told.items()} == {
        one: lines.keys() for one, lines in commands.items()
    }
    ends = [(one, name, *end) for one, some in told.items() for name, end in some.items()]
    assert not [end for end in ends if not _is_orderly(*end[2:])]
    for environment, sentence in FAILS.items():
        assert any(sentence in err for _, err in told[environment].values()), environment
    full = told["full output"]
    assert {name: full[name][0] for name in PRINTING} == dict.fromkeys(PRINTING, 3)


def _left_out(environment: str) -> set[str]:
    if environment == "closed errors":
        return RUNS
    return set() if environment in FAILS else STARTS_PROCESSES


def _is_orderly(code: int, err: str) -> bool:
    if code in (exit_codes.USAGE, exit_codes.UNREADABLE):
        errors = [line for line in err.splitlines() if line.startswith("mbtool: ")]
        return "Traceback" not in err and (len(errors) == 1 or not err)
    return code in (0, 1, exit_codes.INTERRUPTED) and "Traceback" not in err


def _run(
    folder: Path, commands: dict[str, dict[str, list[str]]]
) -> dict[str, dict[str, tuple[int, str]]]:
    done = subprocess.run(
        [sys.executable, "-m", "tests.cli.forked", folder, json.dumps(commands)],
        stdout=subprocess.PIPE,
        cwd=Path(__file__).resolve().parents[2],
        check=True,
    )
    result: dict[str, dict[str, tuple[int, str]]] = json.loads(done.stdout)
    return result
