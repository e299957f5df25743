"""The decoder of a two-wire serial line: RTU and ASCII frames from bytes and times. No I/O."""

from mbtool.serial_line.ascii import AsciiSplitter
from mbtool.serial_line.rtu import RtuSplitter

__all__ = [
    "AsciiSplitter",
    "RtuSplitter",
]
