"""Reads recordings of logic analysers made with sigrok (.sr): PulseView, sigrok-cli."""

# A file is a zip archive (https://sigrok.org/wiki/File_format:Sigrok/v2):
#
#     version       1 or 2
#     metadata      sections of KEY=VALUE: samplerate=1 MHz, unitsize=2, capturefile=logic-1, and
#                   probe3=RXTX for each channel that was recorded
#     logic-1-1, logic-1-2, ...   (version 1: logic-1) samples of `unitsize` bytes; channel 1 is the
#                   lowest bit of the first byte
#
# The UART characters are decoded here (uart.py), so no decoder needs to be set up in sigrok. If the
# user gives no line settings, they are searched on one channel after the other, those with the most
# edges first. The settings with the fewest wrong characters are used, if they give frames with
# correct CRCs. Without such frames the recording is refused.
#
# Each channel is decoded twice, as it is and inverted: an idle line is high, but the recorded
# signal may rest at either level. The number of bytes in frames with correct CRCs decides. The
# channel with the most such bytes is the line. A further channel is added if it adds such bytes,
# and all characters are sorted by time: a two-wire line is one channel, RS-232 has one for each
# direction. So an echo, and the second wire of RS-485, are left out. If no CRC is correct, all
# channels with characters are used, except those that only repeat another one. A recording has no
# date, so it begins in 1970.
#
# Samples of an idle line are compressed to a thousandth of their size. So the unpacked bytes are
# limited only by the highest ratio of deflate (_MAX_RATIO). Edges cost time, so their number is
# limited by the size of the file (MAX_EDGES).
#
# Memory: one block of samples, and the first edges of each channel, at most LOOKED_AT, with their
# characters.

from __future__ import annotations

import configparser
import os
import re
import struct
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from typing import BinaryIO, NamedTuple

from mbtool.core import (
    Chunk,
    Direction,
    InputError,
    LineSettings,
    Origin,
    SerialFormat,
    StreamPlace,
)
from mbtool.modbus.adu import Adu, Skipped
from mbtool.modbus.pdu import pdu_length
from mbtool.serial_line.ascii import AsciiSplitter
from mbtool.serial_line.rtu import RtuSplitter
from mbtool.serial_line.settings_fit import LIKELY_FIT
from mbtool.sources.byte_files import SerialBytes
from mbtool.sources.uart import MIN_SAMPLES, Character, UartChannel, find_format, wrong_share

LOOKED_AT = 20_000
"""The channels and the line's settings are chosen from the beginning of the recording, which ends
where one channel has this many edges (changes of level)."""
MAX_CHANNELS = 64
MAX_EDGES = 5_000_000
"""The most edges (changes of level) of all channels together, plus EDGES_A_BYTE for each byte of
the file. A recording with more raises InputError."""
EDGES_A_BYTE = 20
_MAX_RATIO = 1100
"""A recording is refused if its samples unpack to more than this many times the size of the file.
deflate compresses to 1/1032 at best, so no true file does."""
_BLOCK = 1 << 16
_MAX_METADATA = 1 << 20
_HEAD = re.compile(rb"PK\x03\x04.{22}\x07\0.{2}version", re.DOTALL)
_RATE = re.compile(r"(\d{1,12}(?:\.\d{1,9})?)\s*([kMG]?)Hz")
_FACTORS = {"": 1, "k": 10**3, "M": 10**6, "G": 10**9}
_PROBE = re.compile(r"probe(\d{1,3})")
_MAX_WRONG = 0.2
"""A channel counts as carrying characters if at most this share of them (0 to 1) has a wrong parity
or stop bit."""
_MOST_TRIED = 3000
"""The most characters of a channel that are cut into frames to find the line's settings and its
channels."""
_MIN_CHARACTERS = 20
_LEAST_KINDS = 3
"""A channel with _MIN_CHARACTERS characters or more counts as carrying characters only if at least
this many different byte values occur: a clock signal looks like one character that repeats."""
_SAME = 0.9
"""A channel counts as a copy of another one if at least this share of its characters (0 to 1) is in
the other one at the same time."""


def is_sigrok(head: bytes) -> bool:
    """True if a file is a recording of sigrok; `head` is its beginning, 37 bytes or more."""
    return _HEAD.match(head) is not None


