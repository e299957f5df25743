"""What odd input costs, in times of ordinary traffic: python -m tests.adversary.prices.

For each kind of input it prints the processor seconds of a MB, the memory, and how many times the
price of an ordinary MB this is. `--scale N` makes every input N times as large: the price of a byte
should stay the same. Each input is decoded in a process of its own, which also holds the file.
"""

# A price counts bytes of the file, and all of the work: reading, decoding and naming. The tests
# count function calls of small inputs instead, which no other program's load changes.

from __future__ import annotations

import argparse
import io
import random
import struct
import subprocess
import sys
import tempfile
import time
import zlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import zstandard

from mbtool.core import SerialFormat
from mbtool.core.errors import MbtoolError
from mbtool.decode.connections import Bus
from mbtool.decode.decoder import Decoder
from mbtool.devices import Namer
from mbtool.logs import LogReader
from mbtool.modbus import mbap_adu, rtu_adu
from mbtool.packets.capture import read_capture
from mbtool.packets.segment import ACK, SYN
from tests.packets.building import End, Talk, pcap

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.core import Packet

READ = bytes.fromhex("03 0000 0010")
VALUES = bytes([3, 32]) + bytes(32)


class Price(NamedTuple):
    """What an input cost."""

    size: int
    """Bytes of the input."""
    seconds: float
    """Processor seconds."""
    memory: int
    """The most memory of the process, in bytes."""


def ordinary(size: int) -> bytes:
    """Requests and their responses, one after the other."""
    talk = Talk()
    packets = talk.handshake()
    for number in range(size):
        packets.append(talk.request(mbap_adu(number & 0xFFFF, 1, READ)))
        packets.append(talk.response(mbap_adu(number & 0xFFFF, 1, VALUES)))
    return pcap(packets)


def almost_modbus(size: int) -> bytes:
    """Segments that begin like ADUs whose other bytes do not come, or come too many."""
    rng, talk = random.Random(1), Talk()
    packets = talk.handshake()
    for number in range(size):
        function = rng.choice((1, 3, 15, 16, 0x41, 0x5A))
        length = rng.choice((3, 6, 8, 254, 255, 300, 1400))
        head = struct.pack(">HHHBB", number & 0xFFFF, rng.choice((0, 0, 0, 1)), length, 1, function)
        data = (head + rng.randbytes(rng.choice((0, 1, 3, 4)))) * rng.choice((1, 2, 5))
        packets.append(talk.request(data) if number % 2 else talk.response(data))
    return pcap(packets)


def headers_only(size: int) -> bytes:
    """Bytes of one direction that could all begin a long ADU of an unknown function."""
    talk = Talk()
    packets = talk.handshake()
    for number in range(size):
        head = struct.pack(">HHHBB", number & 0xFFFF, 0, 1400, 1, 0x5A)
        packets.append(talk.request(head * 4))
    return pcap(packets)


def wrong_units(size: int) -> bytes:
    """Requests, each followed by a response that answers none of the pending ones."""
    talk = Talk()
    packets = talk.handshake()
    for number in range(size):
        packets.append(talk.request(mbap_adu(number & 0xFFFF, 1, READ)))
        packets.append(talk.response(mbap_adu(number & 0xFFFF, 2, VALUES)))
    return pcap(packets)


def one_direction(size: int) -> bytes:
    """The requests alone of a connection, as an interface that hears one direction sees them."""
    return pcap([one for one in _polls(size) if one.data[34:36] != b"\x01\xf6"])


def other_direction(size: int) -> bytes:
    """The responses alone of a connection."""
    return pcap([one for one in _polls(size) if one.data[34:36] == b"\x01\xf6"])


def requests_only(size: int) -> bytes:
    """Requests that nobody answers, each with other words."""
    talk = Talk()
    packets = talk.handshake()
    for number in range(size):
        pdu = struct.pack(">BHH", 3, number & 0xFFFF, 1 + number % 100)
        packets.append(talk.request(mbap_adu(number & 0xFFFF, number % 7, pdu)))
    return pcap(packets)


def many_in_a_segment(size: int) -> bytes:
    """Requests that nobody answers, as many in a segment as it has room for."""
    talk = Talk()
    packets = talk.handshake()
    for number in range(0, size, 100):
        packets.append(talk.request(mbap_adu(7, 1, READ) * min(100, size - number)))
    return pcap(packets)


def pipelined(size: int) -> bytes:
    """Requests with one id, 200 of them before their 200 responses."""
    talk = Talk()
    packets = talk.handshake()
    for number in range(0, size, 200):
        together = min(200, size - number)
        packets += [talk.request(mbap_adu(0, 1, READ)) for _ in range(together)]
        packets += [talk.response(mbap_adu(0, 1, VALUES)) for _ in range(together)]
    return pcap(packets)


