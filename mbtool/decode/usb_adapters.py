"""Finds the bytes of serial lines in what USB adapters send and receive."""

# An adapter carries bytes in bulk transfers: from the computer to the line, and from the line to
# the computer. Both are bytes of one line, like those on two wires that one tap hears, since
# nothing tells which side is the master: the computer may ask, answer or only listen. The settings
# of the line are in control transfers, whose form depends on the maker (the functions
# `_..._settings`).
#
# An FTDI adapter begins each USB packet with two status bytes, also a packet without data. A packet
# has 64 or 512 bytes. The descriptors of the adapter give this size; without them the places of
# further status bytes show it. The second status byte has the errors of the line.
#
# A device counts as an adapter once a control transfer, its descriptor or FTDI's status bytes show
# it. Another device with bulk transfers counts only if it carries a whole RTU frame with a correct
# CRC, or the beginning of an ASCII frame: an adapter that was set up before the capture began.
#
# Bytes from the line have the time at which their transfer completed. This is late by the time that
# the adapter holds bytes back (FTDI: up to 16 ms). Bytes to the line begin when their transfer was
# submitted, and end after the time that they take at the line's baud rate.
#
# Memory: a few numbers for each port of each device, and the setups of at most MAX_SETUPS control
# transfers that have not completed. Above MAX_DEVICES, the device that was silent longest is
# forgotten.

from __future__ import annotations

import re
import struct
from collections import OrderedDict, defaultdict
from dataclasses import dataclass, field
from enum import Enum, auto

from mbtool.core import (
    Chunk,
    Direction,
    EventKind,
    LineSettings,
    Origin,
    Packet,
    SerialFormat,
    SerialLink,
    StreamPlace,
    WireEvent,
)
from mbtool.core.limits import MAX_BACK_NS
from mbtool.framing.rtu_lengths import begins_with_frame
from mbtool.packets.usb import BULK, UsbTransfer, read_transfer

MAX_DEVICES = 64
"""At most this many USB devices are followed; a further one makes the one that was silent longest
be forgotten."""
MAX_SETUPS = 64
"""At most this many control transfers wait for their completion; beyond it, the oldest is
forgotten."""

_ASCII_START = re.compile(rb":[0-9A-Fa-f]{2}[0-9A-Fa-f:\r\n]*")
_USUAL_BAUDS = (
    300, 600, 1200, 1800, 2400, 4800, 7200, 9600, 14400, 19200, 28800, 38400, 57600, 76800, 115200,
    128000, 187500, 230400, 250000, 256000, 460800, 500000, 576000, 921600, 1000000, 1500000,
    2000000, 3000000,
)  # fmt: skip
"""The baud rates that a divisor's rate is compared with (_BAUD_TOLERANCE)."""
_BAUD_TOLERANCE = 0.03
"""The rate of a divisor is shown as a usual baud rate if they differ by at most this share
(0 to 1): two UARTs may differ by no more."""
_PARITIES = ("N", "O", "E", "N", "N")
"""The parities in the order of CDC, FTDI and CP210x. Mark and space are read as none."""
_SETUP = struct.Struct("<BBHHH")
_GET_DESCRIPTOR, _DEVICE_DESCRIPTOR, _CONFIGURATION_DESCRIPTOR = 6, 1, 2
_ENDPOINT_DESCRIPTOR, _ENDPOINT_SIZE = 5, 7
_BULK_ENDPOINT = 2


class Maker(Enum):
    """The kind of an adapter."""

    FTDI = auto()
    OTHER = auto()


_MAKERS = {0x0403: Maker.FTDI, 0x1A86: Maker.OTHER, 0x10C4: Maker.OTHER, 0x067B: Maker.OTHER}
"""By USB vendor id, the makers of serial adapters: FTDI, WCH (CH34x), Silicon Labs (CP210x),
Prolific (PL2303)."""

