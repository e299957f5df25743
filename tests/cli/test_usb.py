"""Captures of USB as the input of commands."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.modbus import rtu_adu
from mbtool.packets.usb import USB_LINK_TYPES, USBPCAP
from tests.packets.building import pcap
from tests.packets.usb_captures import UsbCapture, setup

if TYPE_CHECKING:
    from pathlib import Path

    from tests.cli.program import CommandLine


def _capture(path: Path, link_type: int) -> Path:
    capture = UsbCapture(link_type)
    capture.control(1, setup(0x41, 0x1E, length=4), (9600).to_bytes(4, "little"))
    capture.control(2, setup(0x41, 3, 0x0820))
    for number in range(12):
        request = rtu_adu(1, bytes((3, 0, number, 0, 1)))
        capture.ask(100 + 100 * number, request, rtu_adu(1, bytes((3, 2, 0, number))))
    path.write_bytes(pcap(capture.packets))
    return path


@pytest.mark.parametrize("link_type", sorted(USB_LINK_TYPES))
def test_statistics_know_the_settings_of_the_adapter(
    mbtool: CommandLine, tmp_path: Path, link_type: int
) -> None:
    told = mbtool("stats", _capture(tmp_path / "usb.pcap", link_type))
    assert told.code == exit_codes.DONE
    assert told.out.startswith("rtu usb1.5 9600-8E1, unit 1: 12 requests in 1.11 s")


@pytest.mark.parametrize("suffix", [".mcap", ".pcapng"])
def test_a_conversion_has_the_same_transactions_and_settings(
    mbtool: CommandLine, tmp_path: Path, suffix: str
) -> None:
    path, copy = _capture(tmp_path / "usb.pcap", USBPCAP), tmp_path / f"copy{suffix}"
    assert mbtool("convert", path, copy).code == exit_codes.DONE
    told = [
        [
            (one["request_raw"], one["response_raw"], round(one["latency_ns"] / 1e5))
            for one in map(json.loads, mbtool("decode", each, "--format", "jsonl").out.splitlines())
        ]
        for each in (path, copy)
    ]
    assert told[0] == told[1]
    assert len(told[0]) == 12
    assert mbtool("stats", copy).out.startswith("rtu usb1.5 9600-8E1")
