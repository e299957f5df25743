"""The behaviour of every FA3 module beyond its profile, and the outputs of the digital models."""

# Sources: the modules' manual, chapters 10.3 and 10.4. Assumed, as the manual leaves it open:
#
#     41H to 44H  have one byte of data, 00; any other gets the exception for a wrong value
#     41H         resets coils and holding registers, except the non-volatile ones, to the values
#                 they had at the start, and clears the alarm. Inputs stay, as they come from
#                 outside
#     43H         clears RWr1, the latest alarm
#     44H         clears the history of alarms, which no register shows
#     TH models   clear their outputs when no master is connected; for these models, the manual
#                 names no setting to hold the outputs
#
# The registers 00F0H to 00F5H are non-volatile. A real module uses a new IP address in 00F0H after
# a restart. The simulated slave always uses the address of its link: the value is stored without
# effect.
#
# Outputs follow the coils and registers while a master is connected. While no master is connected,
# also before the first one, they are held or cleared.
#
# Memory: the last MAX_HISTORY alarms.

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from mbtool.modbus.pdu import exception_pdu
from mbtool.modbus.tables import Table
from mbtool.slave.device.behaviour import Behaviour, DeviceOutput
from mbtool.slave.families.fa3_connections import LATEST_ALARM, Fa3Connections

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mbtool.devices import Profile
    from mbtool.slave.device.image import RegisterImage

MAX_HISTORY = 16
NON_VOLATILE = range(0x00F0, 0x00F6)
DIGITAL_OUTPUTS = range(16)

_DATA = b"\x00"
_VOLATILE = (
    (Table.COILS, range(0x20)),
    (Table.HOLDING_REGISTERS, range(NON_VOLATILE.start)),
    (Table.HOLDING_REGISTERS, range(NON_VOLATILE.stop, 0x5000)),
)


class Fa3(Behaviour):
    """The behaviour of an FA3 module without outputs, such as FA3-TH1M16XC."""

    kept = ((Table.HOLDING_REGISTERS, NON_VOLATILE),)

    def __init__(self, profile: Profile, image: RegisterImage) -> None:
        super().__init__(profile, image)
        self.own = {
            0x41: self._checked(self._remote_reset),
            0x42: self._checked(self._read_model_name),
            0x43: self._checked(self._clear_error),
            0x44: self._checked(self._clear_history),
        }
        self.rules = self.connections = Fa3Connections(
            profile, image, alarm=self.alarm, linked=self.linked
        )
        self.is_linked = False
        self.history: deque[int] = deque(maxlen=MAX_HISTORY)
        """The codes of the last alarms, at most MAX_HISTORY; the latest one is at the end."""
        self._at_first = [image.get(table, span.start, len(span)) for table, span in _VOLATILE]

    def alarm(self, code: int) -> None:
        self.history.append(code)
        self.image.set(Table.INPUT_REGISTERS, LATEST_ALARM, [code])

    def linked(self, is_linked: bool) -> None:
        """Called with True when the first master has connected, False when the last has gone."""
        self.is_linked = is_linked

    def store(self, table: Table, span: range, values: Sequence[int]) -> None:
        if table is not Table.HOLDING_REGISTERS or not overlap(span, NON_VOLATILE):
            super().store(table, span, values)
            return
        before = self._non_volatile()
        super().store(table, span, values)
        if self._non_volatile() != before:
            self.connections.set_timers()
            if self.keep is not None:
                self.keep()

    def restarted(self) -> None:
        """Called after a remote reset (function 41H) has restored coils and registers."""

    def _non_volatile(self) -> list[int]:
        return self.image.get(Table.HOLDING_REGISTERS, NON_VOLATILE.start, len(NON_VOLATILE))

    def _checked(
        self, function: Callable[[bytes, int], bytes | None]
    ) -> Callable[[bytes, int], bytes | None]:
        def own(pdu: bytes, now_ns: int) -> bytes | None:
            if pdu[1:] != _DATA:
                return exception_pdu(pdu[0], self.profile.exceptions.value)
            return function(pdu, now_ns)

        return own

    def _remote_reset(self, pdu: bytes, now_ns: int) -> None:
        for (table, span), values in zip(_VOLATILE, self._at_first, strict=True):
            self.image.set(table, span.start, values)
        self.image.set(Table.INPUT_REGISTERS, LATEST_ALARM, [0])
        self.restarted()
        self.connections.reset(now_ns)

    def _read_model_name(self, pdu: bytes, now_ns: int) -> bytes:
        return pdu[:1] + (self.profile.model_code or 0).to_bytes(2, "big")

    def _clear_error(self, pdu: bytes, now_ns: int) -> bytes:
        self.image.set(Table.INPUT_REGISTERS, LATEST_ALARM, [0])
        return pdu

    def _clear_history(self, pdu: bytes, now_ns: int) -> bytes:
        self.history.clear()
        return pdu


def overlap(one: range, other: range) -> bool:
    return one.start < other.stop and other.start < one.stop


class Fa3DigitalOutput(Fa3):
    """The behaviour of the FA3 modules with 16 digital outputs: FA3-TH1M16Y and FA3-TH1M16YE."""

    def outputs(self) -> tuple[DeviceOutput, ...]:
        bits = self.image.get(Table.COILS, 0, len(DIGITAL_OUTPUTS))
        if not self.is_linked:
            bits = [0] * len(bits)
        return tuple(
            DeviceOutput(f"Y{number:X}", bit, "on" if bit else "off")
            for number, bit in enumerate(bits)
        )
