"""Turns transactions into tidy rows: one value at one time in each row."""

# If the slave's profile names values (points) in a transaction, each of these is a row. Otherwise
# each register or bit is a row, named by its reference.
#
# Values that a slave did not confirm are left out, such as those of unanswered writes and of
# exception responses.

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core.moments import utc_time
from mbtool.devices import NamedTransaction, Profile, write_reference
from mbtool.modbus import FUNCTIONS, TABLE_FUNCTIONS
from mbtool.modbus.functions import MASK_WRITE_REGISTER, READ_WRITE_REGISTERS

if TYPE_CHECKING:
    from datetime import datetime


class PointRow(NamedTuple):
    """A value that was read or written; `pandas.DataFrame(rows)` makes a table of such rows."""

    time_ns: int
    """The time when the response was complete, in ns since 1970; for a broadcast, that of the
    request."""
    link: str
    slave: str | None
    """The slave's address and port on a network; None on a serial line."""
    unit: int
    device: str | None
    """The name of the slave's profile; None if it has none."""
    reference: str
    """The address in the vendor's notation (HR400001), or `holding 107` without a profile."""
    name: str
    """The name of the point; the reference, if the profile names no point there."""
    value: int | float | None
    """The value in the point's unit of measure; None if the value is a text."""
    text: str
    unit_of_measure: str | None
    written: bool
    """True if a master wrote the value, False if it was read."""
    master: str | None
    """The master's address and port on a network; None on a serial line."""

    @property
    def time(self) -> datetime:
        """The same time as `time_ns`, rounded down to microseconds, in UTC."""
        return utc_time(self.time_ns)


def point_rows(transaction: NamedTransaction, profile: Profile | None) -> Iterator[PointRow]:
    """Yield a row for each value of a transaction; `profile` is the profile of its slave."""
    if not transaction.took_effect:
        return
    one = transaction
    time_ns = one.start_ns if one.response_ns is None else one.response_ns
    begin = (time_ns, one.link, one.destination, one.unit, one.device)
    for points, written in ((one.read_points, False), (one.written_points, True)):
        for point in points:
            named = (point.reference, point.name, point.value, point.text, point.unit)
            yield PointRow(*begin, *named, written, one.source)
    if not one.points and one.function in TABLE_FUNCTIONS and one.function != MASK_WRITE_REGISTER:
        for reference, value, written in _plain_values(one, profile):
            yield PointRow(
                *begin, reference, reference, value, str(value), None, written, one.source
            )


def _plain_values(
    one: NamedTransaction, profile: Profile | None
) -> Iterator[tuple[str, int, bool]]:
    """Yield (reference, value, written) for each register or bit that `one` read or wrote.

    `written` is True if the master wrote the value. The reference is the vendor's if there is a
    profile, else such as `holding 107`.
    """
    function = FUNCTIONS[one.function]
    if function.table is None:
        return
    is_both = one.function == READ_WRITE_REGISTERS
    written_at = one.write_address if is_both else one.address
    for first, values, written in (
        (one.address, one.response_values, False),
        (written_at, one.request_values, True),
    ):
        if first is None or not (is_both or written == function.writes):
            continue
        for address, value in enumerate(values or (), start=first):
            yield (
                write_reference(profile, function.table, address, writing=written),
                value,
                written,
            )
