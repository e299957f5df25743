"""Masters of others and `mbtool slave` over a cable, with `mbtool sniff net:` at either end."""

# The ends of the cable are in network namespaces of their own, so nothing else is on it, and what
# passes is real Ethernet with IPv4 and IPv6. Where namespaces may not be made, nothing is tested.

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import ExitStack
from typing import TYPE_CHECKING

import pytest

from tests.end_to_end.namespaces import INTERFACE, IPV4, IPV6, cable, why_not
from tests.end_to_end.programs import (
    MBTOOL,
    PATIENCE_S,
    Program,
    decoded,
    required,
    run_mbtool,
)
from tests.workflows.fa3_session import session

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from tests.end_to_end.namespaces import Cable

PORT = 1502
ALLOWED = ("--allow", "10.0.0.0/8", "--allow", "fd90::/64")
ASKED = 20

CLIENT = f"""
import json, sys
from tests.end_to_end.peers import ask_twenty, tcp_client
with tcp_client({PORT}, sys.argv[1]) as (client, wire):
    ask_twenty(client)
print(json.dumps([[one.hex() for one in side] for side in (wire.requests, wire.responses)]))
"""


@pytest.fixture(scope="module")
def ends() -> Iterator[Cable]:
    reason = why_not()
    if reason is not None:
        pytest.skip(reason)
    with cable() as made:
        yield made


@pytest.fixture
def own_ends(ends: Cable) -> Iterator[Cable]:
    """A cable of one test: an interface that was down has lost its IPv6 addresses."""
    with cable("mbtool-own") as made:
        yield made


@pytest.mark.parametrize(
    ("host", "slave", "options"),
    [
        (IPV6[1], f"[{IPV6[1]}]:{PORT}", ("--port", str(PORT))),
        (IPV4[1], f"{IPV4[1]}:{PORT}", ("--port", "any")),
    ],
    ids=["ipv6", "any port"],
)
def test_what_pymodbus_asks_is_logged_at_both_ends(
    ends: Cable, tmp_path: Path, host: str, slave: str, options: Sequence[str]
) -> None:
    client = [sys.executable, "-c", CLIENT, host]

    def ask() -> tuple[list[str], list[str]]:
        command = ends.within(ends.master, *client)
        asked = subprocess.run(command, check=True, capture_output=True, timeout=PATIENCE_S)
        requests, responses = json.loads(asked.stdout)
        return requests, responses

    with listening(ends, tmp_path, f"net:{INTERFACE}", slave, options) as sniffers:
        requests, responses = ask()
        logs = sniffers.end_after(ASKED)
    assert len(requests) == ASKED
    for log in logs:
        assert [one["request_raw"] for one in log] == requests
        assert [one["response_raw"] for one in log] == responses
        assert {one["link"] for one in log} == {slave}


@pytest.mark.peers
@pytest.mark.parametrize(
    ("host", "slave"), [(IPV4[1], f"{IPV4[1]}:{PORT}"), (IPV6[1], f"[{IPV6[1]}]:{PORT}")]
)
def test_what_mbpoll_asks_is_logged_at_both_ends(
    ends: Cable, tmp_path: Path, host: str, slave: str
) -> None:
    mbpoll = required("mbpoll", "mbpoll")
    steps = [
        (("-t", "4", "-r", "1", "-c", "3"), ()),
        (("-t", "4", "-r", "10"), ("4660",)),
        (("-t", "0", "-r", "1", "-c", "9"), ()),
    ]
    # On every interface at once: the cable is the only one that carries anything.
    with listening(ends, tmp_path, "net:any", slave, ("--port", str(PORT))) as sniffers:
        for options, values in steps:
            once = ("-m", "tcp", "-p", str(PORT), "-o", "10", "-1", "-q")
            command = (mbpoll, *once, *options, host, *values)
            with Program(*ends.within(ends.master, *command)) as program:
                assert program.wait() == 0, program.said.text + program.printed.text
        logs = sniffers.end_after(len(steps))
    for log in logs:
        assert [(one["function"], one["outcome"]) for one in log] == [
            (3, "ok"),
            (6, "ok"),
            (1, "ok"),
        ]
        assert log[1]["request_values"] == [4660]
        assert {one["link"] for one in log} == {slave}


