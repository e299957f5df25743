"""Reads the classic pcap container."""

# Layout (IETF draft-ietf-opsawg-pcap), in the byte order that the magic shows:
#
#     magic  major  minor  zone  sigfigs  snaplen  link type     the file header
#     4      2      2      4     4        4        4
#
#     seconds  fraction  captured length  original length  data  each record
#     4        4         4                4
#
# The fraction counts microseconds or nanoseconds, as the magic says. The modified format of old
# Linux patches (magic a1b2cd34) has eight more bytes in each record's header, which are skipped.
#
# A record header of zeros ends the file: if a recorder's machine lost power, the file may end in
# many zeros. A compressed file of some kilobytes may hold a gigabyte of them, so they are not read
# as empty packets.
#
# Limits: libpcap captures at most MAX_CAPTURED bytes of a packet, so a longer one is damage. Behind
# it reading goes on at the next place where two records seem to follow one another, if there is one
# within SEARCHED bytes; the error about the damage is raised at the end.

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

from mbtool.core import CutError, DamageError, InputError, Packet
from mbtool.core.moments import SECOND_NS

MAX_CAPTURED = 256 * 1024

SEARCHED = 1024 * 1024
"""Behind damage, the next record is searched in this many bytes."""
_NEAR_S = 24 * 3600
"""Bytes behind damage are taken for a record only if its time differs by at most this (s) from that
of the last record."""
_MAX_ORIGINAL = 16 * 1024 * 1024
"""The search for the next record after damage accepts a record header only if the packet had at
most this length (bytes) on the wire. Hardware that joins TCP segments makes packets of up to some
hundred kB."""

PCAP_HEADER = 24
"""The length of the file header, with its magic, in bytes."""


# By the magic's bytes in the file: the byte order of the file, the nanoseconds in one unit of the
# fraction, and the number of bytes that the header of each record has beyond the usual 16.
_FORMATS = {
    bytes.fromhex("a1b2c3d4"): (">", 1000, 0),
    bytes.fromhex("d4c3b2a1"): ("<", 1000, 0),
    bytes.fromhex("a1b23c4d"): (">", 1, 0),
    bytes.fromhex("4d3cb2a1"): ("<", 1, 0),
    bytes.fromhex("a1b2cd34"): (">", 1000, 8),
    bytes.fromhex("34cdb2a1"): ("<", 1000, 8),
}
PCAP_MAGICS = tuple(_FORMATS)


class PcapForm(NamedTuple):
    """The properties of a pcap file that one needs to read its records, as the file's header gives
    them.
    """

    order: str
    """The byte order as a format character of `struct`: `<` or `>`."""
    unit_ns: int
    """The nanoseconds in one unit of a time stamp's fraction of a second: 1000 or 1."""
    extra: int
    """The number of bytes that each record's header has beyond the usual 16."""
    link_type: int


def read_pcap(source: BinaryIO, magic: bytes, name: str) -> Iterator[Packet]:
    """Yield the packets of a pcap file whose first 4 bytes, `magic`, are read already.

    Raises InputError for an unknown version, DamageError if the file is damaged, CutError if it
    ends too early; the last two after all packets that can be read.
    """
    form = read_pcap_form(magic, source.read(PCAP_HEADER - len(magic)), name)
    stream: BinaryIO | _Rest = source
    unit_ns, link_type = form.unit_ns, form.link_type
    record = struct.Struct(f"{form.order}IIII{form.extra}x")
    size = record.size
    number = 0
    last_s: int | None = None
    damage: DamageError | None = None
    while record_header := stream.read(size):
        if len(record_header) < size:
            raise damage or cut_error(name, number)
        seconds, fraction, captured, original = record.unpack(record_header)
        if captured > MAX_CAPTURED:
            window = record_header + stream.read(SEARCHED - size)
            passed = next_record(window, form, last_s)
            damage = damage or too_long_error(name, number, captured, passed)
            if passed is None:
                raise damage
            stream = _Rest(window[passed:], stream)
            continue
        if not (captured or original or seconds or fraction):
            raise damage or zeros_error(name, number)
        data = stream.read(captured)
        if len(data) < captured:
            raise damage or cut_error(name, number)
        number += 1
        last_s = seconds
        yield Packet(
            ts_ns=seconds * SECOND_NS + fraction * unit_ns,
            link="if0",
            link_type=link_type,
            data=data,
            original_length=original if original > captured else captured,
            file=name,
            number=number,
        )
    if damage is not None:
        raise damage


