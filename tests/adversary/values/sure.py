"""Prints what is called sure of the registers in recordings that others made.

`python -m tests.adversary.values.sure [TEXT]`: for each shared capture (whose name has TEXT) and
slave, the values whose type is sure, to be compared with the map of the device.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from mbtool.core import InputError, parse_line
from mbtool.values.judging import judge
from mbtool.values.value_series import histories_of
from mbtool.values.word_readings import numbers_in
from mbtool.workflows.shared.observed_slaves import ObservedSlaves
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.captures import public_folder
from tests.printed_frames import as_byte_times

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mbtool.devices.observed_slave import ObservedSlave
    from mbtool.values.judging import Judged, WordHistory

SUFFIXES = (".pcap", ".pcapng", ".gz", ".txt", ".log", ".sr")
METER = "20230228_record.txt"


def captures() -> list[Path]:
    return [path for path in sorted(public_folder().rglob("*")) if path.suffix in SUFFIXES]


def reading_of(path: Path, folder: Path) -> tuple[str, ReadingOptions]:
    """The file to read, and how; a log that only we can read is written anew into a folder."""
    if path.name != METER:
        return str(path), ReadingOptions()
    bytes_ = folder / "meter.csv"
    bytes_.write_text(as_byte_times(path.read_text()))
    return str(bytes_), ReadingOptions(line=parse_line("rtu@19200-8E1"))


def slaves_of(path: Path, folder: Path) -> list[ObservedSlave]:
    slaves = ObservedSlaves(with_values=True)
    name, options = reading_of(path, folder)
    try:
        slaves.add(Reading([name], options).records())
    except InputError as error:
        print(f"{path.name}: {str(error)[:90]}")
    return list(slaves.slaves)


def sure_values(slave: ObservedSlave) -> Iterator[tuple[Judged, Sequence[float]]]:
    """The values whose type is sure, with their numbers; none for a text."""
    histories = histories_of(slave)
    for one in judge(histories):
        if one.is_sure:
            yield one, _numbers(histories, one)


def _numbers(histories: Sequence[WordHistory], one: Judged) -> Sequence[float]:
    for history in histories:
        begin = one.address - history.first
        if history.table is one.table and 0 <= begin <= history.stop - history.first - one.words:
            columns = [[row[begin + word] for row in history.rows] for word in range(one.words)]
            return numbers_in(columns, one.reading) or () if one.reading.words else ()
    return ()


def main() -> None:
    chosen = sys.argv[1] if len(sys.argv) > 1 else ""
    total: Counter[str] = Counter()
    with TemporaryDirectory() as folder:
        for path in captures():
            if chosen not in str(path):
                continue
            for slave in slaves_of(path, Path(folder)):
                sure = list(sure_values(slave))
                total["slaves"] += 1
                total["sure"] += len(sure)
                if not sure:
                    continue
                print(f"{path.parent.name}/{path.name} {slave.who}: {len(sure)} sure")
                for one, numbers in sure:
                    seen = f"{min(numbers):.7g} to {max(numbers):.7g}" if numbers else "text"
                    print(
                        f"    {one.table} {one.address}: {one.reading.type} {one.reading.order}, "
                        f"{seen} ({one.reason})"
                    )
    print(f"{total['slaves']} slaves, {total['sure']} values sure")


if __name__ == "__main__":
    main()
