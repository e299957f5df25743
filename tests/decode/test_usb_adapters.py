"""Serial lines in captures of USB: FTDI, CH34x, CP210x, PL2303 and CDC-ACM."""

from __future__ import annotations

import random
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import LineSettings, Packet, SerialFormat, WireEvent
from mbtool.decode.decoder import Decoder
from mbtool.decode.usb_adapters import MAX_DEVICES, UsbAdapters
from mbtool.devices import Assignments, NamedTransaction, Namer
from mbtool.modbus import ascii_adu, rtu_adu
from mbtool.packets.usb import USB_LINK_TYPES, USB_LINUX, USB_LINUX_MMAPPED, USBPCAP
from tests.packets.usb_captures import UsbCapture, device_descriptor, setup

if TYPE_CHECKING:
    from collections.abc import Callable

LINK = "usb1.5"
STATUS = b"\x01\x60"


def _read(number: int) -> tuple[bytes, bytes]:
    request = rtu_adu(1, bytes((3, 0, number, 0, 2)))
    return request, rtu_adu(1, bytes((3, 4, 0, number, 1, number)))


def _decoded(
    packets: list[Packet], line: LineSettings | None = None
) -> tuple[list[NamedTransaction], list[WireEvent], Decoder]:
    decoder = Decoder(Namer(Assignments()), line=line)
    records = [record for packet in packets for record in decoder.feed(packet)] + decoder.close()
    return (
        [one for one in records if not isinstance(one, WireEvent)],
        [one for one in records if isinstance(one, WireEvent)],
        decoder,
    )


def _cdc(capture: UsbCapture, kind: int = 0x21) -> None:
    coding = (9600).to_bytes(4, "little") + bytes((0, 2, 8))
    capture.control(1, setup(kind, 0x20, length=7), coding)


def _ftdi(capture: UsbCapture) -> None:
    capture.control(0, setup(0x80, 6, 0x100, length=18), answer=device_descriptor(0x0403))
    capture.control(1, setup(0x40, 3, 0x4138))  # 3 MHz / 312.5 = 9600
    capture.control(2, setup(0x40, 4, 0x0208))  # 8 data bits, even parity, 1 stop bit


def _ch341(capture: UsbCapture) -> None:
    capture.control(1, setup(0x40, 0x9A, 0x1312, 0xB282))  # 48 MHz / 64 / 78 = 9615
    capture.control(2, setup(0x40, 0x9A, 0x2518, 0x00DB))  # 8 data bits, even parity


def _ch340_of_windows(capture: UsbCapture) -> None:
    capture.control(1, setup(0x40, 0xA1, 0xDB9C, 0xB282))


def _cp210x(capture: UsbCapture) -> None:
    capture.control(1, setup(0x41, 0x1E, length=4), (9600).to_bytes(4, "little"))
    capture.control(2, setup(0x41, 3, 0x0820))


def _old_cp210x(capture: UsbCapture) -> None:
    capture.control(1, setup(0x41, 1, 384))
    capture.control(2, setup(0x41, 3, 0x0820))


ADAPTERS: dict[str, tuple[Callable[[UsbCapture], None], bytes]] = {
    "CDC-ACM and PL2303": (_cdc, b""),
    "FTDI": (_ftdi, STATUS),
    "CH341": (_ch341, b""),
    "CH340 of Windows": (_ch340_of_windows, b""),
    "CP2102": (_cp210x, b""),
    "CP2101": (_old_cp210x, b""),
}


@pytest.mark.parametrize("link_type", sorted(USB_LINK_TYPES))
@pytest.mark.parametrize("adapter", ADAPTERS)
def test_each_adapter_gives_the_line_and_its_settings(adapter: str, link_type: int) -> None:
    begin, status = ADAPTERS[adapter]
    capture = UsbCapture(link_type)
    begin(capture)
    for number in range(8):
        capture.ask(100 + 50 * number, *_read(number), status)
        if status:
            capture.received(130 + 50 * number, status)  # Nothing came: status only.
    found, events, decoder = _decoded(capture.packets)
    assert events == []
    assert [(one.link, str(one.outcome), one.response_values) for one in found] == [
        (LINK, "ok", [number, 256 + number]) for number in range(8)
    ]
    settings = decoder.line_of(LINK).format
    assert settings == SerialFormat(9600, 8, "E", 1)
    # A request of 8 characters of 11 bits takes 9.2 ms, the response of 9 has come after 20 ms; a
    # submission is 0.1 ms earlier in one of the forms.
    assert {0.45 < (one.latency_ns or 0) / 1e6 < 0.65 for one in found} == {True}


