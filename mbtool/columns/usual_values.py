"""Reads the register and bit values of usual reads and writes from arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from mbtool.columns.arrays import Bools, Int64s, Octets, gather, pieces
from mbtool.columns.usual_rows import COUNTED, WRITE_COIL, WRITE_WORD, UsualRows

Words = npt.NDArray[np.uint16]
_PAIR = np.dtype(">u2")


class ValueLists(NamedTuple):
    """Holds one list of numbers (register or bit values) for each chosen row, with all lists joined
    in one array. A row is a transaction of a block.
    """

    numbers: Words
    """The register or bit values of all rows (transactions): those of the first row, then those of
    the second, and so on."""
    offsets: Int64s
    """For each row, the index in `numbers` where its list begins; the last element is the length of
    `numbers`."""
    missing: Bools
    """True for a row whose list is None, such as the request values of a read."""


class UsualValues(UsualRows):
    """Reads the register and bit values of usual reads and writes. A bit is the number 0 or 1."""

    def request_values(self, chosen: Int64s) -> ValueLists:
        """Return the values that requests write, for the rows (transactions) with the indices
        `chosen`.

        The list of a read is marked as missing.
        """
        code, value = self._code[chosen], self._value[chosen]
        words, bits = self._writes_words[chosen], self._writes_bits[chosen]
        single = np.isin(code, [WRITE_COIL, *WRITE_WORD])
        begin = self._request[chosen] + np.where(single, 3, COUNTED)
        words = words | single
        counts = np.where(single, 1, value)
        values = self._values(begin, counts, words, bits)
        if (code == WRITE_COIL).any():
            numbers, offsets = values
            coils = offsets[:-1][code == WRITE_COIL]
            numbers[coils] = numbers[coils] != 0  # FF00H is 1 (layouts.COIL_VALUES).
        return ValueLists(*values, ~(words | bits))

    def response_values(self, chosen: Int64s) -> ValueLists:
        """Return the values in responses, for the rows (transactions) with the indices `chosen`.

        The list of a write or of an exception response is marked as missing.
        """
        is_ok = self.exception[chosen] < 0
        words, bits = self._reads_words[chosen] & is_ok, self._reads_bits[chosen] & is_ok
        begin = self._response[chosen] + 2
        return ValueLists(*self._values(begin, self._value[chosen], words, bits), ~(words | bits))

    def values_of(self, chosen: Int64s) -> list[int]:
        """Return the values of rows (transactions) with the indices `chosen`, which have the same
        function and are answered: those in their responses; of writes, those in their requests.
        """
        is_read = self._reads_bits[chosen[0]] or self._reads_words[chosen[0]]
        values = self.response_values(chosen) if is_read else self.request_values(chosen)
        numbers: list[int] = values.numbers.tolist()
        return numbers

    def value_of(self, chosen: Int64s, place: int) -> Words:
        """Return for each row (transaction) the register or bit at the index `place` of its values.

        `chosen` is as for `values_of`.
        """
        first = chosen[0]
        is_bit = self._reads_bits[first] or self._writes_bits[first]
        if self._reads_bits[first] or self._reads_words[first]:
            begin = self._response[chosen] + 2
        elif self._writes_bits[first] or self._writes_words[first]:
            begin = self._request[chosen] + COUNTED
        else:
            begin = self._request[chosen] + 3
        if is_bit:
            return (self._data[begin + place // 8] >> (place % 8) & 1).astype(np.uint16)
        values: Words = gather(self._data, begin + 2 * place, _PAIR).astype(np.uint16)
        return values if self._code[first] != WRITE_COIL else (values != 0).astype(np.uint16)

    def _values(
        self, begin: Int64s, counts: Int64s, words: Bools, bits: Bools
    ) -> tuple[Words, Int64s]:
        """Return the values of all rows (transactions) joined in one array, and the index in it
        where each row begins.

        Row i has `counts[i]` values from the offset `begin[i]` of the block's bytes on. They are
        registers if `words[i]` is True and bits if `bits[i]` is True; if both are False, the row
        has no values.
        """
        counts = np.where(words | bits, counts, 0)
        offsets = np.concatenate([[0], np.cumsum(counts)])
        registers = pieces(self._data, begin[words], 2 * counts[words]).view(_PAIR)
        if not bits.any():
            return registers.astype(np.uint16), offsets
        numbers = np.empty(int(offsets[-1]), np.uint16)
        is_bit = np.repeat(bits, counts)
        numbers[~is_bit] = registers
        numbers[is_bit] = self._bits(begin[bits], counts[bits])
        return numbers, offsets

    def _bits(self, begin: Int64s, counts: Int64s) -> Octets:
        """Return the bits of all rows joined in one array: for each i, the `counts[i]` bits from
        the offset `begin[i]` in the data on, the lowest bit of a byte first.
        """
        sizes = (counts + 7) // 8
        bits: Octets = np.unpackbits(pieces(self._data, begin, sizes), bitorder="little")
        padding = 8 * sizes - counts
        if not padding.any():
            return bits
        lengths = np.column_stack([counts, padding]).ravel()
        some: Octets = bits[np.repeat(np.arange(len(lengths)) % 2 == 0, lengths)]
        return some