class _Rest:
    """A stream of which some bytes were read already."""

    def __init__(self, held: bytes, stream: BinaryIO | _Rest) -> None:
        self._held = held
        self._at = 0
        self._stream = stream

    def read(self, size: int) -> bytes:
        """Return the next `size` bytes; fewer at the end."""
        data = self._held[self._at : self._at + size]
        self._at += len(data)
        return data if len(data) == size else data + self._stream.read(size - len(data))


def next_record(window: bytes, form: PcapForm, last_s: int | None) -> int | None:
    """Return the offset of the first place in `window`, behind its begin, where a record seems to
    begin, and another one behind it; None if there is none.

    `last_s` is the time (UTC s) of the last packet, None if there was none. Where `window` has less
    than SEARCHED bytes, the file ends behind it, and the record may be the last one.
    """
    unpack = struct.Struct(f"{form.order}IIII").unpack_from
    size = 16 + form.extra
    is_end = len(window) < SEARCHED
    least_s, most_s = (0, 1 << 32) if last_s is None else (last_s - _NEAR_S, last_s + _NEAR_S)
    fractions = SECOND_NS // form.unit_ns

    def end_of_record(at: int) -> int:
        """Return the end of the record at an offset, 0 if there seems to be none."""
        seconds, fraction, captured, original = unpack(window, at)
        is_time = least_s <= seconds <= most_s and fraction < fractions
        is_size = 0 < captured <= MAX_CAPTURED and captured <= original <= _MAX_ORIGINAL
        return at + size + captured if is_time and is_size else 0

    for at in range(1, len(window) - size + 1):
        end = end_of_record(at)
        if end and (
            (is_end and end == len(window)) or (end + size <= len(window) and end_of_record(end))
        ):
            return at
    return None


def read_pcap_form(magic: bytes, header: bytes, name: str) -> PcapForm:
    """Read the file header; `header` are its bytes behind the 4 bytes of the magic.

    `name` is the file's name for error messages. Raises InputError for an unknown version, CutError
    if the header is too short.
    """
    order, unit_ns, extra = _FORMATS[magic]
    if len(header) < PCAP_HEADER - len(magic):
        raise CutError(f"{name}: ends inside the file header")
    major, minor, link_field = struct.unpack(order + "HH12xI", header)
    if major != 2:
        raise InputError(f"{name}: pcap version {major}.{minor} is unknown; 2.4 is read")
    # The upper 16 bits tell about frame check sequences, which are ignored.
    return PcapForm(order, unit_ns, extra, link_field & 0xFFFF)


def too_long_error(name: str, number: int, captured: int, passed: int | None) -> DamageError:
    """The error for a record behind packet `number` that claims to have `captured` bytes.

    That is more than MAX_CAPTURED. `name` is the file's name. `passed` is the number of bytes up to
    the next record, None if there is none.
    """
    then = "" if passed is None else f"; {passed} bytes were passed over up to the next record"
    return DamageError(
        f"{name}: damaged after packet {number}: the next claims {captured} bytes, "
        f"more than {MAX_CAPTURED}{then}"
    )


def zeros_error(name: str, number: int) -> CutError:
    """The error for a file that has zeros in place of a record behind packet `number`."""
    return CutError(
        f"{name}: zeros after {number} whole packets, so the file was not written to its end"
    )


def cut_error(name: str, number: int) -> CutError:
    """The error for a file that ends inside the record behind packet `number`."""
    return CutError(f"{name}: ends in the middle of a record, after {number} whole packets")
