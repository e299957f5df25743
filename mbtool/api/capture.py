"""Reads captures and logs from Python."""

from __future__ import annotations

from importlib.util import find_spec
from os import fspath
from typing import TYPE_CHECKING, Self

from mbtool.api.arguments import AnyPath, assignments_of, condition_of
from mbtool.api.point_rows import PointRow, point_rows
from mbtool.core import (
    CutError,
    DamageError,
    LineSettings,
    WireEvent,
    parse_line,
)
from mbtool.workflows.shared.reading import Reading, ReadingOptions

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from mbtool.api.arguments import Devices
    from mbtool.columns.schema import Table
    from mbtool.decode.decoder import Record
    from mbtool.devices import NamedTransaction
    from mbtool.troubles.trouble import Trouble

_TABLE_ROWS = 65_536
"""If transactions are decoded one by one, `table` collects this many as Python objects, turns them
into a table, and joins the tables at the end. This saves memory."""


class Capture:
    """Captures or logs that can be read: as records, as rows or as a table.

    Each method reads the files from their beginning, and needs little memory, except `table`. A
    `with` block is possible and not necessary: a file is open only while it is read.

    A file that is cut or damaged raises CutError or DamageError after its last good record. If the
    capture was opened with `incomplete=True`, it adds a remark instead.
    """

    def __init__(
        self,
        paths: Sequence[str],
        options: ReadingOptions,
        wanted: Callable[[NamedTransaction], bool] | None,
        *,
        incomplete: bool,
    ) -> None:
        self._paths = paths
        self._options = options
        self._wanted = wanted
        self._incomplete = incomplete
        self.remarks: list[str] = []
        """Lines about the files, such as that packets are cut; complete once a method has read them
        all."""
        self._new_reading().demand_files()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def __iter__(self) -> Iterator[NamedTransaction]:
        return self.transactions()

    def transactions(self) -> Iterator[NamedTransaction]:
        """Yield the transactions in the order in which they ended.

        Raises InputError for a file that cannot be read.
        """
        return (one for one in self.records() if not isinstance(one, WireEvent))

    def events(self) -> Iterator[WireEvent]:
        """Yield the events, which are no transactions: gaps, skipped bytes, and connections."""
        return (one for one in self.records() if isinstance(one, WireEvent))

    def records(self) -> Iterator[Record]:
        """Yield transactions and events in order; `where` filters only the transactions."""
        return self._chosen(self._new_reading())

    def points(self) -> Iterator[PointRow]:
        """Yield each value that was read or written as a row: `pandas.DataFrame(c.points())`.

        If a device has a profile, these are its named points, in their units of measure.
        """
        reading = self._new_reading()
        for record in self._chosen(reading):
            if not isinstance(record, WireEvent):
                yield from point_rows(record, reading.profile_for(record))

    def table(self) -> Table:
        """Return all transactions as a `pyarrow.Table`; docs/log-format.md lists its columns.

        A file of packets that is opened without `devices`, `where`, `line` and `any_port` is
        decoded several times as fast in this way as one by one. Raises UsageError if pyarrow is not
        installed.
        """
        if find_spec("pyarrow") is None:
            from mbtool.core.extras import missing_extra

            raise missing_extra("table()", "columns")
        from mbtool.columns.row_table import row_table, whole_table

        parts = []
        rows: list[NamedTransaction] = []
        if self._wanted is None and (columns := self._columns()) is not None:
            return whole_table(columns)
        for one in self.transactions():
            rows.append(one)
            if len(rows) == _TABLE_ROWS:
                parts.append(row_table(rows))
                rows = []
        return whole_table([*parts, row_table(rows)])

    def troubles(self) -> list[Trouble]:
        """Return what is wrong, the worst first; docs/troubles.md explains the codes.

        They are those of `mbtool check`: with `where`, units are judged by the transactions that
        pass. `cause`, `remedy` and `sentence` have the words, `evidence` the first cases.
        """
        from mbtool.workflows.check import CheckRun

        run = CheckRun(self._paths, self._options, wanted=self._wanted)
        try:
            for _ in run.findings():
                pass
        except (CutError, DamageError) as error:
            self._finish(run.reading, error)
        else:
            self._finish(run.reading)
        return [*run.judgement().troubles]

    def _columns(self) -> list[Table] | None:
        """Return all transactions as tables, made by the array decoder.

        Returns None if it cannot decode these files, or does not support the options.
        """
        from mbtool.workflows.shared.column_reading import ColumnReading
        from mbtool.workflows.shared.reading_choice import can_read_columns

        if not can_read_columns(self._paths, self._options):
            return None
        reading = ColumnReading(self._paths, self._options)
        tables: list[Table] = []
        try:
            tables.extend(batch.table for batch in reading.batches())
        except (CutError, DamageError) as error:
            self._finish(reading, error)
        else:
            self._finish(reading)
        return tables

    def _chosen(self, reading: Reading) -> Iterator[Record]:
        try:
            for record in reading.records():
                if self._wanted is None or isinstance(record, WireEvent) or self._wanted(record):
                    yield record
        except (CutError, DamageError) as error:
            self._finish(reading, error)
        else:
            self._finish(reading)

    def _finish(self, reading: Reading, error: CutError | DamageError | None = None) -> None:
        """Store the remarks about the files, and raise `error`, which ended the reading, if any.

        With `incomplete=True`, the error becomes a remark instead. Raises InputError if nothing in
        the files could be decoded.
        """
        self.remarks = [*reading.remarks]
        if error is not None:
            if not self._incomplete:
                raise error
            self.remarks.append(str(error))
        if reading.why_empty is not None:
            self.remarks.append(reading.why_empty)
        reading.demand_readable()

    def _new_reading(self) -> Reading:
        return Reading(self._paths, self._options)


def open_capture(
    path: AnyPath,
    *more: AnyPath,
    devices: Devices | None = None,
    where: str | None = None,
    line: str | None = None,
    ports: Sequence[int] = (),
    rtu_ports: Sequence[int] = (),
    any_port: bool = False,
    raw: bool = False,
    incomplete: bool = False,
) -> Capture:
    """Open a capture (.pcap, .pcapng) or a log (.mcap), plain, .gz or .zst; or several as one.

    `devices` gives slaves their profiles: {5: "idec-ft1a-touch", "192.168.3.250": "fa3-at1m8x"}; a
    log contains the profiles that it was recorded with. `where` chooses transactions: 'unit == 5
    and outcome != "ok"'. `line` says that the file has the bytes of a serial line: "rtu@19200-8E1".
    `ports` are the TCP ports of slaves (by default 502), `rtu_ports` those with RTU over TCP;
    `any_port` looks for Modbus on all ports. `raw` decodes the bytes in a log again. With
    `incomplete`, a cut or damaged file is read as far as possible.

    Raises InputError if the file cannot be read, UsageError for an argument that is wrong.
    """
    settings: LineSettings | None = None if line is None else parse_line(line)
    options = ReadingOptions(
        assignments=assignments_of(devices),
        ports=ports,
        rtu_ports=rtu_ports,
        any_port=any_port,
        line=settings,
        raw=raw,
    )
    wanted = None if where is None else condition_of(where)
    paths = [fspath(one) for one in (path, *more)]
    return Capture(paths, options, wanted, incomplete=incomplete)
