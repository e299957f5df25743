"""Says what a file that cannot be read looks like, and what would help."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import NamedTuple

from mbtool.core.moments import counted

_READ = "pcap, pcapng and MCAP are read, plain or packed with gzip or zstd"
_FEW_BYTES = 4
_CONTROLS = bytes(set(range(32)) - set(b"\t\n\v\f\r\b\x1b"))
_MOST_FOREIGN = 0.3
"""A text of another encoding than UTF-8 has at most this share of bytes above 7F."""


class Appearance(NamedTuple):
    """A kind of file that is no capture of this program's kinds."""

    is_like: Callable[[bytes], object]
    """Takes the first 64 bytes of a file; true if it is of this kind."""
    words: str
    help: str
    """What the user can do; empty if nothing helps."""


def _starts(*magics: bytes) -> Callable[[bytes], object]:
    return lambda head: head.startswith(magics)


_UNPACK = "unpack it first"
_SAVE_AS = "open it in Wireshark and save it as pcapng"
_EXPORT = "in Logic 2 export it: the table of the analyser, Export to CSV"

APPEARANCES = (
    Appearance(_starts(b"\x7fELF"), "an ELF program", ""),
    Appearance(
        re.compile(rb"PK\x03\x04.{22}.{4}(?:digital-|meta\.json|analog-)", re.DOTALL).match,
        "a recording of Saleae Logic 2 (.sal)",
        _EXPORT,
    ),
    Appearance(_starts(b"PK\x03\x04", b"PK\x05\x06"), "a zip archive", _UNPACK),
    Appearance(_starts(b"\xfd7zXZ\0"), "an xz archive", _UNPACK + ": xz -d"),
    Appearance(_starts(b"BZh"), "a bzip2 archive", _UNPACK + ": bunzip2"),
    Appearance(_starts(b"\x04\x22\x4d\x18"), "an lz4 archive", _UNPACK + ": lz4 -d"),
    Appearance(_starts(b"7z\xbc\xaf\x27\x1c"), "a 7z archive", _UNPACK),
    Appearance(_starts(b"Rar!"), "a RAR archive", _UNPACK),
    Appearance(_starts(b"%PDF"), "a PDF document", "save the log as text"),
    Appearance(
        _starts(b"\x89PNG", b"\xff\xd8\xff", b"GIF8", b"BM"),
        "a picture",
        "copy the log as text",
    ),
    Appearance(_starts(b"\xd0\xcf\x11\xe0"), "an Office document", "save the log as text or CSV"),
    Appearance(_starts(b"PAR1"), "a Parquet file", ""),
    Appearance(_starts(b"SQLite format 3\0"), "an SQLite database", ""),
    Appearance(_starts(b"snoop\0\0\0"), "a capture of snoop", _SAVE_AS),
    Appearance(_starts(b"GMBU", b"RTSS"), "a capture of Microsoft Network Monitor", _SAVE_AS),
    Appearance(_starts(b"btsnoop\0"), "a capture of Bluetooth", ""),
    Appearance(
        re.compile(rb"(?i)\s*<(?:!doctype html|html)").match,
        "a web page",
        "download the file itself, not the page that shows it",
    ),
    Appearance(
        re.compile(rb"\{\"(?:link|kind|ts_ns)\"").match,
        "JSON",
        "if it has transactions of decode --format jsonl, mbtool convert makes a log of it: "
        "convert X.jsonl X.mcap",
    ),
)


def find_appearance(head: bytes) -> Appearance | None:
    """Return the kind of file that begins with `head`; None if it is of no known kind."""
    return next((one for one in APPEARANCES if one.is_like(head)), None)


def is_text(head: bytes) -> bool:
    """True if a file that begins with `head` is a text, in UTF-8, UTF-16 or 8 bits a character."""
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return True
    if not head or head.translate(None, _CONTROLS) != head:
        return False
    try:
        head.decode("utf-8")
    except UnicodeDecodeError as error:
        if error.start <= len(head) - 4:
            return sum(byte > 0x7F for byte in head) <= _MOST_FOREIGN * len(head)
    return True


def unknown_file(head: bytes) -> str:
    """Say what a file looks like that cannot be read, and what would help.

    `head` are its first bytes, after a byte order mark.
    """
    found = find_appearance(head)
    if found is not None:
        hint = f"; {found.help}" if found.help else f"; {_READ}"
        return f"{found.words}, no capture{hint}"
    return (
        f"a file that begins with {head[:8].hex(' ')}, no capture; {_READ}; "
        "if it holds bytes of a serial line, say which: --link rtu@19200-8E1"
    )


def text_without_frames(lines: int, bytes_seen: int) -> str:
    """Say what a text of `lines` lines looks like that has no Modbus frame, and what would help.

    `bytes_seen` is the number of bytes that it shows in hexadecimal or with escapes.
    """
    text = f"a text file of {counted(lines, 'line')}, no capture; "
    if bytes_seen < _FEW_BYTES:
        return text + (
            "it shows no bytes, so there is nothing to decode: let its program log at the level "
            "debug or trace, or record the traffic: mbtool sniff LINK -w FILE.mcap"
        )
    return text + (
        f"it shows {counted(bytes_seen, 'byte')}, but no whole Modbus frame with a correct CRC, "
        "LRC or MBAP length; are frames cut, or their ends left out? "
        "If it holds bytes of a serial line, say which: --link rtu@19200-8E1"
    )
