"""Listening to an interface: the loopback, where that is permitted."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from threading import Event
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import EventKind, InterfaceLink, LinkError, Packet, Quiet, WireEvent
from mbtool.packets.segment import RST
from mbtool.ports.clock import now_ns
from mbtool.sources import interface
from mbtool.sources.inbox import Ended, Inbox
from mbtool.sources.interface import InterfaceSource, _program
from tests.packets.building import ethernet, ipv4, tcp
from tests.sources.live_helpers import drain, take_until

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

if sys.platform != "linux":
    pytest.skip("listening to an interface needs Linux", allow_module_level=True)

ETHERNET = 1


def may_listen() -> bool:
    try:
        socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0).close()
    except PermissionError:
        return False
    return True


needs_privilege = pytest.mark.skipif(not may_listen(), reason="cap_net_raw is missing (see setcap)")


@pytest.fixture
def connection() -> Iterator[tuple[int, socket.socket, socket.socket]]:
    """A port that is listened to, and both ends of a connection to it."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with socket.create_connection(("127.0.0.1", port)) as master:
            slave, _ = server.accept()
            with slave:
                yield port, master, slave


@pytest.fixture
def port() -> Iterator[int]:
    """A port that is nobody else's, and where nothing listens."""
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        yield holder.getsockname()[1]


def send_segments(port: int, count: int) -> int:
    """Put TCP segments on the loopback that nothing answers. Gives how many."""
    with socket.socket(socket.AF_PACKET, socket.SOCK_RAW) as sender:
        sender.bind(("lo", 0))
        for number in range(count):
            data = tcp(50000, port, 1000 + number, flags=RST, payload=bytes(200))
            sender.send(ethernet(ipv4(data, "127.0.0.1", "127.0.0.1")))
    return count


@needs_privilege
def test_hears_each_packet_once_with_a_time_between_sending_and_hearing(
    connection: tuple[int, socket.socket, socket.socket],
) -> None:
    port, master, slave = connection
    inbox = Inbox()
    request = b"\x00\x01\x00\x00\x00\x06\x11\x03\x00\x6b\x00\x03"
    with InterfaceSource(InterfaceLink(("lo",)), inbox, ports=[port]):
        before_ns = now_ns()
        master.sendall(request)
        assert slave.recv(100) == request
        heard = take_until(inbox, lambda item: isinstance(item, Packet) and request in item.data)
        heard_ns = now_ns()
        slave.sendall(b"answer")
        assert master.recv(100) == b"answer"
        later = take_until(inbox, lambda item: isinstance(item, Packet) and b"answer" in item.data)
    packet = heard[-1]
    assert isinstance(packet, Packet)
    assert (packet.link, packet.link_type) == ("lo", ETHERNET)
    # 14 bytes Ethernet, 20 bytes IPv4, 32 bytes TCP with time stamps.
    assert len(packet.data) == packet.original_length == 14 + 20 + 32 + len(request)
    # scapy's float is true to a quarter of a microsecond.
    assert before_ns - 1_000 <= packet.ts_ns <= heard_ns + 1_000
    assert not any(isinstance(item, Packet) and request in item.data for item in later)


@needs_privilege
def test_other_ports_are_not_heard(connection: tuple[int, socket.socket, socket.socket]) -> None:
    port, master, slave = connection
    inbox = Inbox()
    with (
        socket.create_server(("127.0.0.1", 0)) as other,
        InterfaceSource(InterfaceLink(("lo",)), inbox, ports=[port]),
        socket.create_connection(other.getsockname()) as stranger,
    ):
        stranger.sendall(b"stranger")
        master.sendall(b"wanted")
        assert slave.recv(100) == b"wanted"
    packets = [item for item in drain(inbox) if isinstance(item, Packet)]
    assert any(packet.data.endswith(b"wanted") for packet in packets)
    assert not any(b"stranger" in packet.data for packet in packets)


@needs_privilege
def test_all_interfaces_are_heard_at_once_and_the_loopback_once(
    connection: tuple[int, socket.socket, socket.socket],
) -> None:
    port, master, slave = connection
    inbox = Inbox()
    with InterfaceSource(InterfaceLink(("any",)), inbox, ports=[port]):
        master.sendall(b"request")
        assert slave.recv(100) == b"request"
        slave.sendall(b"answer")
        assert master.recv(100) == b"answer"
    packets = [item for item in drain(inbox) if isinstance(item, Packet)]
    assert {(packet.link, packet.link_type) for packet in packets} == {("any", ETHERNET)}
    assert [packet.data.endswith(b"request") for packet in packets].count(True) == 1


