"""Opens capture files: plain, gzip or zstd, from disk or standard input."""

# A file is recognised by its first bytes, not by its name: first the compression, then the kind of
# capture inside. An uncompressed file keeps its seekable stream, which the reader of a log may
# need. A text of no known kind is searched for Modbus frames (text_log.py).
#
# If the user gives the settings of a serial line, a file of no known kind is taken as the bytes of
# that line. A text that has only hexadecimal digits is decoded to these bytes first. On an ASCII
# line the bytes themselves are text; so for such a line, a text counts as hexadecimal only if it
# has no colon and its digits are in separate pairs. A byte order mark before a text is skipped. The
# zeros before a text log, which a file system leaves at a loss of power, are skipped, too.
#
# Limits: a compressed stream is unpacked INPUT_BYTES at a time, so the memory it needs is bounded
# (zlib 0.5 MiB; zstd 16 MiB at most, plus a window of at most MAX_WINDOW). A small file cannot cost
# hours: it may unpack to FREE_BYTES plus MAX_RATIO times its bytes read so far. Captures are
# compressed to a third or a tenth; a log, whose chunks are compressed already, hardly shrinks. If a
# stream ends before its end mark, all bytes that can be unpacked are read, then CutError is raised.

from __future__ import annotations

import codecs
import io
import os
import re
import stat
import sys
import zlib
from collections.abc import Callable, Iterator
from enum import StrEnum
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, BinaryIO, Protocol, TypeVar, cast

from mbtool.core import (
    CutError,
    EmptyError,
    InputError,
    LineSettings,
    Packet,
    SerialFormat,
    UsageError,
)
from mbtool.core.closing import ClosesOnExit
from mbtool.core.moments import counted
from mbtool.packets import CAPTURE_MAGICS, PCAP_MAGICS, PCAPNG_MAGIC, read_capture
from mbtool.sources.appearance import find_appearance, is_text, text_without_frames, unknown_file
from mbtool.sources.byte_files import SerialPiece, read_hex, read_raw

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

    from mbtool.packets.line_packets import CaptureHead
    from mbtool.sources.text_log import TextLog

_Item = TypeVar("_Item")

STANDARD_INPUT = "-"
INPUT_BYTES = 512
MAX_WINDOW = 128 * 1024 * 1024
MAX_RATIO = 100
FREE_BYTES = 64 * 1024 * 1024
FREE_BYTES_OF_LOG = 4 * 1024 * 1024
"""A compressed log may unpack to this many bytes, however small it is. That is less than
FREE_BYTES, the limit for other files, as the chunks inside a log are unpacked once more."""

PROBED = 64 * 1024
"""A text up to this size, in bytes, is searched for frames when it is opened."""

MAX_ZEROS = 1 << 18
"""At most this many zero bytes are skipped at the beginning of a text."""

_HEAD = 256
_LEAST_ZEROS = 8
_BUFFER = 64 * 1024
_GZIP = b"\x1f\x8b"
_ZSTD = b"\x28\xb5\x2f\xfd"
_MCAP = b"\x89MCAP0\r\n"
_HEX_OF_ASCII = re.compile(rb"\s*(?:#|(?:0[xX]|[0-9A-Fa-f]{2}[\s,])[^:]*\Z)")
_HEX_ROWS = re.compile(rb"(?:[ \t\r,xX0-9A-Fa-f]*(?:#[^\n]*)?(?:\n|\Z))+")


class CaptureKind(StrEnum):
    """The kinds of capture files that this program reads."""

    PCAP = "pcap"
    PCAPNG = "pcapng"
    MCAP = "mcap"
    RAW = "raw"
    """The bytes of a serial line, without times."""
    HEX = "hex"
    """The bytes of a serial line, as hexadecimal text."""
    BYTE_TIMES = "byte-times"
    """The bytes of a serial line as CSV, with the start and end time of each byte."""
    SIGROK = "sigrok"
    """A recording of a logic analyser, with the levels of serial lines."""
    TEXT_LOG = "text-log"
    """A text in which another program shows Modbus frames."""


