"""Reads what follows the data section of a log: the summary, the footer and the magic bytes."""

# The summary repeats what is in the data section, so damage in it loses no captured or decoded
# data. It is reported nevertheless: other readers find the chunks by the summary, and a disk that
# has changed one byte may change more. The CRC in the footer covers the summary and the footer
# itself.
#
# Memory: one record.

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from mbtool.logs.layout import MAGIC, MAX_RECORD, PRIVATE, RECORD_HEAD, Opcode

if TYPE_CHECKING:
    from mbtool.core import InputError
    from mbtool.logs.records import RecordStream

_FOOTER = struct.Struct("<QQI")
_CRC_SIZE = 4
_LAST_OPCODE = 0x0F

_SUMMARY_WRONG = "the summary, which repeats what is in the log; all else was read"
_FOOTER_WRONG = "the footer, which tells where the summary is; all else was read"


def is_open_end(records: RecordStream) -> bool:
    """True if the next record is the Footer of a log without a summary.

    The recorder of such a log is still writing it, or ended without closing it.
    """
    record = records.look_at_record()
    return (
        record is not None
        and record.opcode == Opcode.FOOTER
        and len(record.content) == _FOOTER.size
        and _FOOTER.unpack(record.content)[0] == 0
    )


def check_end(records: RecordStream, begin: int = 0) -> None:
    """Check the summary, the footer and the magic bytes that follow the DataEnd record.

    The log begins at file offset `begin`, which is 0 unless other logs are before it.
    Raises CutError if the file ends before they are complete, DamageError if anything in them is
    damaged.
    """
    start = records.position
    records.restart_crc()
    while True:
        record = records.look_at_record()
        if record is None or not _is_known(record.opcode):
            raise _broken(records, start, is_whole=record is not None)
        if record.opcode == Opcode.FOOTER:
            break
        records.take(RECORD_HEAD.size + len(record.content))
    offset = records.position
    if len(record.content) != _FOOTER.size:
        raise records.damaged(offset, _FOOTER_WRONG)
    summary_start, offsets_start, crc = _FOOTER.unpack(record.content)
    records.take(RECORD_HEAD.size + _FOOTER.size - _CRC_SIZE)
    found = records.crc
    records.take(_CRC_SIZE)
    if summary_start == 0:
        # A log that was not closed has summary_start 0, even if it was ended while its summary was
        # being written.
        if offsets_start or crc:
            raise records.damaged(offset, _FOOTER_WRONG)
    elif summary_start + begin != start or crc not in (0, found):
        raise records.damaged(start, _SUMMARY_WRONG)
    records.read_magic()


def begins_log(records: RecordStream) -> bool:
    """True if another log follows behind the end of a log, as in a file made with `cat`."""
    return records.look(len(MAGIC)) == MAGIC


def _is_known(opcode: int) -> bool:
    return 0 < opcode <= _LAST_OPCODE or opcode >= PRIVATE


def _broken(records: RecordStream, start: int, *, is_whole: bool) -> InputError:
    records.look(MAX_RECORD)
    if is_whole or records.ends_as_a_file():
        return records.damaged(start, _SUMMARY_WRONG)
    return records.cut(records.position)
