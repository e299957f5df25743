"""decode --jobs: other processes print what one decodes, with the same result."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow.parquet as pq
import pytest

from mbtool.cli import column_output
from mbtool.core import LinkError
from mbtool.sources.child import start_child
from mbtool.workflows.shared import block_processes, reading_choice
from tests.columns.disturbed_captures import disturbed
from tests.columns.sunspec_capture import sunspec_capture

if TYPE_CHECKING:
    import subprocess

    from tests.cli.program import CommandLine, Said

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs files of POSIX")

OWN = Path(__file__).resolve().parents[2] / "captures"
CAPTURES = sorted(path for kind in ("pcap", "pcapng") for path in OWN.glob(f"*.{kind}"))


@pytest.fixture
def worth_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Prints small files by other processes, too."""
    monkeypatch.setattr(column_output, "WORTH_PROCESSES", 0)
    monkeypatch.setattr(reading_choice, "WORTH_BYTES", 0)


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[subprocess.Popen[bytes]]:
    """The processes that were started to print."""
    processes: list[subprocess.Popen[bytes]] = []

    def noted(*arguments: str, files: list[int]) -> subprocess.Popen[bytes]:
        processes.append(start_child(*arguments, files=files))
        return processes[-1]

    monkeypatch.setattr(block_processes, "start_child", noted)
    return processes


def three_captures(folder: Path) -> list[Path]:
    """Captures with all that arrays can and cannot hold; the last one is cut."""
    paths = []
    for seed in range(3):
        data = disturbed(seed)
        paths.append(folder / f"{seed}.pcap")
        paths[-1].write_bytes(data[:-7] if seed == 2 else data)
    return paths


@pytest.mark.parametrize("format_", ["jsonl", "csv", "parquet"])
@pytest.mark.usefixtures("worth_processes")
def test_several_processes_print_what_one_prints(
    format_: str, mbtool: CommandLine, tmp_path: Path, started: list[subprocess.Popen[bytes]]
) -> None:
    meter = tmp_path / "meter.pcap"
    meter.write_bytes(sunspec_capture(20))
    files = [meter, *CAPTURES, *three_captures(tmp_path)]

    def printed(jobs: int) -> tuple[Said, object]:
        out = tmp_path / f"out.{format_}"
        said = mbtool("decode", *files, "-o", out, "--overwrite", "--jobs", jobs)
        return said, pq.read_table(out) if format_ == "parquet" else out.read_bytes()

    alone, whole = printed(1)
    assert started == []
    assert printed(3) == (alone, whole)
    assert "SunSpec models 1, 64900" in alone.err
    assert alone.code == 3
    assert len(started) == (1 if format_ == "parquet" else 2)
    assert all(one.returncode is not None for one in started)


def test_a_small_capture_starts_no_process(
    mbtool: CommandLine, tmp_path: Path, started: list[subprocess.Popen[bytes]]
) -> None:
    said = mbtool("decode", CAPTURES[0], "-o", tmp_path / "a.parquet", "--jobs", "8")
    assert (said.code, started) == (0, [])


@pytest.mark.parametrize("format_", ["jsonl", "parquet"])
@pytest.mark.usefixtures("worth_processes")
def test_a_killed_process_is_told_in_one_line(
    format_: str, mbtool: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(*arguments: str, files: list[int]) -> subprocess.Popen[bytes]:
        child = start_child(*arguments, files=files)
        os.kill(child.pid, signal.SIGKILL)
        return child

    monkeypatch.setattr(block_processes, "start_child", killed)
    said = mbtool("decode", CAPTURES[0], "-o", tmp_path / f"a.{format_}", "--jobs", "2")
    assert said.code == 3
    line = said.err.splitlines()[-1]
    assert "a process that prints for this one has ended too early (signal 9)" in line
    assert "--jobs 1" in line


@pytest.mark.usefixtures("worth_processes")
def test_one_process_is_enough_where_the_system_starts_no_more(
    mbtool: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: str, files: list[int]) -> subprocess.Popen[bytes]:
        raise LinkError(f"no process for {len(files)} files")

    monkeypatch.setattr(block_processes, "start_child", refused)
    said = mbtool("decode", CAPTURES[0], "-o", tmp_path / "a.parquet", "--jobs", "2")
    assert said.code == 0
    assert pq.read_table(tmp_path / "a.parquet").num_rows


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="/dev/full is of Linux")
@pytest.mark.usefixtures("worth_processes")
def test_a_full_disk_is_told_in_one_line(mbtool: CommandLine) -> None:
    said = mbtool("decode", CAPTURES[0], "--format", "parquet", "-o", "/dev/full", "--jobs", "2")
    assert said.code == 3
    last = said.err.splitlines()[-1]
    assert last == "mbtool: /dev/full: cannot be written: No space left on device"


@pytest.mark.usefixtures("worth_processes")
def test_ctrl_c_completes_the_parquet_file_and_ends_all_processes(
    mbtool: CommandLine,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    started: list[subprocess.Popen[bytes]],
) -> None:
    printed = block_processes.BlockProcesses.printed

    def interrupted(self, blocks):  # type: ignore[no-untyped-def]
        yield next(printed(self, blocks))
        os.kill(os.getpid(), signal.SIGINT)
        yield from printed(self, blocks)

    monkeypatch.setattr(block_processes.BlockProcesses, "printed", interrupted)
    files = three_captures(tmp_path)[:2]
    said = mbtool("decode", *files, "-o", tmp_path / "a.parquet", "--jobs", "2")
    assert said.code == 130
    assert started[0].returncode == 0
    rows = pq.read_table(tmp_path / "a.parquet").num_rows
    assert said.err.startswith("interrupted; ")
    assert f"holds only what was read so far: {rows} transactions" in said.err.splitlines()[0]
