"""Plants on which more is heard than a master and its slaves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.benchmarks.plants import pdus
from tests.benchmarks.plants.polling_plants import cycle, write
from tests.benchmarks.plants.recording import MS

if TYPE_CHECKING:
    from tests.benchmarks.plants.site import Site

STRAY_SHARES = (0.005, 0.01, 0.03, 0.1)
"""The share of the silences of a nearly clean line with a stray byte; each line has its own."""
BURST_SHARES = (0.01, 0.05, 0.2)
INTERLEAVED_SHARE = 0.1
"""How often the second master asks while the first waits."""


def stray_bytes(site: Site, requests: int) -> None:
    """A nearly clean line: now and then one byte of any value, beside a frame or far from it.

    A driver that switches on or off, a line without bias, a relay near the cable: what a UART makes
    of such an edge depends on its length, so every value occurs.
    """
    _polled_with_noise(site, requests, site.random.choice(STRAY_SHARES), (1, 1))


def noise_bursts(site: Site, requests: int) -> None:
    """Bursts of 2 to 40 random bytes between frames: a motor or a welder near the cable."""
    _polled_with_noise(site, requests, site.random.choice(BURST_SHARES), (2, 40))


def _polled_with_noise(site: Site, requests: int, share: float, size: tuple[int, int]) -> None:
    random = site.random
    while site.asked < requests:
        poll = random.choice(site.polls)
        noise_before_request = random.random() < share
        if noise_before_request:
            _noise(site, size, site.pause_ns[0])
        is_write = random.random() < 0.1
        request = site.write() if is_write else poll.pdu
        at = site.bus.ask(poll.unit, request)
        latency_ns = random.randint(*site.latency(poll.unit))
        if random.random() < share:
            _noise(site, size, latency_ns)
        else:
            site.bus.wait(latency_ns)
        site.bus.reply(at, pdus.write_response(request) if is_write else site.values(poll))
        site.pause()


def _noise(site: Site, size: tuple[int, int], silence_ns: int) -> None:
    """Spend a silence with noise in it: behind the last frame, before the next, or between."""
    random = site.random
    count = random.randint(*size)
    spare_ns = max(0, silence_ns - count * site.line.character_ns)
    before_ns = random.choice((0, spare_ns, random.randint(0, spare_ns)))
    site.bus.wait(before_ns)
    site.bus.noise(random.randbytes(count))
    site.bus.wait(spare_ns - before_ns)


def adapter_echo(site: Site, requests: int) -> None:
    """An adapter at the master that hears what it sends: each request comes twice, 0.5 ms apart.

    Two-wire adapters whose receiver stays on while they send. Some units do not respond.
    """
    random = site.random
    site.bus.echo_ns = random.randint(300, 700) * 1000
    dead = next(unit for unit in range(1, 40) if unit not in site.units)
    silent = [site.poll(dead).pdu, site.write((0x06,)), site.write((0x05,))]
    while site.asked < requests:
        cycle(site)
        if random.random() < 0.3:
            site.unanswered(dead, random.choice(silent))


def two_masters(site: Site, requests: int) -> None:
    """Two masters on one line: a panel beside a controller, or a service laptop.

    Each waits for a silence. So the second may ask while the first still waits for its slave, and
    then two responses follow. What collides is damage, and is left out here.
    """
    random = site.random
    units = site.units if len(site.units) > 1 else [site.units[0], site.units[0] % 247 + 1]
    site.units = units
    site.latency_ns |= {unit: (20 * MS, 30 * MS) for unit in units if unit not in site.latency_ns}
    first = [site.poll(unit) for unit in units for _ in range(2)]
    second = [site.poll(unit) for unit in units for _ in range(2)]
    turn = 0
    while site.asked < requests:
        poll = first[turn % len(first)]
        turn += 1
        other = random.choice(second)
        if other.unit != poll.unit and random.random() < INTERLEAVED_SHARE:
            _interleaved(site, poll.unit, poll.pdu, site.values(poll),
                         other.unit, other.pdu, site.values(other))  # fmt: skip
            continue
        site.read(poll)
        if random.random() < 0.5:
            site.read(other)
        if random.random() < 0.1:
            write(site, other.unit)


def _interleaved(
    site: Site, unit: int, request: bytes, response: bytes,
    other_unit: int, other_request: bytes, other_response: bytes,
) -> None:  # fmt: skip
    """Two requests in a row, then their responses in either order."""
    bus, random = site.bus, site.random
    at = bus.ask(unit, request)
    bus.wait(site.line.t3_5_ns + random.randint(0, MS))
    other_at = bus.ask(other_unit, other_request)
    answers = [(at, response), (other_at, other_response)]
    if random.random() < 0.3:
        answers.reverse()
    for place, pdu in answers:
        bus.wait(random.randint(*site.latency(bus.recording.sent[place].unit)))
        bus.reply(place, pdu)
    site.pause()