TIMED_KINDS = frozenset((CaptureKind.BYTE_TIMES, CaptureKind.SIGROK))
"""The kinds of files that have a time for each byte of a serial line."""
PACKET_KINDS = frozenset((CaptureKind.PCAP, CaptureKind.PCAPNG))
_TEXT_KINDS = frozenset((CaptureKind.HEX, CaptureKind.BYTE_TIMES))


class CaptureFile(ClosesOnExit):
    """An open capture. Close it, or use it as a context manager."""

    def __init__(
        self, name: str, kind: CaptureKind, stream: io.BufferedIOBase, file: io.BufferedIOBase
    ) -> None:
        self.name = name
        """The file's name in messages: its path, or "standard input"."""
        self.kind = kind
        self.stream = cast("BinaryIO", stream)
        """The unpacked bytes, without a byte order mark.

        Reading raises InputError for a damaged compressed stream, CutError for one that ends before
        its end mark, and OSError if the system cannot read the file.
        """
        self.head: CaptureHead | None = None
        """The settings of links and devices that `convert` wrote into a pcapng file. None before
        the first packet is read, and if the file has none."""
        self._text: TextLog | None = None
        self._file = file
        self._size = _size(file)

    def packets(self) -> Iterator[Packet]:
        """Yield the packets of a pcap or pcapng file.

        Raises InputError for another kind of file and for one that is damaged or cannot be read,
        CutError for one that was cut off.
        """
        if self.kind not in PACKET_KINDS:
            what = "an MCAP log" if self.kind is CaptureKind.MCAP else "bytes of a serial line"
            raise InputError(f"{self.name}: {what}, where pcap or pcapng is wanted")
        try:
            yield from read_capture(self.stream, self.name, self._note_head)
        except OSError as error:
            raise _unreadable(self.name, error) from error

    def _note_head(self, head: CaptureHead) -> None:
        self.head = head

    @property
    def link(self) -> str:
        """The name of the file's serial line: the file's name without its suffix, or "stdin"."""
        return "stdin" if _is_standard_input(self._file) else PurePath(self.name).stem

    def serial(self, line: LineSettings | None) -> tuple[LineSettings, Iterator[SerialPiece]]:
        """Return the line's settings and the bytes of the serial line in the file, in its order.

        If `line` is None, the settings are found from the times of the bytes. Raises InputError for
        a file of packets, for a log, and, if `line` is None, for a file without times. The iterator
        over the bytes raises InputError and CutError.
        """
        try:
            line, pieces = self._serial(line)
        except OSError as error:
            raise _unreadable(self.name, error) from error
        return line, self.guarded(pieces)

    def _serial(self, line: LineSettings | None) -> tuple[LineSettings, Iterator[SerialPiece]]:
        of_file = self.stream, self.name, self.link
        if self.kind is CaptureKind.BYTE_TIMES:
            from mbtool.sources.byte_times import read_byte_times

            return read_byte_times(*of_file, line)
        if self.kind is CaptureKind.SIGROK:
            from mbtool.sources.sigrok import read_sigrok

            return read_sigrok(*of_file, line)
        if self.kind is CaptureKind.TEXT_LOG:
            from mbtool.sources.text_log import TextLog

            settings = line or LineSettings(SerialFormat())
            self._text = TextLog(*of_file, settings.format)
            return settings, self._frames(self._text)
        if line is None or self.kind not in (CaptureKind.RAW, CaptureKind.HEX):
            raise InputError(f"{self.name}: {self.kind}, where bytes of a serial line are wanted")
        return (read_raw if self.kind is CaptureKind.RAW else read_hex)(*of_file, line)

    def _frames(self, text: TextLog) -> Iterator[SerialPiece]:
        """Yield the frames of a text; raise InputError if it has none."""
        yield from text.pieces()
        if not text.found:
            raise _no_frames(self.name, text)

    @property
    def remark(self) -> str | None:
        """A line for the user about a text that was read to its end; None for other files."""
        text = self._text
        if text is None or not text.found:
            return None
        twice = f"; {counted(text.shown_twice, 'frame')} shown twice" if text.shown_twice else ""
        if text.bare:
            twice += f"; {counted(text.bare, 'frame')} shown without CRC, which is computed"
        if text.steps_back:
            times = counted(text.steps_back, "time")
            twice += f"; its times go back {times}, first in line {text.first_step_back}"
        if text.guessed_date:
            twice += f"; {text.guessed_date} is read as month, day, as nothing shows the order"
        found = f"{counted(text.found, 'frame')} in {counted(text.lines, 'line')}"
        return f"{self.name}: {found} of text, all else passed over{twice}"

    def guarded(self, items: Iterator[_Item]) -> Iterator[_Item]:
        """Yield `items`, which are read from the stream, and turn an OSError into InputError."""
        try:
            yield from items
        except OSError as error:
            raise _unreadable(self.name, error) from error

    def fraction(self) -> float | None:
        """Return the share of the file that has been read, 0 to 1; None if its size is unknown."""
        if self._size is None or self._file.closed:
            return None
        return min(self._file.tell() / self._size, 1.0)

    def close(self) -> None:
        if not _is_standard_input(self._file):
            self._file.close()


