"""The scripts in examples/ run, and print what they promise."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
LINE = str(ROOT / "captures/ft1a-touch-line.mcap")
PACKETS = str(ROOT / "captures/fa3-at1m8x-setup.pcap")


class Run(NamedTuple):
    arguments: tuple[str, ...]
    said: str
    """A part of what the script prints."""


RUNS = {
    "decode_own_bytes.py": Run((), "HR400001..400002 -> [100, 200]\nskipped: ff\n"),
    "listen_through_a_tap.py": Run(("tap.mcap",), "HR400001..400002 -> [100, 200]\n"),
    "points_to_csv.py": Run((PACKETS, "fa3-at1m8x"), "42H,Model code,22,FA3-AT1M8X,,False"),
    "poll_a_recording.py": Run((LINE,), "[100, 200, 300, 400]\n"),
    "slowest_requests.py": Run((LINE,), " ms  unit 1  HR400001..400004\n"),
}


def test_every_example_is_run() -> None:
    assert {path.name for path in EXAMPLES.glob("*.py")} == set(RUNS)


@pytest.mark.parametrize("name", RUNS)
def test_an_example_runs(
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run = RUNS[name]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [name, *run.arguments])
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    assert run.said in capsys.readouterr().out.replace("\r\n", "\n")
