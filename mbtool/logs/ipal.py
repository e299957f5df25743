"""Formats transactions as IPAL: one JSON line for each request and each response."""

# IPAL is a form of industrial traffic for intrusion detection systems, independent of the protocol
# (https://github.com/fkie-cad/ipal_transcriber, README, "Message Format"). A message has an `id`;
# its `timestamp` in seconds; `src` and `dest` (for a slave, with its unit; on a serial line, the
# name of the line); the function code as `type`; an `activity`; and `data`, with the value of each
# register or bit. In the request of a read, these values are null. The response follows its
# request, and `responds to` has the id of the request. `malicious` is null, because the traffic is
# not labelled. Functions without registers or bits have no data, and neither have the masks of a
# mask write.
#
# Memory: the number of messages.

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import msgspec

from mbtool.modbus import FUNCTIONS
from mbtool.modbus.functions import READ_WRITE_REGISTERS

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction

_TABLES = {
    1: "coil", 2: "discrete.input", 3: "holding.register", 4: "input.register", 5: "coil",
    6: "holding.register", 15: "coil", 16: "holding.register",
    23: "holding.register",
}  # fmt: skip
_WRITES = frozenset((5, 6, 15, 16, 22, 23))
_SINGLE = frozenset((5, 6))


class IpalLines:
    """Makes the lines of transactions, and counts messages."""

    def __init__(self) -> None:
        self._messages = 0

    def lines(self, one: NamedTransaction) -> str:
        """Return the lines of the request and of the response, as far as they were captured."""
        master = one.source or one.link
        slave = f"{one.destination or one.link}:{one.unit}"
        is_write = one.function in _WRITES
        found, asked = "", []
        if one.request_ns is not None:
            asked.append(self._messages)
            activity = "command" if is_write else "interrogate"
            ends = (master, slave)
            found += self._line(
                one.request_ns, ends, one, one.request_raw, activity, [], _request_data(one)
            )
        if one.response_ns is not None:
            activity = "action" if is_write else "inform"
            ends = (slave, master)
            data = {} if one.exception is not None else _response_data(one)
            found += self._line(one.response_ns, ends, one, one.response_raw, activity, asked, data)
        return found

    def _line(
        self,
        at_ns: int,
        ends: tuple[str, str],
        one: NamedTransaction,
        raw: bytes | None,
        activity: str,
        asked: Sequence[int],
        data: dict[str, int | None],
    ) -> str:
        message: dict[str, Any] = {
            "id": self._messages,
            "timestamp": at_ns / 1e9,
            "protocol": "modbus",
            "malicious": None,
            "src": ends[0],
            "dest": ends[1],
            "length": len(raw or b""),
            "crc": True,
            "type": one.function,
            "activity": activity,
            "responds to": [*asked],
            "data": data,
        }
        self._messages += 1
        return msgspec.json.encode(message).decode() + "\n"


def _request_data(one: NamedTransaction) -> dict[str, int | None]:
    """The values that a request writes, and null for those that it reads."""
    if one.function not in _WRITES:
        return _data(one.function, one.address, one.quantity, ())
    data: dict[str, int | None] = {}
    if one.function == READ_WRITE_REGISTERS:
        data = _data(one.function, one.address, one.quantity, ())
        return data | _data(one.function, one.write_address, one.write_quantity, one.request_values)
    return _data(one.function, one.address, one.quantity, one.request_values)


def _response_data(one: NamedTransaction) -> dict[str, int | None]:
    """The values that a response has, or that a write has set."""
    values = one.response_values
    if one.function in _WRITES and one.function != READ_WRITE_REGISTERS:
        values = values or one.request_values
    return _data(one.function, one.address, one.quantity, values)


def _data(
    function: int, address: int | None, quantity: int | None, values: Sequence[int] | None
) -> dict[str, int | None]:
    table, values = _TABLES.get(function), values or ()
    if table is None or address is None:
        return {}
    size = 1 if function in _SINGLE else min(quantity or len(values), FUNCTIONS[function].limit)
    places = range(address, min(address + size, 0x10000))
    pairs = zip_longest(places, values[:size])
    return {f"{table}.{place}": value for place, value in pairs}