def lossy_pipelined(size: int) -> bytes:
    """Requests with one id, four at once, of which every third packet is lost."""
    rng, talk = random.Random(1), Talk()
    packets = talk.handshake()
    for _ in range(0, size, 4):
        packets += [talk.request(mbap_adu(0, 1, READ)) for _ in range(4)]
        packets += [talk.response(mbap_adu(0, 1, VALUES)) for _ in range(4)]
    return pcap([one for one in packets if rng.random() > 1 / 3])


def lossy_both_ways(size: int) -> bytes:
    """Requests with few ids, before each of which 384 bytes are lost, and responses, before each of
    which 410 are: each loss may be up to 32 requests, and their responses.
    """
    rng, talk = random.Random(1), Talk()
    packets = talk.handshake()
    for _ in range(size):
        one = rng.randrange(3)
        talk.master.sequence += 384
        packets.append(talk.request(mbap_adu(one, 1, READ)))
        talk.slave.sequence += 410
        packets.append(talk.response(mbap_adu(one, 1, VALUES)))
    return pcap(packets)


def connections(size: int) -> bytes:
    """Connections with one request each."""
    packets: list[Packet] = []
    for number in range(size):
        talk = Talk(End(f"10.1.{number >> 14}.1", 1024 + number % 60000, 1000))
        talk.ts_ns = number * 1_000_000
        packets.append(talk.send(talk.master, flags=SYN))
        packets.append(talk.send(talk.slave, flags=SYN | ACK))
        packets.append(talk.request(mbap_adu(1, 1, READ)))
    return pcap(packets)


def holes(size: int) -> bytes:
    """Segments behind holes that are never filled."""
    talk = Talk()
    packets = talk.handshake()
    for number in range(size):
        talk.master.sequence += 1
        packets.append(talk.request(mbap_adu(number & 0xFFFF, 1, READ)))
    return pcap(packets)


def chat(size: int) -> bytes:
    """Another protocol, of which every third packet is lost; read with `--port any`."""
    rng = random.Random(1)
    talks = [Talk(End("10.0.0.1", 40000 + one, 1000), End("10.0.0.9", 5222, 1)) for one in range(9)]
    packets = []
    for number in range(size):
        talk = rng.choice(talks)
        data = bytes(rng.choices(b"\0\1\2\3abcdefghij <>/=", k=rng.randint(20, 420)))
        one = talk.request(data) if rng.random() < 0.5 else talk.response(data)
        if rng.random() > 1 / 3:
            packets.append(replace(one, ts_ns=number * 10_000_000))
    return pcap(packets)


def ordinary_line(size: int) -> bytes:
    """Polls of three units on a serial line."""
    rng, sent = random.Random(1), []
    for number in range(size):
        unit, address = 1 + number % 3, 16 * (number % 7)
        sent.append(rtu_adu(unit, struct.pack(">BHH", 3, address, 10)))
        sent.append(rtu_adu(unit, bytes([3, 20]) + rng.randbytes(20)))
    return b"".join(sent)


def short_line(size: int) -> bytes:
    """Polls of one register of three units: frames of 7 and 8 bytes."""
    rng, sent = random.Random(1), []
    for number in range(size):
        unit = 1 + number % 3
        sent.append(rtu_adu(unit, struct.pack(">BHH", 3, number % 7, 1)))
        sent.append(rtu_adu(unit, bytes([3, 2]) + rng.randbytes(2)))
    return b"".join(sent)


def one_write(size: int) -> bytes:
    """One write and its echo, again and again."""
    return _write(1, 3) * size


def unechoed_writes(size: int) -> bytes:
    """Writes to seven units that nobody echoes."""
    return b"".join(_write(1 + number % 7, number) for number in range(size))


def unechoed_set_points(size: int) -> bytes:
    """Writes of another value each to one unit, without echoes: each may be a wrong echo."""
    return b"".join(_write(1, number) for number in range(size))