@pytest.mark.parametrize("link_type", [USB_LINUX, USB_LINUX_MMAPPED])
def test_a_capture_of_a_machine_with_the_other_byte_order_is_read(link_type: int) -> None:
    capture = UsbCapture(link_type, ">")
    _cp210x(capture)
    capture.ask(100, *_read(7))
    found, _, _ = _decoded(capture.packets)
    assert [(one.link, str(one.outcome)) for one in found] == [(LINK, "ok")]


@pytest.mark.parametrize("status", [b"", STATUS])
def test_an_adapter_that_was_set_up_before_the_capture_is_found_by_its_bytes(status: bytes) -> None:
    capture = UsbCapture(USB_LINUX_MMAPPED)
    capture.received(50, status)
    for number in range(3):
        capture.ask(100 + 50 * number, *_read(number), status)
    found, events, _ = _decoded(capture.packets)
    assert ([str(one.outcome) for one in found], events) == (["ok"] * 3, [])


@pytest.mark.parametrize("size", [64, 512])
def test_status_bytes_stand_before_each_packet_of_a_transfer(size: int) -> None:
    capture = UsbCapture(USBPCAP)
    _ftdi(capture)
    request = rtu_adu(1, bytes.fromhex("03 0000 007d"))
    response = rtu_adu(1, b"\x03\xfa" + bytes(range(250)))
    parts = [response[at : at + size - 2] for at in range(0, len(response), size - 2)]
    capture.ask(100, request, b"".join(STATUS + part for part in parts))
    found, events, _ = _decoded(capture.packets)
    assert events == []
    assert [str(one.outcome) for one in found] == ["ok"]
    assert found[0].response_raw == response


def test_errors_in_the_status_of_ftdi_are_told_when_they_begin() -> None:
    capture = UsbCapture(USB_LINUX_MMAPPED)
    _ftdi(capture)
    for at, status in enumerate((0x60, 0x64, 0x64, 0x60, 0x6C, 0x70, 0x62)):
        capture.received(100 + at, bytes((1, status)))
    _, events, _ = _decoded(capture.packets)
    assert [one.message for one in events] == [
        "a parity error",
        "a parity error",
        "a framing error",
        "a break",
        "bytes are lost: the receiver of the adapter was overrun",
    ]
    assert {str(one.kind) for one in events} == {"line-error"}


def test_the_ports_of_one_adapter_are_lines_of_their_own() -> None:
    capture = UsbCapture(USB_LINUX_MMAPPED)
    _ftdi(capture)
    for number in range(3):
        request, response = _read(number)
        capture.sent(100 + 100 * number, request, 4)
        capture.received(120 + 100 * number, STATUS + response, 3)
        capture.ask(150 + 100 * number, *_read(number), STATUS)
    found, _, _ = _decoded(capture.packets)
    assert sorted((one.link, str(one.outcome)) for one in found) == [
        *[(LINK, "ok")] * 3,
        *[(f"{LINK}-2", "ok")] * 3,
    ]


def test_each_port_of_an_adapter_has_settings_and_times_of_its_own() -> None:
    capture = UsbCapture(USB_LINUX_MMAPPED)
    for port, divisor in ((1, 0x4138), (2, 0x809C)):
        capture.control(port, setup(0x40, 3, divisor, port))  # 9600 and 19200
        capture.control(port, setup(0x40, 4, 0x0208 if port == 1 else 0x0108, port))
    capture.sent(100, bytes(200))
    capture.sent(101, _read(1)[0], 4)
    adapters = UsbAdapters()
    pieces = [piece for packet in capture.packets for piece in adapters.feed(packet)]
    assert [one.format for one in adapters.lines()] == [
        SerialFormat(9600, 8, "E", 1),
        SerialFormat(19200, 8, "O", 1),
    ]
    assert pieces[1].ts_ns < pieces[0].ts_ns  # The first port still sends for 0.2 s.


