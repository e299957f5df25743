"""Keeps the values that the live master has written to a slave that is played from a recording."""

# The live master is the one that talks to the player; the recorded master is the one in the
# recording. After the live master has written to a register or bit, all responses show the written
# value, recorded responses too. This ends when the player reaches a later write of the recorded
# master to the same address; after it, responses show the recorded values. A response that was
# recorded before that write, but is played after it, shows the value that was shown last, so that
# the register does not seem to change back.
#
# If the live master writes the same value as the recorded master's last write, the two count as the
# same write: later recorded changes are shown, for example of a command bit that the device resets.
#
# A recorded change without a recorded write, such as that of a counter, does not end a live write.
# Responses that are repeated after the end of the recording do not end it either. If the recording
# begins again, its next write to the address ends the live write.
#
# Memory: one entry for each register or bit that the live master has written, if it is in the
# recording.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.modbus import Table
    from mbtool.replay.recording import Recording


class Place(NamedTuple):
    """A position in a recording that may be played several times. Positions compare in the order in
    which they are played.
    """

    lap: int
    """The number of times that the recording had begun again: 0 while it is played for the first
    time."""
    at_ns: int
    """The time in the recording, in UTC ns."""


@dataclass(slots=True)
class _LiveValue:
    """A register or bit that the live master has written: the value that responses show."""

    value: int
    place: Place
    """The player's position when the live master wrote `value`. When a later recorded write ends
    the live write, `value` and `place` become those of the recorded response that showed it."""
    recorded_writes: int
    """The number of recorded writes to this address up to the player's position when the live
    master wrote."""


class LiveWrites:
    """Holds the registers and bits that the live master (the one that talks to the player) has
    written.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._values: dict[tuple[int, Table], dict[int, _LiveValue]] = {}
        """The values that responses show in place of the recorded ones: by unit and table, then by
        address."""

    def keep(
        self, unit: int, table: Table, address: int, value: int, *, recorded: int, place: Place
    ) -> None:
        """Keep a value that the live master wrote to an address of `unit` with an acknowledged
        write.

        `place` is the player's position in the recording at the write; `recorded` is the recorded
        value of the address at that position.
        """
        values = self._values.setdefault((unit, table), {})
        before = values.get(address)
        if before is not None:
            place = max(place, before.place)
        writes = self._recorded_writes(unit, table, address, place)
        last = self._recording.timeline(unit, table).last_write(address, place.at_ns)
        if recorded == value == last:
            writes -= 1  # Count it as that recorded write, which ends it.
        values[address] = _LiveValue(value, place, writes)

    def shown(self, unit: int, table: Table, address: int, recorded: int, place: Place) -> int:
        """Return the value of an address of `unit` that a response shows.

        This is the live master's, or `recorded`, the recorded value at `place`, if the live master
        did not write or a later recorded write has ended its write.
        """
        live = self._values.get((unit, table), {}).get(address)
        if live is None or self._has_ended(live, unit, table, address, place):
            return recorded
        return live.value

    def in_answer(
        self, unit: int, table: Table, start: int, values: Sequence[int], place: Place
    ) -> list[int]:
        """Return the values of a recorded response of `unit`, with those replaced that the live
        master has written.

        `values` are the recorded values, from address `start` on; `place` is the position at which
        the response was recorded.
        """
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
        """True if the recording has a write to the address after the live write `live`, up to the
        position `place`.
        """
        if place < live.place:
            return False
        return self._recorded_writes(unit, table, address, place) > live.recorded_writes

    def _recorded_writes(self, unit: int, table: Table, address: int, place: Place) -> int:
        """The number of recorded writes to an address up to `place`, including those of earlier
        laps.
        """
        recording = self._recording
        timeline = recording.timeline(unit, table)
        before = timeline.writes_until(address, recording.begin_ns - 1)
        of_lap = timeline.writes_until(address, recording.begin_ns + recording.length_ns) - before
        return place.lap * of_lap + timeline.writes_until(address, place.at_ns)
