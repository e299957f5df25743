"""Byte streams cut into ADUs where the stream itself tells where an ADU ends. No I/O."""

from mbtool.framing.mbap import MbapSplitter
from mbtool.framing.rtu_over_tcp import RtuStreamSplitter

__all__ = [
    "MbapSplitter",
    "RtuStreamSplitter",
]
