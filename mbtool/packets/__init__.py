"""Reads capture files and reassembles the bytes of TCP connections and serial lines.

Opens no file.
"""

from mbtool.packets.capture import CAPTURE_MAGICS, read_capture
from mbtool.packets.line_packets import (
    SERIAL_LINK_TYPES,
    USER_LINK_TYPES,
    CaptureHead,
    LinePacket,
    reads_of,
    serial_pieces,
)
from mbtool.packets.pcap import PCAP_MAGICS
from mbtool.packets.pcapng import PCAPNG_MAGIC
from mbtool.packets.reassembler import TcpReassembler
from mbtool.packets.stream_events import (
    CloseReason,
    StreamClosed,
    StreamEvent,
    StreamGap,
    StreamItem,
    StreamOpened,
)

__all__ = [
    "CAPTURE_MAGICS",
    "PCAPNG_MAGIC",
    "PCAP_MAGICS",
    "SERIAL_LINK_TYPES",
    "USER_LINK_TYPES",
    "CaptureHead",
    "CloseReason",
    "LinePacket",
    "StreamClosed",
    "StreamEvent",
    "StreamGap",
    "StreamItem",
    "StreamOpened",
    "TcpReassembler",
    "read_capture",
    "reads_of",
    "serial_pieces",
]
