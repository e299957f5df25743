"""A WAGO 750 coupler: its counters, commands, connections, process image and watchdog."""

# Sources: the two manuals that mbtool/devices/profiles/wago-750.toml was made from. The process
# image is in wago_image.py, the watchdog in wago_watchdog.py.
#
#     07         returns the first eight inputs
#     0B         returns status 0000 and the number of successful requests except 0B (V1.1b3, 6.9)
#     1029H      a block of nine counters (Counter); writing 55AAH or AA55H clears them
#     102AH      the number of open connections
#     1030H      a connection is closed after so many ms without a request; 0 means never
#     100BH      writing 1 saves time and mask of the watchdog, which then survive a restart
#     2040H      writing 55AAH or AA55H restarts: outputs 0, settings as at the start or as saved,
#                counters 0, watchdog off
#
# Assumed: a restart by 2040H is acknowledged, and connections stay open. A new time in 1030H
# applies to later connections only. The second counter is meant for requests with a wrong protocol
# id; here such requests get no response and are not counted. Writes of 2041H to 2043H and 1028H are
# acknowledged without effect.

from __future__ import annotations

import math
from enum import IntEnum
from typing import TYPE_CHECKING

from mbtool.core import Direction
from mbtool.modbus.functions import EXCEPTION_BIT, FUNCTIONS
from mbtool.modbus.pdu import exception_pdu, parse_pdu
from mbtool.modbus.register_access import register_access
from mbtool.slave.device.behaviour import Behaviour
from mbtool.slave.device.connection_policy import ConnectionPolicy
from mbtool.slave.families.wago_image import COILS, HOLDING, ProcessImage
from mbtool.slave.families.wago_watchdog import MASKS, PARAMETERS, SETTINGS, Watchdog

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mbtool.devices import Profile
    from mbtool.modbus.register_access import RegisterAccess
    from mbtool.modbus.tables import Table
    from mbtool.slave.device.image import RegisterImage

COUNTERS = 0x1029
CONNECTIONS = 0x102A
IDLE_TIME = 0x1030
SAVE = 0x100B
SOFTWARE_RESET = 0x2040

_COMMANDS = (0x55AA, 0xAA55)
_FAILURE = 4


class Counter(IntEnum):
    """The nine counters in the block at 1029H, by their offset in it."""

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
    """The behaviour of a fieldbus coupler of the series 750."""

    kept = ((HOLDING, PARAMETERS),)
    watches = True

    def __init__(self, profile: Profile, image: RegisterImage) -> None:
        super().__init__(profile, image)
        self._process = ProcessImage(image)
        self.own = {
            0x07: self._alone(self._read_first_inputs),
            0x0B: self._alone(self._read_event_counter),
        }
        self.rules = self._connections = ConnectionPolicy()
        self._watchdog = Watchdog(image)
        self._counters = self._first_counters()
        self._went_well = 0
        self._at_first: list[int] | None = None
        """The contents that a restart of the coupler gives the watchdog's registers SETTINGS: those
        at the first request; time and mask as a master saved them last. None before the first
        request."""
        self._set_idle_time()

    def barred(self, pdu: bytes, now_ns: int) -> int | None:
        if self._at_first is None:
            self._at_first = self.image.get(HOLDING, SETTINGS.start, len(SETTINGS))
        self._count(Counter.MESSAGES)
        had_expired = self._watchdog.has_expired
        if self._watchdog.heard(pdu[0], now_ns):
            self._process.clear_outputs()
            self._connections.notes.append("the alternative watchdog expired: all outputs are 0")
        if self._watchdog.has_expired and not had_expired:
            self._connections.notes.append(
                "the watchdog expired: requests get exception 04 until it is ended or restarted"
            )
        if not self._watchdog.has_expired:
            return None
        access = register_access(parse_pdu(pdu, Direction.REQUEST))
        ends = access is not None and self._watchdog.takes(access.writes)
        return None if ends else _FAILURE

    def refusal(
        self, function: int, access: RegisterAccess, values: Sequence[int], now_ns: int
    ) -> int | None:
        touches_mask = access.table is HOLDING and not set(MASKS).isdisjoint(access.writes)
        return _FAILURE if touches_mask and self._watchdog.is_active else None

    def is_live(self, table: Table, span: range) -> bool:
        if table.is_bits:
            return False
        begins_counters = span.start == COUNTERS
        return begins_counters or CONNECTIONS in span or self._process.is_made_of_bits(span)

    def shown(self, table: Table, span: range, values: list[int], now_ns: int) -> list[int]:
        if span.start == COUNTERS:
            return self._counters[: len(span)]
        if CONNECTIONS in span:
            values[CONNECTIONS - span.start] = len(self._connections.peers)
        return self._process.read(span, values)

    def standing(self, table: Table, span: range) -> list[int]:
        return self._process.standing(table, span)

    def store(self, table: Table, span: range, values: Sequence[int]) -> None:
        self._process.write(table, span, values)

    def written(self, table: Table, span: range, now_ns: int) -> None:
        if table is not HOLDING:
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
        if response is not None and response[0] & EXCEPTION_BIT:
            self._count_exception(pdu, response[1])
        elif pdu[0] != 0x0B:
            self._went_well = self._went_well + 1 & 0xFFFF

    def _alone(self, function: Callable[[bytes], bytes]) -> Callable[[bytes, int], bytes]:
        """Wrap the handler of a function code whose requests have no data: one with data gets an
        exception.
        """

        def own(pdu: bytes, now_ns: int) -> bytes:
            if len(pdu) > 1:
                return exception_pdu(pdu[0], self.profile.exceptions.value)
            return function(pdu)

        return own

    def _read_first_inputs(self, pdu: bytes) -> bytes:
        bits = self.image.get(COILS, 0, 8)
        return pdu + bytes([sum(bit << place for place, bit in enumerate(bits))])

    def _read_event_counter(self, pdu: bytes) -> bytes:
        return pdu + bytes(2) + self._went_well.to_bytes(2, "big")

    def _has_written(self, span: range, address: int, values: tuple[int, ...]) -> bool:
        return address in span and self.image.get(HOLDING, address)[0] in values

    def _first_counters(self) -> list[int]:
        """Return the initial values of the counters: 0, or those in the user's values file."""
        span = range(COUNTERS, COUNTERS + len(Counter))
        begun = self.image.blocks.get(HOLDING, span) or []
        return [*begun, *[0] * len(Counter)][: len(Counter)]

    def _set_idle_time(self) -> None:
        (idle_ms,) = self.image.get(HOLDING, IDLE_TIME)
        self._connections.idle_s = idle_ms / 1000 if idle_ms else math.inf

    def _save(self) -> None:
        if self._at_first is not None:
            self._at_first[: len(PARAMETERS)] = self.image.get(
                HOLDING, PARAMETERS.start, len(PARAMETERS)
            )
        if self.keep is not None:
            self.keep()

    def _restart(self) -> None:
        self._process.clear_outputs()
        self.image.set(HOLDING, SETTINGS.start, self._at_first or [])
        self._watchdog.reset()
        self._counters = [0] * len(Counter)
        self._went_well = 0

    def _count(self, counter: Counter) -> None:
        self._counters[counter] = self._counters[counter] + 1 & 0xFFFF

    def _count_exception(self, pdu: bytes, code: int) -> None:
        exceptions = self.profile.exceptions
        if code == exceptions.function:
            self._count(Counter.BAD_FUNCTION)
        elif code == self.profile.value_exception(pdu[0]) and self._is_value_wrong(pdu):
            self._count(self._what_was_wrong(pdu))
        elif code == exceptions.address:
            self._count(Counter.BAD_ADDRESS)

    def _is_value_wrong(self, pdu: bytes) -> bool:
        """True if a refused request has a wrong form, quantity or value, not only a wrong address.

        The exception code alone does not tell: functions 01 and 02 give code 02 for a wrong
        quantity and for a wrong address.
        """
        if self.profile.value_exception(pdu[0]) != self.profile.exceptions.address:
            return True
        has_access = register_access(parse_pdu(pdu, Direction.REQUEST)) is not None
        return not has_access or self._what_was_wrong(pdu) is not Counter.BAD_DATA

    def _what_was_wrong(self, pdu: bytes) -> Counter:
        request = parse_pdu(pdu, Direction.REQUEST)
        if request.problem is not None:
            return Counter.BAD_DATA if pdu[0] == 0x05 and len(pdu) == 5 else Counter.BAD_LENGTH
        rule, function = self.profile.rule(pdu[0]), FUNCTIONS.get(pdu[0])
        limit = rule.limit if rule is not None else None
        quantity = request.fields.get("quantity")
        too_many = isinstance(quantity, int) and limit is not None and quantity > limit
        limit = rule.write_limit if rule is not None else None
        written = request.fields.get("write_quantity")
        too_many |= isinstance(written, int) and limit is not None and written > limit
        if not too_many or function is None or function.table is None:
            return Counter.BAD_DATA
        return Counter.TOO_MANY_BITS if function.table.is_bits else Counter.TOO_MANY_REGISTERS
