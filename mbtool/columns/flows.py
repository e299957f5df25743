"""Numbers the flows of a capture. A flow is all segments between two TCP ends (an end is an address
and a port).
"""

# A flow is looked up by a hash of its two ends, then its ends are compared. If two flows have the
# same hash, only the first gets a number. A block with segments of the second is decoded packet by
# packet.
#
# An end is the number port << PORT_AT | address. An IPv4 address is its own number. An IPv6 address
# gets its number when it first comes, with the bit _IPV6_BIT set.
#
# Memory: about MAX_FLOWS flows are kept. If there are more, all are forgotten before the next block
# and numbers begin at 0 again.

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from mbtool.columns.arrays import Int64s, Uint64s
    from mbtool.packets.reassembler import FlowEnds

MAX_FLOWS = 65_536
"""If there are more flows than this, all are forgotten before the next block."""
UNKNOWN = -1
"""Stands in place of a flow number if another flow has the same hash."""
PORT_AT = 48
"""The position, in bits, of the port in the number of an end."""
_IPV6_BIT = 1 << 47
"""The bit that is set in the number of an IPv6 address and clear in that of an IPv4 address."""

_FIRST, _SECOND = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xC2B2AE3D27D4EB4F)
_SHIFT = np.uint64(29)


class Addresses:
    """Gives each IPv6 address a number."""

    def __init__(self) -> None:
        self._known: list[bytes] = []
        self._numbers: dict[bytes, int] = {}

    def __len__(self) -> int:
        return len(self._known)

    def forget(self) -> None:
        self.__init__()  # type: ignore[misc]

    def numbers(self, addresses: npt.NDArray[np.void]) -> Uint64s:
        """Return the number of each address, which is given as its two halves `high` and `low`."""
        high, low = (addresses[each].astype(np.uint64) for each in ("high", "low"))
        _, first, like = np.unique(_hash(high, low), return_index=True, return_inverse=True)
        if not (np.array_equal(high[first][like], high) and np.array_equal(low[first][like], low)):
            first = like = np.arange(len(addresses))  # Two addresses have the same hash.
        found = [
            self._number((upper << 64 | lower).to_bytes(16, "big"))
            for upper, lower in zip(high[first].tolist(), low[first].tolist(), strict=True)
        ]
        numbers: Uint64s = np.array(found, np.uint64)[like]
        return numbers

    def _number(self, address: bytes) -> int:
        number = self._numbers.setdefault(address, len(self._known))
        if number == len(self._known):
            self._known.append(address)
        return _IPV6_BIT | number

    def end(self, end: int) -> tuple[int, bytes]:
        """Return the port and the address of an end."""
        address = end & (1 << PORT_AT) - 1
        if address & _IPV6_BIT:
            return end >> PORT_AT, self._known[address ^ _IPV6_BIT]
        return end >> PORT_AT, address.to_bytes(4, "big")


class FlowNumbers:
    """Gives each flow a number, counted from 0."""

    def __init__(self) -> None:
        self.addresses = Addresses()
        self._forget()

    def make_room(self) -> None:
        """Forget all flows and addresses if there are more than MAX_FLOWS of them."""
        if len(self.ends) > MAX_FLOWS or len(self.addresses) > MAX_FLOWS:
            self._forget()
            self.addresses.forget()

    def numbers(self, lower: Uint64s, upper: Uint64s) -> Int64s:
        """Return the flow number of each segment; UNKNOWN (-1) if another flow has the same hash.

        `lower[i]` and `upper[i]` are the two ends of segment i as numbers (`Segments.lower`,
        `upper`).
        """
        hashes = _hash(lower, upper)
        found = self._find(hashes, lower, upper)
        missing = np.flatnonzero(found == UNKNOWN)
        if len(missing):
            self._learn(hashes[missing], lower[missing], upper[missing])
            found[missing] = self._find(hashes[missing], lower[missing], upper[missing])
        return found

    def _forget(self) -> None:
        self.ends: list[FlowEnds] = []
        """For each flow number, the address and port of its lower end, then those of its upper end.
        The lower end has the smaller port or, of equal ports, the smaller address."""
        self._hashes = np.zeros(0, np.uint64)
        """The hashes of all known flows in ascending order. `_numbers`, `_lower` and `_upper` have
        the number and the two ends of each flow in the same order."""
        self._numbers = np.zeros(0, np.int64)
        self._lower = np.zeros(0, np.uint64)
        self._upper = np.zeros(0, np.uint64)

    def _find(self, hashes: Uint64s, lower: Uint64s, upper: Uint64s) -> Int64s:
        if not len(self._hashes):
            return np.full(len(hashes), UNKNOWN, np.int64)
        at = np.minimum(np.searchsorted(self._hashes, hashes), len(self._hashes) - 1)
        is_same = (self._lower[at] == lower) & (self._upper[at] == upper)
        return np.where(is_same, self._numbers[at], UNKNOWN)

    def _learn(self, hashes: Uint64s, lower: Uint64s, upper: Uint64s) -> None:
        _, first = np.unique(hashes, return_index=True)
        first = first[~np.isin(hashes[first], self._hashes)]
        count = len(self.ends)
        self.ends += [
            (*self._end(low), *self._end(high))
            for low, high in zip(lower[first].tolist(), upper[first].tolist(), strict=True)
        ]
        hashes = np.concatenate([self._hashes, hashes[first]])
        numbers = np.concatenate([self._numbers, np.arange(count, len(self.ends))])
        order = np.argsort(hashes, kind="stable")
        self._hashes, self._numbers = hashes[order], numbers[order]
        self._lower = np.concatenate([self._lower, lower[first]])[order]
        self._upper = np.concatenate([self._upper, upper[first]])[order]

    def _end(self, end: int) -> tuple[bytes, int]:
        port, address = self.addresses.end(end)
        return address, port


def _hash(lower: Uint64s, upper: Uint64s) -> Uint64s:
    mixed: Uint64s = lower * _FIRST
    mixed ^= mixed >> _SHIFT
    mixed += upper * _SECOND
    return mixed