@needs_privilege
def test_what_the_kernel_drops_is_counted_to_the_packet(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody fetches until all are sent: the first fill the buffer, the others are dropped."""
    monkeypatch.setattr(interface, "_BUFFER", 0)  # The kernel takes the least that it has.
    may_fetch = Event()
    fetch = InterfaceSource._fetch
    monkeypatch.setattr(
        InterfaceSource, "_fetch", lambda source: may_fetch.is_set() and fetch(source)
    )
    inbox = Inbox()
    with InterfaceSource(InterfaceLink(("lo",)), inbox, ports=[port]):
        sent = send_segments(port, 200)
        may_fetch.set()
        told = take_until(inbox, lambda item: isinstance(item, WireEvent))  # Within a second.
        sent += send_segments(port, 3)
    items = [*told, *drain(inbox)]
    events = [item for item in items if isinstance(item, WireEvent)]
    assert {event.kind for event in events} == {EventKind.DISCARDED}
    dropped = sum(event.packets for event in events)
    heard = [item for item in items if isinstance(item, Packet)]
    assert dropped > 100
    assert len(heard) + dropped == sent
    assert all(str(event.packets) in event.message for event in events)


@needs_privilege
def test_what_was_dropped_at_the_very_end_is_told_too(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(interface, "_BUFFER", 0)
    monkeypatch.setattr(interface, "_STATISTICS_NS", 3600 * 10**9)
    closing = Event()
    fetch = InterfaceSource._fetch
    monkeypatch.setattr(
        InterfaceSource, "_fetch", lambda source: closing.is_set() and fetch(source)
    )
    inbox = Inbox()
    with InterfaceSource(InterfaceLink(("lo",)), inbox, ports=[port]):
        sent = send_segments(port, 200)
        closing.set()
    items = drain(inbox)
    (event,) = [item for item in items if isinstance(item, WireEvent)]
    assert isinstance(items[-1], Ended)
    assert sum(isinstance(item, Packet) for item in items) + event.packets == sent


@needs_privilege
def test_an_idle_interface_tells_that_time_passes_and_then_that_it_ended() -> None:
    inbox = Inbox()
    with InterfaceSource(InterfaceLink(("lo",)), inbox, ports=[1]):
        first, second = inbox.get(10), inbox.get(10)
        assert isinstance(first, Quiet)
        assert isinstance(second, Quiet)
        assert first.ts_ns < second.ts_ns
    assert drain(inbox)[-1] == Ended("lo")


def test_an_unknown_interface_is_named_with_those_that_are_there() -> None:
    with (
        pytest.raises(LinkError, match=r"^net:eth-no: no such interface; here are: .*lo"),
        InterfaceSource(InterfaceLink(("eth-no",)), Inbox()),
    ):
        pass


def test_a_missing_privilege_says_which_and_how_to_give_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> socket.socket:
        raise PermissionError

    monkeypatch.setattr(socket, "socket", refuse)
    with (
        pytest.raises(LinkError, match="cap_net_raw") as caught,
        InterfaceSource(InterfaceLink(("lo",)), Inbox()),
    ):
        pass
    command = f"sudo setcap cap_net_raw+ep {os.path.realpath(sys.executable)}"
    first, _, second = str(caught.value).partition(
        "; or give raw sockets to every Python program: "
    )
    assert first == f"net:lo: listening needs the capability cap_net_raw: sudo {_program()}"
    assert second == command


@pytest.mark.parametrize(
    ("folder", "there", "said"),
    [
        ("bin", True, "bin/mbtool"),
        ("../bin", True, "{folder}/mbtool"),
        ("bin", False, "{folder}/python -m mbtool"),
    ],
)
def test_under_sudo_the_program_is_called_by_its_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str, there: bool, said: str
) -> None:
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    place = (here / folder).resolve()
    place.mkdir()
    if there:
        (place / "mbtool").touch()
    monkeypatch.setattr(sys, "executable", str(place / "python"))
    assert _program() == said.format(folder=place)


def test_scapy_is_not_imported_before_a_capture_starts() -> None:
    program = (
        "import sys, mbtool.sources.interface, mbtool.sources.live, mbtool.sources.tap;"
        "sys.exit(any(name in sys.modules for name in ('scapy', 'serial')))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


class Scripted:
    """A capture that gives packets with the times that it was told, then has none for now."""

    def __init__(self, times: list[float]) -> None:
        self.times = times
        self.ins = self

    def recv_raw(self, _: int) -> tuple[None, bytes, float]:
        if not self.times:
            raise BlockingIOError
        return None, b"", self.times.pop(0)


@given(
    ways=st.lists(st.lists(st.integers(0, 1000), max_size=20), min_size=2, max_size=3),
    fetch=st.integers(1, 7),
)
def test_packets_of_several_interfaces_come_in_the_order_of_their_times(
    ways: list[list[int]], fetch: int
) -> None:
    """However many are fetched at once, also where one interface lags behind the others."""
    inbox = Inbox()
    source = InterfaceSource(InterfaceLink(("a", "b")), inbox)
    source._captures = [
        interface._Capture(str(number), Scripted([float(time) for time in sorted(way)]), ETHERNET)
        for number, way in enumerate(ways)
    ]
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(interface, "_FETCH", fetch)
        while source._fetch():
            assert all(len(one.held) <= fetch for one in source._captures)
    heard = [item.ts_ns for item in drain(inbox) if isinstance(item, Packet)]
    assert heard == sorted(time * 10**9 for way in ways for time in way)


def of_two_interfaces(times: list[float]) -> tuple[InterfaceSource, Inbox]:
    """One has heard packets, the other none."""
    inbox = Inbox()
    source = InterfaceSource(InterfaceLink(("a", "b")), inbox)
    source._captures = [
        interface._Capture("a", Scripted(times), ETHERNET),
        interface._Capture("b", Scripted([]), ETHERNET),
    ]
    return source, inbox


def seconds(inbox: Inbox) -> list[int]:
    return [item.ts_ns // 10**9 for item in drain(inbox) if isinstance(item, Packet)]


def test_what_another_interface_may_yet_precede_is_held_back_for_a_moment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    source, inbox = of_two_interfaces([1.0, 5.0])
    monkeypatch.setattr(interface, "now_ns", lambda: 5 * 10**9)
    source._fetch()
    assert seconds(inbox) == [1]
    assert len(source._captures[0].held) == 1
    monkeypatch.setattr(interface, "now_ns", lambda: 6 * 10**9)
    source._fetch()
    assert seconds(inbox) == [5]


def test_a_clock_that_is_set_back_stops_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    source, inbox = of_two_interfaces([3600.0, 5.0])
    monkeypatch.setattr(interface, "now_ns", lambda: 6 * 10**9)
    source._fetch()
    assert seconds(inbox) == [3600, 5]
