"""Keeps what the live master has written, until the recording itself writes there."""

# An acknowledged write of the live master gives a register or bit its value in every answer: in
# those from the register image, and in recorded ones. It ends when the player comes to a place at
# which the recording has written there since. From then on the register has the recorded values;
# an answer that was recorded before that place shows the value that was shown last, as a register
# does not go back.
#
# A write of the value that the recording's own last write has left there is that write, played:
# recorded changes that follow it are shown, as of a command that the device takes back.
#
# A value that changes in the recording without a write, such as a counter, does not end a live
# write. Nor do the answers that are repeated at the end, and a recording that begins again does so
# only when it comes to its next write there.
#
# Memory: one entry for each register or bit that the live master has written and the recording
# knows.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.modbus import Table
    from mbtool.replay.recording import Recording


class Place(NamedTuple):
    """A place in a recording that is played, perhaps several times."""

    lap: int
    """How often the recording has begun again."""
    at_ns: int
    """The recorded time."""


@dataclass(slots=True)
class _LiveValue:
    """The value of one register or bit that the live master has written."""

    value: int
    place: Place
    """Where the value was written or, after the recording wrote there, where it was recorded."""
    recorded_writes: int
    """The number of recorded writes there when the live master wrote."""


class LiveWrites:
    """The registers and bits that a live master has written."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._values: dict[tuple[int, Table], dict[int, _LiveValue]] = {}
        """By unit and table, then by address."""

    def keep(
        self, unit: int, table: Table, address: int, value: int, *, recorded: int, place: Place
    ) -> None:
        """Keep the value of an acknowledged write.

        `recorded` is the value that the recording has there at `place`, where the player is.
        """
        values = self._values.setdefault((unit, table), {})
        before = values.get(address)
        if before is not None:
            place = max(place, before.place)
        writes = self._recorded_writes(unit, table, address, place)
        last = self._recording.timeline(unit, table).last_write(address, place.at_ns)
        if recorded == value == last:
            writes -= 1  # The live write is the recorded one, which ends it at once.
        values[address] = _LiveValue(value, place, writes)

    def shown(self, unit: int, table: Table, address: int, recorded: int, place: Place) -> int:
        """The value of an address at a place where the recording has the value `recorded`."""
        live = self._values.get((unit, table), {}).get(address)
        if live is None or self._has_ended(live, unit, table, address, place):
            return recorded
        return live.value

    def in_answer(
        self, unit: int, table: Table, start: int, values: Sequence[int], place: Place
    ) -> list[int]:
        """The values to show instead of those of a recorded answer, from address `start` on."""
        shown = list(values)
        for address, live in self._values.get((unit, table), {}).items():
            index = address - start
            if not 0 <= index < len(values):
                continue
            if self._has_ended(live, unit, table, address, place):
                live.value, live.place = values[index], place
            shown[index] = live.value
        return shown

    def _has_ended(
        self, live: _LiveValue, unit: int, table: Table, address: int, place: Place
    ) -> bool:
        """True if at a place the recording has written to an address since the live master did."""
        if place < live.place:
            return False
        return self._recorded_writes(unit, table, address, place) > live.recorded_writes

    def _recorded_writes(self, unit: int, table: Table, address: int, place: Place) -> int:
        """How often the recording has written to an address up to a place, over all laps."""
        recording = self._recording
        timeline = recording.timeline(unit, table)
        before = timeline.writes_until(address, recording.begin_ns - 1)
        of_lap = timeline.writes_until(address, recording.begin_ns + recording.length_ns) - before
        return place.lap * of_lap + timeline.writes_until(address, place.at_ns)