_FTDI_STATUS, _FTDI_IDLE = 0x01, frozenset((0x00, 0x20, 0x40, 0x60))
"""The status bytes of FTDI without data or errors: the low 4 bits of the first, and the values of
the second. No Modbus function has these numbers, so no frame begins like that."""
_FTDI_ERRORS = (
    (0x02, "bytes are lost: the receiver of the adapter was overrun"),
    (0x04, "a parity error"),
    (0x08, "a framing error"),
    (0x10, "a break"),
)
"""The error bits in the second status byte of FTDI, each with its text for the user."""
_PACKET_SIZES = (64, 512)
"""The sizes in bytes of the packets of an FTDI adapter at USB full speed and at high speed."""


@dataclass(slots=True)
class _Port:
    """The settings and times of one port of an adapter; one serial line is at each port."""

    baud: int | None = None
    data_bits: int = 8
    parity: str = "N"
    stop_bits: int = 1
    last_ns: int = 0
    """The time (ns) of the port's last transfer with bytes."""
    sent_ns: int = 0
    """The time at which the last byte that the machine has sent left the adapter."""
    is_ascii: bool | None = None
    """True for ASCII, False for RTU; None until the bytes show the beginning of an ASCII frame or a
    whole RTU frame."""
    line: SerialLink | None = None
    """The line with the settings of its last bytes; None if the settings are unknown."""
    has_changed: bool = False
    """True if the last bytes came with other settings than those before."""
    errors: set[int] = field(default_factory=set)
    """The error bits in the last status that the FTDI adapter sent."""

    def format(self) -> SerialFormat | None:
        """The line's settings; None if no settings were seen, or if Modbus does not allow them."""
        if self.baud is None:
            return None
        try:
            return SerialFormat(self.baud, self.data_bits, self.parity, self.stop_bits)
        except ValueError:
            return None


@dataclass(slots=True)
class _Device:
    """The maker and the ports of one USB device."""

    maker: Maker | None = None
    """The maker of the adapter; None as long as nothing shows that the device is an adapter."""
    packet_size: int | None = None
    ports: defaultdict[int, _Port] = field(default_factory=lambda: defaultdict(_Port))
    """The ports of the adapter by their number, from 0. Only FTDI's adapters have several."""


