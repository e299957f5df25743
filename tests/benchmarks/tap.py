"""What the tap costs: python -m tests.benchmarks.tap [OPTIONS].

    --bytes 1000000000   to pass through the tap, each way
    --polls 2000         of each way, in each of the rounds
    --rounds 5
    --tls                end TLS on both sides of the tap: `direct` then is TLS, too

First a stream: a sender pushes random bytes through the tap, and a slave sends back what it gets.
The bytes sent, those that came back and what the tap recorded of either side are compared by their
hashes.

Then polls, one after another on one connection: `direct` to the slave, through the `tap` alone,
which hands what it records to a consumer that only drops it, and through `sniff`, the command as
users run it, which decodes each poll, prints it and logs it. The ways take turns, round by round,
so that what slows the machine slows all; the median of a way is compared with that of `direct`. A
pause of 2 ms between polls lets a sniffer finish with the one before, as any real master does;
--pause 0 leaves it out.

Master, slave and tap are processes of their own. Absolute figures are the machine's.
"""

from __future__ import annotations

import argparse
import asyncio
import hashlib
import json
import os
import random
import re
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

from mbtool.core import Chunk, Direction, Endpoint, ListenTls, TapLink, TargetTls, WireEvent
from mbtool.modbus import mbap_adu
from mbtool.sources.inbox import Ended, Inbox
from mbtool.sources.tap import TapSource
from tests.certificates import CA, MASTER, SLAVE, master_context, slave_context

if TYPE_CHECKING:
    import ssl
    from collections.abc import Iterator, Sequence

DIRECT, TAP, SNIFF = "direct", "tap", "sniff"
REQUEST = bytes.fromhex("03 0000 0002")
RESPONSE = bytes.fromhex("03 04 1234 5678")
PATIENCE_S = 120.0
SLOWEST_BYTES_PER_S = 1e6
"""A stream that passes slower than this has stopped."""
_BLOCK = 2**16
_ANY = Endpoint("127.0.0.1", 0)
_ECHO, _RECORD, _TLS = "--as-slave", "--as-tap", "--tls"


@dataclass(frozen=True, slots=True)
class Stream:
    """What became of a stream that went through the tap and back."""

    size: int
    seconds: float
    hashes: tuple[str, str, str, str]
    """Of what was sent, came back, was recorded of the master's side, of the slave's."""
    lost: int
    """How many bytes the record says it lost, as its consumer fell behind."""

    @property
    def is_unchanged(self) -> bool:
        sent, *others = self.hashes
        return all(other == sent for other in others[: 3 if not self.lost else 1])


