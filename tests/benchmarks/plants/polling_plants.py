"""Plants on which every frame is where it belongs, and yet not easy: the device, not the line."""

# Each function plays a line until the master has sent `requests` requests. Its docstring says why
# such a line exists.

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.benchmarks.plants import pdus
from tests.benchmarks.plants.recording import MS

if TYPE_CHECKING:
    from tests.benchmarks.plants.site import Site

RARE_WRITES = 0.1


def clean(site: Site, requests: int) -> None:
    """A master polls a list and writes now and then; every slave responds. Most lines."""
    while site.asked < requests:
        cycle(site)


def cycle(site: Site) -> None:
    """Poll each entry of the list once."""
    for poll in site.polls:
        site.read(poll)
        if site.random.random() < RARE_WRITES:
            write(site, site.random.choice(site.units))


def write(site: Site, unit: int) -> None:
    """Write to a slave, which responds."""
    request = site.write()
    site.exchange(unit, request, lambda: pdus.write_response(request))


def slow_writes(site: Site, requests: int) -> None:
    """Writes take 60 to 150 ms, reads 3 ms: a slave that stores what is written in an EEPROM."""
    random = site.random
    least_ns = max(3 * MS, site.line.t3_5_ns)
    fast_ns = (least_ns, least_ns + MS)
    slow = random.randint(60, 150)
    slow_ns = (slow * MS, (slow + 10) * MS)
    site.latency_ns = dict.fromkeys(site.units, fast_ns)
    site.set_timeout(1000 * MS)
    share = random.choice((0.1, 0.3, 0.5))
    while site.asked < requests:
        for poll in site.polls:
            site.read(poll)
            if random.random() < share:
                request = site.write((0x05, 0x06, 0x06, 0x10, 0x16))
                site.exchange(
                    poll.unit,
                    request,
                    lambda sent=request: pdus.write_response(sent),  # type: ignore[misc]
                    slow_ns,
                )


def write_loop(site: Site, requests: int) -> None:
    """The same 05 or 06 over and over, echoed: a watchdog bit, a set point sent each cycle.

    On half of the lines nothing else is said; on the others a poll comes after some writes. On a
    third of the lines a response is missing now and then.
    """
    random = site.random
    unit = site.units[0]
    request = site.write((0x05, 0x06))
    polls_after = random.choice((0, 0, 10, 50))
    lost = random.choice((0, 0, 0.02))
    written = 0
    while site.asked < requests:
        site.exchange(unit, request, lambda: request, lost=random.random() < lost)
        written += 1
        if polls_after and written % polls_after == 0:
            site.read(random.choice(site.polls))


def glued(site: Site, requests: int) -> None:
    """A slave responds after 0 to 3.4 characters, and on some lines the master is as quick.

    Microcontrollers that know the length of a request do not wait for t3.5.
    """
    random = site.random
    character_ns = site.line.character_ns
    site.latency_ns = dict.fromkeys(site.units, (0, int(3.4 * character_ns)))
    if random.random() < 0.3:
        site.pause_ns = (character_ns // 2, int(3.4 * character_ns))
    clean(site, requests)


def register_scan(site: Site, requests: int) -> None:
    """Somebody looks which registers a slave has: most requests get an exception."""
    random = site.random
    unit = site.units[0]
    address, step = random.choice((0, 0x0100, 0x0200, 0x0300, 0x1000)), random.choice((1, 1, 10))
    function = random.choice((0x01, 0x02, 0x03, 0x03, 0x04))
    quantity = random.choice((1, 2, step, 16, 20))
    exists = random.uniform(0.05, 0.5)
    code = random.choice((0x02, 0x02, 0x03, 0x0B))
    while site.asked < requests:
        request = pdus.read(function, address % 0x10000, quantity)
        values = [min(1, site.value()) if function < 3 else site.value() for _ in range(quantity)]
        response = (
            pdus.read_response(function, values)
            if random.random() < exists
            else pdus.exception(function, code)
        )
        site.exchange(unit, request, lambda: response)  # noqa: B023
        address += step


def user_defined(site: Site, requests: int) -> None:
    """Functions 41H to 48H, 64H to 6EH and 5AH, whose length no table knows, among polls.

    Drives, energy meters and PLCs (Schneider's UMAS) use such functions.
    """
    random = site.random
    codes = random.sample(pdus.USER_DEFINED, 2)
    umas = random.random() < 0.5
    longest = min(60, site.bus.recording.timeout_ns // site.line.character_ns // 3)
    while site.asked < requests:
        cycle(site)
        for _ in range(random.randint(1, 4)):
            if umas:
                session = bytes([0x5A, random.choice((0, 0x17))])
                code = random.choice((0x02, 0x04, 0x12, 0x20, 0x24))
                request = session + bytes([code]) + random.randbytes(random.randint(0, 10))
                response = session + b"\xfe" + random.randbytes(random.randint(0, longest))
            else:
                function = bytes([random.choice(codes)])
                request = function + random.randbytes(random.randint(0, 12))
                response = function + random.randbytes(random.randint(0, longest))
            site.exchange(random.choice(site.units), request, lambda: response)  # noqa: B023