def read_sigrok(stream: BinaryIO, name: str, link: str, line: LineSettings | None) -> SerialBytes:
    """Read the characters of a recording; find the line's settings if `line` is None.

    `name` is the file's name and `link` the name of the line. Raises InputError for a file that is
    damaged, has no logic samples, or fewer than MIN_SAMPLES for each bit, and for one in which no
    channel carries characters of these settings. The iterator over the bytes raises InputError,
    too.
    """
    recording = _Recording.open(stream, name)
    heads = recording.heads()
    found = _format(heads, recording.rate)
    format_ = found.format if line is None else line.format
    if format_ is None:
        raise InputError(
            f"{name}: no channel carries characters; if one does, say which: --link rtu@19200-8E1"
        )
    if recording.rate < MIN_SAMPLES * format_.baud:
        raise InputError(
            f"{name}: {recording.rate} samples a second are too few for {format_.baud} baud"
        )
    if line is None and not found.has_frames:
        raise InputError(
            f"{name}: the characters of {format_} that it seems to carry are not Modbus RTU; to "
            f"read them all the same, name the settings: --link rtu@{format_}"
        )
    settings = line or LineSettings(format_)
    channels = _choose(heads, settings, recording.rate)
    if not channels:
        seems = f"; its signal is that of {found.format}" if found.format is not None else ""
        raise InputError(f"{name}: no channel carries characters of {format_}{seems}")
    pieces = _chunks(recording, channels, format_, Origin(name, 0), link)
    return SerialBytes(settings, pieces)


@dataclass(slots=True)
class _Head:
    """The beginning of one channel of a recording.

    `edges` are the numbers of the samples at which the level changes.
    """

    first: int
    """The level of the first sample, 0 or 1."""
    edges: list[int] = field(default_factory=list)
    end: int = 0
    """The number of samples in this beginning."""

    @property
    def rests_low(self) -> bool:
        """True if the channel is low most of the time, as an idle line that is inverted."""
        times = [0, *self.edges, self.end]
        high = sum(times[at + 1] - times[at] for at in range(1 - self.first, len(times) - 1, 2))
        return 2 * high < self.end

    @property
    def levels(self) -> tuple[int, int]:
        """The level of the first sample (0 or 1) as recorded and inverted, the likely one first."""
        likely = self.first ^ self.rests_low
        return likely, 1 - likely

    def characters(self, line: SerialFormat, rate: int, level: int) -> list[Character]:
        return list(UartChannel(line, rate, level).feed(self.edges, self.end))


class _FoundFormat(NamedTuple):
    """The line settings that fit a recording."""

    format: SerialFormat | None
    """The line's format; None if no channel carries characters."""
    has_frames: bool
    """True if the characters are frames with correct CRCs."""


class _Channel(NamedTuple):
    number: int
    """The number of the channel, counted from 0."""
    level: int
    """The level of the first sample, 0 or 1, corrected if the channel was recorded inverted."""


@dataclass(frozen=True, slots=True)
class _HeardUart:
    """The characters of a channel, and the number of them in frames with a correct checksum."""

    channel: _Channel
    characters: list[Character]
    framed: int


