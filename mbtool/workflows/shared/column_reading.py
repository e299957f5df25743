"""Reads capture files fast, by decoding blocks of packets as numpy arrays."""

# The transactions, their order, the remarks for the user and the errors are the same as with the
# class `Reading`, which decodes one packet at a time. Reading as arrays only works for files of
# packets.

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from typing import TYPE_CHECKING, TypeVar

from mbtool.columns.column_decoder import ColumnDecoder, DecodedBlock
from mbtool.columns.packet_block import PacketBlock, read_blocks
from mbtool.columns.plain_lines import BlockLines, LineBatch
from mbtool.columns.plain_records import plain_records
from mbtool.columns.plain_transactions import PlainObjects
from mbtool.columns.portions import portions
from mbtool.columns.quiet_rows import BlockRows, QuietParts
from mbtool.columns.usual_runs import UsualRuns
from mbtool.core import InputError, WireEvent
from mbtool.decode.usual_run import UsualRun
from mbtool.devices import NamedTransaction, Namer
from mbtool.packets import serial_pieces
from mbtool.sources.files import CaptureFile, open_capture
from mbtool.workflows.shared.capture_parts import Part
from mbtool.workflows.shared.heard_line import HeardLine, serial_types
from mbtool.workflows.shared.reading import UNDECODABLE_EVENTS, Reading, ReadingOptions

if TYPE_CHECKING:
    from mbtool.columns.block_table import TransactionBatch
    from mbtool.decode.decoder import Record

F = TypeVar("F")


