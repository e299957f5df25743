"""Collects the values over time of the points and registers that a user names."""

# The user names a point or a register by a text, such as `Speed` or `HR400001`. The profile of a
# slave says what the text means there, so each text is looked up once for each slave. If it names a
# point, the point's value is collected; if it names addresses without a point, the numbers in their
# registers or bits.
#
# Memory: MAX_CHOSEN series of MAX_SAMPLES samples. If there are more samples, some are dropped, but
# no extreme value (value_series.py).

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from mbtool.devices.references import write_reference
from mbtool.modbus import FUNCTIONS
from mbtool.modbus.functions import MASK_WRITE_REGISTER
from mbtool.values.value_series import ValueSeries
from mbtool.values.values import SeriesKey

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction, PointValue, Profile
    from mbtool.modbus.tables import Table

MAX_CHOSEN = 64
"""The most series that are kept."""
MAX_SAMPLES = 20_000
"""The most samples of a series; beyond it, some are dropped."""


class NamedAddresses(NamedTuple):
    """The addresses that a user's text names at a slave."""

    table: Table
    addresses: range


class _PointMatch(NamedTuple):
    """The user's texts that name a point, and the point's addresses in its table.

    `addresses` is an empty range if the profile does not give them.
    """

    texts: set[str]
    addresses: range


class ChosenValues:
    """Collects the values over time of the points and registers that some texts name."""

    def __init__(
        self,
        texts: Sequence[str],
        find: Callable[[str, Profile | None], NamedAddresses | None],
        profile_for: Callable[[NamedTransaction], Profile | None],
    ) -> None:
        """`texts` are the names and references that the user gave.

        `find` returns the addresses that such a text names in a profile; None if it names none.

        `profile_for` returns the profile of a transaction's slave; None if it has none.
        """
        self._texts = {text: text.strip().casefold() for text in texts}
        self._find, self._profile_for = find, profile_for
        self._places: dict[tuple[str, int], list[tuple[str, NamedAddresses]]] = {}
        self._matches: dict[SeriesKey, _PointMatch | None] = {}
        """For each point seen so far, by link, unit and name: the user's texts for it; None if no
        text names it. It has at most as many entries as the profiles of all slaves have points."""
        self.series: dict[SeriesKey, ValueSeries] = {}
        self.found: set[str] = set()
        """The user's texts for which at least one value was collected."""
        self.left_out: set[SeriesKey] = set()
        """Points and registers that the user names, but whose values are not collected, because
        there are MAX_CHOSEN others."""

    def add(self, one: NamedTransaction) -> None:
        function = FUNCTIONS.get(one.function)
        if function is None or function.table is None or not one.took_effect:
            return
        only_writes = function.writes and one.write_address is None
        values = one.request_values if only_writes else one.response_values
        if values is None or one.address is None or one.function == MASK_WRITE_REGISTER:
            return
        at_ns = one.response_ns or one.start_ns
        covered = self._add_points(one, at_ns)
        for text, place in self._places_of(one):
            if place.table is not function.table:
                continue
            for address, value in enumerate(values, one.address):
                if address in place.addresses and address not in covered:
                    self._note(text, self._register(one, function.table, address), at_ns, value)

    def _add_points(self, one: NamedTransaction, at_ns: int) -> set[int]:
        """Add the values of a transaction's points that the user names.

        Returns the addresses of these points, so that the numbers in their registers are not added
        as well.
        """
        covered: set[int] = set()
        for point in one.points:
            match = self._match(one, point)
            series = self._series(SeriesKey(one.link, one.unit, point.name)) if match else None
            if match is not None and series is not None:
                series.reference, series.unit = point.reference, point.unit or ""
                series.add(at_ns, point.value, point.text)
                self.found |= match.texts
                covered.update(match.addresses)
        return covered

    def _match(self, one: NamedTransaction, point: PointValue) -> _PointMatch | None:
        """Find the texts that name a point; None if no text does.

        A text names a point by its name, by the first words of it, by its reference, or by a range
        in which the point begins.
        """
        key = SeriesKey(one.link, one.unit, point.name)
        if key not in self._matches:
            name, reference = point.name.casefold(), point.reference.casefold()
            place = self._find(point.reference, self._profile_for(one))
            texts = {
                text
                for text, wanted in self._texts.items()
                if wanted in (name, reference) or name.startswith(f"{wanted} ")
            }
            texts |= {text for text, other in self._places_of(one) if _begins_in(place, other)}
            addresses = range(0) if place is None else place.addresses
            self._matches[key] = _PointMatch(texts, addresses) if texts else None
        return self._matches[key]

    def _places_of(self, one: NamedTransaction) -> list[tuple[str, NamedAddresses]]:
        key = one.link, one.unit
        places = self._places.get(key)
        if places is None:
            profile = self._profile_for(one)
            found = ((text, self._find(text, profile)) for text in self._texts)
            places = [(text, place) for text, place in found if place is not None]
            self._places[key] = places
        return places

    def _register(self, one: NamedTransaction, table: Table, address: int) -> ValueSeries | None:
        name = write_reference(self._profile_for(one), table, address)
        return self._series(SeriesKey(one.link, one.unit, name), is_bit=table.is_bits)

    def _note(self, text: str, series: ValueSeries | None, at_ns: int, value: int) -> None:
        if series is not None:
            series.add(at_ns, value)
            self.found.add(text)

    def _series(self, key: SeriesKey, *, is_bit: bool = False) -> ValueSeries | None:
        series = self.series.get(key)
        if series is None:
            if len(self.series) >= MAX_CHOSEN:
                self.left_out.add(key)
                return None
            series = self.series[key] = ValueSeries(key.name, bit=is_bit, limit=MAX_SAMPLES)
        return series


def _begins_in(place: NamedAddresses | None, other: NamedAddresses) -> bool:
    return (
        place is not None
        and place.table is other.table
        and place.addresses.start in other.addresses
    )
