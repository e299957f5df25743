"""Makes transaction objects from rows of the arrays, equal to those that the Decoder would make."""

# A row is a transaction. The usual reads and writes (usual_rows.py) of one kind have the same link,
# slave, master address (without port), MAC addresses, unit, function, address, quantity and
# exception code. They differ only in times, ids, values, bytes and packets. The first one of a kind
# gets the names of its slave's points and becomes the model: the others are copies of it with their
# own times, ids, values, bytes and packets. If names depend on values, they are looked up for each
# transaction. If a new kind differs from a known one only in address and quantity, its model is a
# copy, too.
#
# Memory: MAX_KINDS models; if there are more, all are forgotten and made again when needed. The
# values of at most AT_ONCE rows of a block.

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from msgspec import structs

from mbtool.columns.plain_rows import PlainRows, link_addresses_of
from mbtool.columns.usual_values import UsualValues, ValueLists
from mbtool.core import Direction, LinkAddresses, Origin
from mbtool.decode.transactions import Ends, add_origins, with_response
from mbtool.modbus.adu import MBAP_BYTES, Adu, DirectionBy, Transport
from mbtool.packets.link_layer import MAX_CACHED_HEADERS

if TYPE_CHECKING:
    from mbtool.columns.arrays import Bools, Int64s
    from mbtool.devices import NamedTransaction, Namer
    from mbtool.modbus.transaction import Transaction


MAX_KINDS = 65_536
"""If there are more models than this, all are forgotten, and made again when they are needed."""
AT_ONCE = 4096
"""The values, bytes and packets of this many rows are read from the arrays at one time."""


_Parts = tuple[Any, ...]


class PlainObjects:
    """Makes named transaction objects of the rows of a capture's blocks."""

    def __init__(self, namer: Namer) -> None:
        self.namer = namer
        self.models: dict[tuple[object, ...], tuple[NamedTransaction, bool]] = {}
        """By kind: the model, and True if its names depend on values."""
        self.bases: dict[tuple[object, ...], NamedTransaction] = {}
        """By kind without address and quantity, one transaction; models of new kinds are copies."""

    def of(self, rows: PlainRows, usual: UsualValues | None = None) -> RowObjects:
        """Return what makes the objects of a block. `usual` tells its usual rows, if known."""
        return RowObjects(self, rows, usual or UsualValues(rows))

    def keep(self, key: tuple[object, ...], model: NamedTransaction, *, depends: bool) -> None:
        if len(self.models) >= MAX_KINDS:
            self.models.clear()
        self.models[key] = model, depends


class RowObjects:
    """Makes the transaction objects of the rows of one block."""

    def __init__(self, objects: PlainObjects, rows: PlainRows, usual: UsualValues) -> None:
        self._objects = objects
        self._rows = rows
        self._usual = usual
        self._is_usual = usual.is_usual.copy()  # A caller may change its own array.
        self._octets = rows.data.data
        self._window = -1
        """The index of the group of AT_ONCE rows whose parts are in `_parts`; earlier groups are
        not needed again."""
        self._parts: list[_Parts] = []

    def have_profile(self) -> Bools:
        """Return for each row True if its slave has a profile."""
        rows, assignments = self._rows, self._objects.namer.assignments
        if not any(assignments):
            return np.zeros(len(rows.unit), np.bool_)
        slaves, like = np.unique(rows.connection << 8 | rows.unit, return_inverse=True)
        found = []
        for one in slaves.tolist():
            slave = str(rows.connections[one >> 8].slave)
            found.append(assignments.profile_of(slave, one & 0xFF, Transport.TCP) is not None)
        have: Bools = np.array(found, np.bool_)[like]
        return have

    def transaction_of_row(self, index: int) -> NamedTransaction:
        """Return the transaction of the row with this index."""
        return next(self.chosen(np.array([index])))

    def some(self, begin: int, end: int) -> Iterator[NamedTransaction]:
        """Yield the transactions of the rows with the indices `begin` to `end` (exclusive)."""
        while begin < end:
            window = begin // AT_ONCE
            first = window * AT_ONCE
            if window != self._window:
                indices = np.arange(first, min(first + AT_ONCE, len(self._rows.unit)))
                self._window, self._parts = window, self._parts_of(indices)
            stop = min(end, first + AT_ONCE)
            yield from map(self._transaction, self._parts[begin - first : stop - first])
            begin = stop

    def chosen(self, indices: Int64s) -> Iterator[NamedTransaction]:
        """Yield the transactions of the rows with these indices."""
        for at in range(0, len(indices), AT_ONCE):
            yield from map(self._transaction, self._parts_of(indices[at : at + AT_ONCE]))

    def _parts_of(self, indices: Int64s) -> list[_Parts]:
        """Return what transactions of one kind differ in, for each of the rows with these indices:
        at most AT_ONCE.
        """
        rows, usual, first = self._rows, self._usual, self._rows.block.first_number
        is_usual = self._is_usual[indices]
        begins, sizes = rows.request_begin[indices], rows.request_size[indices]
        starts, lengths = rows.response_begin[indices], rows.response_size[indices]
        return list(
            zip(
                indices.tolist(),
                np.where(is_usual, usual.asked[indices], -1).tolist(),
                rows.connection[indices].tolist(),
                rows.request_ns[indices].tolist(),
                rows.response_ns[indices].tolist(),
                rows.transaction_id[indices].tolist(),
                (first + rows.request[indices]).tolist(),
                (first + rows.response[indices]).tolist(),
                begins.tolist(),
                (begins + sizes).tolist(),
                starts.tolist(),
                (starts + lengths).tolist(),
                _lists(usual.request_values(indices[is_usual]), is_usual),
                _lists(usual.response_values(indices[is_usual]), is_usual),
                strict=True,
            )
        )

    def _transaction(self, parts: _Parts) -> NamedTransaction:
        index, kind, end, begin_ns, end_ns, id_, asking, answering, *places, asked, answered = parts
        namer, rows = self._objects.namer, self._rows
        if kind < 0:
            return namer.name(plain_transaction(rows, index))
        source, place = self._keys_of_ends[end]
        key = rows.block.file, place, kind
        found = self._objects.models.get(key)
        model = (
            self._base(index, (rows.block.file, place, kind >> 32)) if found is None else found[0]
        )
        request, request_end, response, response_end = places
        octets = self._octets
        one = structs.replace(
            model,
            source=source,
            transaction_id=id_,
            request_ns=begin_ns,
            response_ns=end_ns,
            latency_ns=end_ns - begin_ns,
            request_values=asked,
            response_values=answered,
            request_raw=octets[request:request_end].tobytes(),
            response_raw=octets[response:response_end].tobytes(),
            request_packet=asking,
            response_packet=answering,
        )
        if found is None:
            address, quantity = kind >> 16 & 0xFFFF, kind & 0xFFFF
            one = namer.as_kind(structs.replace(one, address=address, quantity=quantity))
            depends = namer.depends_on_values(one)
            self._objects.keep(key, one, depends=depends)
        else:
            _, depends = found
        return namer.with_values(one) if depends else one

    def _base(self, index: int, key: tuple[object, ...]) -> NamedTransaction:
        bases = self._objects.bases
        found = bases.get(key)
        if found is None:
            if len(bases) >= MAX_KINDS:
                bases.clear()
            transaction = plain_transaction(self._rows, index)
            found = bases[key] = self._objects.namer.name(transaction)
        return found

    @cached_property
    def _keys_of_ends(self) -> list[tuple[str, tuple[object, ...]]]:
        """For each item of `connections`: the master as text, and what is equal in all
        transactions of a kind.
        """
        rows = self._rows
        return [
            (str(one.master), (one.link, one.master.host, str(one.slave), addresses))
            for one, addresses in zip(rows.connections, rows.addresses, strict=True)
        ]


