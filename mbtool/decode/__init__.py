"""Decodes evidence into transactions: protocol detection, framing, pairing. No I/O."""

from mbtool.decode.connections import Bus, ConnectionDecoder, Decoded
from mbtool.decode.protocol_detection import ProtocolDetector, ProtocolState
from mbtool.decode.tap_pair import TapPair

__all__ = [
    "Bus",
    "ConnectionDecoder",
    "Decoded",
    "ProtocolDetector",
    "ProtocolState",
    "TapPair",
]
