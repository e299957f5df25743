"""Rotated captures of several sites, as files."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from mbtool.workflows.shared.column_reading import ColumnReading
from mbtool.workflows.shared.reading_options import ReadingOptions
from tests.benchmarks.file_workloads import dirty, make_capture

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

PARTS = 10


def make_sites(folder: Path, sites: int, packets: int = 600) -> list[Path]:
    """Write the captures of some sites, each in PARTS files that cut transactions in two."""
    folder.mkdir()
    paths = []
    for site in range(sites):
        whole = make_capture(folder / f"whole-{site}.pcap", dirty, packets).path
        data = whole.read_bytes()
        whole.unlink()
        paths += write_parts(data, PARTS, folder / f"site-{site}" / "2026-11-22")
    return paths


def write_parts(data: bytes, parts: int, folder: Path) -> list[Path]:
    """Write a pcap file as several, with about as many packets each."""
    places = [24]
    while places[-1] < len(data):
        places.append(places[-1] + 16 + struct.unpack_from("<I", data, places[-1] + 8)[0])
    folder.mkdir(parents=True)
    each = -(-(len(places) - 1) // parts)
    paths = []
    for number in range(parts):
        begin, end = (min(one * each, len(places) - 1) for one in (number, number + 1))
        paths.append(folder / f"cap-{number}.pcap")
        paths[-1].write_bytes(data[:24] + data[places[begin] : places[end]])
    return paths


def rows_alone(
    paths: Sequence[Path], name_of: Callable[[str], str] = lambda name: name
) -> list[str]:
    """The transactions of one reading for each folder, sorted; `name_of` renames files."""
    rows = []
    for folder in sorted({path.parent for path in paths}):
        files = [str(path) for path in paths if path.parent == folder]
        for batch in ColumnReading(files, ReadingOptions()).batches():
            rows += batch.table.to_pylist()
    for row in rows:
        for column in ("file", "response_file"):
            row[column] = None if row[column] is None else name_of(row[column])
    return sorted(map(repr, rows))
