"""Finds the units on a link and the registers that each lets read, by requests that only read."""

# Units. Each unit is asked to read holding register 0, for its diagnostics echo (08) and for its
# identification (2B/0E), until it answers. An exception response is an answer. On TCP, a device
# without a gateway often answers under every unit number; then only one number is scanned.
#
# Registers. A table is read in blocks. In a refused block, single addresses are read: the first
# one, and multiples of 10 and of 16, where areas usually begin. From an address that can be read,
# the area is followed to both ends by bisection. With `every`, a refused block is halved down to
# single registers, which takes up to two requests for each address. After exception 03 the block is
# too long for the device, so it and all later blocks are halved. After exception 01 the table is
# not read further. The same is true if a unit of which nothing could be read so far answers
# exception 04 at the first FAILURES addresses tried in a block.
#
# A read without a correct answer is repeated, because lines lose frames: it is sent _TRIES times in
# all. Before each repetition the scan pauses for a late answer.
#
# If another master uses the line, a block that does not fit into its pauses is halved, too.
#
# Only functions 01 to 04, 08/00 and 2B/0E are sent. Nothing is written.

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

import msgspec

from mbtool.core import Direction
from mbtool.core.moments import SECOND_NS
from mbtool.master.other_master import NoPauseError
from mbtool.modbus import FUNCTIONS, Outcome, encode_pdu
from mbtool.modbus.functions import GATEWAY_EXCEPTIONS
from mbtool.modbus.identification import identities
from mbtool.modbus.pdu import whole_pdu
from mbtool.modbus.tables import READS_OF_TABLE, Table

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction

_TABLES = (
    Table.HOLDING_REGISTERS,
    Table.INPUT_REGISTERS,
    Table.COILS,
    Table.DISCRETE_INPUTS,
)
"""The tables in the order in which they are read."""
_PROBES = (
    bytes.fromhex("03 0000 0001"),  # read holding register 0
    bytes.fromhex("08 0000 a55a"),  # diagnostics: echo
    bytes.fromhex("2b 0e 01 00"),  # read device identification, basic
)
_IDENTIFICATION = _PROBES[2]
_LEAST_SAME = 4
"""If at least this many units of a TCP link give the same answers, one device answers for all."""
_Unit = Annotated[int, msgspec.Meta(ge=0, le=255)]
_Address = Annotated[int, msgspec.Meta(ge=0, le=0x10000)]
_VALUES, _NOTHING = 0, -1
"""The ways in which a read ended, beside exception codes: with values, or without a useful
answer."""
_ILLEGAL_FUNCTION, _ILLEGAL_VALUE, _DEVICE_FAILURE = 0x01, 0x03, 0x04
_TRIES = 3
FAILURES = 8
MOST_SILENT = 3
"""This many requests in a row without an answer end the scan of a unit that answered before."""


class FoundUnit(msgspec.Struct, kw_only=True, omit_defaults=True):
    """A unit that answered."""

    unit: _Unit
    sign: str
    """The unit's answer that showed that it exists, as a table shows it."""
    answer: str = ""
    """The bytes of this answer from its unit on, in hexadecimal, without the unit."""
    identity: list[str] = []
    """The unit's answers to 2B/0E, each as `name: text`."""
    is_any: bool = False
    """True if the device gives the same answers under every unit number."""


class FoundArea(msgspec.Struct, kw_only=True, frozen=True):
    """Addresses (on the wire, both included) of one table that a unit lets read."""

    unit: _Unit
    table: Table
    first: _Address
    last: _Address


class ScanState(msgspec.Struct, kw_only=True):
    """What a scan has found and where it stands; also the content of the file of --resume."""

    link: str
    numbers: list[_Unit] = []
    """The units to ask."""
    addresses: tuple[_Address, _Address] | None = None
    """The first and the last address to read; None if no registers are read."""
    next_unit: Annotated[int, msgspec.Meta(ge=0)] = 0
    """The place in `numbers` of the next unit to ask."""
    units: list[FoundUnit] = []
    areas: list[FoundArea] = []
    next_addresses: dict[str, _Address] = {}
    """The next address to read, by `unit table`; the table is done if it is 65536."""
    remarks: list[str] = []