def equal_writes(size: int) -> bytes:
    """Writes to silent units, three times each: a write with its echo, or retries."""
    return b"".join(_write(1 + number // 3 % 9, 3) for number in range(size))


def scan(size: int) -> bytes:
    """The loopback test of all units, which differs from its response by nothing but its time."""
    test = bytes.fromhex("08 0000 A537")
    return b"".join(rtu_adu(1 + number % 247, test) for number in range(size))


def unknown_function(size: int) -> bytes:
    """A request of an unknown function again and again: nothing but its CRC tells its end."""
    return rtu_adu(1, bytes.fromhex("5A 01 02 03 04 05")) * size


def unknown_pairs(size: int) -> bytes:
    """Requests and responses of an unknown function."""
    return b"".join(
        rtu_adu(1, b"\x5a\1\2\3\4" + bytes([number % 256]))
        + rtu_adu(1, b"\x5a\1\2\3\4\xaa\xbb" + bytes([number * 7 % 256]))
        for number in range(size)
    )


def random_frames(size: int) -> bytes:
    """Random bytes with a correct CRC behind each group of 3 to 41."""
    rng = random.Random(1)
    return b"".join(
        rtu_adu(rng.randrange(256), rng.randbytes(rng.randint(2, 40))) for _ in range(size)
    )


def random_functions(size: int) -> bytes:
    """Frames of one unit with random functions."""
    rng = random.Random(1)
    return b"".join(rtu_adu(1, rng.randbytes(rng.randint(2, 12))) for _ in range(size))


def heads(size: int) -> bytes:
    """The heads of long responses, each before a write that its registers may contain."""
    return b"".join(bytes([1, 3, 240]) + _write(1, number) for number in range(size))


def random_line(size: int) -> bytes:
    """Random bytes."""
    return random.Random(1).randbytes(size)


def ordinary_log(size: int) -> bytes:
    """The log that `convert` makes of ordinary traffic."""
    with tempfile.TemporaryDirectory() as folder:
        capture, log = Path(folder, "ordinary.pcap"), Path(folder, "ordinary.mcap")
        capture.write_bytes(ordinary(size))
        subprocess.run(
            [sys.executable, "-m", "mbtool", "convert", str(capture), str(log)],
            check=True,
            capture_output=True,
        )
        return log.read_bytes()


def bombs(size: int) -> bytes:
    """A log whose chunks unpack to more than a thousand times their size: messages of zeros."""
    return _log([_message(bytes(900)) * 17_000] * size)


def empty_records(size: int) -> bytes:
    """A log whose chunks unpack to a million records of no bytes."""
    return _log([(b"\x80" + bytes(8)) * 1_000_000] * size)


def short_messages(size: int) -> bytes:
    """A log whose chunks unpack to half a million messages that are no items."""
    return _log([_message(b"{}") * 500_000] * size)


def lying_chunks(size: int) -> bytes:
    """A log whose chunks unpack to other sizes than they state."""
    return _log([_message(bytes(900)) * 17_000] * size, stated=1000)


class Input(NamedTuple):
    """A kind of input: what makes it, of what size, and what it is compared with."""

    make: Callable[[int], bytes]
    usual_size: int
    basis: str
    any_port: bool = False


LINE = "ordinary line"
"""Long frames, as few a byte as lines have."""
SHORT_LINE = "ordinary line, short frames"
FORMAT = SerialFormat(9600, 8, "E", 1)
READ_SIZE = 1024

INPUTS = {
    "ordinary": Input(ordinary, 10_000, "ordinary"),
    "almost Modbus": Input(almost_modbus, 20_000, "ordinary"),
    "headers only": Input(headers_only, 20_000, "ordinary"),
    "wrong units": Input(wrong_units, 10_000, "ordinary"),
    "requests of a connection": Input(one_direction, 25_000, "ordinary"),
    "responses of a connection": Input(other_direction, 25_000, "ordinary"),
    "requests only": Input(requests_only, 20_000, "ordinary"),
    "requests only, 100 a segment": Input(many_in_a_segment, 50_000, "ordinary"),
    "pipelined with one id": Input(pipelined, 10_000, "ordinary"),
    "pipelined with one id, with loss": Input(lossy_pipelined, 10_000, "ordinary"),
    "losses of both directions": Input(lossy_both_ways, 10_000, "ordinary"),
    "connections with a request": Input(connections, 65_535, "ordinary"),
    "holes": Input(holes, 10_000, "ordinary"),
    "another protocol, any port": Input(chat, 5_000, "ordinary", any_port=True),
    LINE: Input(ordinary_line, 10_000, LINE),
    SHORT_LINE: Input(short_line, 15_000, LINE),
    "line: one write and its echo": Input(one_write, 20_000, LINE),
    "line: writes without echoes": Input(unechoed_writes, 20_000, LINE),
    "line: set points without echoes": Input(unechoed_set_points, 20_000, LINE),
    "line: equal writes, silent units": Input(equal_writes, 20_000, LINE),
    "line: loopback test of all units": Input(scan, 20_000, LINE),
    "line: one unknown function": Input(unknown_function, 20_000, LINE),
    "line: pairs of an unknown function": Input(unknown_pairs, 10_000, LINE),
    "line: random frames": Input(random_frames, 6_000, LINE),
    "line: random functions": Input(random_functions, 15_000, LINE),
    "line: heads before writes": Input(heads, 15_000, LINE),
    "line: random bytes": Input(random_line, 150_000, LINE),
    "ordinary log": Input(ordinary_log, 10_000, "ordinary log"),
    "chunks that unpack 1:1000": Input(bombs, 600, "ordinary log"),
    "chunks of empty records": Input(empty_records, 1_000, "ordinary log"),
    "chunks of short messages": Input(short_messages, 1_000, "ordinary log"),
    "chunks that lie about their size": Input(lying_chunks, 600, "ordinary log"),
}


def run(name: str, data: bytes) -> int:
    """Decode an input; return the number of records."""
    given = INPUTS[name]
    count = 0
    if given.basis == "ordinary log":
        try:
            for _ in LogReader(io.BytesIO(data), "x.mcap").items():
                count += 1
        except MbtoolError:
            pass
        return count
    if given.basis == LINE:
        bus = Bus("line", FORMAT, timed=False)
        for at in range(0, len(data), READ_SIZE):
            count += len(bus.feed(data[at : at + READ_SIZE], at * FORMAT.character_ns + 1))
        return count + len(bus.close())
    decoder = Decoder(Namer(), ports=(502,), any_port=given.any_port)
    for packet in read_capture(io.BytesIO(data)):
        count += len(decoder.feed(packet))
    return count + len(decoder.close())


def price_of(name: str, path: Path) -> Price:
    """Decode an input that a file has, in this process."""
    data = path.read_bytes()
    before_s = time.process_time()
    run(name, data)
    seconds = time.process_time() - before_s
    return Price(len(data), seconds, _most_memory())


def _most_memory() -> int:
    """The most memory of this process so far, in bytes. (ru_maxrss begins with that of its parent,
    which has made the input.)
    """
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) * 1024


def _polls(size: int) -> list[Packet]:
    talk = Talk()
    packets = talk.handshake()
    for number in range(size):
        packets.append(talk.request(mbap_adu(number & 0xFFFF, 1, READ)))
        packets.append(talk.response(mbap_adu(number & 0xFFFF, 1, VALUES)))
    return packets


def _write(unit: int, value: int) -> bytes:
    return rtu_adu(unit, struct.pack(">BHH", 6, 1, value & 0xFFFF))


def _log(chunks: list[bytes], stated: int | None = None) -> bytes:
    """A log of chunks with these records, each of which states that it unpacks to `stated` bytes;
    None for the truth.
    """
    packer = zstandard.ZstdCompressor(write_content_size=stated is None)
    parts = [b"\x89MCAP0\r\n", _record(1, _text("mbtool") + _text("prices"))]
    known: dict[bytes, bytes] = {}
    for records in chunks:
        if records not in known:
            packed = packer.compress(records)
            head = struct.pack(
                "<QQQI", 1, 2, len(records) if stated is None else stated, zlib.crc32(records)
            )
            content = head + _text("zstd") + struct.pack("<Q", len(packed)) + packed
            known[records] = _record(6, content)
        parts.append(known[records])
    parts += [_record(15, bytes(4)), _record(2, bytes(20)), b"\x89MCAP0\r\n"]
    return b"".join(parts)


def _message(data: bytes) -> bytes:
    return _record(5, struct.pack("<HIQQ", 1, 0, 1, 1) + data)


def _record(opcode: int, content: bytes) -> bytes:
    return bytes([opcode]) + struct.pack("<Q", len(content)) + content


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--inside", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("name", nargs="*", help=", ".join(INPUTS))
    given = parser.parse_args()
    if given.inside:
        print(*price_of(given.name[0], given.inside))
        return
    if unknown := set(given.name) - INPUTS.keys():
        parser.error(f"no input {', '.join(sorted(unknown))}; there are {', '.join(INPUTS)}")
    wanted = [name for name in INPUTS if not given.name or name in given.name]
    names = list(dict.fromkeys([*(INPUTS[name].basis for name in wanted), *wanted]))
    print(f"{'input':36}{'MB':>8}{'s':>8}{'s a MB':>9}{'times':>8}{'MB memory':>11}")
    prices: dict[str, float] = {}
    for name in names:
        with tempfile.NamedTemporaryFile() as file:
            file.write(INPUTS[name].make(max(1, int(INPUTS[name].usual_size * given.scale))))
            file.flush()
            command = [sys.executable, "-m", "tests.adversary.prices", "--inside", file.name, name]
            done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
        size, seconds, memory = (float(word) for word in done.stdout.split())
        prices[name] = seconds / size
        times = prices[name] / prices[INPUTS[name].basis]
        print(
            f"{name:36}{size / 1e6:8.2f}{seconds:8.2f}{1e6 * prices[name]:9.2f}{times:8.1f}"
            f"{memory / 1e6:11.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
