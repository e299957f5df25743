"""Cuts byte streams into ADUs by their lengths, without silences. No I/O."""

from mbtool.framing.mbap import MbapSplitter
from mbtool.framing.rtu_over_tcp import RtuStreamSplitter

__all__ = [
    "MbapSplitter",
    "RtuStreamSplitter",
]