class UsbAdapters:
    """Takes the packets of a USB capture; returns the bytes of serial lines, and errors."""

    def __init__(self) -> None:
        self._devices: OrderedDict[str, _Device] = OrderedDict()
        self._setups: OrderedDict[tuple[int, int], bytes] = OrderedDict()

    def line(self, link: str) -> SerialLink | None:
        """The link of an adapter, with the settings that it was given; None if they are unknown."""
        port = self._port(link)
        return None if port is None else port.line

    def settings(self, link: str) -> LineSettings | None:
        """The settings that an adapter was given; None if they are unknown."""
        line = self.line(link)
        return None if line is None else LineSettings(line.format, line.ascii)

    def has_changed(self, link: str) -> bool:
        """True if the last bytes of a link came with other settings than those before."""
        port = self._port(link)
        return port is not None and port.has_changed

    def lines(self) -> list[SerialLink]:
        """The links of all adapters whose settings are known."""
        ports = (port for device in self._devices.values() for port in device.ports.values())
        return [port.line for port in ports if port.line is not None]

    def _port(self, link: str) -> _Port | None:
        name, _, number = link.partition("-")
        device = self._devices.get(name)
        return None if device is None else device.ports.get(int(number or 1) - 1)

    def feed(self, packet: Packet) -> list[Chunk | WireEvent]:
        """Take a packet. Never raises, whatever it contains."""
        transfer = read_transfer(packet)
        if transfer is None:
            return []
        name = f"usb{transfer.bus}.{transfer.device}"
        device = self._device(name)
        if transfer.kind != BULK:
            self._control(transfer, device)
            return []
        if transfer.is_in is not transfer.is_completion or not transfer.data:
            return []
        return self._bulk(transfer, device, name, packet)

    def _device(self, name: str) -> _Device:
        device = self._devices.setdefault(name, _Device())
        self._devices.move_to_end(name)
        if len(self._devices) > MAX_DEVICES:
            self._devices.popitem(last=False)
        return device

    def _control(self, transfer: UsbTransfer, device: _Device) -> None:
        key = transfer.device, transfer.id
        if transfer.setup:
            self._setups[key] = transfer.setup
            if len(self._setups) > MAX_SETUPS:
                self._setups.popitem(last=False)
            if not transfer.setup[0] & 0x80:
                _set_up(device, transfer.setup, transfer.data)
        elif transfer.is_completion and transfer.data:
            setup = self._setups.pop(key, b"")
            if setup and setup[0] & 0x80:
                _note_description(device, setup, transfer.data)
        elif transfer.data and key in self._setups:
            _set_up(device, self._setups[key], transfer.data)

    def _bulk(
        self, transfer: UsbTransfer, device: _Device, name: str, packet: Packet
    ) -> list[Chunk | WireEvent]:
        data = transfer.data
        if device.maker is None:
            device.maker = _maker_by_data(data, is_in=transfer.is_in)
            if device.maker is None:
                return []
        pieces: list[Chunk | WireEvent] = []
        is_ftdi = device.maker is Maker.FTDI
        number = max((transfer.endpoint - 1) // 2, 0) if is_ftdi else 0
        port = device.ports[number]
        link = f"{name}-{number + 1}" if number else name
        if is_ftdi and transfer.is_in:
            data, errors = _without_status(data, port, device.packet_size)
            pieces += (_event(packet, link, EventKind.LINE_ERROR, one) for one in errors)
        if data:
            pieces.append(self._chunk(data, transfer, port, link, packet))
        if transfer.missing:
            text = f"a transfer without its last {transfer.missing} bytes; capture longer ones"
            pieces.append(_event(packet, link, EventKind.CUT, text, transfer.missing))
        return pieces

    def _chunk(
        self, data: bytes, transfer: UsbTransfer, port: _Port, link: str, packet: Packet
    ) -> Chunk:
        format_ = port.format()
        if port.is_ascii is None:
            port.is_ascii = _is_ascii(data)
        if format_ is not None:
            line = LineSettings(format_, port.is_ascii or format_.data_bits == 7).link_at(link)
            port.has_changed = port.line is not None and port.line != line
            port.line = line
        if packet.ts_ns < port.last_ns - MAX_BACK_NS:
            port.sent_ns = 0  # The clock was set back.
        port.last_ns = packet.ts_ns
        ts_ns = max(packet.ts_ns, port.sent_ns)
        if not transfer.is_in:
            ts_ns += 0 if format_ is None else len(data) * format_.character_ns
            port.sent_ns = ts_ns
        place = StreamPlace(0, None, Origin(packet.file, packet.number))
        return Chunk(ts_ns=ts_ns, link=link, data=data, place=place)


def _event(packet: Packet, link: str, kind: EventKind, message: str, missing: int = 0) -> WireEvent:
    return WireEvent(ts_ns=packet.ts_ns, link=link, kind=kind, message=message, missing=missing)


def _maker_by_data(data: bytes, *, is_in: bool) -> Maker | None:
    """Return the kind of an adapter that was set up before the capture; None if it may be none."""
    if is_in and len(data) >= 2 and _is_idle_status(data):
        return Maker.FTDI
    return None if _is_ascii(data) is None else Maker.OTHER


def _is_ascii(data: bytes) -> bool | None:
    """True for the beginning of an ASCII frame, False for a whole RTU frame, else None."""
    if _ASCII_START.fullmatch(data):
        return True
    directions = (Direction.REQUEST, Direction.RESPONSE)
    return False if any(begins_with_frame(data, one) for one in directions) else None


def _is_idle_status(data: bytes) -> bool:
    return data[0] & 0x0F == _FTDI_STATUS and data[1] in _FTDI_IDLE


def _without_status(data: bytes, port: _Port, size: int | None) -> tuple[bytes, list[str]]:
    """Take FTDI's status bytes off; return the other bytes, and the errors that begin here."""
    size = size or _packet_size(data)
    parts = [data[at : at + size] for at in range(0, len(data), size)]
    told: list[str] = []
    for part in parts:
        if len(part) < 2:
            continue
        for bit, text in _FTDI_ERRORS:
            if not part[1] & bit:
                port.errors.discard(bit)
            elif bit not in port.errors:
                port.errors.add(bit)
                told.append(text)
    return b"".join(part[2:] for part in parts), told


def _packet_size(data: bytes) -> int:
    """Guess the size of the packets of a transfer by its status bytes."""
    small, large = _PACKET_SIZES
    starts = range(0, len(data) - 1, small)
    has_status = all(data[at] == data[0] and not data[at + 1] & 0x80 for at in starts)
    return small if has_status else large


def _set_up(device: _Device, setup: bytes, data: bytes) -> None:
    """Take the settings in a control transfer to a device."""
    kind, request, value, index, _ = _SETUP.unpack(setup)
    for read in (_cdc_settings, _ftdi_settings, _ch34x_settings, _cp210x_settings):
        if read(device, (kind, request, value, index), data):
            return


_Request = tuple[int, int, int, int]
"""The fields of a setup: bmRequestType, bRequest, wValue, wIndex."""


def _cdc_settings(device: _Device, request: _Request, data: bytes) -> bool:
    """SET_LINE_CODING of USB CDC 1.2 (PSTN), 6.3.10, which PL2303 has, too."""
    if request[:2] != (0x21, 0x20) or len(data) < 7:
        return False
    baud, stop, parity, bits = struct.unpack_from("<IBBB", data)
    device.maker = device.maker or Maker.OTHER
    port = device.ports[0]
    if 0 < baud < 1 << 31:  # With the highest bit set, it is a divisor (PL2303).
        port.baud = _usual_baud_near(baud)
    port.stop_bits, port.data_bits = (2 if stop == 2 else 1), bits
    port.parity = _PARITIES[parity] if parity < len(_PARITIES) else "N"
    return True


def _ftdi_settings(device: _Device, request: _Request, _: bytes) -> bool:
    """SIO_SET_BAUDRATE and SIO_SET_DATA (FTDI AN232B-05; linux/drivers/usb/serial/ftdi_sio.h)."""
    kind, code, value, index = request
    if kind != 0x40 or device.maker is Maker.OTHER:
        return False
    # An adapter with several ports has the number of the port, from 1, in the low byte of the
    # index; other adapters have 0 there, or a bit of the divisor.
    number = max((index & 0xFF) - 1, 0)
    if code == 0x03:
        device.maker = Maker.FTDI
        port = device.ports[number]
        port.baud = _ftdi_baud(value, index)
        return True
    if code == 0x04:
        device.maker = Maker.FTDI
        port = device.ports[number]
        port.data_bits = value & 0xFF
        parity, stop = value >> 8 & 7, value >> 11 & 7
        port.parity = _PARITIES[parity] if parity < len(_PARITIES) else "N"
        port.stop_bits = 2 if stop == 2 else 1
        return True
    return False


def _ftdi_baud(value: int, index: int) -> int:
    """The rate of a divisor: 14 bits of whole, 3 bits that tell eighths, 1 bit for a clock of 12 in
    place of 3 MHz. The highest of these bits are in the high or the low byte of the index, whose
    other byte may be the number of the port.
    """
    eighths = (0, 4, 2, 1, 3, 5, 6, 7)
    rates = []
    for high in dict.fromkeys((index >> 8, index & 0xFF)):
        clock = 12_000_000 if high & 2 else 3_000_000
        divisor = (value & 0x3FFF) + eighths[value >> 14 | (high & 1) << 2] / 8
        divisor = {0: 1.0, 1: 1.5}.get(value | (high & 1) << 16, divisor)
        rates.append(clock / divisor)
    return _usual_baud_near(min(rates, key=_distance))


def _ch34x_settings(device: _Device, request: _Request, _: bytes) -> bool:
    """The registers of CH340 and CH341 (linux/drivers/usb/serial/ch341.c): divisor and format."""
    kind, code, value, index = request
    if kind != 0x40 or device.maker is Maker.FTDI or code not in (0x9A, 0xA1):
        return False
    if code == 0x9A and value not in (0x1312, 0x2518):
        return False
    device.maker = Maker.OTHER
    port = device.ports[0]
    if value == 0x2518 or (code == 0xA1 and value):
        control = index if code == 0x9A else value >> 8
        port.data_bits = 5 + (control & 3)
        port.stop_bits = 2 if control & 4 else 1
        port.parity = ("E" if control & 0x10 else "O") if control & 8 else "N"
    if value == 0x1312 or (code == 0xA1 and index):
        shift = 12 - 3 * (index & 3) - (index >> 2 & 1)
        port.baud = _usual_baud_near(48_000_000 / ((1 << shift) * (0x100 - (index >> 8))))
    return True


def _cp210x_settings(device: _Device, request: _Request, data: bytes) -> bool:
    """SET_BAUDRATE, SET_BAUDDIV and SET_LINE_CTL (Silicon Labs AN571)."""
    kind, code, value, _ = request
    if kind != 0x41 or code not in (0x1E, 0x01, 0x03):
        return False
    port = device.ports[0]
    if code == 0x1E and len(data) >= 4:
        port.baud = _usual_baud_near(int.from_bytes(data[:4], "little"))
    elif code == 0x01 and value:
        port.baud = _usual_baud_near(3_686_400 / value)
    elif code == 0x03:
        parity = value >> 4 & 0xF
        port.parity = _PARITIES[parity] if parity < len(_PARITIES) else "N"
        port.data_bits, port.stop_bits = value >> 8 & 0xF, 2 if value & 0xF == 2 else 1
    device.maker = Maker.OTHER
    return True


def _note_description(device: _Device, setup: bytes, data: bytes) -> None:
    """Take what a device says of itself: its maker, and the size of its packets."""
    kind, request, value, _, _ = _SETUP.unpack(setup)
    if request != _GET_DESCRIPTOR or kind & 0x7F:
        return
    if value >> 8 == _DEVICE_DESCRIPTOR and len(data) >= 12:
        vendor = int.from_bytes(data[8:10], "little")
        device.maker = device.maker or _MAKERS.get(vendor)
    elif value >> 8 == _CONFIGURATION_DESCRIPTOR:
        at = 0
        while at + 2 <= len(data) and data[at]:
            part = data[at : at + data[at]]
            is_endpoint = part[1] == _ENDPOINT_DESCRIPTOR and len(part) >= _ENDPOINT_SIZE
            if is_endpoint and part[3] & 3 == _BULK_ENDPOINT:
                device.packet_size = int.from_bytes(part[4:6], "little") & 0x7FF or None
            at += data[at]


def _distance(rate: float) -> float:
    """Return the distance of a rate to the nearest usual baud rate, as a share (0 to 1) of that."""
    return min(abs(rate - one) / one for one in _USUAL_BAUDS)


def _usual_baud_near(rate: float) -> int:
    """The usual baud rate next to a rate, if it is near; else the rate itself."""
    baud = min(_USUAL_BAUDS, key=lambda one: abs(rate - one) / one)
    return baud if abs(rate - baud) <= _BAUD_TOLERANCE * baud else max(1, round(rate))
