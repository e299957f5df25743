"""Plants on which slaves do not respond, or respond late."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.benchmarks.plants import pdus
from tests.benchmarks.plants.polling_plants import cycle, write
from tests.benchmarks.plants.recording import MS

if TYPE_CHECKING:
    from tests.benchmarks.plants.site import Site

JITTER_NS = 15 * MS
"""By how much the timeout of a master differs that shares its machine with other programs."""


def dead_units(site: Site, requests: int) -> None:
    """Units that were removed or have no power are read and written, one to three times each.

    A master keeps them in its list for years. Writes to them are 05, 06, 0F and 10H.
    """
    random = site.random
    dead = [unit for unit in range(1, 40) if unit not in site.units]
    dead = dead[:2] if random.random() < 0.5 else random.sample(dead, 2)
    requests_to_dead = [
        (unit, site.write((function,))) for unit in dead for function in (0x05, 0x06, 0x0F, 0x10)
    ]
    random.shuffle(requests_to_dead)
    # A master that only writes to the dead unit, or reads it as well.
    requests_to_dead = requests_to_dead[: random.randint(2, 8)]
    if random.random() < 0.5:
        requests_to_dead += [(unit, site.poll(unit).pdu) for unit in dead]
    while site.asked < requests:
        for unit, request in requests_to_dead:
            cycle(site)
            site.unanswered(unit, request)


def lost_responses(site: Site, requests: int) -> None:
    """Slaves that respond, and sometimes do not; the master asks again, up to two times more.

    A slave that is busy, or a request that it heard with a wrong CRC.
    """
    random = site.random
    while site.asked < requests:
        for poll in site.polls:
            site.read(poll, lost=random.randint(1, 2) if random.random() < 0.05 else 0)
            if random.random() < 0.2:
                request = site.write((0x05, 0x06, 0x10))
                response = pdus.write_response(request)
                lost = int(random.random() < 0.1)
                site.exchange(poll.unit, request, lambda: response, lost=lost)  # noqa: B023


def near_timeout(site: Site, requests: int) -> None:
    """A slave that needs 0.4 to 1.1 times the master's timeout, beside fast ones.

    A gateway to a slower line, or a slave whose program runs first. What comes after the timeout
    comes after the retry; then the slave drops the retry, or answers it at once. On half of the
    lines the master repeats after exactly its timeout, on the others with 15 ms of jitter.
    """
    random = site.random
    site.set_timeout(random.choice((100, 200, 300, 500)) * MS, random.choice((0, JITTER_NS)))
    slow, *site.units = site.units
    site.polls = [poll for poll in site.polls if poll.unit != slow]
    answers_both = random.random() < 0.5
    polls = [site.poll(slow, (3, 4)) for _ in range(2)]
    while site.asked < requests:
        cycle(site)
        for poll in polls:
            if random.random() < 0.5:
                _slow_exchange(site, slow, poll.pdu, site.values(poll), answers_both)
            else:
                request = site.write((0x05, 0x06, 0x10))
                response = pdus.write_response(request)
                _slow_exchange(site, slow, request, response, answers_both)


def _slow_exchange(
    site: Site,
    unit: int,
    request: bytes,
    response: bytes,
    answers_both: bool,
) -> None:
    """Ask a slow slave; if it needs longer than the timeout, ask again before it responds."""
    bus, random = site.bus, site.random
    recording = bus.recording
    timeout_ns = recording.timeout_ns + random.randint(0, recording.jitter_ns)
    latency_ns = int(recording.timeout_ns * random.uniform(0.4, 1.1))
    if random.random() < 0.1:
        latency_ns = timeout_ns + 1  # Just too late.
    at = bus.ask(unit, request)
    if latency_ns < timeout_ns:
        bus.wait(latency_ns)
        bus.reply(at, response)
    else:
        begin_ns = bus.now_ns
        bus.wait(timeout_ns)
        again = bus.ask(unit, request, is_retry=True)
        # A response that would have begun while the master spoke waits until the line is silent.
        bus.wait(max(begin_ns + latency_ns - bus.now_ns, site.line.t3_5_ns))
        bus.reply(at, response)
        if answers_both:
            bus.wait(site.line.t3_5_ns + random.randint(0, 2 * MS))
            bus.reply(again, response)
    site.pause()


def late_responses(site: Site, requests: int) -> None:
    """A response that comes after the master's request to the next unit: overdue, not lost."""
    random = site.random
    site.units = site.units if len(site.units) > 1 else [site.units[0], site.units[0] % 247 + 1]
    site.polls = [site.poll(unit) for unit in site.units for _ in range(2)]
    while site.asked < requests:
        for poll, after in zip(site.polls, (*site.polls[2:], *site.polls[:2]), strict=True):
            if random.random() > 0.05:
                site.read(poll)
                continue
            at = site.bus.ask(poll.unit, poll.pdu)
            site.time_out()
            second = site.bus.ask(after.unit, after.pdu)
            site.bus.wait(random.randint(*site.latency(after.unit)))
            site.bus.reply(at, site.values(poll), is_late=True)
            site.bus.wait(random.randint(*site.latency(after.unit)))
            site.bus.reply(second, site.values(after))
            site.pause()


def unit_scan(site: Site, requests: int) -> None:
    """Somebody looks which units exist: 1 to 247 are asked in turn, and most do not respond.

    Tools ask with 03, 11H, 08 or 2BH/0EH; some ask a second time.
    """
    random = site.random
    question = random.choice((
        pdus.read(0x03, 0, 1), pdus.read(0x04, 0, 2), b"\x11", pdus.diagnostics(0, 0xA537),
        b"\x2b\x0e\x01\x00",
    ))  # fmt: skip
    tries = random.randint(1, 2)
    unit = 0
    while site.asked < requests:
        unit = unit % 247 + 1
        if unit in site.units:
            site.exchange(unit, question, lambda: _scanned(site, question))
        else:
            site.unanswered(unit, question, tries)
        if random.random() < 0.1:
            write(site, random.choice(site.units))


def _scanned(site: Site, question: bytes) -> bytes:
    random = site.random
    match question[0]:
        case 0x03 | 0x04:
            if random.random() < 0.3:
                return pdus.exception(question[0], 2)
            return pdus.read_response(question[0], [site.value()] * question[4])
        case 0x08:
            return question
        case 0x11:
            return b"\x11\x05" + random.randbytes(4) + b"\xff"
        case _:
            return pdus.exception(0x2B, 1)
