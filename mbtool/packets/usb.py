"""Reads the transfers of USB in captures: usbmon of Linux and USBPcap of Windows."""

# Link types (tcpdump.org/linktypes.html):
#
#     189, 220   usbmon (Linux, Documentation/usb/usbmon.rst): a header of 48 or 64 bytes in the
#                byte order of the machine that captured
#
#                id  type  transfer  endpoint  device  bus  setup?  data?  seconds  microseconds
#                8   1     1         1         1       2    1       1      8        4
#                status  length  captured length  setup
#                4       4       4                8
#
#     249        USBPcap (desowin.org/usbpcap/captureformat.html): a header of 27 bytes and more,
#                little-endian
#
#                header length  id  status  function  info  bus  device  endpoint  transfer  length
#                2              8   4       2         1     2    2       1         1         4
#
# A capture has each transfer twice: once when it is submitted to the bus, once when it is
# completed. Data to a device are in the submission, data from a device in the completion. A control
# transfer begins with 8 setup bytes, which have the request; USBPcap stores them as data of the
# submission.

from __future__ import annotations

import struct
from typing import NamedTuple

from mbtool.core import Packet

USB_LINUX, USB_LINUX_MMAPPED, USBPCAP = 189, 220, 249
USB_LINK_TYPES = frozenset((USB_LINUX, USB_LINUX_MMAPPED, USBPCAP))
CONTROL, BULK = 2, 3

_USBMON = "QBBBBHBB"
_USBMON_SIZES = {USB_LINUX: 48, USB_LINUX_MMAPPED: 64}
_LENGTHS = "ii"
_LENGTHS_AT = 32
_SETUP_AT = 40
_SETUP_SIZE = 8
_USBPCAP = struct.Struct("<HQIHBHHBBI")
_FROM_DEVICE = 1 << 7
_COMPLETE = ord("C")
_PRESENT = 0
_IS_COMPLETION = 1


class UsbTransfer(NamedTuple):
    """One half of a transfer: its submission or its completion."""

    bus: int
    device: int
    endpoint: int
    """The number of the endpoint, without the bit for the direction."""
    is_in: bool
    """True if the device sends the data."""
    kind: int
    """CONTROL or BULK."""
    is_completion: bool
    id: int
    """A number that submission and completion share."""
    setup: bytes
    """The setup of a control transfer; empty if it is not in this half."""
    data: bytes
    missing: int
    """The number of bytes at the end of the data that the capture did not keep."""


def read_transfer(packet: Packet) -> UsbTransfer | None:
    """Return the control or bulk transfer in a packet of a USB capture; None if it holds none."""
    if packet.link_type == USBPCAP:
        return _read_usbpcap(packet.data)
    return _read_usbmon(packet.data, _USBMON_SIZES[packet.link_type])


def _read_usbmon(data: bytes, size: int) -> UsbTransfer | None:
    if len(data) < size:
        return None
    order = "<"
    length, kept = struct.unpack_from("<" + _LENGTHS, data, _LENGTHS_AT)
    if not 0 <= kept <= len(data):
        order = ">"
        length, kept = struct.unpack_from(">" + _LENGTHS, data, _LENGTHS_AT)
    fields = struct.unpack_from(order + _USBMON, data)
    number, event, kind, endpoint, device, bus, no_setup, no_data = fields
    if kind not in (CONTROL, BULK):
        return None
    has_data = no_data == _PRESENT
    content = data[size : size + max(kept, 0)] if has_data else b""
    is_setup = kind == CONTROL and no_setup == _PRESENT and event != _COMPLETE
    return UsbTransfer(
        bus,
        device,
        endpoint & ~_FROM_DEVICE,
        bool(endpoint & _FROM_DEVICE),
        kind,
        event == _COMPLETE,
        number,
        data[_SETUP_AT : _SETUP_AT + _SETUP_SIZE] if is_setup else b"",
        content,
        max(0, length - len(content)) if has_data else 0,
    )


def _read_usbpcap(data: bytes) -> UsbTransfer | None:
    if len(data) < _USBPCAP.size:
        return None
    fields = _USBPCAP.unpack_from(data)
    size, number, _, _, info, bus, device, endpoint, kind, length = fields
    if kind not in (CONTROL, BULK) or not _USBPCAP.size <= size <= len(data):
        return None
    content = data[size : size + length]
    is_completion = bool(info & _IS_COMPLETION)
    setup = b""
    if kind == CONTROL and not is_completion:
        setup, content = content[:_SETUP_SIZE], content[_SETUP_SIZE:]
        length -= len(setup)
    return UsbTransfer(
        bus,
        device,
        endpoint & ~_FROM_DEVICE,
        bool(endpoint & _FROM_DEVICE),
        kind,
        is_completion,
        number,
        setup if len(setup) == _SETUP_SIZE else b"",
        content,
        max(0, length - len(content)),
    )
