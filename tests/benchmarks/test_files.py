from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import pytest

from mbtool.cli.main import run as run_mbtool
from mbtool.modbus import Outcome
from tests.benchmarks.files import (
    Cost,
    FileMeasurement,
    report,
    run,
    workloads,
)
from tests.columns.both_ways import as_arrays, differences

if TYPE_CHECKING:
    from pathlib import Path

NAMES = ("clean", "dirty", "per-poll", "serial", "log")


@pytest.mark.parametrize("name", NAMES)
def test_mbtool_reads_every_transaction_of_a_workload(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ((_, made),) = workloads(2000, tmp_path, [name])
    assert run_mbtool(["decode", str(made.path), *made.options, "--format", "jsonl"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert made.transactions > 200
    assert len(lines) == made.transactions
    assert all(f'"outcome":"{Outcome.OK}"' in line for line in lines)


@pytest.mark.parametrize(("name", "share"), [("clean", 0.95), ("dirty", 0.8), ("per-poll", 1)])
def test_arrays_give_equal_results_for_a_workload(name: str, share: float, tmp_path: Path) -> None:
    ((_, made),) = workloads(2000, tmp_path, [name])
    capture = made.path.read_bytes()
    assert differences(capture) == []
    assert as_arrays(capture).plain >= share * made.transactions


def test_a_process_is_measured_with_its_memory() -> None:
    cost = run([sys.executable, "-c", "x = bytearray(50 << 20)"])
    assert cost.seconds > 0
    assert cost.peak_mib > 50


def test_the_report_compares_with_tshark() -> None:
    measured = [
        FileMeasurement("clean", "mbtool parquet", 1000, Cost(0.5, 100), 0.25),
        FileMeasurement("clean", "tshark fields", 1000, Cost(5.0, 800), 1.0),
        FileMeasurement("serial", "mbtool jsonl", 1000, Cost(1.0, 40)),
    ]
    lines = report(measured).splitlines()
    assert lines[1].split()[-3:] == ["10.0", "0.25", "16.0"]
    assert lines[2].split()[-3:] == ["1.0", "1.00", "1.0"]
    assert lines[3].split()[-2:] == ["40", "0.00"]
