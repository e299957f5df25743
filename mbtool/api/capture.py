"""Reads captures and logs from Python."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from html import escape
from importlib.util import find_spec
from itertools import islice
from os import fspath
from typing import TYPE_CHECKING, Any, Self

from mbtool.api.arguments import AnyPath, Devices, assignments_of, condition_of
from mbtool.api.point_rows import PointRow, point_rows
from mbtool.core import (
    CutError,
    DamageError,
    InputError,
    LineSettings,
    MbtoolError,
    WireEvent,
    parse_line,
)
from mbtool.workflows.shared.named_files import named_files
from mbtool.workflows.shared.reading import Reading, ReadingOptions

if TYPE_CHECKING:
    import pandas
    import polars

    from mbtool.columns.schema import Table
    from mbtool.decode.decoder import Record
    from mbtool.devices import NamedTransaction
    from mbtool.devices.checking.finding import Finding
    from mbtool.troubles.trouble import Trouble
    from mbtool.workflows.check import CheckRun

_TABLE_ROWS = 65_536
"""If transactions are decoded one by one, `to_arrow` collects this many as Python objects, turns
them into a table, and joins the tables at the end. This saves memory."""


_SHOWN = 10
"""A notebook shows the first transactions of a capture, at most this many."""


class Capture:
    """Captures or logs that can be read: as records, as rows, as tables, or judged.

    Each method reads the files from their beginning, and needs little memory, except `to_arrow` and
    what is made of it. In a notebook a capture is shown by its first transactions. A `with` block
    is possible and not necessary: a file is open only while it is read.

    A file that is cut or damaged raises CutError or DamageError after its last good record. If the
    capture was opened with `incomplete=True`, it adds a remark instead.
    """

    def __init__(
        self,
        paths: Sequence[str],
        options: ReadingOptions,
        where: str | None,
        *,
        incomplete: bool,
    ) -> None:
        self._paths = paths
        self._options = options
        self._where = where
        self._wanted = None if where is None else condition_of(where)
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

    def __repr__(self) -> str:
        return f"mbtool.open({', '.join(map(repr, self._paths))})"

    def _repr_html_(self) -> str:
        """Return the first transactions as a table, for a notebook."""
        from mbtool.views.cells import transaction_text

        title = escape(", ".join(self._paths))
        try:
            shown = list(islice(self.transactions(), _SHOWN + 1))
        except MbtoolError as error:
            return f"<p>{title}: {escape(str(error))}</p>"
        cells = [
            (one.time.isoformat(" "), one.link, str(one.unit), transaction_text(one))
            for one in shown[:_SHOWN]
        ]
        cells += [("...", "", "", "")] if len(shown) > _SHOWN else []
        rows = [("time (UTC)", "link", "unit", "request and response"), *cells]
        lines = ("".join(f"<td>{escape(one)}</td>" for one in row) for row in rows)
        table = "".join(f"<tr>{line}</tr>" for line in lines)
        return f"<table><caption>{title}</caption>{table}</table>"

    def transactions(self) -> Iterator[NamedTransaction]:
        """Yield the transactions in the order in which it was certain how they ended.

        A request without an answer comes when its time is over, behind later ones: for the order of
        the requests use `sorted(capture, key=lambda one: one.start_ns)`. Of several files, those of
        the first come first. Raises InputError for a file that cannot be read.
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

    def to_arrow(self, *, points: bool = False) -> Table:
        """Return all transactions as a `pyarrow.Table`; docs/log-format.md lists its columns.

        With `points`, return the values instead, one in each row; docs/sql.md lists their columns.
        A file of packets that is opened without `line` and `any_port` is decoded several times as
        fast in this way as one by one. Raises UsageError if pyarrow is not
        installed.
        """
        _demand("to_arrow()", "columns", "pyarrow")
        if not points:
            return self._table()
        from mbtool.columns.value_table import joined_values

        reading = self._new_reading()
        reading.demand_files()
        return joined_values(self._table(reading), reading.profile_named)

    def to_polars(self, *, points: bool = False) -> polars.DataFrame:
        """Return the table of `to_arrow` as a `polars.DataFrame`.

        Raises UsageError if polars or pyarrow are not installed.
        """
        _demand("to_polars()", "data", "pyarrow", "polars")
        import polars

        frame = polars.from_arrow(self.to_arrow(points=points))
        assert isinstance(frame, polars.DataFrame)
        return frame

    def to_pandas(self, *, points: bool = False) -> pandas.DataFrame:
        """Return the table of `to_arrow` as a `pandas.DataFrame`; texts become categories.

        Raises UsageError if pandas or pyarrow are not installed.
        """
        _demand("to_pandas()", "data", "pyarrow", "pandas")
        frame: pandas.DataFrame = self.to_arrow(points=points).to_pandas()
        return frame

    def _table(self, reading: Reading | None = None) -> Table:
        from mbtool.columns.row_table import row_table, whole_table

        parts = []
        rows: list[NamedTransaction] = []
        if self._wanted is None and (columns := self._columns()) is not None:
            return whole_table(columns)
        for one in self._chosen(reading or self._new_reading()):
            if isinstance(one, WireEvent):
                continue
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
        return [*self._checked()[0].judgement().troubles]

    def findings(self) -> list[Finding]:
        """Return the broken rules, those of `mbtool check`; docs/findings.md explains the codes.

        At the end of each file come those about it as a whole.
        """
        return self._checked()[1]

    def stats(self) -> dict[str, Any]:
        """Return the statistics: a dictionary with the keys of `mbtool stats --json`.

        docs/stats.md explains them: `stats()["links"][0]["functions"]`.
        """
        from mbtool.views.statistics_document import statistics_document

        run, _ = self._checked()
        text = statistics_document(
            run.ledger,
            run.judgement(),
            sources=self._paths,
            where=self._where,
            remarks=self.remarks,
        )
        document: dict[str, Any] = json.loads(text)
        return document

    def inventory(self) -> dict[str, Any]:
        """Return slaves and masters: a dictionary with the keys of `inventory --format json`.

        docs/inventory.md explains them: `inventory()["slaves"][0]["host"]`.
        """
        from mbtool.version import __version__
        from mbtool.views.inventory_documents import inventory_json
        from mbtool.workflows.inventory import InventoryOptions, InventoryRun

        options = InventoryOptions(reading=self._options, wanted=self._wanted)
        run = InventoryRun(self._paths, options)
        inventory = run.take()
        error = run.error
        self._finish(run.reading, error)
        text = inventory_json(
            inventory, __version__, judgement=run.judgement(), remarks=self.remarks
        )
        document: dict[str, Any] = json.loads(text)
        return document

    def _checked(self) -> tuple[CheckRun, list[Finding]]:
        """Read and check the files; return the run with its judgement, and all findings."""
        from mbtool.workflows.check import CheckRun

        run = CheckRun(self._paths, self._options, wanted=self._wanted)
        found: list[Finding] = []
        try:
            found.extend(one.finding for one in run.findings())
        except (CutError, DamageError) as error:
            self._finish(run.reading, error)
        else:
            self._finish(run.reading)
        return run, found

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

    def _finish(self, reading: Reading, error: InputError | None = None) -> None:
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


def _demand(what: str, extra: str, *packages: str) -> None:
    """Raise UsageError, which says that `what` needs the extra, if a package is not installed."""
    if any(find_spec(name) is None for name in packages):
        from mbtool.core.extras import missing_extra

        raise missing_extra(what, extra)


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

    A folder stands for the captures in it, a pattern ("site-*.pcap") for the files that fit it.
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
    paths = named_files([fspath(one) for one in (path, *more)])
    return Capture(paths, options, where, incomplete=incomplete)
