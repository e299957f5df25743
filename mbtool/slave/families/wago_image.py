"""The process image of a WAGO 750 coupler: where its inputs and outputs are read and written."""

# Sources: the manuals named in wago.py. Functions 03 and 04 read the same registers, 01 and 02 the
# same bits. Reads from 0000 on return inputs; writes from 0000 on set outputs, which are read back
# at addresses 0200H higher. A second range works in the same way: registers written from 6000H on
# are read back at 7000H, bits written from 3000H on at 4000H.
#
# The digital inputs and outputs can also be read and written in registers, behind all analog data.
# Registers 1022H to 1025H give the sizes of the analog and digital outputs and inputs in bits. They
# are read once, at the start, and are 0 unless the user's values file sets them, to describe a
# coupler with modules. If they are set, a read of a register of digital data returns the bits, and
# a write to it sets the bits. Assumed: bit 0 of a register is the first of its 16 digital inputs or
# outputs, and digital data begin in a new register. Only the first range (256 registers, 512 bits)
# has digital data in registers.

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
"""The ranges of outputs: table, addresses at which masters write them, addresses at which masters
read them back and where they are stored."""
_SIZES = range(0x1022, 0x1026)
"""Registers with the sizes, in bits, of analog outputs and inputs, digital outputs and inputs."""
_OUTPUT_BASE = 0x0200
_WORDS, _BITS = 0x0100, 0x0200
_WORD_BITS = 16


class ProcessImage:
    """Reads and writes the inputs and outputs of a coupler in its register image."""

    def __init__(self, image: RegisterImage) -> None:
        image.share(Table.INPUT_REGISTERS, HOLDING)
        image.share(Table.DISCRETE_INPUTS, COILS)
        self._image = image
        self._parts = _digital_parts(image.get(HOLDING, _SIZES.start, len(_SIZES)))

    def is_made_of_bits(self, span: range) -> bool:
        """True if at least one register of the addresses `span` shows digital inputs or outputs."""
        return any(
            words.start < span.stop and span.start < words.stop for _, words, _ in self._parts
        )

    def read(self, span: range, values: list[int]) -> list[int]:
        """Return the contents of the registers `span`, with digital inputs and outputs filled in.

        `values` are the contents of these registers in the image; registers that show digital data
        are replaced in this list.
        """
        for base, words, bits in self._parts:
            for at in range(max(words.start, span.start), min(words.stop, span.stop)):
                first = base + (at - words.start) * _WORD_BITS
                held = self._image.get(COILS, first, min(_WORD_BITS, bits.stop - first))
                values[at - span.start] = sum(bit << place for place, bit in enumerate(held))
        return values

    def standing(self, table: Table, span: range) -> list[int]:
        """Return the present values of what a write to the addresses `span` would change.

        They are read where the image stores the outputs, which differs from `span`.
        """
        span = stored_range(table, span)
        values = self._image.get(table, span.start, len(span))
        return values if table.is_bits else self.read(span, values)

    def write(self, table: Table, span: range, values: Sequence[int]) -> None:
        """Store values that a master writes to the addresses `span`.

        Outputs are stored at the addresses where masters read them back. If a register shows
        digital inputs or outputs, a value written to it sets their bits as well.
        """
        span = stored_range(table, span)
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
    """Return an item for the digital outputs and one for the digital inputs, if there are any.

    Each item has the address of the first bit, the addresses of the registers that show the bits,
    and the addresses of the bits. `sizes` are the contents of the registers _SIZES, in bits.
    """
    parts = []
    for base, analog, digital in ((_OUTPUT_BASE, *sizes[::2]), (0, *sizes[1::2])):
        if digital:
            first = base + -(-analog // _WORD_BITS)
            count = min(digital, _BITS)
            end = min(first + -(-count // _WORD_BITS), base + _WORDS)
            parts.append((base, range(first, end), range(base, base + count)))
    return parts


def stored_range(table: Table, span: range) -> range:
    """Return the addresses at which the image stores values that a master writes to `span`.

    For outputs these are the addresses at which masters read them back, else `span` itself.
    """
    for each, first, stands in _OUTPUTS:
        if table is each and span.start in first:
            by = stands.start - first.start
            return range(span.start + by, span.stop + by)
    return span
