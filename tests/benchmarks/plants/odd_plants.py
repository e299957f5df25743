"""Plants with gaps inside frames, late or odd slaves, a slave of two masters, and only writes."""

# Each function plays a line until the master has sent `requests` requests. Its docstring says why
# such a line exists.

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.benchmarks.plants import pdus
from tests.benchmarks.plants.polling_plants import clean, cycle
from tests.benchmarks.plants.recording import MS

if TYPE_CHECKING:
    from tests.benchmarks.plants.site import Poll, Site

GAPPED = 0.3
"""The share of the frames with a gap."""
SLOW_SHARE = 0.5


def radio_gaps(site: Site, requests: int) -> None:
    """Radio modems send a frame in parts: gaps of 50 to 500 ms inside frames."""
    site.bus.gap_ms = (50, 500)
    site.bus.gapped = GAPPED
    site.set_timeout(3000 * MS)
    clean(site, requests)


def slow_slave(site: Site, requests: int) -> None:
    """A slave that is slower than its master's time-out, on some lines always, on others at times.

    The master then asks the next unit, the same unit for something else, or the same again. The
    slave answers in order. What would collide is left out, so the master's time-outs are long.
    """
    random = site.random
    site.set_timeout(random.choice((300, 500)) * MS)
    slow, *others = site.units
    site.units = others or [slow % 247 + 1]
    polls = [site.poll(slow, (3, 4)) for _ in range(2)]
    site.polls = [site.poll(unit) for unit in site.units]
    share = random.choice((SLOW_SHARE, 1.0))
    after = random.choice((_next_unit, _next_poll, _retry))
    while site.asked < requests:
        cycle(site)
        for poll, other in zip(polls, reversed(polls), strict=True):
            if random.random() < share:
                after(site, poll, other)
            else:
                answer = site.values(poll)
                site.exchange(slow, poll.pdu, lambda pdu=answer: pdu, _early(site))  # type: ignore[misc]


def _early(site: Site) -> tuple[int, int]:
    timeout_ns = site.bus.recording.timeout_ns
    return int(0.5 * timeout_ns), int(0.6 * timeout_ns)


def _late_ns(site: Site) -> int:
    """The time that the slave needs beyond the master's time-out."""
    return int(site.random.uniform(0.3, 0.5) * site.bus.recording.timeout_ns)


def _next_unit(site: Site, poll: Poll, _: Poll) -> None:
    quick = site.random.choice(site.polls)
    at = site.bus.ask(poll.unit, poll.pdu)
    site.time_out()
    late_ns = _late_ns(site)
    second = site.bus.ask(quick.unit, quick.pdu)
    wait_ns = site.random.randint(*site.latency(quick.unit))
    site.bus.wait(wait_ns)
    site.bus.reply(second, site.values(quick))
    site.bus.wait(max(late_ns - wait_ns, site.line.t3_5_ns + MS))
    site.bus.reply(at, site.values(poll), is_late=True)
    site.pause()


def _next_poll(site: Site, poll: Poll, other: Poll) -> None:
    _twice(site, poll, other, is_retry=False)


def _retry(site: Site, poll: Poll, _: Poll) -> None:
    _twice(site, poll, poll, is_retry=True)


def _twice(site: Site, poll: Poll, other: Poll, *, is_retry: bool) -> None:
    at = site.bus.ask(poll.unit, poll.pdu)
    site.time_out()
    again = site.bus.ask(other.unit, other.pdu, is_retry=is_retry)
    site.bus.wait(_late_ns(site))
    site.bus.reply(at, site.values(poll), is_late=True)
    # The slave begins with the second request when it has answered the first.
    site.bus.wait(site.bus.recording.timeout_ns + _late_ns(site))
    site.bus.reply(again, site.values(other), is_late=True)
    site.pause()


def slave_of_two(site: Site, requests: int) -> None:
    """Two masters ask one slave, each for something else; it answers in order."""
    random = site.random
    unit = site.units[0]
    site.latency_ns[unit] = (max(20 * MS, site.line.t3_5_ns), max(30 * MS, 2 * site.line.t3_5_ns))
    first = [site.poll(unit, (3, 4)) for _ in range(3)]
    second = [site.poll(unit, (3, 4)) for _ in range(3)]
    while site.asked < requests:
        one, two = random.choice(first), random.choice(second)
        if one.quantity == two.quantity or random.random() < 0.7:
            site.read(one)
            site.read(two)
            continue
        at = site.bus.ask(unit, one.pdu)
        site.bus.wait(site.line.t3_5_ns + random.randint(0, MS))
        other_at = site.bus.ask(unit, two.pdu)
        for place, poll in ((at, one), (other_at, two)):
            site.bus.wait(random.randint(*site.latency(unit)))
            site.bus.reply(place, site.values(poll))
        site.pause()


def set_points(site: Site, requests: int) -> None:
    """A controller that only writes, values that change each time, and every slave echoes."""
    random = site.random
    addresses = [random.randrange(0x100) for _ in range(3)]
    while site.asked < requests:
        for unit in site.units:
            request = pdus.write_register(random.choice(addresses), random.randrange(0x1000))
            site.exchange(unit, request, lambda sent=request: sent)  # type: ignore[misc]


def odd_devices(site: Site, requests: int) -> None:
    """Slaves that answer in a form of their own, as cheap devices do, beside others.

    One repeats the whole request of function 10H. One limits the value of function 06 and repeats
    the value that it took. One answers function 05 with 1 in place of FF00H.
    """
    random = site.random
    units = [*site.units, *(unit for unit in range(1, 40) if unit not in site.units)]
    whole, limiting, switching = units[:3]
    limit = random.randrange(100, 2000)
    site.latency_ns |= {unit: site.latency_ns.get(unit) or (5 * MS, 8 * MS) for unit in units[:3]}
    site.polls = [site.poll(unit) for unit in {*site.units, *units[:3]}]
    while site.asked < requests:
        for poll in site.polls:
            site.read(poll)
            if random.random() < 0.3:
                _write_to_odd(site, random.choice((whole, limiting, switching)), units, limit)


def _write_to_odd(site: Site, unit: int, units: list[int], limit: int) -> None:
    random = site.random
    address = random.randrange(0x40)
    if unit == units[0]:
        request = pdus.write_registers(address, [site.value() for _ in range(random.randint(1, 6))])
        response = request
    elif unit == units[1]:
        value = random.randrange(0x1000)
        request = pdus.write_register(address, value)
        response = pdus.write_register(address, min(value, limit))
    else:
        request = pdus.write_coil(address, True)
        response = request[:3] + b"\x00\x01"
    at = site.bus.ask(unit, request)
    site.bus.wait(random.randint(*site.latency(unit)))
    answer = site.bus.reply(at, response)
    site.bus.recording.sent[answer].is_odd = response != pdus.write_response(request)
    site.pause()
