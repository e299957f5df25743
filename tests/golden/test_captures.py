"""Every capture of captures/ decodes to the lines beside it."""

from __future__ import annotations

import json
import re
from contextlib import chdir
from pathlib import Path
from typing import Any

import pytest

from mbtool.cli import exit_codes
from mbtool.cli.main import run

FOLDER = Path(__file__).resolve().parents[2] / "captures"
CAPTURES = sorted(path for path in FOLDER.iterdir() if path.suffix in {".mcap", ".pcap", ".pcapng"})
SETUPS = sorted(path.name for path in CAPTURES if path.name.startswith("fa3-at1m8x-setup"))

BEFORE_THE_CUT = frozenset({"ok", "exception", "broadcast"})
"""How a transaction can have ended that a cut has not touched."""

LATER = frozenset({"confidence", "file", "write_quantity", "source_mac", "destination_mac", "vlan"})
"""The confidence is that of the decoder that made the log; the log is older than most others. Only
what is read as it was logged names the log as its file."""

each_capture = pytest.mark.parametrize("capture", CAPTURES, ids=lambda path: path.name)


@each_capture
def test_a_capture_decodes_to_its_expected_lines(
    capture: Path, tmp_path: Path, pytestconfig: pytest.Config
) -> None:
    lines = decode(capture, tmp_path)
    expected = FOLDER / f"{capture.name}.expected.jsonl"
    if pytestconfig.getoption("--update-golden"):
        expected.write_text("".join(f"{line}\n" for line in lines))
    assert lines == expected.read_text().splitlines()


@pytest.mark.parametrize(
    "log", [path for path in CAPTURES if path.suffix == ".mcap"], ids=lambda path: path.name
)
def test_the_evidence_of_a_log_decodes_to_what_was_logged(log: Path, tmp_path: Path) -> None:
    anew, logged = (decode(log, tmp_path, *options) for options in (["--raw"], []))
    assert [without(LATER, line) for line in anew] == [without(LATER, line) for line in logged]


@each_capture
def test_a_capture_that_was_cut_off_gives_what_stands_before_the_cut(
    capture: Path, tmp_path: Path
) -> None:
    whole = answered(decode(capture, tmp_path))
    data = capture.read_bytes()
    counts = []
    # A short log may have all its evidence in one message, which the last cut leaves whole.
    for size in (*(len(data) * tenth // 10 for tenth in range(1, 10)), len(data) - 1):
        cut = tmp_path / f"cut{capture.suffix}"
        cut.write_bytes(data[:size])
        lines = answered(decode(cut, tmp_path, code=None))
        lines = [line.replace(f'"{cut.name}"', f'"{capture.name}"') for line in lines]
        assert lines == whole[: len(lines)]
        counts.append(len(lines))
    assert counts == sorted(counts)
    assert counts[-1] > 0


def test_four_captures_of_one_run_say_the_same(tmp_path: Path) -> None:
    runs = [pdus(decode(FOLDER / name, tmp_path)) for name in SETUPS]
    assert len(runs) == 4
    assert len(runs[0]) == 9
    assert all(run == runs[0] for run in runs)


def test_every_capture_is_explained_and_nothing_else_is() -> None:
    text = (FOLDER / "README.md").read_text()
    named = set(re.findall(r"`([a-z0-9-]+\.(?:mcap|pcapng|pcap))`", text))
    assert named == {path.name for path in CAPTURES}
    beside = {path.name for path in FOLDER.glob("*.expected.jsonl")}
    assert beside == {f"{path.name}.expected.jsonl" for path in CAPTURES}


def decode(
    capture: Path, folder: Path, *options: str, code: int | None = exit_codes.DONE
) -> list[str]:
    """The lines of `mbtool decode --format jsonl --events trouble`."""
    out = folder / "decoded.jsonl"
    out.unlink(missing_ok=True)
    arguments = ["decode", capture.name, "--format", "jsonl", "--events", "trouble", *options]
    with chdir(capture.parent):  # The lines name the file as the command does.
        answer = run([*arguments, "-o", str(out)])
    assert answer in (exit_codes.DONE, exit_codes.UNREADABLE) if code is None else answer == code
    return out.read_text().splitlines() if out.exists() else []


def without(names: frozenset[str], line: str) -> dict[str, Any]:
    return {key: value for key, value in json.loads(line).items() if key not in names}


def answered(lines: list[str]) -> list[str]:
    return [line for line in lines if json.loads(line).get("outcome") in BEFORE_THE_CUT]


def pdus(lines: list[str]) -> list[tuple[Any, ...]]:
    transactions = [json.loads(line) for line in lines]
    return [
        (one["unit"], one["request_raw"][12:], one["response_raw"][12:]) for one in transactions
    ]