class Scan:
    """A scan of one link. `ask` sends a request PDU to a unit and returns the transaction."""

    def __init__(
        self,
        ask: Callable[[int, bytes], NamedTransaction],
        state: ScanState,
        *,
        is_tcp: bool,
        every: bool = False,
        interval_ns: int = 0,
        late_ns: int = 0,
    ) -> None:
        """With `every`, each address of a refused block is read. `interval_ns` is the least time
        from one request to the next, and `late_ns` the time in which a late answer may come, in ns.
        """
        self._ask = ask
        self.state = state
        self._is_tcp = is_tcp
        self._every = every
        self._interval_ns = interval_ns
        self._late_ns = late_ns
        self.asked = 0
        """The number of requests sent."""
        self._next_ns = 0
        self._silent = 0
        """The number of requests without an answer since the last answer."""
        self._answers: set[int] = set()
        """The results of the reads in the last refused block: exception codes, _VALUES or
        _NOTHING."""
        self._limits: dict[tuple[int, int], int] = {}
        """The longest block that a unit lets read, by unit and function code."""
        self._longest: dict[tuple[int, int], int] = {}
        """The longest block that was read, by unit and function code."""
        self._refuses_by_value: set[tuple[int, int]] = set()
        """The units and functions that refuse addresses with exception 03, as others do with 02."""

    def units(self, numbers: Sequence[int]) -> Iterator[int]:
        """Ask each unit; yield the number of each, asked or left out, after it."""
        for place in range(self.state.next_unit, len(numbers)):
            unit = numbers[place]
            found = self._probe_unit(unit)
            if found is not None:
                self.state.units.append(found)
            self.state.next_unit = place + 1
            yield unit
            if self._is_tcp and place + 1 == _LEAST_SAME and self._answers_all_units(numbers):
                self.state.units[1:] = []
                self.state.units[0].is_any = True
                self.state.next_unit = len(numbers)
                return

    def _answers_all_units(self, numbers: Sequence[int]) -> bool:
        """True if one device answers for all units: the first ones gave equal answers, and so does
        the last one.
        """
        found = self.state.units
        if len(found) < _LEAST_SAME:
            return False
        last = self._probe_unit(numbers[-1])
        answers = {(one.answer, *one.identity) for one in (*found, *([last] if last else ()))}
        return last is not None and len(answers) == 1

    def _probe_unit(self, unit: int) -> FoundUnit | None:
        """Send the probes to a unit until one shows that it exists; None if none does."""
        for pdu in _PROBES:
            transaction = self._send(unit, pdu)
            if _is_sign(transaction):
                found = FoundUnit(unit=unit, sign=_sign_text(transaction))
                response = whole_pdu(transaction.transport, transaction.response_raw)
                found.answer = (response or b"").hex()
                known = transaction if pdu == _IDENTIFICATION else self._send(unit, _IDENTIFICATION)
                found.identity = [f"{one.name}: {one.text}" for one in identities(known)]
                return found
        return None

    def scan_registers(self, unit: int, addresses: range) -> Iterator[tuple[Table, int]]:
        """Find the areas of each table; yield table and next address after each block.

        Addresses are those on the wire. Ends early if the unit answers no more.
        """
        for table in _TABLES:
            code = READS_OF_TABLE[table]
            key = f"{unit} {table.value}"
            at = self.state.next_addresses.get(key, addresses.start)
            self._silent = 0
            while at < addresses.stop:
                limit = self._limits.get((unit, code), FUNCTIONS[code].limit)
                size = min(limit, addresses.stop - at)
                try:
                    answer = self._read(unit, code, at, size)
                except NoPauseError:
                    if size == 1:
                        raise
                    self._limits[unit, code] = size // 2
                    continue
                if answer == _ILLEGAL_VALUE and size > 1:
                    shorter = self._accepted_length(unit, code, at, size)
                    if shorter:
                        self._limits[unit, code] = shorter
                        continue
                if answer == _ILLEGAL_FUNCTION:
                    at = addresses.stop
                elif answer == _VALUES:
                    self._add(unit, table, at, at + size)
                    at += size
                else:
                    self._answers.clear()
                    for first, end in self._readable_parts(unit, code, range(at, at + size)):
                        self._add(unit, table, first, end)
                    at = at + size if self._can_more(unit) else addresses.stop
                self.state.next_addresses[key] = at
                yield table, at
                if self._silent >= MOST_SILENT:
                    self.state.remarks.append(
                        f"unit {unit} answers no more: {table.value} is not read from {at} on"
                    )
                    return

    def _can_more(self, unit: int) -> bool:
        """False if the unit has refused each address of the last block with 04, and nothing of it
        could be read before: then there is probably no such unit.
        """
        is_known = any(area.unit == unit for area in self.state.areas)
        return is_known or self._answers != {_DEVICE_FAILURE}

    def _accepted_length(self, unit: int, code: int, at: int, size: int) -> int:
        """Return a length of a block that is not too long for the unit, if `size` is; 0 if it
        refuses the addresses, and not the length.
        """
        # A block of this length was read at other addresses, so the unit refuses these addresses.
        is_by_address = size <= self._longest.get((unit, code), 0)
        if is_by_address or (unit, code) in self._refuses_by_value:
            return 0
        while size > 1:
            size //= 2
            if self._read(unit, code, at, size) != _ILLEGAL_VALUE:
                return size
        self._refuses_by_value.add((unit, code))
        return 0

    def _readable_parts(self, unit: int, code: int, block: range) -> Iterable[tuple[int, int]]:
        """Yield the parts of a refused block that can be read, as first address and end."""
        if self._every:
            yield from self._readable_halves(unit, code, block)
            return
        done, tried = block.start, 0
        for seed in block:
            is_likely = seed == block.start or not seed % 10 or not seed % 16
            if seed < done or not is_likely or self._silent >= MOST_SILENT:
                continue
            if tried >= FAILURES and not self._can_more(unit):
                return
            tried += 1
            if self._can_read(unit, code, seed, 1):
                first = self._edge(unit, code, seed, range(done, seed), step=-1)
                end = self._edge(unit, code, seed, range(seed + 1, block.stop), step=1) + 1
                yield first, end
                done = end

    def _edge(self, unit: int, code: int, seed: int, rest: range, *, step: int) -> int:
        """Return the last address that can be read from `seed` on, upwards or downwards, within
        the addresses of `rest`, which begin or end beside `seed`.
        """
        least, most = 0, len(rest)  # The number of readable addresses of `rest` is between these.
        while least < most:
            middle = (least + most + 1) // 2
            first = seed if step > 0 else seed - middle
            if self._can_read(unit, code, first, middle + 1):
                least = middle
            else:
                most = middle - 1
        return seed + step * least

    def _readable_halves(self, unit: int, code: int, block: range) -> Iterator[tuple[int, int]]:
        if len(block) == 1 or self._silent >= MOST_SILENT:
            return
        middle = block.start + len(block) // 2
        for half in (range(block.start, middle), range(middle, block.stop)):
            if self._can_read(unit, code, half.start, len(half)):
                yield half.start, half.stop
            else:
                yield from self._readable_halves(unit, code, half)

    def _add(self, unit: int, table: Table, first: int, end: int) -> None:
        """Note that addresses can be read, joined with the area that ends before them."""
        areas = self.state.areas
        if areas and (areas[-1].unit, areas[-1].table) == (unit, table):
            last = areas[-1]
            if last.last + 1 == first:
                areas[-1] = msgspec.structs.replace(last, last=end - 1)
                return
        areas.append(FoundArea(unit=unit, table=table, first=first, last=end - 1))

    def _can_read(self, unit: int, code: int, first: int, quantity: int) -> bool:
        return self._read(unit, code, first, quantity) == _VALUES

    def _read(self, unit: int, code: int, first: int, quantity: int) -> int:
        """Read; return _VALUES, the exception code if it is refused, or _NOTHING."""
        pdu = encode_pdu(code, Direction.REQUEST, address=first, quantity=quantity)
        for _ in range(_TRIES):
            transaction = self._send(unit, pdu)
            if transaction.outcome in (Outcome.OK, Outcome.EXCEPTION):
                break
            time.sleep(self._late_ns / SECOND_NS)
        self._silent = self._silent + 1 if transaction.outcome is Outcome.NO_ANSWER else 0
        answer = _NOTHING
        if transaction.outcome is Outcome.EXCEPTION:
            answer = transaction.exception or _NOTHING
        elif transaction.outcome is Outcome.OK:
            self._longest[unit, code] = max(quantity, self._longest.get((unit, code), 0))
            answer = _VALUES
        self._answers.add(answer)
        return answer

    def _send(self, unit: int, pdu: bytes) -> NamedTransaction:
        wait_ns = self._next_ns - time.monotonic_ns()
        if wait_ns > 0:
            time.sleep(wait_ns / SECOND_NS)
        self._next_ns = time.monotonic_ns() + self._interval_ns
        self.asked += 1
        return self._ask(unit, pdu)


def final_reads(state: ScanState, unit: int) -> Iterator[bytes]:
    """Yield the PDUs of the requests that read all areas found of a unit, each once."""
    for area in state.areas:
        if area.unit != unit:
            continue
        code, at = READS_OF_TABLE[area.table], area.first
        while at <= area.last:
            size = min(FUNCTIONS[code].limit, area.last + 1 - at)
            yield encode_pdu(code, Direction.REQUEST, address=at, quantity=size)
            at += size


def _is_sign(transaction: NamedTransaction) -> bool:
    if transaction.outcome is Outcome.EXCEPTION:
        return transaction.exception not in GATEWAY_EXCEPTIONS
    return transaction.outcome in (Outcome.OK, Outcome.MALFORMED)


def _sign_text(transaction: NamedTransaction) -> str:
    code = f"{transaction.function:02X}"
    if transaction.outcome is Outcome.EXCEPTION:
        return f"{code}: {transaction.exception:02X} {transaction.exception_name or 'exception'}"
    return f"{code}: {'malformed' if transaction.outcome is Outcome.MALFORMED else 'answered'}"
