"""Makes packets of USB captures, from the documents of usbmon and USBPcap."""

from __future__ import annotations

import struct

from mbtool.core import Packet
from mbtool.packets.usb import BULK, CONTROL, USB_LINUX, USBPCAP

BUS, DEVICE = 1, 5
IN = 0x80
MS = 1_000_000


class UsbCapture:
    """The packets of one adapter, in one of the forms of USB captures."""

    def __init__(self, link_type: int, order: str = "<", device: int = DEVICE) -> None:
        self._link_type = link_type
        self._order = order
        self._device = device
        self._id = 100
        self.packets: list[Packet] = []

    def control(self, ms: float, setup: bytes, data: bytes = b"", answer: bytes = b"") -> None:
        """A control transfer: `data` goes to the device, `answer` comes from it."""
        endpoint = IN if setup[0] & 0x80 else 0
        if self._link_type == USBPCAP:
            self._pcap(ms, endpoint, CONTROL, setup + data, is_done=False, stage=b"\0")
            self._pcap(ms + 0.1, endpoint, CONTROL, answer, is_done=True, stage=b"\3")
        else:
            self._mon(ms, endpoint, CONTROL, "S", data, setup)
            self._mon(ms + 0.1, endpoint, CONTROL, "C", answer)
        self._id += 1

    def sent(self, ms: float, data: bytes, endpoint: int = 2) -> None:
        """Bytes from the machine to the adapter."""
        self._bulk(ms, endpoint, data, b"")

    def received(self, ms: float, data: bytes, endpoint: int = 1) -> None:
        """Bytes from the adapter to the machine."""
        self._bulk(ms, endpoint | IN, b"", data)

    def ask(self, ms: float, request: bytes, response: bytes, status: bytes = b"") -> None:
        """A request that the machine sends, and its response; FTDI puts `status` before it."""
        self.sent(ms, request)
        self.received(ms + 20, status + response)

    def _bulk(self, ms: float, endpoint: int, submitted: bytes, completed: bytes) -> None:
        if self._link_type == USBPCAP:
            self._pcap(ms - 0.1, endpoint, BULK, submitted, is_done=False)
            self._pcap(ms, endpoint, BULK, completed, is_done=True)
        else:
            begin = ms if submitted else ms - 0.1
            self._mon(begin, endpoint, BULK, "S", submitted)
            self._mon(ms + 0.05 if submitted else ms, endpoint, BULK, "C", completed)
        self._id += 1

    def _mon(
        self, ms: float, endpoint: int, kind: int, event: str, data: bytes, setup: bytes = b""
    ) -> None:
        header = struct.pack(
            self._order + "QBBBBHBBqiiII8s",
            self._id,
            ord(event),
            kind,
            endpoint,
            self._device,
            BUS,
            0 if setup else ord("-"),
            0 if data else ord(">"),
            int(ms // 1000),
            int(ms % 1000 * 1000),
            0,
            len(data),
            len(data),
            setup.ljust(8, b"\0"),
        )
        more = b"" if self._link_type == USB_LINUX else bytes(16)
        self._add(ms, header + more + data)

    def _pcap(
        self, ms: float, endpoint: int, kind: int, data: bytes, *, is_done: bool, stage: bytes = b""
    ) -> None:
        header = struct.pack(
            "<HQIHBHHBBI",
            27 + len(stage),
            self._id,
            0,
            9,
            is_done,
            BUS,
            self._device,
            endpoint,
            kind,
            len(data),
        )
        self._add(ms, header + stage + data)

    def _add(self, ms: float, data: bytes) -> None:
        self.packets.append(
            Packet(
                ts_ns=round(ms * MS),
                link="usbmon1",
                link_type=self._link_type,
                data=data,
                original_length=len(data),
            )
        )


def setup(kind: int, request: int, value: int = 0, index: int = 0, length: int = 0) -> bytes:
    """The setup of a control transfer."""
    return struct.pack("<BBHHH", kind, request, value, index, length)


def device_descriptor(vendor: int) -> bytes:
    return struct.pack(
        "<BBHBBBBHHHBBBB", 18, 1, 0x200, 0, 0, 0, 8, vendor, 0x6001, 0x600, 1, 2, 3, 1
    )
