"""From evidence to transactions: framing, pairing, protocol detection. No I/O."""

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
