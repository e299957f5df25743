"""mbtool sniff in a process of its own, ended in every way."""

from __future__ import annotations

import json
import signal
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.devices import NamedTransaction
from mbtool.logs import LogReader
from mbtool.workflows.asking import TcpMaster
from tests.cli.program import Program, endpoint_in
from tests.workflows.bench import Bench
from tests.workflows.evidence import WRITE

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from mbtool.core import Endpoint


@pytest.fixture
def bench() -> Iterator[Bench]:
    with Bench() as one:
        yield one


def _tap_of(program: Program) -> Endpoint:
    """Where a sniffer says that its tap listens."""
    return endpoint_in(program.await_said("listening on"))


def _ask(tap: Endpoint, count: int) -> None:
    with TcpMaster(tap) as master:
        for _ in range(count):
            assert master.ask(1, WRITE) == WRITE


def _logged(path: Path) -> list[NamedTransaction]:
    with LogReader.open(path) as log:
        found = [item for item in log.items() if isinstance(item, NamedTransaction)]
        assert log.closed
        return found


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_leaves_a_complete_log(bench: Bench, tmp_path: Path, number: int) -> None:
    path = tmp_path / "a.mcap"
    with Program("sniff", bench.tap(), "-w", path) as program:
        _ask(_tap_of(program), 5)
        told = program.end(number)
    assert told.code == exit_codes.INTERRUPTED
    assert told.err == f"5 transactions: 5 ok\nlog: {path}\n"
    assert told.out.count("06 write register") == 5
    assert len(_logged(path)) == 5


def test_stops_after_so_many_and_logs_what_it_heard(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with Program("sniff", bench.tap(), "-w", path, "--count", 2, "--format", "jsonl") as program:
        _ask(_tap_of(program), 2)
        told = program.end()
    assert told.code == exit_codes.DONE
    assert len(told.lines) == 2
    assert all(json.loads(line)["outcome"] == "ok" for line in told.lines)
    assert len(_logged(path)) == 2


def test_a_filter_chooses_what_is_shown_and_not_what_is_logged(
    bench: Bench, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    tap = bench.tap()
    with Program("sniff", tap, "-w", path, "--where", "transaction_id == 2") as program:
        _ask(_tap_of(program), 3)
        told = program.end(signal.SIGINT)
    assert told.err.splitlines()[0] == "1 transaction: 1 ok"
    assert len(_logged(path)) == 3


def test_stops_after_so_long(bench: Bench) -> None:
    with Program("sniff", bench.tap(), "--duration", "0.01") as program:
        told = program.end()
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert told.err.splitlines()[-1] == "0 transactions"


def test_the_end_of_time_is_no_error(bench: Bench) -> None:
    with Program("sniff", bench.tap(), "--duration", "inf", "--count", 1) as program:
        _ask(_tap_of(program), 1)
        assert program.end().code == exit_codes.DONE


def test_a_row_is_shown_as_soon_as_it_is_known(bench: Bench) -> None:
    with Program("sniff", bench.tap()) as program:
        tap = _tap_of(program)
        assert program.process.stdout is not None
        for number in (1, 2):
            _ask(tap, 1)
            line = ""
            while f" {number}  " not in line[:4]:
                line = program.process.stdout.readline()
            assert "06 write register" in line
        assert program.end(signal.SIGINT).code == exit_codes.INTERRUPTED


def test_a_reader_that_goes_away_leaves_a_complete_log(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with Program("sniff", bench.tap(), "-w", path) as program:
        tap = _tap_of(program)
        assert program.process.stdout is not None
        program.process.stdout.close()
        program.process.stdout = None
        _ask(tap, 3)
        assert program.end().code == exit_codes.DONE
    assert 1 <= len(_logged(path)) <= 3


def test_a_log_is_replaced_where_that_is_asked(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("old")
    with Program("sniff", bench.tap(), "-w", path, "--overwrite", "--duration", 0) as program:
        assert program.end().code == exit_codes.DONE
    assert _logged(path) == []