@dataclass(frozen=True, slots=True)
class Polls:
    """How long the polls of one way took, in ascending order."""

    way: str
    taken_ns: list[int]

    @property
    def median_ns(self) -> float:
        return statistics.median(self.taken_ns)

    def percentile_ns(self, percent: int) -> int:
        return self.taken_ns[min(len(self.taken_ns) * percent // 100, len(self.taken_ns) - 1)]


def main() -> None:
    if sys.argv[1:2] == [_ECHO]:
        _answer()
        return
    if sys.argv[1:2] == [_RECORD]:
        _record(sys.argv[2], tls=_TLS in sys.argv)
        return
    assert __doc__ is not None
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--bytes", type=int, default=1_000_000_000)
    parser.add_argument("--polls", type=int, default=2000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--pause", type=float, default=2.0, metavar="MS")
    parser.add_argument(_TLS, action="store_true")
    options = parser.parse_args()
    if options.bytes:
        stream = measure_stream(options.bytes, tls=options.tls)
        sys.stdout.write(report_stream(stream))
    if options.polls:
        polls = measure_polls(options.polls, options.rounds, options.pause / 1000, tls=options.tls)
        sys.stdout.write(report_polls(polls))


def report_stream(stream: Stream) -> str:
    verdict = "unchanged" if stream.is_unchanged else "CHANGED"
    recorded = "all recorded" if not stream.lost else f"{stream.lost} bytes not recorded, as told"
    rate = stream.size / stream.seconds / 1e6
    return f"{stream.size} bytes each way, {verdict}, {recorded}: {rate:.0f} MB/s each way\n"


def report_polls(polls: Sequence[Polls]) -> str:
    direct = next(one for one in polls if one.way == DIRECT)
    lines = [f"{'way':8}{'median us':>12}{'p95 us':>10}{'added us':>10}"]
    lines += [
        f"{one.way:8}{one.median_ns / 1e3:12.0f}{one.percentile_ns(95) / 1e3:10.0f}"
        f"{(one.median_ns - direct.median_ns) / 1e3:10.0f}"
        for one in polls
    ]
    return "\n".join(lines) + "\n"


def measure_stream(size: int, *, tls: bool = False) -> Stream:
    with _slave("stream", tls=tls) as target, _tap(target, tls=tls) as (endpoint, tap):
        sent, back = hashlib.sha256(), hashlib.sha256()
        seconds = asyncio.run(_send_and_receive(endpoint, size, sent, back, tls=tls))
        assert tap.stdin is not None
        assert tap.stdout is not None
        tap.stdin.close()
        recorded = json.loads(tap.stdout.read())
    hashes = sent.hexdigest(), back.hexdigest(), recorded["request"], recorded["response"]
    return Stream(size, seconds, hashes, recorded["lost"])


def measure_polls(
    polls: int, rounds: int, pause_s: float = 0.0, *, tls: bool = False
) -> list[Polls]:
    with ExitStack() as stack:
        target = stack.enter_context(_slave("polls", tls=tls))
        ways = {DIRECT: target, TAP: stack.enter_context(_tap(target, tls=tls))[0]}
        ways[SNIFF] = stack.enter_context(_sniff(target, tls=tls))
        masters = {way: stack.enter_context(_called(each, tls=tls)) for way, each in ways.items()}
        taken: dict[str, list[int]] = {way: [] for way in ways}
        for master in masters.values():
            _poll(master, 20, pause_s)
        for _ in range(rounds):
            for way, master in masters.items():
                taken[way] += _poll(master, polls, pause_s)
    return [Polls(way, sorted(each)) for way, each in taken.items()]


def _called(endpoint: Endpoint, *, tls: bool) -> socket.socket:
    master = socket.create_connection((endpoint.host, endpoint.port), PATIENCE_S)
    master.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if not tls:
        return master
    return master_context().wrap_socket(master, server_hostname="localhost")


def _poll(master: socket.socket, count: int, pause_s: float) -> list[int]:
    taken = []
    for number in range(count):
        request = mbap_adu(number & 0xFFFF, 1, REQUEST)
        begun = time.perf_counter_ns()
        master.sendall(request)
        answer = master.recv(_BLOCK)
        taken.append(time.perf_counter_ns() - begun)
        assert answer == mbap_adu(number & 0xFFFF, 1, RESPONSE)
        if pause_s:
            time.sleep(pause_s)
    return taken


# One thread sends and receives. With a thread for each, both would use one SSL object at the same
# time, which OpenSSL forbids and Python prevents only from 3.13 on: the sender's SSL_write changes
# what SSL_get_error reports to the receiver, whose recv() then returns b"" amid the stream.
async def _send_and_receive(
    endpoint: Endpoint, size: int, sent: hashlib._Hash, back: hashlib._Hash, *, tls: bool
) -> float:
    """Send `size` random bytes and read them back; give the seconds that took."""
    reader, writer = await asyncio.open_connection(
        endpoint.host,
        endpoint.port,
        ssl=master_context() if tls else None,
        server_hostname="localhost" if tls else None,
    )
    async with asyncio.timeout(PATIENCE_S + size / SLOWEST_BYTES_PER_S):
        begun = time.perf_counter()
        await asyncio.gather(_send(writer, size, sent), _receive(reader, size, back))
        seconds = time.perf_counter() - begun
    writer.close()
    with suppress(OSError):
        await writer.wait_closed()
    return seconds


async def _send(writer: asyncio.StreamWriter, size: int, sent: hashlib._Hash) -> None:
    block = random.Random(size).randbytes(2**20)
    while size:
        piece = block[:size]
        writer.write(piece)
        sent.update(piece)
        await writer.drain()
        size -= len(piece)
        block = block[1:] + block[:1]


async def _receive(reader: asyncio.StreamReader, size: int, back: hashlib._Hash) -> None:
    while size > 0 and (data := await reader.read(_BLOCK)):
        back.update(data)
        size -= len(data)


@contextmanager
def _child(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "tests.benchmarks.tap", *arguments]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        try:
            yield child
        finally:
            child.kill()


@contextmanager
def _slave(what: str, *, tls: bool) -> Iterator[Endpoint]:
    with _child(_ECHO, what, *([_TLS] if tls else [])) as child:
        assert child.stdout is not None
        yield Endpoint("127.0.0.1", int(child.stdout.readline()))


@contextmanager
def _tap(target: Endpoint, *, tls: bool) -> Iterator[tuple[Endpoint, subprocess.Popen[str]]]:
    with _child(_RECORD, str(target.port), *([_TLS] if tls else [])) as child:
        assert child.stdout is not None
        yield Endpoint("127.0.0.1", int(child.stdout.readline())), child


@contextmanager
def _sniff(target: Endpoint, *, tls: bool) -> Iterator[Endpoint]:
    with tempfile.TemporaryDirectory() as folder:
        link = str(TapLink(_ANY, target))
        log = str(Path(folder) / "tap.mcap")
        command = [sys.executable, "-m", "mbtool", "sniff", link, "-w", log]
        if tls:
            command += ["--tls-cert", SLAVE, "--tls-ca", CA]
            command += ["--tls-target-ca", CA, "--tls-target-cert", MASTER]
        with subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        ) as child:
            try:
                assert child.stderr is not None
                found = re.search(r"tap:127\.0\.0\.1:(\d+)=", child.stderr.readline())
                assert found is not None
                yield Endpoint("127.0.0.1", int(found[1]))
            finally:
                child.terminate()
                child.wait()


def _answer() -> None:
    """A slave: sends back what comes, or answers each request."""
    is_stream = sys.argv[2] == "stream"
    tls = slave_context(ca=CA) if _TLS in sys.argv else None
    with socket.create_server(("127.0.0.1", 0)) as server:
        _say(str(server.getsockname()[1]))
        while True:
            connection, _ = server.accept()
            Thread(target=_serve, args=(connection, is_stream, tls), daemon=True).start()


def _serve(connection: socket.socket, is_stream: bool, tls: ssl.SSLContext | None) -> None:
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if tls is not None:
        connection = tls.wrap_socket(connection, server_side=True)
    with connection:
        while data := connection.recv(_BLOCK):
            if is_stream:
                connection.sendall(data)
            else:
                connection.sendall(mbap_adu(int.from_bytes(data[:2], "big"), 1, RESPONSE))


def _record(port: str, *, tls: bool) -> None:
    """A tap whose consumer hashes what is recorded; says so when its input ends."""
    inbox = Inbox()
    hashes = {way: hashlib.sha256() for way in (Direction.REQUEST, Direction.RESPONSE)}
    lost = 0
    link = TapLink(
        _ANY,
        Endpoint("127.0.0.1", int(port)),
        listen_tls=ListenTls(SLAVE, ca=CA) if tls else None,
        target_tls=TargetTls(CA, MASTER) if tls else None,
    )
    with TapSource(link, inbox) as tap:
        _say(str(tap.endpoint.port))
        Thread(target=_close_at_end, args=(tap,), daemon=True).start()
        while not isinstance(item := inbox.get(), Ended):
            if isinstance(item, Chunk):
                hashes[item.direction].update(item.data)
            elif isinstance(item, WireEvent):
                lost += item.missing
    said = {str(way): each.hexdigest() for way, each in hashes.items()}
    _say(json.dumps({**said, "lost": lost}))


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def _close_at_end(tap: TapSource) -> None:
    os.read(sys.stdin.fileno(), 1)
    tap.close()


if __name__ == "__main__":
    main()
