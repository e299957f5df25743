"""Recognises other protocols by the first bytes of their messages."""

from __future__ import annotations

import re

TLS = "TLS"

_PATTERNS = {
    # The first bytes of a TLS record (RFC 8446, 5.1): content type and version.
    TLS: re.compile(rb"[\x14-\x17]\x03[\x01-\x04]"),
    "HTTP": re.compile(rb"(?:GET|HEAD|POST|PUT|OPTIONS|CONNECT|DELETE|TRACE) |HTTP/"),
    "SSH": re.compile(rb"SSH-"),
    # The first bytes of an LDAP message (RFC 4511, 4.1.1): a SEQUENCE that begins with an INTEGER
    # of 1 to 4 bytes.
    "LDAP": re.compile(rb"(?s)\x30(?:\x84....|[\x05-\x7F])\x02[\x01-\x04]"),
    # The first bytes of a TPKT packet (RFC 1006, 6): version 3, a zero, the length, and the length
    # and kind of a COTP header.
    "TPKT, as of S7 or RDP": re.compile(rb"(?s)\x03\x00...[\xE0\xD0\xF0]"),
    # The first bytes of a DCE/RPC message (The Open Group's C706, 12.6.3): version 5.0 or 5.1, then
    # a packet type of 00 to 13H.
    "DCE/RPC": re.compile(rb"\x05[\x00\x01][\x00-\x13]"),
}
_TLS_RECORD = re.compile(rb"(?s)[\x14-\x17]\x03[\x01-\x04](?:[\x00-\x3F].|[\x40-\x48].)")
"""The head of a TLS record: content type, version, and a length of at most 2^14 + 2048 bytes (RFC
8446, 5.1, and RFC 5246, 6.2.3)."""


def foreign_protocol(head: bytes) -> str | None:
    """Return the name of the protocol whose messages begin like these bytes; None if unknown."""
    return next((name for name, pattern in _PATTERNS.items() if pattern.match(head)), None)


def begins_tls_record(head: bytes) -> bool:
    """True if bytes begin with the whole head of a TLS record, with a length that TLS allows."""
    return _TLS_RECORD.match(head) is not None
