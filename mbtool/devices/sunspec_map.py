"""Finds the SunSpec models of a slave in the registers that a master reads from it."""

# A SunSpec device has the text "SunS" in two registers at 0, 40000 or 50000. Its models (tables of
# registers) follow one after the other: the model's number, its length L, and L registers. Model 1
# comes first; its first registers have the maker and the device as text. The number FFFFH ends the
# map. (SunSpec Device Information Model Specification, on the map and on model 1.)
#
# Memory: for each slave at most MAX_MODELS models, the registers of two texts, and the number and
# length of one model.

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

from mbtool.modbus.tables import ADDRESSES
from mbtool.modbus.transaction import Outcome, Transaction

if TYPE_CHECKING:
    from mbtool.devices.values import PointInstance

# The code below remembers the scale factors that slaves have in registers.
#
# A scale factor is a power of ten by which the number in another register is multiplied.
#
# SunSpec devices have scale factors. One register holds the current A; another one, A_SF, holds -1
# if the current is in tenths of an ampere. A master often reads A_SF only once.
#
# Memory: the scale factors of the MAX_SLAVES slaves that were read last.

MAX_SLAVES = 1024
_POWERS = range(-10, 11)
"""The exponents that a scale factor of SunSpec can have (Information Model Specification, data type
sunssf)."""

_Slave = tuple[str, str | None, int]


class ScaleFactors:
    """Remembers the powers of ten that slaves with one profile hold in registers."""

    def __init__(self, names: Collection[str]) -> None:
        """Take the names of the points that hold a power of ten."""
        self._names = names
        self._slaves: dict[_Slave, dict[str, int]] = {}

    def update(
        self, transaction: Transaction, read: Sequence[tuple[int, PointInstance]]
    ) -> Mapping[str, int]:
        """Take a transaction into account, and return the slave's powers of ten, by the name of the
        point that holds them.

        `read` are the points in the response, each with the index of its first value. If such a
        point should hold a power of ten, but its value is not from -10 to 10, its power becomes
        unknown.
        """
        key = (transaction.link, transaction.destination, transaction.unit)
        powers = self._slaves.pop(key, None)
        if powers is None:
            powers = {}
            while len(self._slaves) >= MAX_SLAVES:
                del self._slaves[next(iter(self._slaves))]
        self._slaves[key] = powers
        values = transaction.response_values
        if values and transaction.outcome in (Outcome.OK, Outcome.LATE):
            for index, point in read:
                if point.name in self._names and index < len(values):
                    power = point.value(values[index : index + 1]).value
                    if isinstance(power, int) and power in _POWERS:
                        powers[point.name] = power
                    else:
                        powers.pop(point.name, None)
        return powers


BASES = (40000, 0, 50000)
MAX_MODELS = 256
READ_HOLDING = 0x03
COMMON = 1
MARK = (0x5375, 0x6E53)
_END = 0xFFFF
_TEXT_WORDS = 16


class FoundModel(NamedTuple):
    """A SunSpec model in a device's registers: its number, address and length."""

    id: int
    address: int
    """Address of the first register of the model, which has its number."""
    length: int
    """Number of registers after the model's number and length: L in SunSpec's words."""

    @property
    def words(self) -> int:
        return self.length + 2


def mark_in(address: int, values: Sequence[int]) -> int | None:
    """The address of the text "SunS", if the registers `values` from `address` on contain it.

    None if they do not.
    """
    for base in BASES:
        at = base - address
        if 0 <= at < len(values) - 1 and (values[at], values[at + 1]) == MARK:
            return base
    return None


class SunSpecMap:
    """Collects the SunSpec models of one slave from the registers that were read so far."""

    def __init__(self, base: int) -> None:
        self.base = base
        self.models: list[FoundModel] = []
        self.is_complete = False
        """True if no further model can be added: the end of the map was read, or what follows
        cannot be a model."""
        self._at = base + 2
        self._known: dict[int, int] = {}
        """The registers that were read, by address. Only those needed are kept: the number and
        length of the next model, and the texts of maker and device."""

    def note(self, address: int, values: Sequence[int]) -> None:
        """Add registers that a master read from the slave, from `address` on."""
        texts = range(self.base + 4, self.base + 4 + 2 * _TEXT_WORDS)
        for at in range(max(address, texts.start), min(address + len(values), texts.stop)):
            self._known[at] = values[at - address]
        while not self.is_complete and self._take_head(address, values):
            pass

    @property
    def end(self) -> int:
        """The first address after the last model that is known so far."""
        return self._at

    @property
    def maker(self) -> str:
        return self._text(self.base + 4)

    @property
    def device(self) -> str:
        """The names of maker and device, from the registers of model 1; empty if they were not
        read.
        """
        return f"{self.maker} {self._text(self.base + 4 + _TEXT_WORDS)}".strip()

    def _take_head(self, address: int, values: Sequence[int]) -> bool:
        """Add the next model to `models` if its number and length were read. Returns True if it was
        added.

        `values` are the registers that were just read, from `address` on.
        """
        for at in (self._at, self._at + 1):
            if 0 <= at - address < len(values):
                self._known[at] = values[at - address]
        number, length = self._known.get(self._at), self._known.get(self._at + 1)
        if number is None:
            return False
        is_impossible = not self.models and number != COMMON
        if number == _END or is_impossible or len(self.models) >= MAX_MODELS:
            self.is_complete = True
            return False
        if length is None:
            return False
        model = FoundModel(number, self._at, length)
        if self._at + model.words > ADDRESSES:
            self.is_complete = True
            return False
        self.models.append(model)
        self._at += model.words
        return True

    def _text(self, address: int) -> str:
        words = [self._known.get(at, 0) for at in range(address, address + _TEXT_WORDS)]
        data = b"".join(word.to_bytes(2, "big") for word in words if 0 <= word <= 0xFFFF)
        text = data.partition(b"\0")[0].decode(errors="replace")
        return " ".join("".join(one for one in text if one.isprintable()).split())
