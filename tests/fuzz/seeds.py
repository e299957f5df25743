"""The first inputs of each target, made from this project's own captures and files."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from mbtool.core import Chunk, Packet
from mbtool.logs import LogReader
from mbtool.modbus import mbap_adu, rtu_adu
from mbtool.packets.capture import read_capture
from mbtool.packets.usb import USB_LINK_TYPES
from tests.fuzz.targets import LINK_TYPES
from tests.packets.building import ethernet, ipv4, udp
from tests.packets.usb_captures import UsbCapture, setup
from tests.sources.text_logs import FORMS, conversation

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

ROOT = Path(__file__).resolve().parents[2]
CAPTURES = ROOT / "captures"
MOST_BYTES = 20_000
MAX_PACKETS = 64

_LISTS = (
    "Address,Name,Type,Unit,Scale\n40001,Level,uint16,m,0.1\n40002,Flow,float32,l/s,\n",
    "Register;Beschreibung;Datentyp;R/W\n0x0010;Druck;int16;RO\n0x0011-0x0012;Zähler;uint32;RW\n",
    "Modbus Address\tDescription\tFormat\n300001\tTemperature\tINT16\n300003..300004\tPower\tFLOAT\n",  # noqa: E501
    "Function,Address,Parameter,Length\n03,100,Voltage L1,2\n04,102,Current,2\n01,5,Pump runs,1\n",
)
_IMAGES = (
    'HR400001 = 4660\nHR400010 = [1, 2, -3]\nC1 = true\n"holding 9005" = 7\n',
    "IR300001 = { ramp = [0, 1000], seconds = 10 }\nIR300002 = { sine = [20, 80], seconds = 60 }\n",
    "IR300003 = { walk = [0, 100], step = 2, seconds = 0.5, seed = 3 }\n"
    "IR300005 = { steps = [0, 50, 100], seconds = 5 }\n",
)
_FAULTS = (
    'seed = 7\n[[faults]]\nkind = "exception"\ncode = 6\nfunctions = [3, 0x10]\nunits = [1]\n'
    'registers = "HR400001..400010"\nseconds = [10, 20]\nnth = 3\nevery = 5\ntimes = 2\n',
    '[[faults]]\nkind = "delay"\nms = 20\nprobability = 0.5\n[[faults]]\nkind = "split"\n'
    'pieces = 3\ngap_ms = 5\n[[faults]]\nkind = "extra-bytes"\nbytes = "00ff"\n',
)
_WHERE = (
    "unit == 5 and function in (3, 16)",
    'outcome != "ok" or latency_ms > 50',
    "0x0102 <= address < 0x0110 and 4660 in values",
    'reference like "HR4*" or points matches "^CH[12] "',
    'source == "10.0.0.66" and time >= "2026-11-22T09:14"',
    'not (105 in written_registers) and device not like "a?b"',
    'findings == "FT1A-Q3" or verdicts == "glued" or retries > 2',
)
_LINKS = (
    "rtu:/dev/ttyUSB0@19200-8E1",
    "ascii:/dev/ttyUSB0@9600-7E1",
    "rtu:/dev/ttyUSB0,/dev/ttyUSB1@19200-8E1,t3.5=28bits,t1.5=1ms",
    "rtutap:/dev/ttyUSB0@19200-8E1=/dev/ttyUSB1",
    "rtu:COM3@auto",
    "net:eth0,eth1",
    "tap:[::1]:1502=10.0.0.9:502",
    "tcp:127.0.0.1:1502",
    "rtu+tcp:[fe80::1]:1502",
)


def seeds(target: str) -> list[bytes]:
    """Inputs that are right, or nearly so; each has at most MOST_BYTES."""
    texts = {"image": _IMAGES, "faults": _FAULTS, "csv": _LISTS, "where": _WHERE, "link": _LINKS}
    if target in texts:
        return [text.encode() for text in texts[target]]
    return list(_MADE[target]())


def _files(pattern: str) -> Iterable[bytes]:
    """Files of captures/; of a long one its beginning."""
    paths = sorted(CAPTURES.rglob(pattern))
    return {path.read_bytes()[:MOST_BYTES] for path in paths}


def _profiles() -> Iterator[bytes]:
    folder = ROOT / "mbtool/devices/profiles"
    for path in [*sorted(folder.glob("*.toml")), ROOT / "tests/soak/unit.toml"]:
        yield path.read_bytes()[:MOST_BYTES]


def _text_logs() -> Iterator[bytes]:
    for form in FORMS.values():
        for transport in ("rtu", "ascii", "tcp"):
            yield form(conversation(transport)).encode()[:4000]
    for said in conversation()[:2]:
        rows = enumerate(said.data)
        yield (
            "Time [s],Value\n" + "".join(f"{at / 1000},0x{one:02X}\n" for at, one in rows)
        ).encode()


def _lines(*names: str) -> Iterator[bytes]:
    for name in names:
        data = b"".join(
            bytes([len(one.data), 4]) + one.data for one in _evidence(name) if len(one.data) < 256
        )
        yield from (data[at : at + 100] for at in range(0, min(len(data), 4000), 100))


def _streams(name: str) -> Iterator[bytes]:
    data = b"".join(one.data for one in _evidence(name))
    yield from (bytes([first]) + data[:600] for first in (0, 1, 0x80, 0x81))


def _packets(*names: str) -> Iterator[bytes]:
    for link_type in sorted(USB_LINK_TYPES):
        capture = UsbCapture(link_type)
        capture.control(0, setup(0x40, 3, 0x4138))
        capture.ask(1, rtu_adu(1, b"\3\0\0\0\1"), rtu_adu(1, b"\3\2\0\7"), b"\1\x60")
        how = bytes((LINK_TYPES.index(link_type),))
        yield b"".join(len(one.data).to_bytes(2) + how + one.data for one in capture.packets)
    datagram = ethernet(ipv4(udp(50000, 502, mbap_adu(1, 1, b"\3\0\0\0\1")), protocol=17))
    yield len(datagram).to_bytes(2) + b"\0" + datagram
    for name in names:
        with (CAPTURES / name).open("rb") as stream:
            read = list(read_capture(stream))[:MAX_PACKETS]
        for at in range(0, len(read), 8):
            part = read[at : at + 8]
            yield b"".join(len(one.data).to_bytes(2, "big") + b"\0" + one.data for one in part)


def _evidence(name: str) -> Iterator[Chunk | Packet]:
    with LogReader.open(CAPTURES / name) as log:
        for item in log.evidence():
            if isinstance(item, Chunk):
                yield item


_MADE: dict[str, Callable[[], Iterable[bytes]]] = {
    "rtu": partial(_lines, "ft1a-touch-line.mcap", "torn-and-glued-frames.mcap"),
    "ascii": partial(_lines, "ascii-line.mcap"),
    "mbap": partial(_streams, "fa3-at1m8x-setup.mcap"),
    "pcap": partial(_files, "*.pcap"),
    "pcapng": partial(_files, "*.pcapng"),
    "packets": partial(_packets, "fa3-at1m8x-setup.pcap", "plant.pcap"),
    "mcap": partial(_files, "*.mcap"),
    "profile": _profiles,
    "text-log": _text_logs,
}
