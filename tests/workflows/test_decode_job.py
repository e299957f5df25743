"""decode of many captures into a Parquet file for each."""

from __future__ import annotations

import os
import signal
from typing import TYPE_CHECKING

import msgspec
import pyarrow.dataset as ds

from mbtool.workflows.decode_job import DecodeJob, JobOptions, local_processes
from mbtool.workflows.decode_run import DecodeTask, FileOutcome, decode_run
from tests.workflows.rotated import make_sites, rows_alone

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path


class Inside:
    """An executor that decodes in this process."""

    processes = 2

    def __init__(self) -> None:
        self.tasks: list[DecodeTask] = []

    def run(self, tasks: Sequence[bytes]) -> Iterator[tuple[bytes, bytes | str]]:
        self.tasks += [msgspec.json.decode(one, type=DecodeTask) for one in tasks]
        return ((one, decode_run(one)) for one in tasks)


def decoded(
    inputs: object, output: Path, executor: Inside | None = None, **options: object
) -> list[FileOutcome]:
    job = DecodeJob([str(inputs)], str(output), JobOptions(**options))  # type: ignore[arg-type]
    return list(job.run(executor or Inside()))


def rows_in(folder: Path) -> list[str]:
    table = ds.dataset(folder, format="parquet").to_table()
    return sorted(map(repr, table.to_pylist()))


def parquets(folder: Path) -> list[str]:
    return sorted(one.name for one in folder.glob("**/*.parquet"))


def test_many_files_give_the_rows_of_one_reading_and_a_second_run_does_nothing(
    tmp_path: Path,
) -> None:
    paths = make_sites(tmp_path / "in", 2)
    pattern = tmp_path / "in" / "site-*" / "2026-*" / "*.pcap"
    executor = Inside()
    outcomes = decoded(pattern, tmp_path / "out", executor)
    assert [one.error for one in outcomes] == [""] * 20
    assert any(task.run.around[0].before for task in executor.tasks)
    assert rows_in(tmp_path / "out") == rows_alone(paths)
    assert len([*(tmp_path / "out" / "site-1" / "2026-11-22").glob("*.parquet")]) >= 10
    assert decoded(pattern, tmp_path / "out") == []


def test_the_shares_of_a_job_make_it_together(tmp_path: Path) -> None:
    paths = make_sites(tmp_path / "in", 2, 300)
    pattern = tmp_path / "in" / "*" / "*" / "*"
    counts = [len(decoded(pattern, tmp_path / "out", share=(share, 2))) for share in range(2)]
    assert sum(counts) == len(paths)
    assert rows_in(tmp_path / "out") == rows_alone(paths)


def test_a_file_that_comes_later_ends_the_requests_that_were_open(tmp_path: Path) -> None:
    paths = make_sites(tmp_path / "in", 1)
    folder, later = paths[0].parent, tmp_path / "later"
    later.mkdir()
    for path in paths[7:]:
        path.rename(later / path.name)
    for number in range(7, 11):
        decoded(folder / "*", tmp_path / "out")
        here = sorted(folder.iterdir())
        assert rows_in(tmp_path / "out") == rows_alone(here)
        if number < 10:
            (later / f"cap-{number}.pcap").rename(folder / f"cap-{number}.pcap")


def test_a_changed_file_replaces_its_rows_and_those_that_may_depend_on_them(tmp_path: Path) -> None:
    paths = make_sites(tmp_path / "in", 1)
    decoded(paths[0].parent / "*", tmp_path / "out")
    paths[9].write_bytes(paths[9].read_bytes()[:24])
    executor = Inside()
    decoded(paths[0].parent / "*", tmp_path / "out", executor)
    assert {one.path for task in executor.tasks for one in task.run.files} >= {
        str(paths[8]),
        str(paths[9]),
    }
    assert rows_in(tmp_path / "out") == rows_alone(paths)
    assert len(parquets(tmp_path / "out")) == len(paths)


def test_a_killed_process_loses_nothing(tmp_path: Path) -> None:
    paths = make_sites(tmp_path / "in", 2, 300)
    executor = local_processes(2)
    job = DecodeJob([str(tmp_path / "in/*/*/*")], str(tmp_path / "out"), JobOptions())
    outcomes = job.run(executor)
    first = next(outcomes)
    os.kill(next(iter(executor.pids)), signal.SIGKILL)
    assert all(not one.error for one in [first, *outcomes])
    assert rows_in(tmp_path / "out") == rows_alone(paths)