SPEAK = """
import socket, sys
from mbtool.modbus import mbap_adu
from tests.packets.building import Talk
from tests.workflows.evidence import READ, VALUES
talk = Talk()
said = talk.handshake()
for number in range(int(sys.argv[1])):
    said += [talk.request(mbap_adu(number, 1, READ)), talk.response(mbap_adu(number, 1, VALUES))]
ways = {name: socket.socket(socket.AF_PACKET, socket.SOCK_RAW) for name in sys.argv[2:]}
for name, way in ways.items():
    way.bind((name, 0))
both = list(ways.values())
for one in said + talk.goodbye():
    # A packet with the master's address goes out on the first, others on the last.
    both[0 if one.data[26:30] == bytes([10, 0, 0, 1]) else -1].send(one.data)
"""


@pytest.mark.parametrize(
    ("links", "outcomes"),
    [
        ((f"net:{INTERFACE},lo",), ["ok"] * 5),
        ((f"net:{INTERFACE}", "net:lo"), ["not-captured"] * 10),
    ],
    ids=["as one", "apart"],
)
def test_a_flow_is_followed_across_interfaces_only_where_that_is_asked(
    ends: Cable, tmp_path: Path, links: Sequence[str], outcomes: list[str]
) -> None:
    """As behind a network tap: each interface hears one way of the connection."""
    log = tmp_path / "both.mcap"
    sniff = (MBTOOL, "sniff", *links, "-w", str(log), "--format", "jsonl")
    with Program(*ends.within(ends.slave, *sniff)) as sniffer:
        sniffer.said.find("listening on")
        speak = (sys.executable, "-c", SPEAK, "5", INTERFACE, "lo")
        subprocess.run(ends.within(ends.slave, *speak), check=True, timeout=PATIENCE_S)
        sniffer.printed.take(5)
        assert sniffer.interrupt() == 130
    found = [str(one["outcome"]) for one in decoded(log)]
    # The last request counts as unanswered where the busy machine let it wait for long.
    assert sorted(one.replace("no-answer", "not-captured") for one in found) == outcomes
    assert sorted(str(one["outcome"]) for one in decoded(log, "--raw")) == outcomes


CONNECT = """
import socket, sys
try:
    with socket.create_connection((sys.argv[1], int(sys.argv[2])), 10) as connection:
        print(len(connection.recv(100)))
except ConnectionResetError:  # Perhaps before the call has returned.
    print(0)
"""


@pytest.mark.parametrize(
    "command",
    [
        ("slave", "idec-ft1a-touch", "--on", f"tcp:[::]:{PORT}"),
        ("sniff", f"tap:[::]:{PORT}=127.0.0.1:9"),
    ],
    ids=["slave", "tap"],
)
@pytest.mark.parametrize("side", [0, 1], ids=["ipv4", "ipv6"])
def test_a_machine_outside_the_allowed_networks_is_turned_away(
    ends: Cable, command: Sequence[str], side: int
) -> None:
    allowed = ("--allow", "192.0.2.0/24", "--allow", "fd90:1::/64")
    with Program(*ends.within(ends.slave, MBTOOL, *command, *allowed)) as program:
        program.said.find("Ctrl-C ends")
        host, own = (IPV4[1], IPV4[0]) if side == 0 else (IPV6[1], IPV6[0])
        connect = (sys.executable, "-c", CONNECT, host, str(PORT))
        asked = subprocess.run(
            ends.within(ends.master, *connect), check=True, capture_output=True, timeout=PATIENCE_S
        )
        assert asked.stdout == b"0\n"
        program.said.find(f"a master was turned away: {own} is in no network of --allow")
        assert program.interrupt() == 130