def test_a_machine_that_only_listens_hears_both_sides() -> None:
    capture = UsbCapture(USB_LINUX_MMAPPED)
    _ftdi(capture)
    for number in range(5):
        request, response = _read(number)
        capture.received(100 + 100 * number, STATUS + request)
        capture.received(130 + 100 * number, STATUS + response)
    found, _, _ = _decoded(capture.packets)
    assert [str(one.outcome) for one in found] == ["ok"] * 5


def test_an_ascii_line_is_known_by_its_first_bytes() -> None:
    capture = UsbCapture(USB_LINUX_MMAPPED)
    _cdc(capture)
    for number in range(3):
        request = ascii_adu(1, bytes((3, 0, number, 0, 1)))
        capture.ask(100 + 100 * number, request, ascii_adu(1, bytes((3, 2, 0, number))))
    found, _, _ = _decoded(capture.packets)
    assert [(str(one.transport), str(one.outcome)) for one in found] == [("ascii", "ok")] * 3


@pytest.mark.parametrize("begun", [b"02C5\r\n", b"\xff"])
def test_an_ascii_line_whose_first_bytes_are_no_beginning_is_known_by_later_ones(
    begun: bytes,
) -> None:
    capture = UsbCapture(USB_LINUX_MMAPPED)
    _cdc(capture)
    capture.received(50, begun)
    for number in range(3):
        request = ascii_adu(1, bytes((3, 0, number, 0, 1)))
        capture.ask(100 + 100 * number, request, ascii_adu(1, bytes((3, 2, 0, number))))
    found, _, decoder = _decoded(capture.packets)
    assert [(str(one.transport), str(one.outcome)) for one in found] == [("ascii", "ok")] * 3
    assert decoder.line_of(LINK).ascii


def test_a_line_with_7_data_bits_is_ascii() -> None:
    capture = UsbCapture(USB_LINUX_MMAPPED)
    capture.control(1, setup(0x21, 0x20, length=7), (9600).to_bytes(4, "little") + b"\0\2\7")
    capture.received(50, b"C5\r\n")
    _, _, decoder = _decoded(capture.packets)
    assert decoder.line_of(LINK).ascii


def test_a_colon_in_a_part_of_an_rtu_frame_makes_no_ascii_line() -> None:
    capture = UsbCapture(USB_LINUX_MMAPPED)
    _cdc(capture)
    capture.received(50, b":12\x80")
    capture.ask(100, *_read(1))
    _, _, decoder = _decoded(capture.packets)
    assert not decoder.line_of(LINK).ascii


def test_settings_that_the_user_gives_override_those_of_the_adapter() -> None:
    capture = UsbCapture(USB_LINUX_MMAPPED)
    _cp210x(capture)
    capture.ask(100, *_read(1))
    _, _, decoder = _decoded(capture.packets, LineSettings(SerialFormat(19200)))
    assert decoder.line_of(LINK).format == SerialFormat(19200)


def test_settings_that_change_hold_from_then_on() -> None:
    capture = UsbCapture(USB_LINUX_MMAPPED)
    _cp210x(capture)
    capture.ask(100, *_read(1))
    capture.control(200, setup(0x41, 0x1E, length=4), (57600).to_bytes(4, "little"))
    capture.ask(300, *_read(2))
    found, _, decoder = _decoded(capture.packets)
    assert decoder.line_of(LINK).format.baud == 57600
    assert [str(one.outcome) for one in found] == ["ok"] * 2


def test_the_lines_of_adapters_that_are_gone_are_forgotten() -> None:
    decoder = Decoder(Namer(Assignments()))
    adapters = UsbAdapters()
    for device in range(1, MAX_DEVICES + 11):
        capture = UsbCapture(USB_LINUX_MMAPPED, device=device)
        _cp210x(capture)
        capture.ask(100, *_read(1))
        for packet in capture.packets:
            adapters.feed(packet)
            decoder.feed(packet)
    kept = [f"usb1.{device}" for device in range(11, MAX_DEVICES + 11)]
    assert [one.name for one in adapters.lines()] == kept
    assert decoder.line_of("usb1.1").format == decoder.line_of("none").format
    assert decoder.line_of("usb1.11").format == SerialFormat(9600, 8, "E", 1)


