"""Reads a capture file into tables of transactions, as arrays where that is possible."""

# The transactions, their order, the remarks and the errors are the same as with `Reading`. This
# faster way only works for a single file of packets, without device profiles.

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from mbtool.columns.column_decoder import ColumnDecoder
from mbtool.columns.packet_block import read_blocks
from mbtool.columns.plain_lines import BlockLines
from mbtool.columns.plain_records import plain_records
from mbtool.columns.poll_runs import PollRuns
from mbtool.core import CutError, DamageError, InputError, WireEvent
from mbtool.devices import Namer
from mbtool.overview.answered_run import AnsweredRun
from mbtool.packets import serial_pieces
from mbtool.sources.files import PACKET_KINDS, CaptureKind, open_capture, place_of
from mbtool.workflows.shared.heard_line import HeardLine, serial_types
from mbtool.workflows.shared.part_reading import PartReading
from mbtool.workflows.shared.reading import UNDECODABLE_EVENTS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from mbtool.columns.block_table import TransactionBatch
    from mbtool.columns.column_decoder import DecodedBlock
    from mbtool.columns.packet_block import PacketBlock
    from mbtool.columns.plain_lines import LineBatch
    from mbtool.decode.decoder import Record
    from mbtool.devices import NamedTransaction
    from mbtool.sources.files import CaptureFile
    from mbtool.workflows.shared.reading import ReadingOptions


def can_read_columns(paths: Sequence[str], options: ReadingOptions) -> bool:
    """True if ColumnReading can read these files.

    Raises InputError for a file that cannot be read.
    """
    has_own = any(options.assignments) or options.line is not None or options.any_port
    if len(paths) != 1 or has_own or place_of(paths[0])[1]:
        return False
    with open_capture(paths[0]) as capture:
        if capture.kind is CaptureKind.PCAPNG:
            # Packets of a file that describes its links may show bytes of a serial line.
            with suppress(InputError):
                next(capture.packets(), None)
        return capture.kind in PACKET_KINDS and capture.head is None


class ColumnReading(PartReading):
    """Reads a capture file once, and yields tables of its transactions."""

    def records(self) -> Iterator[Record]:
        """Yield all transactions and events, one by one. Raises as `batches` does."""
        namer = Namer(self.assignments)
        for block in self._blocks():
            for _, record in block.records:
                self._note(record)
            yield from plain_records(block, namer)

    def batches(self) -> Iterator[TransactionBatch]:
        """Yield the transactions and events, as a table for each block of packets.

        Raises InputError if the file cannot be read, CutError if it ends too early, after the
        transactions before that place.
        """
        from mbtool.columns.block_table import BlockTables  # Needs pyarrow, `parts` does not.

        tables = BlockTables()
        for block in self._blocks():
            batch = tables.batch(block)
            for record in batch.records:
                self._note(record)
            yield batch

    def lines(
        self, line_of: Callable[[NamedTransaction], str], separator: str
    ) -> Iterator[LineBatch]:
        """Yield the lines of the transactions, as a text for each block of packets.

        The arguments are those of BlockLines. Raises as `batches` does.
        """
        lines = BlockLines(line_of, separator)
        for block in self._blocks():
            batch = lines.batch(block)
            for record in batch.records:
                self._note(record)
            yield batch

    def parts(self) -> Iterator[Record | AnsweredRun]:
        runs = PollRuns()
        for block in self._blocks():
            for part in runs.parts(block):
                if not isinstance(part, AnsweredRun):
                    self._note(part)
                yield part

    def _blocks(self) -> Iterator[DecodedBlock]:
        (path,) = self._paths
        decoder = self._own_decoder()
        self.format_of, self.line_of = decoder.format_of, decoder.line_of
        ports, rtu_ports = self._ports
        columns = ColumnDecoder(decoder, (*ports, *rtu_ports))
        broken: InputError | None = None
        with open_capture(path) as capture:
            self._current = capture
            self._kinds.add(capture.kind)
            self._enter()
            try:
                for block in capture.guarded(read_blocks(capture.stream, capture.name)):
                    self._note_block(capture, block)
                    for decoded in columns.feed(block):
                        yield self._noted(decoded)
            except InputError as error:
                broken = error
        yield columns.close()
        if broken is None or isinstance(broken, CutError | DamageError):
            self._files_read += 1
        if broken is not None:
            raise broken

    def _note_block(self, capture: CaptureFile, block: PacketBlock) -> None:
        self._items += len(block)
        cut = block.captured[block.original > block.captured]
        if len(cut):
            self._missing.note_cut(len(cut), int(cut.min()), int(cut.max()))
        types = serial_types(None)
        if types.isdisjoint(link_type for _, link_type in block.links):
            return
        heard: HeardLine | None = self._heard[0] if self._heard else None
        for index in range(len(block)):
            packet = block.packet(index)
            if packet.link_type in types:
                self._serial_packets += 1
                heard = heard or self._hear(capture)
                for piece in serial_pieces(packet):
                    heard.note(piece)

    def _noted(self, block: DecodedBlock) -> DecodedBlock:
        # Transactions that were read as arrays are in connections whose OPENED event came before.
        if block.plain is not None:
            self._has_found = self._has_decoded = True
        return block

    def _note(self, record: Record) -> None:
        self._has_found = True
        self._missing.note_record(record)
        if isinstance(record, WireEvent) and record.kind in UNDECODABLE_EVENTS:
            self._first_undecodable = self._first_undecodable or record.message
        else:
            self._has_decoded = True