class ColumnReading(Reading):
    """Reads capture files once as blocks of packets, and yields their transactions.

    Each method yields them in another form: records, tables, lines of text, or batches for
    counting.
    """

    def __init__(self, paths: Sequence[str], options: ReadingOptions) -> None:
        super().__init__(paths, options)
        self.on_block: Callable[[DecodedBlock], None] | None = None
        """If not None, this function is called with each decoded block before its transactions are
        yielded."""
        self._heard_here: HeardLine | None = None
        """Checks the assumed baud rate with the bytes of a serial line in the current file; None if
        the file has none."""

    def records(self) -> Iterator[Record]:
        """Yield all transactions and events, one by one.

        Raises InputError if a file cannot be read; CutError for a file that ends in the middle of a
        packet, after the records before that place.
        """
        objects = PlainObjects(Namer(self.assignments))
        for block in self._blocks():
            for _, record in block.records:
                self._note(record)
            yield from plain_records(block, objects)

    def batches(self) -> Iterator[TransactionBatch]:
        """Yield the transactions and events, those of each block of packets together, with the
        transactions as an Arrow table.

        Raises InputError if a file cannot be read; CutError for a file that ends in the middle of a
        packet, after the transactions before that place.
        """
        from mbtool.columns.block_table import BlockTables  # Other methods do not need pyarrow.

        tables = BlockTables(Namer(self.assignments))
        for block in self._portions():
            batch = tables.batch(block)
            for record in batch.records:
                self._note(record)
            yield batch

    def lines(
        self, line_of: Callable[[NamedTransaction], str], separator: str
    ) -> Iterator[LineBatch]:
        """Yield the transactions as text, the lines of each block of packets together.

        `line_of` makes the line of a transaction; `separator` stands between the values of a list
        in a line. Raises InputError if a file cannot be read, CutError for a file that ends in the
        middle of a packet.
        """
        lines = BlockLines(line_of, separator, Namer(self.assignments))
        for block in self._portions():
            batch = lines.batch(block)
            for record in batch.records:
                self._note(record)
            yield batch

    def decoded(self) -> Iterator[DecodedBlock]:
        """Yield the decoded blocks of packets as they are.

        Raises InputError if a file cannot be read, CutError for a file that ends in the middle of a
        packet.
        """
        for block in self._portions():
            for _, record in block.records:
                self._note(record)
            yield block

    def runs(
        self, form_of: Callable[[NamedTransaction], F], singly: int
    ) -> Iterator[Record | UsualRun[F]]:
        """Yield all transactions and events. Many usual reads and writes come together as one
        UsualRun.

        `form_of` and `singly` are as for UsualRuns. Raises the errors of `batches`.
        """
        runs = UsualRuns(form_of, singly, Namer(self.assignments))
        for block in self._portions():
            for part in runs.parts(block):
                if not isinstance(part, UsualRun):
                    self._note(part)
                yield part

    def quiet_parts(self) -> Iterator[Record | BlockRows]:
        """Yield all transactions and events. Many answered reads and writes that break no rule come
        together as one BlockRows.
        """
        quiet = QuietParts(Namer(self.assignments))
        for block in self._blocks():
            for _, record in block.records:
                self._note(record)
            yield from quiet.parts(block)

    def _portions(self) -> Iterator[DecodedBlock]:
        """Yield the blocks cut into portions, as each value of a row takes memory."""
        return chain.from_iterable(map(portions, self._blocks()))

    def _blocks(self) -> Iterator[DecodedBlock]:
        return self.results.in_turn(self._file_blocks, self._broken_off, self._ended)

    def _file_blocks(self, path: str) -> Iterator[DecodedBlock]:
        with open_capture(path) as capture:
            self._current = capture
            self._kinds.add(capture.kind)
            self._heard_here = None
            if self._part is None:
                yield from self._ended()
            self._part = Part()
            is_first = True
            for block in capture.guarded(read_blocks(capture.stream, capture.name)):
                if is_first and not self._seam.is_continued_by(block.packet(0)):
                    self._note_order(block.packet(0))
                    yield from self._ended()
                    self._part = Part()
                if is_first:
                    self._enter()
                is_first = False
                self._note_block(capture, block)
                for decoded in self._columns().feed(block):
                    yield self._noted(decoded)

    def _columns(self) -> ColumnDecoder:
        """Return the array decoder of the current capture; create it if the capture has
        none yet.
        """
        if self._decoder is None:
            self._decoder = self._own_decoder()
            self.format_of, self.line_of = self._decoder.format_of, self._decoder.line_of
            ports, rtu_ports = self._ports
            self._column_decoder = ColumnDecoder(self._decoder, (*ports, *rtu_ports))
        return self._column_decoder

    def _ended(self) -> Iterator[DecodedBlock]:
        """End the capture: yield the records that its decoder still holds, as one block.

        They count for the last file of the ended capture, although the next file is already open.
        """
        file, captures = self.file, self.captures
        block = _block_of(self._end_capture())
        begun = self.file, self.captures
        self.file, self.captures = file, captures
        yield self._noted(block)
        self.file, self.captures = begun

    def _broken_off(self, error: InputError) -> Iterator[DecodedBlock]:
        yield self._noted(_block_of(self._break_off(error)))

    def _note_block(self, capture: CaptureFile, block: PacketBlock) -> None:
        self._items += len(block)
        for place in sorted({*block.first_of_each_interface(), len(block) - 1}):
            self._seam.note(block.packet(place))
        cut = block.captured[block.original > block.captured]
        if len(cut):
            self._missing.note_cut(len(cut), int(cut.min()), int(cut.max()))
        types = serial_types(None)
        if types.isdisjoint(link_type for _, link_type in block.links):
            return
        for index in range(len(block)):
            packet = block.packet(index)
            if packet.link_type in types:
                self._serial_packets += 1
                self._heard_here = self._heard_here or self._hear(capture)
                for piece in serial_pieces(packet):
                    self._heard_here.note(piece)

    def _noted(self, block: DecodedBlock) -> DecodedBlock:
        if self.on_block is not None:
            self.on_block(block)
        events = sum(isinstance(record, WireEvent) for _, record in block.records)
        transactions = len(block.records) - events
        # A block with transactions that the array decoder read shows that the files could be
        # decoded.
        if block.plain is not None:
            self._has_found = self._has_decoded = True
            transactions += len(block.plain.request)
        if block.passed is not None:
            events += 2 * len(block.passed.connections)
        self.results.note_some(self.file, transactions, events)
        last_ns = block.last_ns()
        if last_ns is not None:
            self._last_ns = last_ns
        return block

    def _note(self, record: Record) -> None:
        self._has_found = True
        self._missing.note_record(record)
        if isinstance(record, WireEvent) and record.kind in UNDECODABLE_EVENTS:
            self._first_undecodable = self._first_undecodable or record.message
        else:
            self._has_decoded = True


def _block_of(records: Iterable[Record]) -> DecodedBlock:
    return DecodedBlock(records=[(0, one) for one in records])
