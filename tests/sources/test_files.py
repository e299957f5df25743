from __future__ import annotations

import codecs
import gzip
import io
import os
import sys
import tracemalloc
from types import SimpleNamespace
from typing import TYPE_CHECKING

import pytest
import zstandard

from mbtool.core import Chunk, CutError, InputError, Packet, parse_line
from mbtool.sources import files
from mbtool.sources.files import CaptureKind, open_capture
from tests.captures import read_packets
from tests.packets.building import Pcapng, packet, pcap

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

_PACKETS = [packet(bytes([number]) * 100, number * 1000) for number in range(50)]
_PCAP = pcap(_PACKETS)
_PCAPNG = Pcapng().section() + Pcapng().interface() + Pcapng().enhanced(b"abc")
_MCAP = b"\x89MCAP0\r\n" + bytes(100)


def _zstd(data: bytes) -> bytes:
    """Pack in small blocks: a block is the least that can be unpacked."""
    packer = zstandard.ZstdCompressor(write_checksum=True).compressobj()
    parts = []
    size = max(500, len(data) // 64)
    for at in range(0, len(data), size):
        parts.append(packer.compress(data[at : at + size]))
        parts.append(packer.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK))
    return b"".join(parts) + packer.flush()


def _plain(data: bytes) -> bytes:
    return data


def _standard_input(
    monkeypatch: pytest.MonkeyPatch, data: bytes, *, terminal: bool = False
) -> None:
    monkeypatch.setattr(
        sys, "stdin", SimpleNamespace(buffer=io.BytesIO(data), isatty=lambda: terminal)
    )


@pytest.mark.parametrize("pack", [_plain, gzip.compress, _zstd])
@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (_PCAP, CaptureKind.PCAP),
        (_PCAPNG, CaptureKind.PCAPNG),
        (_MCAP, CaptureKind.MCAP),
        (_MCAP[:8], CaptureKind.MCAP),
    ],
)
def test_tells_the_kind_by_the_first_bytes(
    tmp_path: Path, pack: Callable[[bytes], bytes], content: bytes, kind: CaptureKind
) -> None:
    path = tmp_path / "misleading.txt"
    path.write_bytes(pack(content))

    with open_capture(path) as capture:
        assert capture.kind is kind
        assert capture.name == str(path)
        assert capture.stream.read() == content


def test_a_plain_file_keeps_its_seekable_stream(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(_MCAP)

    with open_capture(path) as capture:
        assert capture.stream.seekable()


@pytest.mark.parametrize("pack", [_plain, gzip.compress, _zstd])
def test_reads_packets_plain_and_packed(tmp_path: Path, pack: Callable[[bytes], bytes]) -> None:
    path = tmp_path / "a"
    path.write_bytes(pack(_PCAP))

    assert list(read_packets(path)) == _PACKETS


@pytest.mark.parametrize("pack", [gzip.compress, _zstd])
def test_reads_packed_streams_one_after_another(
    tmp_path: Path, pack: Callable[[bytes], bytes]
) -> None:
    path = tmp_path / "a"
    path.write_bytes(pack(_PCAP[:1000]) + pack(b"") + pack(_PCAP[1000:]) + bytes(5000))

    assert list(read_packets(path)) == _PACKETS


@pytest.mark.parametrize("pack", [gzip.compress, _zstd])
def test_every_beginning_of_a_packed_file_gives_its_packets_and_is_cut(
    tmp_path: Path, pack: Callable[[bytes], bytes]
) -> None:
    path = tmp_path / "a"
    whole = pack(_PCAP)
    counts = []
    for end in range(4, len(whole)):
        path.write_bytes(whole[:end])
        packets: list[Packet] = []
        with pytest.raises(CutError) as caught:
            packets.extend(read_packets(path))
        assert str(caught.value).startswith(f"{path}: ")
        assert packets == _PACKETS[: len(packets)]
        counts.append(len(packets))
    assert counts == sorted(counts)
    # Only the checksum behind the data is missing.
    assert counts[-1] == len(_PACKETS)


def test_a_cut_behind_whole_records_is_seen_by_the_packing(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(gzip.compress(_PCAP, mtime=0)[:-8])
    packets: list[Packet] = []

    with pytest.raises(CutError, match="the compressed stream ends before its end mark"):
        packets.extend(read_packets(path))

    assert packets == _PACKETS


@pytest.mark.parametrize("pack", [gzip.compress, _zstd])
def test_a_damaged_packed_stream_is_one_line(
    tmp_path: Path, pack: Callable[[bytes], bytes]
) -> None:
    path = tmp_path / "a"
    damaged = bytearray(pack(bytes(range(256)) * 40))
    damaged[4:40] = bytes(36)
    path.write_bytes(bytes(damaged))

    with pytest.raises(InputError) as caught:
        list(read_packets(path))

    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("pack", "bound"), [(gzip.compress, 2 << 20), (_zstd, 20 << 20)])
def test_unpacks_a_little_at_a_time(
    tmp_path: Path, pack: Callable[[bytes], bytes], bound: int
) -> None:
    path = tmp_path / "bomb"
    path.write_bytes(pack(bytes(64 << 20)))
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="begins with 00"):
            open_capture(path)
        assert tracemalloc.get_traced_memory()[1] < bound
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty; a capture has at least a header"),
        (gzip.compress(b"", mtime=0), "empty; a capture has at least a header"),
        (
            b"09:14:03 unit 1 \xc3\xa4\n" * 9,
            "a text file of 9 lines, no capture; it shows no bytes",
        ),
        (b'{"link":"plant"}\n' * 9, "JSON, no capture; if it has transactions of decode"),
        (b"\x7fELF\x02\x01" + bytes(60), "an ELF program, no capture"),
        (b"PK\x03\x04" + bytes(60), "a zip archive, no capture"),
        (b"\xfd7zXZ\0" + bytes(60), "an xz archive, no capture"),
        (bytes(64), "a file that begins with 00 00 00 00 00 00 00 00, no capture"),
        (gzip.compress(b"some words", mtime=0), "a text file of 1 line, no capture"),
    ],
)
def test_another_kind_of_file_says_what_it_looks_like(
    tmp_path: Path, content: bytes, words: str
) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(content)

    with pytest.raises(InputError) as caught:
        open_capture(path)

    assert str(caught.value).startswith(f"{path}: {words}")


