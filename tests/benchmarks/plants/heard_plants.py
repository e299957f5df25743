"""Plants of which a listener hears less or more than what the master and its slaves said."""

# Each function plays a line until the master has sent `requests` requests. Its docstring says why
# such a line exists.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import SerialFormat
from tests.benchmarks.plants import hearing, pdus
from tests.benchmarks.plants.polling_plants import clean, cycle
from tests.benchmarks.plants.recording import MS, Role
from tests.benchmarks.plants.site import BAUDS

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.benchmarks.plants.site import Site

LOST_SHARES = (0.002, 0.01, 0.03)
"""The share of the frames that lack bytes; each line has its own."""
LOST_MOST = (1, 8, 40)
"""The most bytes that are lost in a row: of a UART without a FIFO, of a FIFO, of a buffer."""
GLITCHES = (b"\x00", b"\xff", b"\xf8", b"\xfe", b"\xc0", b"\x80", b"\x00\x00")
GLITCH_SHARES = (0.1, 0.5, 1.0)
FOREIGN_SHARES = (0.05, 0.2)
"""How often another protocol is spoken after a poll."""
RATE_SHARES = (0.01, 0.05)


def only_one_wire(site: Site, requests: int) -> None:
    """A four-wire line of which one wire is heard: that of the slaves, on a third the master's."""
    role = site.random.choice((Role.RESPONSE, Role.RESPONSE, Role.REQUEST))
    clean(site, requests)
    site.bus.recording = hearing.only(site.bus.recording, role)


def repeater(site: Site, requests: int) -> None:
    """A repeater sends each frame again: the listener hears both of its sides. One unit is dead."""
    random = site.random
    least_ns = random.choice((site.line.t3_5_ns, site.line.character_ns, 2 * site.line.t3_5_ns))
    site.bus.repeat_ns = (least_ns, least_ns + MS // 5)
    dead = next(unit for unit in range(1, 40) if unit not in site.units)
    poll_of_dead = site.poll(dead).pdu
    while site.asked < requests:
        cycle(site)
        if random.random() < 0.1:
            site.unanswered(dead, poll_of_dead)


def lost_bytes(site: Site, requests: int) -> None:
    """The listener's adapter loses bytes: an overrun, or a buffer that a slow program left full."""
    random = site.random
    clean(site, requests)
    share, most = random.choice(LOST_SHARES), random.choice(LOST_MOST)
    site.bus.recording = hearing.with_lost_bytes(site.bus.recording, random, share, most)


def bias(site: Site, requests: int) -> None:
    """A line without bias: the edges of a driver that switches on or off are bytes to a receiver.

    Which bytes, and if they come before a frame or behind it, is the same all the time.
    """
    random = site.random
    before, behind = random.choice(((True, False), (False, True), (False, True), (True, True)))
    share = random.choice(GLITCH_SHARES)
    values = random.sample(GLITCHES, random.randint(1, 3))

    def glitch() -> tuple[bytes, bytes]:
        first, last = (
            random.choice(values) if side and random.random() < share else b""
            for side in (before, behind)
        )
        return first, last

    site.bus.glitch = glitch
    clean(site, requests)


def baud_change(site: Site, requests: int) -> None:
    """Somebody tries other baud rates on the line: what is sent so is wrong bytes to a listener."""
    random = site.random
    share = random.choice(RATE_SHARES)
    while site.asked < requests:
        for poll in site.polls:
            site.read(poll)
            if random.random() < share:
                _at_other_rate(site, random.choice([one for one in BAUDS if one != site.line.baud]))


def _at_other_rate(site: Site, baud: int) -> None:
    random, line = site.random, site.line
    other = SerialFormat.parse(f"{baud}-{str(line).rpartition('-')[2]}")
    for _ in range(random.randint(1, 6)):
        poll = random.choice(site.polls)
        frames = [pdus.rtu_frame(poll.unit, poll.pdu)]
        if random.random() < 0.5:
            frames.append(pdus.rtu_frame(poll.unit, site.values(poll)))
        for frame in frames:
            heard = hearing.at_another_rate(frame, other, line)
            if heard:
                site.bus.noise(heard)
            site.bus.wait(max(other.t3_5_ns, line.t3_5_ns))
        site.pause()


def foreign_protocol(site: Site, requests: int) -> None:
    """Devices that speak another protocol share the line: meters, drives, or text."""
    random = site.random
    speak = random.choice((_dlt645, _uss, _mbus, _text))
    share = random.choice(FOREIGN_SHARES)
    while site.asked < requests:
        for poll in site.polls:
            site.read(poll)
            if random.random() < share:
                for frame in speak(random.randbytes):
                    site.bus.noise(frame)
                    site.bus.wait(random.randint(5, 20) * MS)
                site.pause()


def _dlt645(data: Callable[[int], bytes]) -> list[bytes]:
    """DL/T 645: waking bytes, 68H, address, 68H, control, length, data, sum, 16H."""
    address = data(6)
    return [_summed(b"\xfe\xfe\xfe\xfe", b"\x68" + address + b"\x68" + body, b"\x16")
            for body in (b"\x11\x04" + data(4), b"\x91\x08" + data(8))]  # fmt: skip


def _uss(data: Callable[[int], bytes]) -> list[bytes]:
    """USS of drives: 02H, length, address, four words, exclusive or."""
    frames = []
    for body in (data(8), data(8)):
        frame = b"\x02\x0a\x03" + body
        check = 0
        for byte in frame:
            check ^= byte
        frames.append(frame + bytes([check]))
    return frames


def _mbus(data: Callable[[int], bytes]) -> list[bytes]:
    """M-Bus: a short frame, and a long frame as the answer."""
    values = b"\x08\x01\x72" + data(24)
    head = bytes([0x68, len(values), len(values), 0x68])
    return [b"\x10\x5b\x01\x5c\x16", _summed(head, values, b"\x16")]


def _text(data: Callable[[int], bytes]) -> list[bytes]:
    """Lines of text, as scales and modems send them."""
    (value,) = data(1)
    return [b"AT+CSQ\r\n", b"+CSQ: %d,0\r\nOK\r\n" % (value % 32)]


def _summed(head: bytes, counted: bytes, end: bytes) -> bytes:
    return head + counted + bytes([sum(counted) % 256]) + end
