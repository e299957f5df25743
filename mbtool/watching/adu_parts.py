"""Splits the bytes of an ADU into named fields, so that they can be shown field by field."""

# Offsets count the raw bytes as captured. An ASCII frame has two hexadecimal digits for each byte
# of unit, PDU and LRC.

from __future__ import annotations

from typing import NamedTuple

from mbtool.core import Direction
from mbtool.modbus import Transport
from mbtool.modbus.pdu import LAYOUTS

_MBAP = (("transaction id", 2), ("protocol id", 2), ("length", 2), ("unit", 1))
_SERIAL = (("unit", 1),)


class AduPart(NamedTuple):
    """A field of an ADU: the bytes from `begin` up to, but not including, `end`."""

    name: str
    begin: int
    end: int


def adu_parts(transport: Transport, raw: bytes, direction: Direction) -> list[AduPart]:
    """Return the fields of an ADU, in order; together they cover all its bytes. Never raises."""
    if transport is Transport.ASCII:
        return _ascii_parts(raw, direction)
    is_tcp = transport.has_mbap
    check = 0 if is_tcp else min(2, max(len(raw) - 2, 0))
    body = raw[: len(raw) - check]
    parts = _body_parts(body, _MBAP if is_tcp else _SERIAL, direction)
    if check:
        parts.append(AduPart("CRC", len(body), len(raw)))
    return parts


def _body_parts(
    body: bytes, header: tuple[tuple[str, int], ...], direction: Direction
) -> list[AduPart]:
    """Return the fields of `body`, an ADU without its CRC or LRC.

    `header` has name and width in bytes of each field before the function code.
    """
    at = sum(width for _, width in header)
    fields = [*header, ("function", 1)]
    if len(body) > at:
        fields += LAYOUTS[direction][body[at]].heads
    parts: list[AduPart] = []
    begin = 0
    for name, width in fields:
        end = min(begin + width, len(body))
        if end > begin:
            parts.append(AduPart(name.replace("_", " "), begin, end))
        begin = end
    if begin < len(body):
        parts.append(AduPart("data", begin, len(body)))
    return parts


def _ascii_parts(raw: bytes, direction: Direction) -> list[AduPart]:
    digits = raw[1:].rstrip(b"\r\n")
    try:
        body = bytes.fromhex(digits.decode("ascii"))
    except (UnicodeDecodeError, ValueError):
        return [AduPart("data", 0, len(raw))] if raw else []
    inner = _body_parts(body[:-1], _SERIAL, direction)
    parts = [AduPart("start", 0, 1)]
    parts += [AduPart(name, 1 + 2 * begin, 1 + 2 * end) for name, begin, end in inner]
    end = 1 + len(digits)
    if body:
        parts.append(AduPart("LRC", end - 2, end))
    if end < len(raw):
        parts.append(AduPart("end", end, len(raw)))
    return parts
