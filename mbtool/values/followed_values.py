"""Tells which values an answer holds: by the slave's profile, or judged from their words."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.devices.model import Access, Point, Profile
from mbtool.devices.point_types import PointType
from mbtool.devices.references import write_reference
from mbtool.devices.values import PointInstance
from mbtool.values.guessed_series import guessed_name
from mbtool.values.judging import WordHistory, judge
from mbtool.values.word_readings import Order, WordReading

if TYPE_CHECKING:
    from mbtool.modbus.tables import Table

_NOT_VALID = re.compile(
    r"\b(?:not valid|invalid|unreliable"
    r"|(?:sensor|probe|wire|loop) (?:error|fault|failure|break|broken|open|missing))\b",
    re.IGNORECASE,
)
_VALID = re.compile(r"\bvalid\b", re.IGNORECASE)
_STATES = (PointType.HEX16, PointType.FLAGS, PointType.BIT)
_ORDERS = {(one.words, one.bytes): one for one in Order}


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowedValue:
    """A value of an answer: where it stands, how it is read, and what its profile says of it."""

    name: str
    address: int
    at: int
    """The index in the answer of the value's first register (or bit)."""
    reading: WordReading
    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""
    minimum: float | None = None
    """The least value that the profile allows, after scale and offset."""
    maximum: float | None = None
    no_value: int | None = None
    """The number that the profile knows as "no value"."""
    not_valid: tuple[tuple[int, int, str], ...] = ()
    """Mask, bits and text: if the masked bits of the register are these, a value is not valid."""
    is_state: bool = False
    """True if the numbers or bits of the value have meanings, so that it is a state, not a
    quantity."""

    def shown(self, number: float) -> str:
        """Return a number as text, with scale and unit."""
        return self._text(number * self.scale + self.offset)

    def shown_step(self, size: float) -> str:
        """Return the size of a change as text, with scale and unit."""
        return self._text(size * abs(self.scale))

    def _text(self, value: float) -> str:
        return f"{value:.7g}{self.unit and f' {self.unit}'}"


def values_of_profile(
    profile: Profile, table: Table, address: int, quantity: int
) -> list[FollowedValue]:
    """Return the numbers and states that a read has by a profile."""
    found = []
    for point in profile.points:
        if point.table is not table or point.access is Access.WRITE:
            continue
        form = PointType.UINT16 if point.type in _STATES else point.type
        if form.struct_code is None and not form.is_number:
            continue
        order = _ORDERS.get((point.word_order, point.byte_order), Order.ABCD)
        for first in point.addresses:
            at = first - address
            if not 0 <= at <= quantity - point.words or point.block not in (None, address):
                continue
            reference = write_reference(profile, table, first, point.words)
            found.append(
                FollowedValue(
                    name=PointInstance(point, first, reference).name,
                    address=first,
                    at=at,
                    reading=WordReading(form, order),
                    scale=point.scale,
                    offset=point.offset,
                    unit=point.unit or "",
                    minimum=point.minimum,
                    maximum=point.maximum,
                    no_value=point.no_value,
                    not_valid=tuple(_states_that_mean_invalid(point)),
                    is_state=point.type in _STATES or bool(point.texts),
                )
            )
    return found


def _states_that_mean_invalid(point: Point) -> Iterator[tuple[int, int, str]]:
    for key, text in point.bits.items():
        mask = 1 << int(key)
        if _NOT_VALID.search(text):
            yield mask, mask, text
        elif _VALID.search(text):
            yield mask, 0, f"not {text}"
    for key, text in point.texts.items():
        if point.type in (*_STATES, PointType.UINT16) and _NOT_VALID.search(text):
            yield 0xFFFF, int(key), text


def judged_values(history: WordHistory) -> list[FollowedValue]:
    """Return the numbers in an answer whose types are judged from its words."""
    found = []
    for one in judge([history]):
        if one.reading.type is PointType.STRING:
            continue
        name = write_reference(None, one.table, one.address)
        found.append(
            FollowedValue(
                name=guessed_name(one) if one.words > 1 else name,
                address=one.address,
                at=one.address - history.first,
                reading=one.reading,
                is_state=one.reading.type is PointType.HEX16,
            )
        )
    return found
