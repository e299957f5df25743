"""Finds the SunSpec models of a slave in the registers that it is read."""

# A SunSpec device has the text "SunS" in two registers at 0, 40000 or 50000. Behind it stand its
# models one after the other: the model's number, its length L, and L registers. Model 1 comes first
# and begins with maker and device, as text. The number FFFFH ends the map. (SunSpec Device
# Information Model Specification, on the map and on model 1.)
#
# Memory: for each map at most MAX_MODELS models, and the registers of one head and of two texts.

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from mbtool.modbus.tables import ADDRESSES

if TYPE_CHECKING:
    from collections.abc import Sequence

BASES = (40000, 0, 50000)
MAX_MODELS = 256
READ_HOLDING = 0x03
COMMON = 1
MARK = (0x5375, 0x6E53)
_END = 0xFFFF
_TEXT_WORDS = 16


class FoundModel(NamedTuple):
    """A model of a device, and where it stands."""

    id: int
    address: int
    """The register of its number."""
    length: int
    """Its L: the number of registers behind its number and length."""

    @property
    def words(self) -> int:
        return self.length + 2


def mark_in(address: int, values: Sequence[int]) -> int | None:
    """Where a map begins in registers that were read from `address` on; None if none does."""
    for base in BASES:
        at = base - address
        if 0 <= at < len(values) - 1 and (values[at], values[at + 1]) == MARK:
            return base
    return None


class SunSpecMap:
    """The models of one slave, as far as it was asked for them."""

    def __init__(self, base: int) -> None:
        self.base = base
        self.models: list[FoundModel] = []
        self.is_complete = False
        """True if the end of the map was read."""
        self._at = base + 2
        self._known: dict[int, int] = {}
        """The registers of the next head, and of the texts of model 1."""

    def note(self, address: int, values: Sequence[int]) -> None:
        """Take registers that the slave was read, from `address` on."""
        texts = range(self.base + 4, self.base + 4 + 2 * _TEXT_WORDS)
        for at in range(max(address, texts.start), min(address + len(values), texts.stop)):
            self._known[at] = values[at - address]
        while not self.is_complete and self._take_head(address, values):
            pass

    @property
    def end(self) -> int:
        """The address behind the last model."""
        return self._at

    @property
    def maker(self) -> str:
        return self._text(self.base + 4)

    @property
    def device(self) -> str:
        """Maker and device, as model 1 says; empty if that was not read."""
        return f"{self.maker} {self._text(self.base + 4 + _TEXT_WORDS)}".strip()

    def _take_head(self, address: int, values: Sequence[int]) -> bool:
        """Take the next model, if its number and length are known; return true if one was taken."""
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
