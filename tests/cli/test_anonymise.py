"""Copies that do not show the plant: what they lack of the original, and what they keep."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from mbtool.cli import exit_codes
from mbtool.core import Chunk, EventKind, Packet, Stamp, WireEvent
from mbtool.core.pseudonyms import Pseudonyms
from mbtool.logs.reader import LogReader
from mbtool.logs.writer import LogWriter
from mbtool.modbus import ascii_adu, rtu_adu
from mbtool.modbus.adu import read_frame
from mbtool.packets.link_layer import IP_FINDERS
from mbtool.packets.segment import find_tcp
from mbtool.workflows.shared.anonymous_packets import (
    MIN_TEXT,
    AnonymousChoice,
    AnonymousPackets,
)
from tests.captures import public_folder, read_packets
from tests.sources.text_logs import conversation, pymodbus

if TYPE_CHECKING:
    from tests.cli.program import CommandLine

ROOT = Path(__file__).resolve().parents[2]
OWN = ["plant.pcap", "fa3-at1m8x-setup.pcapng", "fa3-at1m8x-setup.mcap", "ft1a-touch-line.mcap",
       "ascii-line.mcap", "torn-and-glued-frames.mcap"]  # fmt: skip
OTHERS = [
    "cisagov__icsnpp-modbus/testing__traces__modbus_example.pcap",
    "digitalbond__Quickdraw-Snort/modbus_test_data_part1.pcap",
    "kb221svs__modbus-anomaly-detection/modbus.pcap",
    "nopnoplabs__nopnoplabs.github.io/hist_50fa3d41__pcap__modbus.pcap",
    "ntop__nDPI/modbus.pcap",
    "seladb__PcapPlusPlus/Tests__Packet++Test__PacketExamples__modbusFrames.pcap",
    "sigrokproject__sigrok-dumps/flowmeter_graph_tool.user0.pcap",
]
PACKETS = [one for one in [*OWN, *OTHERS] if ".pcap" in one and "sigrok" not in one]
_ADDRESS = re.compile(r"\b\d{1,3}(?:\.\d{1,3}){3}\b|\b(?:[0-9a-f]{2}:){5}[0-9a-f]{2}\b")
_LINK = re.compile(r"\b(?:rs485|if\d|line\d|net\d|ttyUSB\d)\b")
_WORDS = re.compile(rb"[A-Za-z0-9 ._-]{%d,}" % (MIN_TEXT + 3))
_NAMES = {"sources", "remarks", "packets", "file", "files"}


@pytest.fixture
def key(tmp_path: Path) -> Path:
    path = tmp_path / "key"
    path.write_text("a long text")
    return path


def _capture(name: str) -> Path:
    if "/" not in name:
        return ROOT / "captures" / name
    path = public_folder() / name
    if not path.exists():
        pytest.skip("the captures of others are not here")
    return path


def _told(mbtool: CommandLine, command: str, path: Path) -> object:
    return nameless(json.loads(mbtool(command, path, "--json").out))


def nameless(value: Any) -> object:
    """Leave out of JSON what may differ: names, addresses, times, and the order they give."""
    if isinstance(value, dict):
        return {
            _word(key): nameless(one)
            for key, one in value.items()
            if key not in _NAMES and "ns" not in key.split("_") and "time" not in key
        }
    if isinstance(value, list):
        return sorted((nameless(one) for one in value), key=lambda one: json.dumps(one))
    return _word(value) if isinstance(value, str) else value


def _word(text: str) -> str:
    text = _LINK.sub("LINK", _ADDRESS.sub("ADDRESS", text))
    return re.sub(r"\d{4}-\d\d-\d\d[ T][\d:.]+Z?|\d\d:\d\d:\d\d(?:\.\d+)?", "TIME", text)


@pytest.mark.parametrize("name", [*OWN, *OTHERS])
def test_statistics_and_findings_stay_what_they_are(
    mbtool: CommandLine, tmp_path: Path, key: Path, name: str
) -> None:
    path = _capture(name)
    is_line = "sigrok" in name
    copy = tmp_path / ("copy.pcapng" if is_line else f"copy{path.suffix}")
    assert mbtool("convert", path, copy, "--anonymous", "--key", key).code == exit_codes.DONE
    for command in ("stats", "check"):
        assert _told(mbtool, command, copy) == _told(mbtool, command, path)


@pytest.mark.parametrize("name", PACKETS)
def test_no_address_and_no_text_of_the_original_is_in_the_copy(
    mbtool: CommandLine, tmp_path: Path, key: Path, name: str
) -> None:
    path = _capture(name)
    copy = tmp_path / "copy.pcap"
    assert mbtool("convert", path, copy, "--anonymous", "--key", key).code == exit_codes.DONE
    whole = copy.read_bytes()
    addresses: set[bytes] = set()
    packets = [*zip(read_packets(path), read_packets(copy), strict=True)]
    for packet, _ in packets:
        at = _ip_at(packet.link_type, packet.data)
        if packet.link_type == 1:
            addresses |= {packet.data[:6], packet.data[6:12]}
        if at >= 0 and packet.data[at] >> 4 == 4:
            addresses |= {packet.data[at + 12 : at + 16], packet.data[at + 16 : at + 20]}
    addresses = {one for one in addresses if any(one) and not one[0] & 1 and one[0] < 224}
    for address in addresses:
        if len(address) == 4:
            assert str(ip_address(address)).encode() not in whole
    for packet, replaced in packets:
        assert len(replaced.data) == len(packet.data)
        payload = _payload_at(packet.link_type, packet.data, packet.original_length)
        for address in addresses:
            found = replaced.data.find(address)
            # Values of registers stay, and some are like an address.
            assert found < 0 or found + len(address) > payload, (packet.number, address.hex(":"))
        for match in _WORDS.finditer(packet.data):
            if sum(byte > 0x40 and bytes((byte,)).isalpha() for byte in match[0]) > 4:
                assert match[0] not in whole


def _ip_at(link_type: int, data: bytes) -> int:
    finder = IP_FINDERS.get(link_type)
    return -1 if finder is None else finder(data)


def _payload_at(link_type: int, data: bytes, length: int) -> int:
    at = _ip_at(link_type, data)
    place = find_tcp(data, at, length) if at >= 0 else None
    return len(data) if place is None else place.start + 20


def test_a_log_of_text_becomes_a_copy_without_its_names(
    mbtool: CommandLine, tmp_path: Path, key: Path
) -> None:
    path = tmp_path / "boiler-house.txt"
    path.write_text(pymodbus(conversation()))
    copy = tmp_path / "copy.mcap"
    assert mbtool("convert", path, copy, "--anonymous", "--key", key).code == exit_codes.DONE
    assert b"boiler" not in copy.read_bytes()
    told = mbtool("decode", copy, "--format", "jsonl").out
    assert [json.loads(line)["outcome"] for line in told.splitlines()].count("ok") == 6


@pytest.mark.parametrize("suffix", [".mcap", ".pcapng", ".jsonl", ".csv"])
def test_no_form_names_the_file_the_line_or_the_machine(
    mbtool: CommandLine, tmp_path: Path, suffix: str
) -> None:
    path = tmp_path / "boiler-house.mcap"
    path.write_bytes((ROOT / "captures" / "ft1a-touch-line.mcap").read_bytes())
    copy = tmp_path / f"copy{suffix}"
    assert mbtool("convert", path, copy, "--anonymous").code == exit_codes.DONE
    whole = copy.read_bytes()
    for word in (b"boiler", b"rs485", str(tmp_path).encode()):
        assert word not in whole


def test_the_same_key_gives_the_same_copy_and_another_key_another(
    mbtool: CommandLine, tmp_path: Path, key: Path
) -> None:
    other = tmp_path / "other"
    other.write_text("another text")
    copies = []
    for number, each in enumerate((key, key, other)):
        copy = tmp_path / f"{number}.pcap"
        mbtool("convert", _capture("plant.pcap"), copy, "--anonymous", "--key", each)
        copies.append(copy.read_bytes())
    assert copies[0] == copies[1] != copies[2]


def test_texts_in_registers_and_units_are_replaced(
    mbtool: CommandLine, tmp_path: Path, key: Path
) -> None:
    path = tmp_path / "log.txt"
    # Unit 17: 8 registers from 100 on that hold PUMP-HOUSE NORTH.
    path.write_text(
        "TX 00 01 00 00 00 06 11 03 00 64 00 08\n"
        f"RX 00 01 00 00 00 13 11 03 10 {b'PUMP-HOUSE NORTH'.hex(' ')}\n"
    )
    copy = tmp_path / "copy.jsonl"
    mbtool("convert", path, copy, "--anonymous", "--key", key, "--units")
    (one,) = [json.loads(line) for line in copy.read_text().splitlines()]
    text = b"".join(value.to_bytes(2) for value in one["response_values"])
    assert (one["outcome"], one["address"], len(text)) == ("ok", 100, 16)
    assert text[4:5] + text[10:11] == b"- "
    assert b"PUMP" not in text
    assert b"NORTH" not in text
    assert one["unit"] != 17


def test_an_empty_key_is_refused(mbtool: CommandLine, tmp_path: Path) -> None:
    empty = tmp_path / "key"
    empty.write_text("\n")
    copy = tmp_path / "copy.pcap"
    for given, problem in ((empty, "a key is any text"), (tmp_path / "no", "cannot be read")):
        told = mbtool("convert", _capture("plant.pcap"), copy, "--anonymous", "--key", given)
        assert told.code != exit_codes.DONE
        assert problem in told.err
    told = mbtool("convert", _capture("plant.pcap"), copy, "--anonymous", "--key", "/dev/zero")
    assert "a key has at most 65,536 bytes" in told.err
    told = mbtool("convert", _capture("plant.pcap"), copy, "--units")
    assert told.code == exit_codes.USAGE


_MACS = "00a1a2a3a4a5 00b1b2b3b4b5"
_THREE = f"{_MACS} 00c1c2c3c4c5 1000"
_FOUR = f"{_THREE} 00d1d2d3d4d5"
_SNAP = "aaaa03000000"
_IP = "4500 0014 0000 0000 4006 0000 0a000001 0a000002"


@pytest.mark.parametrize(
    ("link_type", "header"),
    [
        (1, f"{_MACS} 0800"),
        (1, f"{_MACS} 0806 0001 0800 0604 0001 00b1b2b3b4b5"),
        (9, f"c021 {_MACS}"),
        (105, f"0801 2c00 {_THREE} {_SNAP} 0800"),
        (105, f"0803 2c00 {_FOUR} {_SNAP} 0800"),
        (105, f"8841 2c00 {_THREE} 0000 {_MACS}"),
        (105, f"8000 0000 {_THREE} {_MACS}"),
        (105, f"d400 0000 {_MACS}"),
        (113, "0000 0001 0006 00a1a2a3a4a5 0000 0800"),
        (127, f"0000 0800 00000000 0801 2c00 {_THREE} {_SNAP} 0800"),
        (127, f"0000 0800 00000000 0803 2c00 {_FOUR} {_SNAP} 0800"),
        (127, f"0000 0800 00000000 8000 0000 {_THREE} {_MACS}"),
        (127, f"0000 ff00 00000000 8000 0000 {_THREE} {_MACS}"),
        (276, "0800 0000 00000002 0001 00 06 00a1a2a3a4a5 0000"),
        (9999, _MACS),
    ],
)
def test_no_mac_address_is_in_the_copy_wherever_a_packet_is_cut(
    link_type: int, header: str
) -> None:
    packets = AnonymousPackets(Pseudonyms(b"key"), {502}, set(), AnonymousChoice())
    whole = bytes.fromhex(header + _IP)
    for size in range(len(whole) + 1):
        data = whole[:size]
        packet = Packet(
            ts_ns=0, link="", link_type=link_type, data=data, original_length=len(whole)
        )
        replaced = packets.replaced(packet)
        assert len(replaced) == size
        for first in (0xA1, 0xB1, 0xC1, 0xD1):
            assert bytes((first, first + 1, first + 2)) not in replaced
    assert any(replaced[-20:]) == (_ip_at(link_type, whole) == len(whole) - 20)


def _set_parity(raw: bytes, ones: int) -> bytes:
    return bytes(byte | 0x80 * (byte.bit_count() & 1 != ones) for byte in raw)


_TEXT_FRAME = ascii_adu(17, bytes.fromhex("0310") + b"PUMP-HOUSE NORTH")
_WRONG = _TEXT_FRAME[:-4] + b"00\r\n"


@pytest.mark.parametrize(
    ("raw", "seven"),
    [
        (_TEXT_FRAME, _TEXT_FRAME),
        (_set_parity(_TEXT_FRAME, 0), _TEXT_FRAME),
        (_set_parity(_TEXT_FRAME, 1), _TEXT_FRAME),
        (bytes(byte | 0x80 for byte in _TEXT_FRAME), _TEXT_FRAME),
        (_WRONG, _WRONG),
        (_WRONG.lower(), _WRONG.lower()),
        (_set_parity(_WRONG, 0), _WRONG),
        (_TEXT_FRAME[:-7], _TEXT_FRAME[:-7]),
        (_WRONG * 2000, _WRONG * 2000),
        (_TEXT_FRAME[:5] + b"?" + _TEXT_FRAME[6:], _TEXT_FRAME[:5] + b"?" + _TEXT_FRAME[6:]),
        (_set_parity(_TEXT_FRAME, 0)[:20] + _TEXT_FRAME[20:], _TEXT_FRAME),
    ],
)
def test_texts_in_ascii_are_replaced_also_in_damaged_frames(raw: bytes, seven: bytes) -> None:
    packets = AnonymousPackets(Pseudonyms(b"key"), {502}, set(), AnonymousChoice())
    before = read_frame(raw)
    for replace_texts in (packets.other, packets.payload, packets.ascii):
        replaced = replace_texts(raw)
        assert len(replaced) == len(raw)
        made = bytes(byte & 0x7F for byte in replaced)
        for text in (b"PUMP", b"HOUSE", b"NORTH"):
            assert text.hex() not in made.decode().lower()
        assert [chr(byte) in "0123456789abcdefABCDEF" for byte in made] == [
            chr(byte) in "0123456789abcdefABCDEF" for byte in seven
        ]
        after = read_frame(replaced)
        assert (after and after.checksum.ok) == (before and before.checksum.ok)
        assert (after and after.parity_in_data) == (before and before.parity_in_data)


@pytest.mark.parametrize("link", ["rs485", "eth0"])
def test_settings_events_and_bytes_of_a_link_get_one_name(
    mbtool: CommandLine, tmp_path: Path, link: str
) -> None:
    path, copy = tmp_path / "log.mcap", tmp_path / "copy.mcap"
    items: list[Chunk | Packet]
    if link == "eth0":
        spec = "net:eth0"
        items = [replace(one, link=link) for one in read_packets(_capture("plant.pcap"))]
    else:
        spec = "rtu:/dev/rs485@9600"
        frame = rtu_adu(1, bytes.fromhex("0300000001"))
        items = [Chunk(ts_ns=10**18, link=link, data=frame, stamp=Stamp.AT_ONCE)]
    before_ns = items[0].ts_ns - 10**9
    with LogWriter(path, capture={}) as log:
        log.add_link(link, {"spec": spec, "ports": "502"})
        log.write(
            WireEvent(ts_ns=before_ns, link=link, kind=EventKind.GAP, message=f"{link} is back")
        )
        for item in items:
            log.write(item)
    assert mbtool("convert", path, copy, "--anonymous").code == exit_codes.DONE
    with LogReader.open(copy) as reader:
        heard = [*reader.captured_items()]
        (name,) = reader.links
    assert {one.link for one in heard if isinstance(one, Packet | Chunk)} == {name}
    (event,) = [one for one in heard if isinstance(one, WireEvent) and one.kind is EventKind.GAP]
    assert (event.link, event.message) == (name, f"{name} is back")
