"""The scripts and the notebook in docs/examples/ run, and print what they promise."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path
from typing import Any, NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "docs" / "examples"
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
    "parquet_and_duckdb.py": Run(
        ("plant.parquet", str(ROOT / "captures/plant.pcap")), "63 transactions -> plant.parquet\n"
    ),
    "poll_a_recording.py": Run((LINE,), "[100, 200, 300, 400]\n"),
    "who_asks_whom.py": Run((PACKETS,), '[label="'),
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


def run(cells: list[dict[str, Any]], names: dict[str, Any]) -> None:
    for cell in cells:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            exec("".join(cell["source"]), names)


def test_the_notebook_of_values_runs_from_its_beginning_to_its_end(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("pandas", "polars"):
        pytest.importorskip(name, reason=f"{name} is not installed: pip install 'mbtool[data]'")
    monkeypatch.chdir(EXAMPLES)
    names: dict[str, Any] = {}
    run(json.loads((EXAMPLES / "values.ipynb").read_text())["cells"], names)
    assert "<td>03 read holding 100..103 -&gt; 1514" in names["capture"]._repr_html_()
    assert len(names["values"]) == 162
    assert names["means"].loc[(1, "input 0")].tolist() == [230.8, 231.0, 231.2, 230.8]
    assert names["slowest"]["unit"].to_list() == [2, 1, 1]
    assert "UNIT-SLOW: " in capsys.readouterr().out
    assert names["units"] == [("10.0.0.11", 1, 22), ("10.0.0.12", 1, 21), ("10.0.0.12", 2, 19)]


def test_the_notebook_runs_from_its_beginning_to_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(EXAMPLES)
    names: dict[str, Any] = {}
    run(json.loads((EXAMPLES / "tour.ipynb").read_text())["cells"], names)
    assert names["latest"]["HR400003"] == 7  # A master writes it meanwhile.
    assert names["table"].num_rows == len(names["transactions"]) > 5
    assert names["answer"] == bytes.fromhex("0001 0000 0007 01 03 04 0064 00c8")
    assert names["asked"][0].endswith("03 read HR400001..400002 -> 100, 200")
