"""Replaces in captured packets and frames what shows a plant: addresses, names and texts."""

# These bytes of a packet stay unchanged: the headers of the link layer, of IP, TCP and UDP except
# addresses and IP options, and the payload at Modbus ports except texts. All other bytes become
# zeros: other payload, ARP, trailers behind the IP packet, 802.11 frames without a readable IP
# packet. So packets keep their number, size and order, and are reassembled and decoded as before.
# Packets inside tunnels are treated in the same way. If a packet is whole, its checksums are
# computed anew.
#
# A text is a run of at least MIN_TEXT printable characters, of which most are letters and digits
# and at least MIN_LETTERS are letters; or a run of MIN_WIDE characters with a zero byte before
# each. In responses that identify a device (functions 11H and 2BH), MIN_IDENTITY characters are
# enough. A byte count before a text stays unchanged, even if it is printable. RTU and ASCII frames
# get a new CRC or LRC. A text that continues in the next packet is replaced as two texts.

from __future__ import annotations

import re
import struct
from collections.abc import Container
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import Packet
from mbtool.modbus.adu import MBAP_BYTES, SEVEN_BITS, crc, like_parity, lrc, mbap_size, read_frame
from mbtool.packets.link_layer import IP_FINDERS, NOT_IP, TAGGED, wireless_macs
from mbtool.packets.segment import TCP, UDP, find_tcp, walk_ipv6
from mbtool.packets.tunnels import MAX_TUNNELS, find_inner

if TYPE_CHECKING:
    from mbtool.core.pseudonyms import Pseudonyms

MIN_TEXT = 5
MIN_LETTERS = 3
MIN_WIDE = 4
MIN_IDENTITY = 2

_TEXT = re.compile(rb"[\x20-\x7e]{%d,}" % MIN_TEXT)
_WIDE = re.compile(rb"(?:\0[\x21-\x7e]){%d,}" % MIN_WIDE)
_IDENTITY = re.compile(rb"[\x20-\x7e]{%d,}" % MIN_IDENTITY)
_ASCII = re.compile(rb":[0-9A-Fa-f]{2}[\x20-\x7e]*[\r\n]*")
"""What begins like an ASCII frame, damaged or not, in characters of 7 bits."""
_DIGITS = re.compile(rb"([0-9A-Fa-f]{%d,})" % (2 * MIN_WIDE))
_WORD = re.compile(rb"[A-Za-z0-9]")
_LETTER = re.compile(rb"[A-Za-z]")
_COUNTED = frozenset((0x01, 0x02, 0x03, 0x04, 0x0C, 0x14, 0x15, 0x17, 0x18))
"""Functions behind which a byte count stands."""
_IDENTIFYING = (0x11, 0x2B)
_MACS_AT = {1: (0, 6), 113: (6,), 276: (12,)}
"""By link type, the offsets of the MAC addresses in the link-layer header. Those of 802.11 frames
are found by link_layer.wireless_macs."""
_KEPT_WITHOUT_IP = {0: 4, 1: 14, 9: 4, 50: 4, 104: 4, 105: 2, 108: 4, 113: 16, 127: 8, 276: 20}
"""By link type, the number of bytes that stay at the front of a packet without IP. They hold no
address, or one of _MACS_AT."""
_NOP = 1
_UDP_SIZE = 8


class AnonymousChoice(NamedTuple):
    """What is replaced beside addresses, names and texts."""

    units: bool = False
    """True to replace unit ids, too."""


