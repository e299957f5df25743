"""Captures made by others give the same with their ports named and with `--port any`."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import pytest

from mbtool.core import EventKind, InputError, WireEvent
from mbtool.devices import NamedTransaction
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.differential.truth import PORTS, RTU_PORTS, captures_with_truth

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.decode.decoder import Record

MAX_SIZE = 500_000
"""Larger captures are load, of connections like those of the smaller ones."""

LDAP = "testing__btest__Traces__ldap__ldap_invalid_credentials.pcap"
MIXED = "modbus-and-non-modbus-p502.pcap"


def read(path: Path, options: ReadingOptions) -> list[Record]:
    records = []
    try:
        for record in Reading([str(path)], options).records():
            records.append(record)
    except InputError:
        pass  # A cut file, told in another test; all that came before the cut is there.
    return records


def named(path: Path) -> ReadingOptions:
    return ReadingOptions(
        ports=PORTS.get(path.name, (502,)), rtu_ports=RTU_PORTS.get(path.name, ())
    )


def transactions(records: list[Record]) -> Counter[str]:
    return Counter(
        f"{one.source} {one.destination} {one.outcome} {one.request_ns} {one.response_ns} "
        f"{one.request_raw!r} {one.response_raw!r}"
        for one in records
        if isinstance(one, NamedTransaction)
    )


@pytest.mark.public_captures
def test_modbus_is_found_at_any_port_as_at_its_own(public_captures: Path) -> None:
    looked_at = 0
    for path in captures_with_truth(public_captures):
        if path.stat().st_size > MAX_SIZE:
            continue
        found = transactions(read(path, ReadingOptions(any_port=True)))
        assert found == transactions(read(path, named(path))), path.name
        looked_at += bool(found)
    assert looked_at > 20


@pytest.mark.public_captures
@pytest.mark.parametrize(
    "options",
    [ReadingOptions(any_port=True), ReadingOptions(ports=(389,))],
    ids=["any", "named"],
)
def test_lengths_of_ldap_are_no_headers(public_captures: Path, options: ReadingOptions) -> None:
    (path,) = public_captures.rglob(LDAP)
    records = read(path, options)
    assert not transactions(records)
    (event,) = [one for one in records if isinstance(one, WireEvent) and one.raw]
    assert event.kind is EventKind.FOREIGN
    assert "LDAP" in event.message


@pytest.mark.public_captures
@pytest.mark.parametrize(
    "options", [ReadingOptions(any_port=True), ReadingOptions()], ids=["any", "named"]
)
def test_each_scanner_at_port_502_is_one_event(
    public_captures: Path, options: ReadingOptions
) -> None:
    (path,) = public_captures.rglob(MIXED)
    records = read(path, options)
    assert transactions(records).total() == 6  # 12 ADUs in one of seven connections.
    events = Counter(one.kind for one in records if isinstance(one, WireEvent))
    assert events[EventKind.FOREIGN] == 6
    assert set(events) == {EventKind.FOREIGN, EventKind.OPENED, EventKind.CLOSED}
