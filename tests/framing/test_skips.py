"""Runs of bytes that cannot be read."""

from __future__ import annotations

from mbtool.core import EventKind
from mbtool.framing.skips import MAX_RUN, SkipRun
from mbtool.modbus.adu import Adu, Checksum, Skipped


def run() -> SkipRun:
    return SkipRun(lambda raw: (EventKind.SKIPPED, f"{len(raw)} bytes", None))


def test_run_is_one_event_with_the_time_of_its_first_byte() -> None:
    events: list[Adu | Skipped] = []
    skips = run()
    skips.add(b"ab", 10, events)
    skips.add(b"c", 20, events)
    assert skips
    assert events == []
    skips.end(events)
    skips.end(events)
    assert events == [Skipped(10, EventKind.SKIPPED, "3 bytes", b"abc")]
    assert not skips


def test_full_run_becomes_an_event_and_the_next_begins_with_its_own_time() -> None:
    events: list[Adu | Skipped] = []
    skips = run()
    skips.add(bytes(MAX_RUN - 1), 10, events)
    skips.add(bytes(2 * MAX_RUN), 20, events)
    assert [(one.ts_ns, len(one.raw)) for one in events if isinstance(one, Skipped)] == [
        (10, MAX_RUN), (20, MAX_RUN),
    ]  # fmt: skip
    skips.end(events)
    assert len(events[-1].raw) == MAX_RUN - 1
    assert MAX_RUN == 1024  # As docs and logs have it: another number changes what decode prints.


def test_event_has_the_wrong_check() -> None:
    check = Checksum(received=0x8876, computed=0x8776)
    skips = SkipRun(lambda raw: (EventKind.BAD_CHECK, "wrong", check))
    events: list[Adu | Skipped] = []
    skips.add(b"ab", 10, events)
    skips.end(events)
    assert events == [Skipped(10, EventKind.BAD_CHECK, "wrong", b"ab", check)]
    assert not check.ok