def test_the_beginning_of_a_magic_is_cut(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(_PCAP[:3])

    with pytest.raises(CutError, match="ends inside the first bytes"):
        open_capture(path)


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("absent.pcap", "there is no such file"),
        (".", "a directory; name a capture file in it"),
        ("file/below", "cannot be read: Not a directory"),
        ("x" * 300, "cannot be read: File name too long"),
        ("a\0b", "cannot be read: embedded null byte"),
    ],
)
def test_a_path_that_cannot_be_opened_is_one_line(tmp_path: Path, name: str, problem: str) -> None:
    (tmp_path / "file").write_bytes(_PCAP)

    with pytest.raises(InputError) as caught:
        open_capture(f"{tmp_path}/{name}")

    assert str(caught.value) == f"{tmp_path}/{name}: {problem}"


def test_a_forbidden_file_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: str, mode: str) -> None:
        raise PermissionError(13, "Permission denied", path)

    monkeypatch.setattr("builtins.open", refuse)

    with pytest.raises(InputError, match=r"^a\.pcap: reading it is not permitted to this user$"):
        open_capture("a.pcap")


@pytest.mark.parametrize("pack", [_plain, gzip.compress, _zstd])
def test_reads_standard_input(
    monkeypatch: pytest.MonkeyPatch, pack: Callable[[bytes], bytes]
) -> None:
    _standard_input(monkeypatch, pack(_PCAP))

    with open_capture("-") as capture:
        assert capture.kind is CaptureKind.PCAP
        assert list(capture.packets()) == _PACKETS
        assert capture.fraction() is None
    assert not sys.stdin.buffer.closed


def test_a_terminal_is_no_capture(monkeypatch: pytest.MonkeyPatch) -> None:
    _standard_input(monkeypatch, b"", terminal=True)

    with pytest.raises(InputError, match="standard input: a terminal; pipe a capture into it"):
        open_capture("-")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_reads_a_pipe_as_it_comes() -> None:
    reader, writer = os.pipe()
    with os.fdopen(writer, "wb", buffering=0) as sink:
        sink.write(_PCAP[:500])
        with open_capture(f"/dev/fd/{reader}") as capture:
            packets = capture.packets()
            assert next(packets) == _PACKETS[0]
            assert capture.fraction() is None
    os.close(reader)