class AnonymousPackets:
    """Replaces addresses and texts in packets."""

    def __init__(
        self,
        pseudonyms: Pseudonyms,
        ports: Container[int],
        rtu_ports: Container[int],
        choice: AnonymousChoice,
    ) -> None:
        """`ports` are all ports of Modbus, `rtu_ports` those with RTU over TCP or UDP."""
        self._pseudonyms = pseudonyms
        self._ports = ports
        self._rtu_ports = rtu_ports
        self._choice = choice

    def replaced(self, packet: Packet) -> bytes:
        """Return the bytes of a packet with everything replaced. Never raises."""
        data = bytearray(packet.data)
        finder = IP_FINDERS.get(packet.link_type)
        at = NOT_IP if finder is None else finder(packet.data)
        is_ip = NOT_IP < at <= len(data)
        wireless = wireless_macs(packet.link_type, packet.data) if is_ip else ()
        for mac in _MACS_AT.get(packet.link_type, wireless):
            self._replace_mac(data, mac)
        if not is_ip:
            kept = _KEPT_WITHOUT_IP.get(packet.link_type, 0)
            kept = kept if kept <= len(data) else 0
            return bytes(data[:kept]) + bytes(len(data) - kept)
        end = self._replace_ip(data, packet.data, at, packet.original_length, MAX_TUNNELS)
        data[end:] = bytes(len(data) - end)
        return bytes(data)

    def _replace_mac(self, data: bytearray, at: int) -> None:
        if len(data) >= at + 6:
            data[at : at + 6] = self._pseudonyms.mac(bytes(data[at : at + 6]))

    def _replace_ip(self, data: bytearray, given: bytes, at: int, length: int, depth: int) -> int:
        """Replace what an IP packet at offset `at` shows; return the offset of its end.

        `given` is the packet before anything was replaced, `length` its size on the wire.
        """
        seen = len(data)
        version = given[at] >> 4 if seen > at else 0
        if version == 4 and seen >= at + 20:
            size = (given[at] & 0x0F) * 4
            total = int.from_bytes(given[at + 2 : at + 4])
            start, end, protocol = at + size, at + total if total else length, given[at + 9]
            is_later = bool(int.from_bytes(given[at + 6 : at + 8]) & 0x1FFF)
            self._replace_address(data, at + 12, 4)
            self._replace_address(data, at + 16, 4)
            data[at + 20 : min(start, seen)] = bytes((_NOP,)) * max(0, min(start, seen) - at - 20)
        elif version == 6 and seen >= at + 40:
            end, protocol, start = walk_ipv6(given, at, length)
            is_later = False
            self._replace_address(data, at + 8, 16)
            self._replace_address(data, at + 24, 16)
        else:
            data[at:] = bytes(seen - at)
            return seen
        end = max(at, min(end, seen))
        inner = find_inner(given, at, length) if depth else NOT_IP
        if inner > at and inner < seen:
            self._replace_macs_of_tunnel(data, given, inner)
            end = self._replace_ip(data, given, inner, length, depth - 1)
        elif protocol == TCP and is_later:
            data[start:end] = self._without_text(bytes(data[start:end]))
        elif protocol == TCP and start < end:
            self._replace_tcp(data, given, at, start, end, length)
        elif protocol == UDP and not is_later and end >= start + _UDP_SIZE:
            self._replace_udp(data, given, at, start, end, length)
        else:
            data[start:end] = bytes(max(0, end - start))
        if version == 4:
            data[at + 10 : at + 12] = b"\0\0"
            if start <= seen:
                data[at + 10 : at + 12] = _sum(data[at:start]).to_bytes(2)
        return end

    def _replace_address(self, data: bytearray, at: int, size: int) -> None:
        data[at : at + size] = self._pseudonyms.ip(bytes(data[at : at + size]))

    def _replace_macs_of_tunnel(self, data: bytearray, given: bytes, inner: int) -> None:
        """Replace the MAC addresses of an Ethernet header in a tunnel; its IP packet is `inner`."""
        for size in (14, 18, 22):
            begin = inner - size
            kind = given[begin + 12 : begin + 14]
            if begin >= 0 and (kind in TAGGED if size > 14 else kind in (b"\x08\0", b"\x86\xdd")):
                self._replace_mac(data, begin)
                self._replace_mac(data, begin + 6)
                return

    def _replace_tcp(
        self, data: bytearray, given: bytes, at: int, start: int, end: int, length: int
    ) -> None:
        if end < start + 14:
            return
        ports = struct.unpack_from(">HH", given, start)
        begin = min(end, start + max(20, (given[start + 12] >> 4) * 4))
        if any(port in self._ports for port in ports):
            is_rtu = any(port in self._rtu_ports for port in ports)
            data[begin:end] = self.payload(bytes(data[begin:end]), is_rtu=is_rtu)
        else:
            data[begin:end] = bytes(end - begin)
        place = find_tcp(given, at, length)
        if end >= start + 18 and place is not None and place.end <= len(data):
            data[start + 16 : start + 18] = b"\0\0"
            addresses = data[at + 12 : at + 20] if given[at] >> 4 == 4 else data[at + 8 : at + 40]
            pseudo = bytes(addresses) + struct.pack(">HH", TCP, end - start)
            data[start + 16 : start + 18] = _sum(pseudo + bytes(data[start:end])).to_bytes(2)

    def _replace_udp(
        self, data: bytearray, given: bytes, at: int, start: int, end: int, length: int
    ) -> None:
        ports = struct.unpack_from(">HH", given, start)
        begin = start + _UDP_SIZE
        if any(port in self._ports for port in ports):
            is_rtu = any(port in self._rtu_ports for port in ports)
            data[begin:end] = self.payload(bytes(data[begin:end]), is_rtu=is_rtu)
        else:
            data[start:end] = bytes(end - start)
        place = find_tcp(given, at, length, UDP)
        had_sum = any(given[start + 6 : start + 8])
        data[start + 6 : start + 8] = b"\0\0"
        if had_sum and place is not None and place.end <= len(data):
            addresses = data[at + 12 : at + 20] if given[at] >> 4 == 4 else data[at + 8 : at + 40]
            pseudo = bytes(addresses) + struct.pack(">HH", UDP, end - start)
            total = _sum(pseudo + bytes(data[start:end])) or 0xFFFF
            data[start + 6 : start + 8] = total.to_bytes(2)

    def payload(self, data: bytes, *, is_rtu: bool = False) -> bytes:
        """Return the payload of a TCP segment with everything replaced; the same size."""
        if is_rtu:
            return self.rtu(data) if len(data) >= 4 and crc(data) == 0 else self.other(data)
        parts = []
        while len(data) > MBAP_BYTES and data[2:4] == b"\0\0" and mbap_size(data) > MBAP_BYTES:
            size = mbap_size(data)
            parts.append(self.mbap(data[:size]))
            data = data[size:]
        return b"".join(parts) + self.other(data)

    def mbap(self, adu: bytes) -> bytes:
        """Return an ADU of Modbus/TCP, or its beginning, with everything replaced."""
        return adu[:6] + self._unit(adu[6]) + self._pdu(adu[MBAP_BYTES:])

    def rtu(self, frame: bytes) -> bytes:
        """Return an RTU frame with everything replaced, and a new CRC."""
        body = self._unit(frame[0]) + self._pdu(frame[1:-2])
        return body + crc(body).to_bytes(2, "little")

    def ascii(self, raw: bytes) -> bytes:
        """Return an ASCII frame with everything replaced, and a new LRC: wrong if it was."""
        frame = read_frame(raw)
        if frame is None or len(frame.body) < 2:
            return self._damaged_ascii(raw)
        body = self._unit(frame.body[0]) + self._pdu(frame.body[1:])
        error = frame.checksum.received - frame.checksum.computed
        digits = (body + bytes(((lrc(body) + error) & 0xFF,))).hex().encode()
        made = b":" + (digits if frame.is_lower_case else digits.upper()) + frame.end
        return like_parity(made, raw)

    def other(self, data: bytes) -> bytes:
        """Return bytes that are no frame with their texts replaced, also those in ASCII digits."""
        seven = data.translate(SEVEN_BITS)
        made = []
        end = 0
        while match := _ASCII.match(seven, end):
            end = match.end()
            made.append(self.ascii(data[match.start() : end]))
        parts = _DIGITS.split(data[end:])
        parts[1::2] = [self._digits(one) for one in parts[1::2]]
        return b"".join(made) + self._without_text(b"".join(parts))

    def _damaged_ascii(self, raw: bytes) -> bytes:
        """Replace the texts in damaged characters of ASCII; wrong parity bits stay wrong."""
        seven = raw.translate(SEVEN_BITS)
        parts = _DIGITS.split(seven)
        parts[::2] = [self._without_text(one) for one in parts[::2]]
        parts[1::2] = [self._digits(one) for one in parts[1::2]]
        made = like_parity(b"".join(parts), raw)
        errors = zip(raw, like_parity(seven, raw), strict=True)
        return bytes(new ^ old ^ right for new, (old, right) in zip(made, errors, strict=True))

    def _digits(self, digits: bytes) -> bytes:
        """Replace the texts whose bytes are written as hexadecimal digits, from either digit on."""
        for at in (0, 1):
            end = len(digits) - (len(digits) - at) % 2
            made = self._without_text(bytes.fromhex(digits[at:end].decode())).hex().encode()
            made = made if digits != digits.upper() else made.upper()
            digits = digits[:at] + made + digits[end:]
        return digits

    def _unit(self, unit: int) -> bytes:
        return bytes((self._pseudonyms.unit(unit) if self._choice.units else unit,))

    def _pdu(self, pdu: bytes) -> bytes:
        if pdu[:1] and pdu[0] in _IDENTIFYING:
            return pdu[:2] + _IDENTITY.sub(self._text, pdu[2:])
        return self._without_text(pdu)

    def _without_text(self, data: bytes) -> bytes:
        made = _WIDE.sub(self._text, data)
        return _TEXT.sub(lambda match: self._run(match, data), made)

    def _run(self, match: re.Match[bytes], data: bytes) -> bytes:
        """Replace a run of printable characters if it is a text, but for a byte count before it."""
        run = match[0]
        at = match.start()
        before = data[at - 1] if at else -1
        is_count = before in _COUNTED or (before >= 0 and run[0] == 2 * before)
        head, text = (run[:1], run[1:]) if is_count else (b"", run)
        words, letters = len(_WORD.findall(text)), len(_LETTER.findall(text))
        if letters < MIN_LETTERS or 2 * words < len(text):
            return run
        return head + self._pseudonyms.text(text)

    def _text(self, match: re.Match[bytes]) -> bytes:
        return self._pseudonyms.text(match[0])


def _sum(data: bytes | bytearray) -> int:
    """The Internet checksum of bytes (RFC 1071)."""
    data = bytes(data) + bytes(len(data) % 2)
    total: int = sum(struct.unpack(f">{len(data) // 2}H", data))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF
