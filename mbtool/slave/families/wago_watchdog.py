"""The watchdog of a WAGO 750 coupler: registers 1000H to 100BH."""

# Source: the later manual, 6.5.1, as mbtool/devices/profiles/wago-750.toml quotes it.
#
#     starts     when a value other than 0 and other than the last one is written to 1003H, and
#                1000H holds a time
#     restarts   when a master writes another such value to 1003H, and with each request whose
#                function is in the mask of 1001H and 1002H
#     expires    when the time in 1000H (unit 100 ms) passes without a restart: then 1006H is 2,
#                1004H is 0, and every request gets exception 04
#     stops      when a master writes AAAAH and then 5555H to 1005H, or 55AAH or AA55H to 1008H;
#                writing 1 to 1007H starts it again
#
# The alternative watchdog (100AH = 1) restarts with every request. When it expires, all outputs
# become 0, and requests are still answered.
#
# Assumed:
#
#     after the watchdog has expired, single writes of 1005H, 1007H and 1008H are accepted
#     a write of the mask while the watchdog runs gets exception 04
#     1004H is the shortest time that was left at a restart
#     writing 1 to 1007H does not start a watchdog that is off
#     outputs stay as they are when the ordinary watchdog expires
#     1009H (close sockets when the watchdog expires) is stored without effect
#
# There is no timer: at each request, the watchdog checks if its time has passed.

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING

from mbtool.modbus.tables import Table

if TYPE_CHECKING:
    from mbtool.slave.device.image import RegisterImage

TIME = 0x1000
MASKS = range(0x1001, 0x1003)
TRIGGER = 0x1003
LEAST_LEFT = 0x1004
STOP = 0x1005
STATUS = 0x1006
RESTART = 0x1007
SIMPLE_STOP = 0x1008
ALTERNATIVE = 0x100A
PARAMETERS = range(TIME, MASKS.stop)
"""The registers that survive a restart once a master has saved them: time and mask."""
SETTINGS = range(TIME, ALTERNATIVE + 1)

_ENDING = (STOP, RESTART, SIMPLE_STOP)
_STOP_SEQUENCE = (0xAAAA, 0x5555)
_SIMPLE_STOPS = (0x55AA, 0xAA55)
_NEVER_TRIGGERED = 0xFFFF
_UNIT_NS = 100_000_000


class Status(IntEnum):
    """The state of the watchdog, as register 1006H shows it."""

    OFF = 0
    ACTIVE = 1
    EXPIRED = 2


class Watchdog:
    """The watchdog of a coupler; `image` holds the registers of its settings and state."""

    def __init__(self, image: RegisterImage) -> None:
        self._image = image
        self._status = Status.OFF
        self._since_ns = 0
        self._time_ns = 0
        self._last_trigger = 0
        self._stop_place = 0
        """The number of values of the stop sequence (AAAAH, 5555H) that were written to 1005H so
        far: 0 or 1."""

    @property
    def is_active(self) -> bool:
        return self._status is Status.ACTIVE

    @property
    def has_expired(self) -> bool:
        return self._status is Status.EXPIRED

    def heard(self, function: int, now_ns: int) -> bool:
        """Note a request: let the watchdog expire if its time has passed, else restart it.

        The ordinary watchdog restarts only if the request's function code is in the mask. Returns
        True if the alternative watchdog expired, so that the caller must set all outputs to 0; this
        watchdog restarts even then.
        """
        is_alternative = bool(self._register(ALTERNATIVE))
        is_over = self.is_active and now_ns - self._since_ns >= self._time_ns
        if is_alternative:
            if self._time():
                self._begin(now_ns)
            return is_over
        if is_over:
            self._set_status(Status.EXPIRED)
            self._set(LEAST_LEFT, 0)
        elif self.is_active and self._is_masked(function):
            self._restart_time(now_ns)
        return False

    @staticmethod
    def takes(writes: range) -> bool:
        """True if a write to the addresses `writes` is accepted after the watchdog has expired.

        It must write a single one of the registers that stop or restart the watchdog.
        """
        return len(writes) == 1 and writes.start in _ENDING

    def written(self, span: range, now_ns: int) -> None:
        """Called after a master wrote the registers `span`: start, restart or stop the watchdog."""
        for address in span:
            value = self._register(address)
            if address == TRIGGER:
                self._trigger(value, now_ns)
            elif address == STOP:
                self._stop(value)
            elif address == RESTART and value == 1 and self._status is not Status.OFF:
                self._begin(now_ns)
            elif address == SIMPLE_STOP and value in _SIMPLE_STOPS:
                self._set_status(Status.OFF)

    def reset(self) -> None:
        """Put the watchdog into the state after a restart of the coupler: off, never triggered."""
        self._set_status(Status.OFF)
        self._set(LEAST_LEFT, _NEVER_TRIGGERED)
        self._last_trigger = self._stop_place = 0

    def _trigger(self, value: int, now_ns: int) -> None:
        is_new = value not in (0, self._last_trigger)
        self._last_trigger = value
        if not is_new:
            return
        if self.is_active:
            self._restart_time(now_ns)
        elif self._status is Status.OFF and self._time():
            self._begin(now_ns)

    def _stop(self, value: int) -> None:
        is_next = value == _STOP_SEQUENCE[self._stop_place]
        self._stop_place = self._stop_place + 1 if is_next else int(value == _STOP_SEQUENCE[0])
        if self._stop_place == len(_STOP_SEQUENCE):
            self._stop_place = 0
            self._set_status(Status.OFF)

    def _begin(self, now_ns: int) -> None:
        self._time_ns = self._time() * _UNIT_NS
        self._since_ns = now_ns
        self._set_status(Status.ACTIVE)

    def _restart_time(self, now_ns: int) -> None:
        left = (self._time_ns - (now_ns - self._since_ns)) // _UNIT_NS
        self._set(LEAST_LEFT, min(self._register(LEAST_LEFT), left))
        self._since_ns = now_ns

    def _is_masked(self, function: int) -> bool:
        if not 1 <= function <= 32:
            return False
        word, bit = divmod(function - 1, 16)
        return bool(self._register(MASKS[word]) >> bit & 1)

    def _time(self) -> int:
        return self._register(TIME)

    def _set_status(self, status: Status) -> None:
        self._status = status
        self._set(STATUS, status)

    def _register(self, address: int) -> int:
        return self._image.get(Table.HOLDING_REGISTERS, address)[0]

    def _set(self, address: int, value: int) -> None:
        self._image.set(Table.HOLDING_REGISTERS, address, [value])
