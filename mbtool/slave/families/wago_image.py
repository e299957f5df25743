"""The process image of a WAGO 750 coupler: inputs, outputs, and how bits stand in registers."""

# Sources: as wago.py. Functions 03 and 04 read the same registers, 01 and 02 the same bits. Reading
# from 0000 on gives inputs, writing there sets outputs, which are read back 0200H higher; the
# second part likewise, registers from 6000H at 7000H and bits from 3000H at 4000H.
#
# Digital data are in registers too, behind all analog data. How much there is of each the registers
# 1022H to 1025H say, in bits; they are 0, and so bits and registers apart, unless the user
# describes a node there, which is looked at once. Then the bits are what counts: such a register is
# made of them, and a write to it sets them. Assumed: the lowest bit of a register is the first one,
# and digital data begin with a register of their own. Only the first part, 256 registers and 512
# bits, is looked at.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.modbus.tables import Table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.slave.device.image import RegisterImage

HOLDING, COILS = Table.HOLDING_REGISTERS, Table.COILS

_OUTPUTS = (
    (HOLDING, range(0x0100), range(0x0200, 0x0300)),
    (HOLDING, range(0x6000, 0x62FD), range(0x7000, 0x72FD)),
    (COILS, range(0x0200), range(0x0200, 0x0400)),
    (COILS, range(0x3000, 0x35F8), range(0x4000, 0x45F8)),
)
"""Where outputs are written, and where they stand."""
_SIZES = range(0x1022, 0x1026)
"""Analog outputs and inputs, digital outputs and inputs, in bits."""
_OUTPUT_BASE = 0x0200
_WORDS, _BITS = 0x0100, 0x0200
_WORD_BITS = 16


class ProcessImage:
    """The inputs and outputs in a register image."""

    def __init__(self, image: RegisterImage) -> None:
        image.share(Table.INPUT_REGISTERS, HOLDING)
        image.share(Table.DISCRETE_INPUTS, COILS)
        self._image = image
        self._parts = _digital_parts(image.get(HOLDING, _SIZES.start, len(_SIZES)))

    def is_made_of_bits(self, span: range) -> bool:
        """Whether some of these registers are."""
        return any(
            words.start < span.stop and span.start < words.stop for _, words, _ in self._parts
        )

    def read(self, span: range, values: list[int]) -> list[int]:
        """The registers of a range, where `values` are those that stand there."""
        for base, words, bits in self._parts:
            for at in range(max(words.start, span.start), min(words.stop, span.stop)):
                first = base + (at - words.start) * _WORD_BITS
                held = self._image.get(COILS, first, min(_WORD_BITS, bits.stop - first))
                values[at - span.start] = sum(bit << place for place, bit in enumerate(held))
        return values

    def standing(self, table: Table, span: range) -> list[int]:
        """The outputs that a write to a range would replace, or what else stands there."""
        span = where_it_stands(table, span)
        values = self._image.get(table, span.start, len(span))
        return values if table.is_bits else self.read(span, values)

    def write(self, table: Table, span: range, values: Sequence[int]) -> None:
        """Write outputs, or what else can be written."""
        span = where_it_stands(table, span)
        self._image.set(table, span.start, values)
        if table.is_bits:
            return
        for base, words, bits in self._parts:
            for at in range(max(words.start, span.start), min(words.stop, span.stop)):
                first = base + (at - words.start) * _WORD_BITS
                word = values[at - span.start]
                count = min(_WORD_BITS, bits.stop - first)
                self._image.set(COILS, first, [word >> place & 1 for place in range(count)])

    def clear_outputs(self) -> None:
        for table, _, span in _OUTPUTS:
            self._image.set(table, span.start, [0] * len(span))


def _digital_parts(sizes: Sequence[int]) -> list[tuple[int, range, range]]:
    """Of inputs and outputs: the first bit, the registers that bits make, and these bits."""
    parts = []
    for base, analog, digital in ((_OUTPUT_BASE, *sizes[::2]), (0, *sizes[1::2])):
        if digital:
            first = base + -(-analog // _WORD_BITS)
            count = min(digital, _BITS)
            end = min(first + -(-count // _WORD_BITS), base + _WORDS)
            parts.append((base, range(first, end), range(base, base + count)))
    return parts


def where_it_stands(table: Table, span: range) -> range:
    """Where what is written to a range stands, and is read back."""
    for each, first, stands in _OUTPUTS:
        if table is each and span.start in first:
            by = stands.start - first.start
            return range(span.start + by, span.stop + by)
    return span