def place_of(path: str) -> tuple[object, bool]:
    """Return a key that is equal for all paths to one file, and True if the file is a pipe.

    Standard input (`-`) counts as a pipe. If the file cannot be found, the key is `path` itself.
    """
    if path == STANDARD_INPUT:
        return path, True
    try:
        status = os.stat(path)
    except (OSError, ValueError):  # Opening the file later will report the error.
        return path, False
    return (status.st_dev, status.st_ino), stat.S_ISFIFO(status.st_mode)


def shown_name(path: str) -> str:
    """The name of a file for messages and records; bytes that are no UTF-8 are shown in hex."""
    if path == STANDARD_INPUT:
        return "standard input"
    return os.fsencode(path).decode("utf-8", "backslashreplace")


def open_capture(path: str | Path, line: LineSettings | None = None) -> CaptureFile:
    """Open a capture file, or standard input for `-`.

    If `line` is given, a file of no known kind is read as bytes of this line; it may be empty.
    Raises UsageError for an empty path, InputError for a file that cannot be read or is no capture,
    CutError for one that ends inside its header.
    """
    if not str(path):
        raise UsageError("a file's name is empty; name a capture or a log, or - for standard input")
    name = shown_name(str(path))
    try:
        file = _open(path)
    except (OSError, ValueError) as error:
        raise _unreadable(name, error) from error
    try:
        head, stream = _peek(file)
        unpacked = _unpacked(name, head, stream)
        if unpacked is not None:
            head, stream = _peek(io.BufferedReader(unpacked, _BUFFER))
            if head.startswith(_MCAP):
                unpacked.limit_as_log()
        if line is None or not line.ascii:
            head, stream = _without_zeros(head, stream)
        if not head and line is None:
            raise InputError(f"{name}: empty; a capture has at least a header")
        kind = _kind(name, head, line)
        if kind is CaptureKind.TEXT_LOG and not _is_standard_input(file):
            stream = _stream_after_probe(name, stream)
        if kind in _TEXT_KINDS and head.startswith(codecs.BOM_UTF8):
            stream.read(len(codecs.BOM_UTF8))
        return CaptureFile(name, kind, stream, file)
    except OSError as error:
        file.close()
        raise _unreadable(name, error) from error
    except InputError:
        file.close()
        raise


def _open(path: str | Path) -> io.BufferedIOBase:
    if str(path) != STANDARD_INPUT:
        return open(path, "rb")
    if sys.stdin is None:
        raise InputError("standard input: closed; name a file")
    if sys.stdin.isatty():
        raise InputError("standard input: a terminal; pipe a capture into it, or name a file")
    return cast("io.BufferedIOBase", sys.stdin.buffer)