def test_times_go_on_after_the_clock_was_set_back() -> None:
    capture = UsbCapture(USB_LINUX_MMAPPED)
    _cp210x(capture)
    for ms in (4_000_000, 400_000, 400_100):
        capture.ask(ms, *_read(1))
    adapters = UsbAdapters()
    pieces = [piece for packet in capture.packets for piece in adapters.feed(packet)]
    assert [one.ts_ns // 1_000_000_000 for one in pieces] == [4000, 4000, 400, 400, 400, 400]


def test_bytes_that_wait_behind_a_long_transfer_are_sent_after_it() -> None:
    capture = UsbCapture(USB_LINUX_MMAPPED)
    _cp210x(capture)
    for ms in (100, 101, 102):
        capture.sent(ms, _read(1)[0] * 10)
    adapters = UsbAdapters()
    ends = [piece.ts_ns for packet in capture.packets for piece in adapters.feed(packet)]
    took_ns = 80 * SerialFormat(9600, 8, "E", 1).character_ns
    assert [later - one for one, later in pairwise(ends)] == [took_ns, took_ns]


def test_other_devices_on_the_bus_are_passed_over() -> None:
    capture = UsbCapture(USB_LINUX_MMAPPED)
    noise = random.Random(5)
    for at in range(50):
        capture.sent(at, b"USBC" + noise.randbytes(27))
        capture.received(at + 0.3, noise.randbytes(512))
    assert _decoded(capture.packets)[:2] == ([], [])


@pytest.mark.parametrize(
    ("value", "index", "baud"),
    [
        (0x4138, 0, 9600),
        (0x0271, 0, 4800),
        (0x2710, 0, 300),
        (0xC04E, 0, 38400),
        (0x0034, 0, 57600),
        (0x001A, 0, 115200),
        (0x000D, 0, 230400),
        (0x0000, 0, 3000000),
        (0x0001, 0, 2000000),
        (0x809C, 0, 19200),
        (0xC027, 0, 76800),
        (0x04E2, 0x0200, 9600),
        (0x4138, 0x0001, 9600),
        (0x0068, 0x0201, 115200),
    ],
)
def test_the_divisor_of_ftdi_tells_the_rate(value: int, index: int, baud: int) -> None:
    capture = UsbCapture(USB_LINUX)
    _ftdi(capture)
    capture.control(5, setup(0x40, 3, value, index))
    capture.ask(100, *_read(1), STATUS)
    _, _, decoder = _decoded(capture.packets)
    assert decoder.line_of(LINK).format.baud == baud


def test_a_transfer_that_the_capture_has_cut_is_told() -> None:
    capture = UsbCapture(USBPCAP)
    _cp210x(capture)
    capture.ask(100, *_read(1))
    last = capture.packets[-1]
    capture.packets[-1] = replace(last, data=last.data[:-3])
    found, events, _ = _decoded(capture.packets)
    assert "cut" in [str(one.kind) for one in events]
    assert [str(one.outcome) for one in found] == ["not-captured"]


@given(data=st.binary(max_size=200), link_type=st.sampled_from(sorted(USB_LINK_TYPES)))
def test_no_bytes_raise(data: bytes, link_type: int) -> None:
    packet = Packet(
        ts_ns=0, link="usbmon1", link_type=link_type, data=data, original_length=len(data)
    )
    UsbAdapters().feed(packet)


@given(data=st.data(), link_type=st.sampled_from(sorted(USB_LINK_TYPES)))
def test_no_changed_capture_raises(data: st.DataObject, link_type: int) -> None:
    capture = UsbCapture(link_type)
    _ftdi(capture)
    capture.control(3, setup(0x80, 6, 0x200, length=32), answer=bytes(range(40)))
    capture.ask(100, *_read(1), STATUS)
    adapters = UsbAdapters()
    for packet in capture.packets:
        changed = bytearray(packet.data)
        for _ in range(data.draw(st.integers(0, 3))):
            changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.integers(0, 255))
        cut = data.draw(st.integers(0, len(changed)))
        adapters.feed(replace(packet, data=bytes(changed[:cut])))