def test_tells_how_much_of_a_file_was_read(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(pcap(_PACKETS * 100))

    with open_capture(path) as capture:
        seen = [capture.fraction() for _ in capture.packets()]
        assert capture.fraction() == 1.0

    told = [each for each in seen if each is not None]
    assert told == sorted(told)
    assert len(told) == 5000
    assert 0 < told[0] < 0.5


def test_an_mcap_log_has_no_packets_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(_MCAP)

    with pytest.raises(InputError, match="an MCAP log, where pcap or pcapng is wanted"):
        list(read_packets(path))


def test_an_error_while_reading_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(_PCAP)

    class Broken(io.BytesIO):
        def read(self, size: int | None = -1, /) -> bytes:
            raise OSError(5, "Input/output error")

    with open_capture(path) as capture:
        monkeypatch.setattr(capture, "stream", Broken())
        with pytest.raises(InputError, match="cannot be read: Input/output error"):
            list(capture.packets())


_FRAME = bytes.fromhex("01 03 0000 0002 c40b")  # unit 1, read two holding registers, CRC
_BYTE_TIMES = b"t_start_s,t_end_s,line,byte_hex\n0.1,0.2,rx,01\n"


@pytest.mark.parametrize("pack", [_plain, gzip.compress, _zstd])
@pytest.mark.parametrize(
    ("content", "line", "kind"),
    [
        (_BYTE_TIMES, None, CaptureKind.BYTE_TIMES),
        (_BYTE_TIMES, "rtu@9600", CaptureKind.BYTE_TIMES),
        (_PCAP, "rtu@9600", CaptureKind.PCAP),
        (_MCAP, "rtu@9600", CaptureKind.MCAP),
        (_FRAME, "rtu@9600", CaptureKind.RAW),
        (bytes(64), "rtu@9600", CaptureKind.RAW),
        (codecs.BOM_UTF8 + bytes(64), "rtu@9600", CaptureKind.RAW),
        (b"# of 2024: tio\n01 03", "rtu@9600", CaptureKind.HEX),
        (b"0103000000", "rtu@9600", CaptureKind.HEX),
        (b"<< 01 03 00 00 00 02 c4 0b", "rtu@9600", CaptureKind.TEXT_LOG),
        (b":0103\r\n" * 9, "ascii@9600", CaptureKind.RAW),
        (b"FB\r\n:0103\r\n", "ascii@9600", CaptureKind.RAW),
        (b"00000001000000010000000100000001" * 2, "ascii@9600", CaptureKind.RAW),
        (b"3a 30 31 30 33 0d 0a", "ascii@9600", CaptureKind.HEX),
        (b"0x3a,0x30", "ascii@9600", CaptureKind.HEX),
        (b"# of a line: ascii\n3a3031", "ascii@9600", CaptureKind.HEX),
    ],
)
def test_tells_how_a_file_holds_the_bytes_of_a_line(
    tmp_path: Path,
    pack: Callable[[bytes], bytes],
    content: bytes,
    line: str | None,
    kind: CaptureKind,
) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(pack(content))

    with open_capture(path, None if line is None else parse_line(line)) as capture:
        assert capture.kind is kind
        assert capture.link == "a"


def test_gives_the_bytes_of_a_line(tmp_path: Path) -> None:
    path = tmp_path / "bench.bin"
    path.write_bytes(_FRAME)
    line = parse_line("rtu@9600")

    with open_capture(path, line) as capture:
        settings, pieces = capture.serial(line)
        assert settings == line
        (chunk,) = pieces
    assert isinstance(chunk, Chunk)
    assert (chunk.link, chunk.data) == ("bench", _FRAME)


@pytest.mark.parametrize("pack", [_plain, gzip.compress, _zstd])
@pytest.mark.parametrize(
    ("content", "line"),
    [
        (_BYTE_TIMES, None),
        (b"01 03 00 00", "rtu@9600"),
        (b"3a 30 31", "ascii@9600"),
        (b"", "rtu@9600"),
    ],
)
def test_a_byte_order_mark_is_no_part_of_a_text(
    tmp_path: Path, pack: Callable[[bytes], bytes], content: bytes, line: str | None
) -> None:
    settings = None if line is None else parse_line(line)
    pieces = []
    for mark in (b"", codecs.BOM_UTF8):
        path = tmp_path / "a"
        path.write_bytes(pack(mark + content))
        with open_capture(path, settings) as capture:
            pieces.append(list(capture.serial(settings)[1]))
    assert pieces[0] == pieces[1]
    assert bool(pieces[0]) is bool(content)


def test_a_byte_order_mark_on_standard_input_is_no_part_of_a_text(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _standard_input(monkeypatch, codecs.BOM_UTF8 + b"01 03")
    line = parse_line("rtu@9600")

    with open_capture("-", line) as capture:
        pieces = list(capture.serial(line)[1])
    assert b"".join(piece.data for piece in pieces if isinstance(piece, Chunk)) == b"\1\3"


def test_bytes_of_a_line_may_begin_like_a_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "a"
    data = codecs.BOM_UTF8 + _FRAME
    path.write_bytes(data)
    line = parse_line("rtu@9600")

    with open_capture(path, line) as capture:
        (chunk,) = capture.serial(line)[1]
    assert isinstance(chunk, Chunk)
    assert chunk.data == data


@pytest.mark.parametrize("pack", [_plain, gzip.compress])
@pytest.mark.parametrize("line", ["rtu@9600", "ascii@9600"])
def test_an_empty_file_of_a_line_has_no_bytes(
    tmp_path: Path, pack: Callable[[bytes], bytes], line: str
) -> None:
    path = tmp_path / "a"
    path.write_bytes(pack(b""))

    with open_capture(path, parse_line(line)) as capture:
        assert list(capture.serial(parse_line(line))[1]) == []


def test_the_bytes_of_standard_input_are_called_so(monkeypatch: pytest.MonkeyPatch) -> None:
    _standard_input(monkeypatch, _FRAME)
    line = parse_line("rtu@9600")

    with open_capture("-", line) as capture:
        assert capture.link == "stdin"
        (piece,) = capture.serial(line)[1]
    assert isinstance(piece, Chunk)
    assert piece.link == "stdin"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (_FRAME, "a file that begins with 01 03 00 00 00 02 c4 0b, no capture"),
        (b"01 03 00 00", "a text file of 1 line, no capture; it shows 4 bytes, but no whole"),
    ],
)
def test_bytes_of_a_line_that_nobody_names_are_refused_with_a_hint(
    tmp_path: Path, content: bytes, words: str
) -> None:
    path = tmp_path / "a"
    path.write_bytes(content)

    with pytest.raises(InputError) as caught:
        open_capture(path)

    assert str(caught.value).startswith(f"{path}: {words}")
    assert (
        str(caught.value)
        .lower()
        .endswith("if it holds bytes of a serial line, say which: --link rtu@19200-8e1")
    )


