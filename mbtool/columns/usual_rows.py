"""Finds the usual reads and writes (functions 01 to 06, 0F and 10, hexadecimal) among transactions
in arrays, and reads the fields of their PDUs.
"""

# A usual row is a transaction with one of the functions 01 to 06, 0F and 10 (hex). Its request has
# the length and fields of the function; its response fits the request or is an exception response.
# The table columns of these rows are computed from arrays. A row with any other PDU is made a
# transaction object, as the Decoder makes it (plain_transactions.py).

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbtool.columns.arrays import Bools, Int64s, gather
from mbtool.modbus.adu import MBAP_BYTES
from mbtool.modbus.functions import (
    EXCEPTION_BIT,
    READ_BITS,
    READ_REGISTERS,
    READ_WRITE_REGISTERS,
    WRITE_ONE,
    WRITE_SEVERAL,
)
from mbtool.modbus.layouts import COIL_VALUES

if TYPE_CHECKING:
    from mbtool.columns.plain_rows import PlainRows

WRITE_COIL, WRITE_COILS = 0x05, 0x0F
READ_WORDS = READ_REGISTERS - {READ_WRITE_REGISTERS}
WRITE_WORD = WRITE_ONE - {WRITE_COIL, 0x16}
WRITE_WORDS = WRITE_SEVERAL - {WRITE_COILS}
_FOUR_BYTES = np.dtype([("address", ">u2"), ("quantity", ">u2")])
_FIXED = 5
"""The size in bytes of a PDU that consists of function code, address, and a quantity or value."""
COUNTED = 6
"""The number of bytes before the values in a request PDU that writes several values: function code,
address, quantity and byte count."""


class UsualRows:
    """Finds, among transactions in arrays, the usual ones (functions 01 to 06, 0F and 10 in
    hexadecimal), and reads the fields of their PDUs.

    Each array has one element per transaction.
    """

    def __init__(self, rows: PlainRows) -> None:
        self._data = data = rows.data
        self._code = code = rows.code
        self._unit = rows.unit
        self._request = rows.request_begin + MBAP_BYTES
        self._response = rows.response_begin + MBAP_BYTES
        self._request_size = request_size = rows.request_size - MBAP_BYTES
        self._response_size = response_size = rows.response_size - MBAP_BYTES
        fields = gather(data, self._request + 1, _FOUR_BYTES)
        self.address = fields["address"].astype(np.int64)
        self._value = fields["quantity"].astype(np.int64)
        writes_one = np.isin(code, [WRITE_COIL, *WRITE_WORD])
        self.quantity = np.where(writes_one, 1, self._value)
        second, count = data[self._response + 1].astype(np.int64), data[self._request + 5]
        self._reads_bits, self._reads_words = (
            np.isin(code, [*READ_BITS]),
            np.isin(code, [*READ_WORDS]),
        )
        self._writes_words = np.isin(code, [*WRITE_WORDS])
        self._writes_bits = code == WRITE_COILS
        bit_bytes, reads = (self._value + 7) // 8, self._reads_bits | self._reads_words
        written = np.where(self._writes_bits, bit_bytes, 2 * self._value)
        read = np.where(self._reads_bits, bit_bytes, 2 * self._value)
        writes_several = self._writes_bits | self._writes_words
        is_coil_value = np.isin(self._value, [*COIL_VALUES])
        has_form = (
            (reads | writes_one & ((code != WRITE_COIL) | is_coil_value)) & (request_size == _FIXED)
        ) | (writes_several & (request_size == COUNTED + written) & (count == written))
        repeated = gather(data, self._response + 1, _FOUR_BYTES)
        repeats = (
            (response_size == _FIXED)
            & (repeated["address"] == fields["address"])
            & (repeated["quantity"] == fields["quantity"])
        )
        fits = np.where(reads, (second == read) & (response_size == 2 + read), repeats)
        is_exception = rows.response_code == code | EXCEPTION_BIT
        answered = np.where(is_exception, response_size == 2, fits)
        is_whole = has_form & answered & rows.has_addresses
        self.is_usual: Bools = is_whole & ~self._is_padded(is_exception)
        self.exception = np.where(is_exception, second, -1)

    @property
    def asked(self) -> Int64s:
        """For each row (transaction) a number. Two usual reads or writes have equal numbers if
        they have the same unit, function, address, quantity and exception code.
        """
        head = self.exception + 1 << 48 | self._code << 40 | self._unit << 32
        return head | self.address << 16 | self.quantity

    def _is_padded(self, is_exception: Bools) -> Bools:
        """Return for each row True if a bit that carries no value is set in the last byte of its
        coils or discrete inputs. `is_exception` is True for a row whose response is an exception
        response.

        Such a row gets a finding, so it must be made a transaction object.
        """
        used = self._value % 8
        request_end = self._request + self._request_size - 1
        response_end = self._response + self._response_size - 1
        last = np.where(self._writes_bits, self._data[request_end], self._data[response_end])
        has_bits = self._writes_bits | self._reads_bits & ~is_exception
        is_padded: Bools = has_bits & (used > 0) & (last.astype(np.int64) >> used > 0)
        return is_padded
