"""Devices that a master polls and probes by chance: built-in ones, and such as nobody knows."""

# A device is played by its profile. A stranger has one or two areas at round or odd places, some of
# the usual functions, and refuses the rest as the standard says.

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING, Any

from mbtool.devices import Access, Area, Exceptions, FunctionRule, Profile
from mbtool.devices.observed_slave import ObservedSlave
from mbtool.modbus import FUNCTIONS, Outcome, Table, Transport, mbap_adu, rtu_adu
from mbtool.slave.device.image import RegisterImage
from mbtool.slave.families import make_device
from tests.devices.transactions import transaction

if TYPE_CHECKING:
    from mbtool.modbus.transaction import Transaction

MODEL_REQUEST = "42 00"
"""Asks an FA3 module for its model code."""
_READS = {
    Table.COILS: 0x01,
    Table.DISCRETE_INPUTS: 0x02,
    Table.HOLDING_REGISTERS: 0x03,
    Table.INPUT_REGISTERS: 0x04,
}


def stranger(seed: int) -> Profile:
    """A device that is none of the built-in ones."""
    chance = Random(f"stranger {seed}")
    tables = chance.sample(list(Table), chance.randint(1, 4))
    areas = [
        Area(
            name=f"area {index}",
            table=table,
            first=(first := chance.choice((0, 0, 0, 1, 100, 1000, chance.randrange(30000)))),
            last=first + chance.choice((7, 9, 15, 31, 49, 63, 99, 127, 255, 999, 9998)),
            access=Access.READ_WRITE if table.is_writable else Access.READ,
        )
        for index, table in enumerate(tables)
    ]
    functions = {_READS[table] for table in tables}
    if Table.HOLDING_REGISTERS in tables:
        functions |= {6, 16}
    if Table.COILS in tables:
        functions |= {5, 15}
    functions |= set(chance.sample((8, 0x11, 0x16, 0x17, 0x2B), chance.randint(0, 2)))
    return Profile(
        name="stranger",
        title="Stranger",
        vendor="Nobody",
        transports=[chance.choice((Transport.TCP, Transport.RTU))],
        source="none",
        areas=areas,
        functions={f"{code:02X}": FunctionRule() for code in functions},
        exceptions=Exceptions(function=1, address=2, value=3, documented=[1, 2, 3]),
    )


def polled(profile: Profile, seed: int, *, probes: int = 0, model: bool = False) -> ObservedSlave:
    """What is seen of a device: 2 to 30 different polls and a number of probes.

    A poll reads part of an area. A probe reads or writes anywhere, or right behind an area. With
    `model`, the master asks for the model by 42H.
    """
    chance = Random(f"{profile.name} {seed}")
    device = make_device(profile, RegisterImage.of(profile))
    tcp = Transport.TCP in profile.transports
    seen = ObservedSlave("" if tcp else "line", "10.0.0.7:502" if tcp else None, 1)
    requests = [_poll(chance, profile) for _ in range(chance.randint(2, 30))]
    requests += [_probe(chance, profile) for _ in range(probes)]
    if model:
        requests.append(bytes.fromhex(MODEL_REQUEST))
    for number, request in enumerate(requests):
        response = device.respond(1, request, number * 1_000_000_000)
        seen.note(_transaction(request, response.pdu if response is not None else None, tcp=tcp))
    return seen


def _poll(chance: Random, profile: Profile) -> bytes:
    readable = [one for one in profile.areas if one.access is not Access.WRITE]
    area = chance.choice(readable)
    first = chance.randint(area.first, min(area.last, area.first + 200))
    rule = profile.rule(_READS[area.table])
    limit = (rule.limit if rule is not None else None) or 60
    count = chance.randint(1, min(area.last - first + 1, limit))
    return _read(area.table, first, count)


def _probe(chance: Random, profile: Profile) -> bytes:
    kind = chance.randrange(4)
    area = chance.choice(profile.areas)
    if kind == 0:
        return _read(area.table, min(area.last + 1, 0xFFFF), 1)
    if kind == 1:
        return _read(area.table, min(area.last, 0xFFFE), 2)
    if kind == 2:
        return _read(chance.choice(list(Table)), chance.randrange(0x10000), 1)
    return bytes((6,)) + chance.randrange(0x10000).to_bytes(2) + bytes(2)


def _read(table: Table, first: int, count: int) -> bytes:
    return bytes((_READS[table],)) + first.to_bytes(2) + count.to_bytes(2)


def _transaction(request: bytes, response: bytes | None, *, tcp: bool) -> Transaction:
    function = request[0]
    transport = Transport.TCP if tcp else Transport.RTU
    fields: dict[str, Any] = {"transport": transport, "unit": 1}
    if function in FUNCTIONS:
        fields["address"] = int.from_bytes(request[1:3])
        fields["quantity"] = 1 if function == 6 else int.from_bytes(request[3:5])
    if response is None:
        return transaction(function, **fields, outcome=Outcome.NO_ANSWER)
    adu = mbap_adu(0, 1, response) if tcp else rtu_adu(1, response)
    fields["response_raw"] = adu
    if response[0] & 0x80:
        return transaction(function, **fields, outcome=Outcome.EXCEPTION, exception=response[1])
    return transaction(function, **fields)
