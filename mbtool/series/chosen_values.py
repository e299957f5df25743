"""Follows the values of points and registers that a user has named."""

# What a text names depends on the slave: its profile says what a reference or a name stands for. So
# the texts are looked up once for each slave. A point is followed by its value; a reference where
# no point is, by its register or bit.
#
# Memory: MAX_CHOSEN series of MAX_SAMPLES samples, thinned out so that no extreme is lost.

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from mbtool.devices.references import write_reference
from mbtool.modbus import FUNCTIONS
from mbtool.series.value_series import ValueSeries
from mbtool.series.values import SeriesKey

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mbtool.devices import NamedTransaction, PointValue, Profile
    from mbtool.modbus.tables import Table

MAX_CHOSEN = 64
MAX_SAMPLES = 20_000
_MASK_WRITE = 0x16


class NamedAddresses(NamedTuple):
    """What a text names at a slave."""

    table: Table
    addresses: range


class _PointMatch(NamedTuple):
    """The texts that name a point, and the addresses of its registers, as far as they are known."""

    texts: set[str]
    addresses: range


class ChosenValues:
    """The values over time of what some texts name."""

    def __init__(
        self,
        texts: Sequence[str],
        find: Callable[[str, Profile | None], NamedAddresses | None],
        profile_for: Callable[[NamedTransaction], Profile | None],
    ) -> None:
        """`find` gives the addresses that a text names in a profile; None if it names none."""
        self._texts = {text: text.strip().casefold() for text in texts}
        self._find, self._profile_for = find, profile_for
        self._places: dict[tuple[str, int], list[tuple[str, NamedAddresses]]] = {}
        self._matches: dict[SeriesKey, _PointMatch | None] = {}
        """By point; as many as the profiles of the slaves have."""
        self.series: dict[SeriesKey, ValueSeries] = {}
        self.found: set[str] = set()
        """The texts of which there is at least one value."""
        self.left_out: set[SeriesKey] = set()

    def add(self, one: NamedTransaction) -> None:
        function = FUNCTIONS.get(one.function)
        if function is None or function.table is None or not one.took_effect:
            return
        only_writes = function.writes and one.write_address is None
        values = one.request_values if only_writes else one.response_values
        if values is None or one.address is None or one.function == _MASK_WRITE:
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
        """Add the points that are named; return the addresses at which they begin."""
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
        """The texts that name a point: by its name or the beginning of it, or by where it is."""
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