def _peek(stream: io.BufferedIOBase) -> tuple[bytes, io.BufferedIOBase]:
    """Return the first bytes of a stream, and a stream that begins with the same bytes."""
    head = b""
    try:
        while len(head) < _HEAD and (more := stream.read1(_HEAD - len(head))):
            head += more
    except CutError:
        if not head:
            raise
        # The stream raises the CutError again when the bytes behind `head` are read.
    if stream.seekable():
        stream.seek(0)
        return head, stream
    return head, io.BufferedReader(_Rejoined(head, stream), _BUFFER)


def _without_zeros(head: bytes, stream: io.BufferedIOBase) -> tuple[bytes, io.BufferedIOBase]:
    """Skip zeros at the beginning of a stream if a text follows; return its head and the stream."""
    if not head.startswith(bytes(_LEAST_ZEROS)):
        return head, stream
    zeros = 0
    text = b""
    while zeros < MAX_ZEROS and len(text) < _HEAD and (more := stream.read1(_BUFFER)):
        if not text:
            text = more.lstrip(b"\0")
            zeros += len(more) - len(text)
        else:
            text += more
    if not text or not is_text(text[:_HEAD]):
        text = bytes(zeros) + text
    return text[:_HEAD], io.BufferedReader(_Rejoined(text, stream), _BUFFER)


def _stream_after_probe(name: str, stream: io.BufferedIOBase) -> io.BufferedIOBase:
    """Return a stream that begins with the same bytes; raise EmptyError for a short text without a
    Modbus frame.

    A text of more than PROBED bytes is not examined; the error is then raised at its end.
    """
    head = stream.read(PROBED)
    if len(head) < PROBED:
        from mbtool.sources.text_log import TextLog

        text = TextLog(cast("BinaryIO", io.BytesIO(head)), name, "", SerialFormat())
        if not any(True for _ in text.pieces()):
            raise _no_frames(name, text)
    if stream.seekable():
        stream.seek(0)
        return stream
    return io.BufferedReader(_Rejoined(head, stream), _BUFFER)


class _Rejoined(io.RawIOBase):
    """A stream that cannot seek, whose first bytes were read already and are returned again."""

    def __init__(self, head: bytes, rest: io.BufferedIOBase) -> None:
        self._head = head
        self._rest = rest

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: WriteableBuffer) -> int:
        view = memoryview(buffer)
        data = self._head[: len(view)] or self._rest.read1(len(view))
        self._head = self._head[len(view) :]
        view[: len(data)] = data
        return len(data)


class _Unpacker(Protocol):
    """The interface that the decompressors of zlib and zstandard share."""

    @property
    def eof(self) -> bool: ...
    @property
    def unused_data(self) -> bytes: ...
    def decompress(self, data: bytes, /) -> bytes: ...


class _Unpacked(io.RawIOBase):
    """The unpacked content of a file of one compressed stream, or of several in a row."""

    def __init__(
        self,
        packed: io.BufferedIOBase,
        begin: Callable[[], _Unpacker],
        error: type[Exception],
        name: str,
    ) -> None:
        self._packed = packed
        self._begin = begin
        self._error = error
        self._name = name
        self._unpacker: _Unpacker | None = None
        self._ready = memoryview(b"")
        self._left = FREE_BYTES
        """The number of bytes that may still be unpacked; it grows with the packed bytes read."""

    def limit_as_log(self) -> None:
        """Lower the limit on unpacked bytes, as the content is a log (see FREE_BYTES_OF_LOG)."""
        self._left -= FREE_BYTES - FREE_BYTES_OF_LOG

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: WriteableBuffer) -> int:
        view = memoryview(buffer)
        while not self._ready:
            data = self._packed.read1(INPUT_BYTES)
            if not data:
                if self._unpacker is not None:
                    raise CutError(f"{self._name}: the compressed stream ends before its end mark")
                return 0
            try:
                self._ready = memoryview(self._unpack(data))
            except self._error as error:
                raise InputError(
                    f"{self._name}: its compressed data are damaged and cannot be unpacked"
                ) from error
            self._left += MAX_RATIO * len(data) - len(self._ready)
        if self._left < 0:
            raise InputError(
                f"{self._name}: unpacks to more than {MAX_RATIO} times its size, so it is read no "
                "further; if it is a capture all the same, unpack it first"
            )
        count = min(len(view), len(self._ready))
        view[:count] = self._ready[:count]
        self._ready = self._ready[count:]
        return count

    def _unpack(self, data: bytes) -> bytes:
        unpacked = []
        while data:
            if self._unpacker is None:
                data = data.lstrip(b"\0")  # A gzip file may end in zeros, the padding for tapes.
                if not data:
                    break
                self._unpacker = self._begin()
            unpacked.append(self._unpacker.decompress(data))
            if not self._unpacker.eof:
                break
            data = self._unpacker.unused_data
            self._unpacker = None
        return b"".join(unpacked)