def _lists(lists: ValueLists, is_usual: Bools) -> list[list[int] | None]:
    """Return the values of each row, None for one without. `lists` has those of the rows for which
    `is_usual` is True.
    """
    numbers, offsets = lists.numbers.tolist(), lists.offsets.tolist()
    found = [
        None if is_missing else numbers[begin:end]
        for is_missing, (begin, end) in zip(lists.missing.tolist(), pairwise(offsets), strict=True)
    ]
    if len(found) == len(is_usual):
        return found
    given = iter(found)
    return [next(given) if each else None for each in is_usual.tolist()]


def plain_transaction(rows: PlainRows, index: int) -> Transaction:
    """Return the transaction with this index in the arrays, as the Decoder would make it from
    packets.
    """
    identity = rows.connections[rows.connection[index]]
    ends = Ends(identity.link, str(identity.master), str(identity.slave))
    request = _adu(
        rows,
        Direction.REQUEST,
        index,
        _Half(
            rows.request, rows.request_ip_at, rows.request_begin, rows.request_size, rows.request_ns
        ),
    )
    response = _adu(
        rows,
        Direction.RESPONSE,
        index,
        _Half(
            rows.response,
            rows.response_ip_at,
            rows.response_begin,
            rows.response_size,
            rows.response_ns,
        ),
    )
    return with_response(ends, request, response, 0, ())


@lru_cache(maxsize=MAX_CACHED_HEADERS)
def origin_fields(
    request: LinkAddresses | None, response: LinkAddresses | None
) -> tuple[str | None, str | None, str | None, int | None]:
    """Return the MAC address of the master, that of the slave, that of the response if it is
    another one, and the VLAN number; None for what is unknown.

    `request` and `response` are the addresses in the headers of the two packets; None if a header
    has none.
    """
    fields: dict[str, Any] = {}
    add_origins(fields, Origin("", 0, request), Origin("", 0, response))
    names = ("source_mac", "destination_mac", "response_mac", "vlan")
    source, destination, answering, vlan = (fields.get(name) for name in names)
    return source, destination, answering, vlan


class _Half(NamedTuple):
    """Fields of all requests, or of all responses, as arrays with an element per transaction.

    `packet` is the packet's index in the block, `ip_at` the length of its link layer header in
    bytes. The ADU has `size` bytes from the offset `begin` of the block's bytes on; `ts_ns` is its
    time in UTC ns.
    """

    packet: Int64s
    ip_at: Int64s
    begin: Int64s
    size: Int64s
    ts_ns: Int64s


def _adu(rows: PlainRows, direction: Direction, index: int, half: _Half) -> Adu:
    packet, ip_at, begin, size, ts_ns = (int(values[index]) for values in half)
    block = rows.block
    raw = rows.data[begin : begin + size].tobytes()
    addresses = link_addresses_of(block, packet, ip_at)
    return Adu(
        start_ns=ts_ns,
        end_ns=ts_ns,
        transport=Transport.TCP,
        direction=direction,
        direction_by=DirectionBy.PORT,
        confidence=1.0,
        unit=raw[6],
        pdu=raw[MBAP_BYTES:],
        raw=raw,
        transaction_id=raw[0] << 8 | raw[1],
        origin=Origin(block.file, block.first_number + packet, addresses),
    )
