"""Defines the bytes of an MCAP file that both the writer and the reader need."""

#     magic | record ... | DataEnd | summary ... | Footer | magic
#     record = opcode (1 byte), length (8 bytes), content; integers are little-endian
#
# Source: the MCAP format specification, https://mcap.dev/spec. The `mcap` package defines the
# records; this module adds what its classes do not make public, or do too slowly for each message.

from __future__ import annotations

import struct

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import DataEnd, Footer, McapRecord

MAGIC = b"\x89MCAP0\r\n"
PROFILE = "mbtool"
LIBRARY = "mbtool "
"""A log's header names the program that wrote it: this text, followed by the version of mbtool."""
FORMAT_VERSION = 2
"""The version of the log format that this program writes."""
READ_VERSIONS = ("1", "2")
"""The versions of the log format that this program reads. In version 1 each read of a serial line
is a message of its own."""

CAPTURE = "mbtool.capture"
EVIDENCE_ONLY = "evidence_only"
"""A key of the metadata record CAPTURE. Its value is "true" in a log that contains captured bytes
but nothing decoded."""
LINK = "mbtool.link"
DEVICE = "mbtool.device"
STATUS = "mbtool.status"
RECOVERED = "mbtool.recovered"
DECODING_TOPIC = "decoding"
"""The topic, without its slash, of the messages that say how far the decoder is behind the
capture."""
PROFILE_MEDIA_TYPE = "application/json"

RECORD_HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""The head of a message, before its data: channel id, sequence number, log time, publish time (both
in ns)."""

PRIVATE = 0x80
"""The first private opcode; readers skip private records that they do not know."""

MAX_RECORD = 64 << 20
"""The most bytes that a reader accepts in a record, and in an unpacked chunk."""


def pack_records(*records: McapRecord) -> bytes:
    """Encode MCAP records as bytes, one after the other."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def empty_record(size: int) -> bytes:
    """Make a filler record, which readers ignore, of `size` bytes (at least RECORD_HEAD.size)."""
    return RECORD_HEAD.pack(PRIVATE, size - RECORD_HEAD.size) + bytes(size - RECORD_HEAD.size)


def footer(summary_start: int = 0, offsets_start: int = 0, crc: int = 0) -> bytes:
    """Return the end of a file: the Footer record and the magic bytes.

    `summary_start` and `offsets_start` are the file offsets of the summary and of the summary
    offset records in it; 0 means that there are none. `crc` is that of the summary; 0 means none.
    """
    return pack_records(Footer(summary_start, offsets_start, crc)) + MAGIC


def data_end(crc: int) -> bytes:
    return pack_records(DataEnd(crc))


DATA_END_SIZE = len(data_end(0))
FOOTER_SIZE = len(footer())
TAIL_SIZE = DATA_END_SIZE + FOOTER_SIZE

__all__ = [
    "CAPTURE",
    "DATA_END_SIZE",
    "DECODING_TOPIC",
    "DEVICE",
    "EVIDENCE_ONLY",
    "FOOTER_SIZE",
    "FORMAT_VERSION",
    "LIBRARY",
    "LINK",
    "MAGIC",
    "MAX_RECORD",
    "MESSAGE_HEAD",
    "PRIVATE",
    "PROFILE",
    "PROFILE_MEDIA_TYPE",
    "READ_VERSIONS",
    "RECORD_HEAD",
    "RECOVERED",
    "STATUS",
    "TAIL_SIZE",
    "Opcode",
    "data_end",
    "empty_record",
    "footer",
    "pack_records",
]
