"""What a WAGO 750 coupler does beyond its registers: process image, counters, commands."""

# Sources: the two manuals that mbtool/devices/profiles/wago-750.toml joins; the watchdog is in
# wago_watchdog.py.
#
# One process image: functions 03 and 04 read the same registers, 01 and 02 the same bits. Reading
# from 0000 on gives inputs, writing there sets outputs, which are read back 0200H higher; the
# second part likewise, registers from 6000H at 7000H and bits from 3000H at 4000H.
#
#     07         the first eight inputs
#     0B         status 0000 and how many requests went well, those of 0B apart (V1.1b3, 6.9)
#     17         writes 100 registers at most
#     1029H      a block of nine counters (Counter); 55AAH or AA55H written there clears them
#     102AH      the connections that are open
#     1030H      a connection without a request for so many milliseconds is closed; 0: never
#     100BH      1 saves time and mask of the watchdog; they outlast a restart then
#     2040H      55AAH or AA55H is a restart: outputs 0, settings as at the start or as saved,
#                counters 0, watchdog off
#
# Assumed: a restart by 2040H is acknowledged, and connections stay. The time of 1030H holds for
# connections that are made later. The header errors that the second counter counts get silence
# before they come here. 2041H to 2043H and 1028H are acknowledged and do nothing more; what modules
# the node has is not known here, so bits and registers of the image have no part in common.

from __future__ import annotations

import math
from enum import IntEnum
from typing import TYPE_CHECKING

from mbtool.core import Direction
from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.pdu import exception_pdu, parse_pdu
from mbtool.modbus.reach import reach_of
from mbtool.modbus.tables import Table
from mbtool.slave.behaviour import Behaviour
from mbtool.slave.connection_rules import ConnectionRules
from mbtool.slave.wago_watchdog import MASKS, PARAMETERS, SETTINGS, Watchdog

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mbtool.devices import Profile
    from mbtool.modbus.reach import Reach
    from mbtool.slave.image import RegisterImage

COUNTERS = 0x1029
CONNECTIONS = 0x102A
IDLE_TIME = 0x1030
SAVE = 0x100B
SOFTWARE_RESET = 0x2040

_HOLDING, _COILS = Table.HOLDING_REGISTERS, Table.COILS
_COMMANDS = (0x55AA, 0xAA55)
_FAILURE = 4
_WRITE_LIMIT_17H = 100

_OUTPUTS = (
    (_HOLDING, range(0x0100), range(0x0200, 0x0300)),
    (_HOLDING, range(0x6000, 0x62FD), range(0x7000, 0x72FD)),
    (_COILS, range(0x0200), range(0x0200, 0x0400)),
    (_COILS, range(0x3000, 0x35F8), range(0x4000, 0x45F8)),
)
"""Where outputs are written, and where they stand."""


class Counter(IntEnum):
    """What is counted from 1029H on, by its place there."""

    DEVICE_FAILURE = 0
    BAD_PROTOCOL = 1
    BAD_LENGTH = 2
    BAD_FUNCTION = 3
    BAD_ADDRESS = 4
    BAD_DATA = 5
    TOO_MANY_REGISTERS = 6
    TOO_MANY_BITS = 7
    MESSAGES = 8