class listening(ExitStack):  # noqa: N801
    """A slave, and a sniffer at each end of the cable, while the context is open."""

    def __init__(
        self, ends: Cable, folder: Path, link: str, slave: str, options: Sequence[str]
    ) -> None:
        super().__init__()
        answers = ("slave", "idec-ft1a-touch", "--on", f"tcp:{slave}", *ALLOWED)
        self._programs: list[Program] = []
        self._logs = []
        self._start(ends.within(ends.slave, MBTOOL, *answers), "Ctrl-C ends")
        for namespace in (ends.master, ends.slave):
            log = folder / f"{namespace}.mcap"
            hears = (MBTOOL, "sniff", link, *options, "-w", str(log), "--format", "jsonl")
            sniffer = self._start(ends.within(namespace, *hears), "listening on")
            self._programs.append(sniffer)
            self._logs.append(log)

    def end_after(self, count: int) -> list[list[dict[str, object]]]:
        """What each sniffer has logged, once it has shown so many transactions."""
        for program in self._programs:
            program.printed.take(count)
            assert program.interrupt() == 130
            assert "dropped" not in program.said.text
        return [decoded(log) for log in self._logs]

    def _start(self, command: Sequence[str], says: str) -> Program:
        program = self.enter_context(Program(*command))
        program.said.find(says)
        return program


def test_an_interface_that_goes_down_and_up_is_heard_again(own_ends: Cable, tmp_path: Path) -> None:
    log = tmp_path / "both.mcap"
    sniff = (MBTOOL, "sniff", f"net:{INTERFACE}", "-w", str(log), "--format", "jsonl")
    with Program(*own_ends.within(own_ends.slave, *sniff)) as sniffer:
        sniffer.said.find("listening on")
        speak = (sys.executable, "-c", SPEAK, "3", INTERFACE)
        subprocess.run(own_ends.within(own_ends.slave, *speak), check=True, timeout=PATIENCE_S)
        sniffer.printed.take(3)
        for way, told in (("down", "It is opened again when it is back"), ("up", "is back after")):
            command = ("ip", "link", "set", INTERFACE, way)
            subprocess.run(
                own_ends.within(own_ends.slave, *command), check=True, timeout=PATIENCE_S
            )
            sniffer.said.find(told)
        subprocess.run(own_ends.within(own_ends.slave, *speak), check=True, timeout=PATIENCE_S)
        sniffer.printed.take(3)
        assert sniffer.interrupt() == 130
    assert len(decoded(log)) == 6


def test_a_session_with_resets_and_refusals_is_played_so_that_diff_has_nothing_to_say(
    own_ends: Cable, tmp_path: Path
) -> None:
    recording, log = tmp_path / "recording.pcap", tmp_path / "played.mcap"
    recording.write_bytes(session())
    place = f"tcp:{IPV4[1]}:502"
    slave = ("replay", str(recording), "--as-slave", "--on", place, "--allow", "10.0.0.0/8")
    master = ("replay", str(recording), "--as-master", "--to", place)
    sniff = ("sniff", f"net:{INTERFACE}", "-w", str(log), "--format", "jsonl")
    with Program(*own_ends.within(own_ends.slave, MBTOOL, *slave)) as playing:
        playing.said.find("Ctrl-C ends")
        with Program(*own_ends.within(own_ends.master, MBTOOL, *sniff)) as sniffer:
            sniffer.said.find("listening on")
            asking = own_ends.within(own_ends.master, MBTOOL, *master)
            subprocess.run(asking, check=True, capture_output=True, timeout=PATIENCE_S)
            sniffer.printed.take(7)
            assert sniffer.interrupt() == 130
    run_mbtool("diff", str(recording), str(log), "--no-latency")
    without = tmp_path / "without.pcap"
    without.write_bytes(session(resets=False))
    differs = Program(MBTOOL, "diff", str(without), str(log), "--no-latency")
    with differs:
        differs.printed.find("connection 1  +opened, not ended by")
        assert differs.wait() == 1