def _unpacked(name: str, head: bytes, stream: io.BufferedIOBase) -> _Unpacked | None:
    """Return the unpacked content of a stream; None if it is not compressed, as `head` shows."""
    if head.startswith(_GZIP):
        gzip_window = 16 + zlib.MAX_WBITS
        return _Unpacked(stream, lambda: zlib.decompressobj(gzip_window), zlib.error, name)
    if head.startswith(_ZSTD):
        import zstandard  # Imported here, as few files are compressed with zstd.

        context = zstandard.ZstdDecompressor(max_window_size=MAX_WINDOW)
        return _Unpacked(stream, context.decompressobj, zstandard.ZstdError, name)
    return None


def _kind(name: str, head: bytes, line: LineSettings | None) -> CaptureKind:
    if head.startswith(PCAP_MAGICS):
        return CaptureKind.PCAP
    if head.startswith(PCAPNG_MAGIC):
        return CaptureKind.PCAPNG
    if head.startswith(_MCAP):
        return CaptureKind.MCAP
    # Imported here: few files are of these kinds, and both need many modules.
    from mbtool.sources.byte_times import is_byte_times
    from mbtool.sources.sigrok import is_sigrok

    if is_sigrok(head):
        return CaptureKind.SIGROK
    text = head.removeprefix(codecs.BOM_UTF8)
    if is_byte_times(text):
        return CaptureKind.BYTE_TIMES
    other = find_appearance(text)
    if line is not None and other is None:
        if not is_text(head):
            return CaptureKind.RAW
        if line.ascii:
            is_hex = _HEX_OF_ASCII.match(text) is not None
            return CaptureKind.HEX if is_hex else CaptureKind.RAW
        is_hex = _HEX_ROWS.fullmatch(text) is not None
        return CaptureKind.HEX if is_hex else CaptureKind.TEXT_LOG
    if head and any(magic.startswith(head) for magic in (*CAPTURE_MAGICS, _MCAP)):
        raise CutError(f"{name}: ends inside the first bytes of its header")
    if other is None and is_text(head):
        return CaptureKind.TEXT_LOG
    raise InputError(f"{name}: {unknown_file(text)}")


def _no_frames(name: str, text: TextLog) -> EmptyError:
    """Return the error for a text that was read to its end and has no Modbus frame."""
    return EmptyError(f"{name}: {text_without_frames(text.lines, text.bytes_seen)}")


def _is_standard_input(file: io.BufferedIOBase) -> bool:
    return sys.stdin is not None and file is sys.stdin.buffer


def _size(file: io.BufferedIOBase) -> int | None:
    if _is_standard_input(file):
        return None
    status = os.fstat(file.fileno())
    return status.st_size or None if stat.S_ISREG(status.st_mode) else None


def _unreadable(name: str, error: OSError | ValueError) -> InputError:
    if isinstance(error, FileNotFoundError):
        stem, suffix = os.path.splitext(name)
        parts = f"; its parts are {stem}-0001{suffix} and following: name {stem}-*{suffix}"
        is_rotated = os.path.exists(f"{stem}-0001{suffix}")
        return InputError(f"{name}: there is no such file{parts if is_rotated else ''}")
    if isinstance(error, IsADirectoryError):
        return InputError(f"{name}: a directory; name a capture file in it")
    if isinstance(error, PermissionError):
        return InputError(f"{name}: reading it is not permitted to this user")
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return InputError(f"{name}: cannot be read: {reason}")