def test_a_known_kind_of_file_is_no_line_whatever_is_said(tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    path.write_bytes(b"PK\x03\x04" + bytes(60))

    with pytest.raises(InputError, match="a zip archive, no capture") as caught:
        open_capture(path, parse_line("rtu@9600"))

    assert "--link" not in str(caught.value)


def test_a_file_is_read_as_what_it_is_only(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(_BYTE_TIMES)
    with open_capture(path) as capture, pytest.raises(InputError, match="bytes of a serial line"):
        next(capture.packets())
    path.write_bytes(_PCAP)
    with open_capture(path) as capture, pytest.raises(InputError, match="pcap, where bytes"):
        capture.serial(parse_line("rtu@9600"))


def test_an_error_while_bytes_are_read_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.csv"

    class Broken(io.BytesIO):
        def readline(self, size: int | None = -1, /) -> bytes:
            raise OSError(5, "Input/output error")

        read1 = readline

    line = parse_line("rtu@9600")
    for content in (_FRAME, _BYTE_TIMES, b"01 03"):
        path.write_bytes(content)
        with open_capture(path, line) as capture:
            monkeypatch.setattr(capture, "stream", Broken())
            with pytest.raises(InputError, match="cannot be read: Input/output error"):
                list(capture.serial(line)[1])


def test_standard_input_that_is_closed_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(InputError, match="standard input: closed; name a file"):
        open_capture("-", None)


@pytest.mark.parametrize("pack", [gzip.compress, zstandard.compress])
def test_a_small_file_cannot_unpack_to_gigabytes(
    tmp_path: Path, pack: Callable[[bytes], bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "FREE_BYTES", 100_000)
    empty = packet(b"", 1_000_000_000)
    path = tmp_path / "bomb"
    path.write_bytes(pack(pcap([empty] * 5_000)))
    assert len([*read_packets(path)]) == 5_000
    path.write_bytes(pack(pcap([empty] * 50_000)))
    with pytest.raises(InputError, match="unpacks to more than 100 times its size"):
        list(read_packets(path))


def test_a_packed_log_may_unpack_to_less_as_it_holds_packed_chunks(tmp_path: Path) -> None:
    data = b"\x89MCAP0\r\n" + bytes(2 * files.FREE_BYTES_OF_LOG)
    path = tmp_path / "bomb.mcap.zst"
    path.write_bytes(zstandard.compress(data))
    with (
        open_capture(path) as capture,
        pytest.raises(InputError, match="unpacks to more than 100 times its size"),
    ):
        capture.stream.read(len(data))


def test_the_parts_of_a_rotated_log_are_named(tmp_path: Path) -> None:
    (tmp_path / "week-0001.mcap").touch()
    with pytest.raises(
        InputError, match=r"week\.mcap: there is no such file; its parts are .*0001"
    ):
        open_capture(tmp_path / "week.mcap")