@dataclass(slots=True)
class _Recording:
    """An open recording, with the names and the format of the files that have its samples."""

    archive: zipfile.ZipFile
    name: str
    rate: int
    """The sample rate, in samples per second."""
    unit: int
    """The number of bytes of one sample; each channel is one bit of it."""
    channels: list[int]
    """The numbers of the channels that were recorded, counted from 0."""
    parts: list[str]
    most_edges: int

    @classmethod
    def open(cls, stream: BinaryIO, name: str) -> _Recording:
        if not stream.seekable():
            raise InputError(
                f"{name}: a recording of sigrok cannot be packed or come through a pipe"
            )
        try:
            archive = zipfile.ZipFile(stream)
            with archive.open("metadata") as file:
                text = file.read(_MAX_METADATA).decode("utf-8", "replace")
            keys = _logic_keys(text)
            stem = keys["capturefile"]
            names = set(archive.namelist())
            parts = [stem] if stem in names else []
            while (part := f"{stem}-{len(parts) + 1}") in names:
                parts.append(part)
            unit = int(keys.get("unitsize", "1"))
            rate = _rate(keys["samplerate"])
            size = stream.seek(0, os.SEEK_END)
            _demand_plain(archive, parts, size)
        except (*_DAMAGE, KeyError, configparser.Error) as error:
            why = " ".join(str(error).split())
            raise InputError(f"{name}: no recording of sigrok that can be read: {why}") from error
        found = [int(match[1]) - 1 for key in keys if (match := _PROBE.fullmatch(key))]
        channels = sorted(one for one in found if 0 <= one < min(8 * unit, MAX_CHANNELS))
        if not parts or not rate or not channels or not 1 <= unit <= MAX_CHANNELS // 8:
            raise InputError(f"{name}: has no logic samples with a sample rate")
        most_edges = MAX_EDGES + EDGES_A_BYTE * size
        return cls(archive, name, rate, unit, channels, parts, most_edges)

    def heads(self) -> dict[int, _Head]:
        """Return the beginning of each channel, by the channel's number.

        Reading stops at the block of samples in which a channel exceeds LOOKED_AT edges. Only the
        first LOOKED_AT edges of that channel are returned.
        """
        heads: dict[int, _Head] = {}
        for block in self.blocks(self.channels):
            for number, (first, edges) in block.edges.items():
                head = heads.setdefault(number, _Head(first))
                head.edges += edges
            for head in heads.values():
                head.end = block.end
            if any(len(head.edges) > LOOKED_AT for head in heads.values()):
                break
        for head in heads.values():
            if len(head.edges) > LOOKED_AT:
                head.end = head.edges[LOOKED_AT]
                del head.edges[LOOKED_AT:]
        return heads

    def blocks(self, channels: Sequence[int]) -> Iterator[_Block]:
        """Yield the edges of the channels with these numbers, block by block of the samples."""
        levels: dict[int, int] = {}
        at = count = 0
        for data in self._data():
            edges = {}
            for number in channels:
                plane = data[number // 8 :: self.unit].translate(_LEVELS[number % 8])
                first = levels.get(number, plane[0])
                found, levels[number] = _edges(plane, first, at)
                edges[number] = first, found
                count += len(found)
            if count > self.most_edges:
                raise InputError(f"{self.name}: more than {count} edges, which no serial line has")
            at += len(data) // self.unit
            yield _Block(edges, at)

    def _data(self) -> Iterator[bytes]:
        """Yield the samples as bytes, in blocks that contain only whole samples."""
        size = _BLOCK - _BLOCK % self.unit
        rest = b""
        for part in self.parts:
            try:
                with self.archive.open(part) as file:
                    while piece := file.read(size):
                        data = rest + piece
                        whole = len(data) - len(data) % self.unit
                        rest = data[whole:]
                        if whole:
                            yield data[:whole]
            except _DAMAGE as error:
                raise InputError(f"{self.name}: damaged, in {part}: {error}") from error


class _Block(NamedTuple):
    edges: dict[int, tuple[int, list[int]]]
    """For each channel, by its number: its level before the block, and the numbers of the samples,
    counted from the start of the recording, at which the level changes."""
    end: int
    """The number of samples from the beginning of the recording to the end of the block."""


_DAMAGE = (
    zipfile.BadZipFile, zlib.error, struct.error, EOFError, RuntimeError, OverflowError, ValueError,
)  # fmt: skip
_LEVELS = [bytes(byte >> bit & 1 for byte in range(256)) for bit in range(8)]
"""For each bit position a table for bytes.translate that turns bytes of samples into levels, 0 or
1."""


def _demand_plain(archive: zipfile.ZipFile, parts: Sequence[str], size: int) -> None:
    """Raise ValueError if the samples are packed in another way than sigrok does, or too many.

    `parts` are the names of the files with samples in the archive, which has `size` bytes.
    """
    infos = [archive.getinfo(part) for part in parts]
    if any(one.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for one in infos):
        raise ValueError("its samples are not packed with deflate")
    if sum(one.file_size for one in infos) > _MAX_RATIO * size:
        raise ValueError("its samples would be more than can be packed so")


def _logic_keys(text: str) -> dict[str, str]:
    """Return keys and values of the first section of the metadata that names logic samples.

    `text` is the content of the file `metadata`. Raises KeyError if no section has `capturefile`.
    """
    parser = configparser.RawConfigParser(strict=False)
    parser.read_string(text)
    for section in parser.sections():
        if parser.has_option(section, "capturefile"):
            return dict(parser.items(section))
    raise KeyError("no logic samples")


def _rate(text: str) -> int:
    match = _RATE.fullmatch(text.strip())
    if match is None:
        raise ValueError(f"the sample rate is {text[:40]!r}")
    return int(Decimal(match[1]) * _FACTORS[match[2]])


def _edges(levels: bytes, level: int, offset: int) -> tuple[list[int], int]:
    """Return the numbers of the samples at which the level changes, and the last level.

    `levels` has a byte, 0 or 1, for each sample; `level` is the level before them, and `offset` the
    number of the first sample.
    """
    edges = []
    at = 0
    while (at := levels.find(1 - level, at)) >= 0:
        edges.append(offset + at)
        level = 1 - level
    return edges, level


def _format(heads: dict[int, _Head], rate: int) -> _FoundFormat:
    """Find the line settings of a recording; try the channels with the most edges first.

    `heads` are the beginnings of the channels, `rate` is in samples per second.
    """
    first: SerialFormat | None = None
    for head in sorted(heads.values(), key=lambda one: -len(one.edges)):
        for level in head.levels:
            found = find_format(head.edges, head.end, rate, level)
            if found is None:
                continue
            characters = head.characters(found, rate, level)
            if _are_sent(characters):
                first = first or found
                if _are_frames(characters, found, rate):
                    return _FoundFormat(found, True)
    return _FoundFormat(first, False)


def _choose(heads: dict[int, _Head], line: LineSettings, rate: int) -> list[_Channel]:
    """Return the channels that together carry a line with the settings `line`.

    `rate` is in samples per second.
    """
    heard = [
        one
        for number, head in heads.items()
        if (one := _hear(number, head, line, rate)) is not None
    ]
    heard.sort(key=lambda one: (-one.framed, -len(one.characters)))
    chosen: list[_HeardUart] = []
    framed = 0
    tolerance = rate / line.format.baud
    for one in heard:
        together = [*chosen, one]
        gained = _framed_characters(_in_order(together), line, rate)[0]
        if gained > framed:
            framed = gained
        elif framed or any(
            _repeats(one.characters, other.characters, tolerance) for other in chosen
        ):
            continue
        chosen = together
    return sorted(one.channel for one in chosen)


def _hear(number: int, head: _Head, line: LineSettings, rate: int) -> _HeardUart | None:
    """Return the characters of a channel at the likelier level; None if it carries none."""
    best: _HeardUart | None = None
    for level in head.levels:
        characters = head.characters(line.format, rate, level)
        if not _are_sent(characters):
            continue
        framed, _ = _framed_characters(characters, line, rate)
        if best is None or framed > best.framed:
            best = _HeardUart(_Channel(number, level), characters, framed)
    return best


def _in_order(heard: Sequence[_HeardUart]) -> list[Character]:
    return sorted(character for one in heard for character in one.characters)


def _are_frames(characters: Sequence[Character], line: SerialFormat, rate: int) -> bool:
    """True if characters are RTU frames, up to some that are damaged or not heard from the start.

    A channel of RS-232 carries the requests or the responses only. Random bytes have a frame with a
    correct CRC now and then, but hardly two, and hardly one of the form that its function tells.
    """
    framed, frames = _framed_characters(characters, LineSettings(line), rate)
    return any(map(_has_known_form, frames)) and framed >= LIKELY_FIT * min(
        len(characters), _MOST_TRIED
    )


def _has_known_form(frame: Adu) -> bool:
    """True if the frame's PDU has the length that its function tells."""
    ways = Direction.REQUEST, Direction.RESPONSE
    return any(pdu_length(frame.pdu, way) == len(frame.pdu) for way in ways)


def _framed_characters(
    characters: Sequence[Character], line: LineSettings, rate: int
) -> tuple[int, list[Adu]]:
    """Return the number of the first characters that are in frames with a correct checksum.

    Looks at _MOST_TRIED characters. Also returns the frames.
    """
    format_ = line.format
    splitter = AsciiSplitter(format_) if line.ascii else RtuSplitter(format_)
    events: list[Adu | Skipped] = []
    for one in characters[:_MOST_TRIED]:
        end_ns = one.start * 10**9 // rate + format_.character_ns
        events += splitter.feed(bytes((one.byte,)), end_ns)
    events += splitter.close()
    frames = [
        one
        for one in events
        if isinstance(one, Adu) and one.checksum is not None and one.checksum.ok
    ]
    return sum(len(one.raw) for one in frames), frames


def _are_sent(found: Sequence[Character]) -> bool:
    """True if a UART probably sent these characters: few are wrong, and they are not all alike."""
    if not found or wrong_share(found) > _MAX_WRONG:
        return False
    return len(found) < _MIN_CHARACTERS or len({one.byte for one in found}) >= _LEAST_KINDS


def _repeats(one: Sequence[Character], other: Sequence[Character], tolerance: float) -> bool:
    """True if at least the share _SAME of the characters of `one` are in `other` at the same time.

    `tolerance` is the largest difference, in samples, between the starts of two equal characters.
    """
    same = at = 0
    for character in one:
        while at < len(other) and other[at].start < character.start - tolerance:
            at += 1
        same += (
            at < len(other)
            and other[at].start <= character.start + tolerance
            and other[at].byte == character.byte
        )
    return same >= _SAME * len(one)


def _chunks(
    recording: _Recording,
    channels: Sequence[_Channel],
    line: SerialFormat,
    origin: Origin,
    link: str,
) -> Iterator[Chunk]:
    """Yield the characters of all channels in the order of time, each as a chunk of one byte.

    The chunk's time is that of the character's end.
    """
    decoders = {one.number: UartChannel(line, recording.rate, one.level) for one in channels}
    offset = 0
    for block in recording.blocks([*decoders]):
        characters = [
            character
            for number, (_, edges) in block.edges.items()
            for character in decoders[number].feed(edges, block.end)
        ]
        for character in sorted(characters):
            start_ns = character.start * 10**9 // recording.rate
            yield Chunk(
                ts_ns=start_ns + line.character_ns,
                link=link,
                data=bytes((character.byte,)),
                place=StreamPlace(offset, None, origin),
            )
            offset += 1