class Wago(Behaviour):
    """A fieldbus coupler."""

    kept = ((_HOLDING, PARAMETERS),)

    def __init__(self, profile: Profile, image: RegisterImage) -> None:
        super().__init__(profile, image)
        image.share(Table.INPUT_REGISTERS, _HOLDING)
        image.share(Table.DISCRETE_INPUTS, _COILS)
        self.own = {
            0x07: self._alone(self._read_first_inputs),
            0x0B: self._alone(self._read_event_counter),
        }
        self.rules = self._connections = ConnectionRules()
        self._watchdog = Watchdog(image)
        self._counters = [0] * len(Counter)
        self._went_well = 0
        self._at_first: list[int] | None = None
        """The settings when the first request came, and the saved parameters since then."""
        self._set_idle_time()

    def barred(self, pdu: bytes, now_ns: int) -> int | None:
        if self._at_first is None:
            self._at_first = self.image.get(_HOLDING, SETTINGS.start, len(SETTINGS))
        self._count(Counter.MESSAGES)
        if self._watchdog.heard(pdu[0], now_ns):
            self._clear_outputs()
        if not self._watchdog.has_expired:
            return None
        reach = reach_of(parse_pdu(pdu, Direction.REQUEST))
        ends = reach is not None and self._watchdog.takes(reach.writes)
        return None if ends else _FAILURE

    def refusal(
        self, function: int, reach: Reach, values: Sequence[int], now_ns: int
    ) -> int | None:
        if function == 0x17 and len(values) > _WRITE_LIMIT_17H:
            return self.profile.exceptions.value
        touches_mask = reach.table is _HOLDING and not set(MASKS).isdisjoint(reach.writes)
        return _FAILURE if touches_mask and self._watchdog.is_active else None

    def is_live(self, table: Table, span: range) -> bool:
        return True  # The watchdog looks at every request.

    def shown(self, table: Table, span: range, values: list[int], now_ns: int) -> list[int]:
        if table.is_bits:
            return values
        if span.start == COUNTERS:
            return self._counters[: len(span)]
        if CONNECTIONS in span:
            values[CONNECTIONS - span.start] = len(self._connections.peers)
        return values

    def standing(self, table: Table, span: range) -> list[int]:
        return super().standing(table, _where_it_stands(table, span))

    def store(self, table: Table, span: range, values: Sequence[int]) -> None:
        self.image.set(table, _where_it_stands(table, span).start, values)

    def written(self, table: Table, span: range, now_ns: int) -> None:
        if table is not _HOLDING:
            return
        self._watchdog.written(span, now_ns)
        if self._has_written(span, SAVE, (1,)):
            self._save()
        if self._has_written(span, COUNTERS, _COMMANDS):
            self._counters = [0] * len(Counter)
        if IDLE_TIME in span:
            self._set_idle_time()
        if self._has_written(span, SOFTWARE_RESET, _COMMANDS):
            self._restart()

    def answered(self, pdu: bytes, response: bytes | None, now_ns: int) -> None:
        if response is not None and response[0] & 0x80:
            self._count_exception(pdu, response[1])
        elif pdu[0] != 0x0B:
            self._went_well = self._went_well + 1 & 0xFFFF

    def _alone(self, function: Callable[[bytes], bytes]) -> Callable[[bytes, int], bytes]:
        """A function whose request is its code and nothing else."""

        def own(pdu: bytes, now_ns: int) -> bytes:
            if len(pdu) > 1:
                return exception_pdu(pdu[0], self.profile.exceptions.value)
            return function(pdu)

        return own

    def _read_first_inputs(self, pdu: bytes) -> bytes:
        bits = self.image.get(_COILS, 0, 8)
        return pdu + bytes([sum(bit << place for place, bit in enumerate(bits))])

    def _read_event_counter(self, pdu: bytes) -> bytes:
        return pdu + bytes(2) + self._went_well.to_bytes(2, "big")

    def _has_written(self, span: range, address: int, values: tuple[int, ...]) -> bool:
        return address in span and self.image.get(_HOLDING, address)[0] in values

    def _set_idle_time(self) -> None:
        (idle_ms,) = self.image.get(_HOLDING, IDLE_TIME)
        self._connections.idle_s = idle_ms / 1000 if idle_ms else math.inf

    def _save(self) -> None:
        if self._at_first is not None:
            self._at_first[: len(PARAMETERS)] = self.image.get(
                _HOLDING, PARAMETERS.start, len(PARAMETERS)
            )
        if self.keep is not None:
            self.keep()

    def _restart(self) -> None:
        self._clear_outputs()
        self.image.set(_HOLDING, SETTINGS.start, self._at_first or [])
        self._watchdog.reset()
        self._counters = [0] * len(Counter)
        self._went_well = 0

    def _clear_outputs(self) -> None:
        for table, _, span in _OUTPUTS:
            self.image.set(table, span.start, [0] * len(span))

    def _count(self, counter: Counter) -> None:
        self._counters[counter] = self._counters[counter] + 1 & 0xFFFF

    def _count_exception(self, pdu: bytes, code: int) -> None:
        exceptions = self.profile.exceptions
        if code == exceptions.function:
            self._count(Counter.BAD_FUNCTION)
        elif code == exceptions.address:
            self._count(Counter.BAD_ADDRESS)
        elif code == exceptions.value:
            self._count(self._what_was_wrong(pdu))

    def _what_was_wrong(self, pdu: bytes) -> Counter:
        request = parse_pdu(pdu, Direction.REQUEST)
        if request.problem is not None:
            return Counter.BAD_DATA if pdu[0] == 0x05 and len(pdu) == 5 else Counter.BAD_LENGTH
        rule, function = self.profile.rule(pdu[0]), FUNCTIONS.get(pdu[0])
        limit = rule.limit if rule is not None else None
        quantity = request.fields.get("quantity")
        too_many = isinstance(quantity, int) and limit is not None and quantity > limit
        if pdu[0] == 0x17 and not too_many:
            written = request.fields.get("write_quantity")
            too_many = isinstance(written, int) and written > _WRITE_LIMIT_17H
        if not too_many or function is None or function.table is None:
            return Counter.BAD_DATA
        return Counter.TOO_MANY_BITS if function.table.is_bits else Counter.TOO_MANY_REGISTERS


def _where_it_stands(table: Table, span: range) -> range:
    """Where what is written to a range stands, and is read back."""
    for each, first, stands in _OUTPUTS:
        if table is each and span.start in first:
            by = stands.start - first.start
            return range(span.start + by, span.stop + by)
    return span
