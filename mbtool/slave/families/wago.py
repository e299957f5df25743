"""A WAGO 750 coupler: its counters, commands, connections, process image and watchdog."""

# Sources: the two manuals that mbtool/devices/profiles/wago-750.toml was made from. The process
# image and the watchdog are described below.
#
#     07         returns the first eight inputs
#     0B         returns status 0000 and the number of successful requests except 0B (V1.1b3, 6.9)
#     1029H      a block of nine counters (Counter); writing 55AAH or AA55H clears them
#     102AH      the number of open connections
#     1030H      a connection is closed after this many ms without a request; 0 means never
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
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import TYPE_CHECKING

from mbtool.core import Direction
from mbtool.modbus.functions import EXCEPTION_BIT, FUNCTIONS
from mbtool.modbus.pdu import exception_pdu, parse_pdu
from mbtool.modbus.register_access import RegisterAccess, register_access
from mbtool.modbus.tables import Table
from mbtool.slave.device.behaviour import Behaviour
from mbtool.slave.device.connection_policy import ConnectionPolicy

if TYPE_CHECKING:
    from mbtool.devices import Profile
    from mbtool.slave.device.image import RegisterImage

# The process image of a WAGO 750 coupler: where its inputs and outputs are read and written.
#
# Sources: the manuals named in the module's head. Functions 03 and 04 read the same registers, 01
# and 02 the same bits. Reads from 0000 on return inputs; writes from 0000 on set outputs, which are
# read back at addresses 0200H higher. A second range works in the same way: registers written from
# 6000H on are read back at 7000H, bits written from 3000H on at 4000H.
#
# The digital inputs and outputs can also be read and written in registers, behind all analog data.
# Registers 1022H to 1025H give the sizes of the analog and digital outputs and inputs in bits. They
# are read once, at the start, and are 0 unless the user's values file sets them, to describe a
# coupler with modules. If they are set, a read of a register of digital data returns the bits, and
# a write to it sets the bits. Assumed: bit 0 of a register is the first of its 16 digital inputs or
# outputs, and digital data begin in a new register. Only the first range (256 registers, 512 bits)
# has digital data in registers.

HOLDING, COILS = Table.HOLDING_REGISTERS, Table.COILS

_OUTPUTS = (
    (HOLDING, range(0x0100), range(0x0200, 0x0300)),
    (HOLDING, range(0x6000, 0x62FD), range(0x7000, 0x72FD)),
    (COILS, range(0x0200), range(0x0200, 0x0400)),
    (COILS, range(0x3000, 0x35F8), range(0x4000, 0x45F8)),
)
"""The ranges of outputs: table, addresses at which masters write them, addresses at which masters
read them back and where they are stored."""
_SIZES = range(0x1022, 0x1026)
"""Registers with the sizes, in bits, of analog outputs and inputs, digital outputs and inputs."""
_OUTPUT_BASE = 0x0200
"""The first address at which registers or coils show outputs; that of inputs is 0."""
_WORD_COUNT = 0x0100
"""The number of registers, from the first address on, that show inputs or outputs."""
_BIT_COUNT = 0x0200
"""The most digital inputs or outputs that are shown in registers, too."""
_WORD_BITS = 16


class ProcessImage:
    """Reads and writes the inputs and outputs of a coupler in its register image."""

    def __init__(self, image: RegisterImage) -> None:
        image.share_contents(Table.INPUT_REGISTERS, HOLDING)
        image.share_contents(Table.DISCRETE_INPUTS, COILS)
        self._image = image
        self._parts = _digital_parts(image.get(HOLDING, _SIZES.start, len(_SIZES)))

    def is_made_of_bits(self, span: range) -> bool:
        """True if at least one register of the addresses `span` shows digital inputs or outputs."""
        return any(
            words.start < span.stop and span.start < words.stop for _, words, _ in self._parts
        )

    def read(self, span: range, values: list[int]) -> list[int]:
        """Return the contents of the registers `span`, with digital inputs and outputs filled in.

        `values` are the contents of these registers in the image; registers that show digital data
        are replaced in this list.
        """
        for base, words, bits in self._parts:
            for at in range(max(words.start, span.start), min(words.stop, span.stop)):
                first = base + (at - words.start) * _WORD_BITS
                held = self._image.get(COILS, first, min(_WORD_BITS, bits.stop - first))
                values[at - span.start] = sum(bit << place for place, bit in enumerate(held))
        return values

    def present_values(self, table: Table, span: range) -> list[int]:
        """Return the present values of what a write to the addresses `span` would change.

        They are read where the image stores the outputs, which differs from `span`.
        """
        span = stored_range(table, span)
        values = self._image.get(table, span.start, len(span))
        return values if table.is_bits else self.read(span, values)

    def write(self, table: Table, span: range, values: Sequence[int]) -> None:
        """Store values that a master writes to the addresses `span`.

        Outputs are stored at the addresses where masters read them back. If a register shows
        digital inputs or outputs, a value written to it sets their bits as well.
        """
        span = stored_range(table, span)
        self._image.set(table, span.start, values)
        if table.is_bits:
            return
        for base, words, bits in self._parts:
            for at in range(max(words.start, span.start), min(words.stop, span.stop)):
                first = base + (at - words.start) * _WORD_BITS
                word = values[at - span.start]
                count = min(_WORD_BITS, bits.stop - first)
                self._image.set(COILS, first, [word >> place & 1 for place in range(count)])

    def clear_outputs(self) -> None:
        for table, _, span in _OUTPUTS:
            self._image.set(table, span.start, [0] * len(span))


def _digital_parts(sizes: Sequence[int]) -> list[tuple[int, range, range]]:
    """Return an item for the digital outputs and one for the digital inputs, if there are any.

    Each item has the address of the first bit, the addresses of the registers that show the bits,
    and the addresses of the bits. `sizes` are the contents of the registers _SIZES, in bits.
    """
    parts = []
    for base, analog, digital in ((_OUTPUT_BASE, *sizes[::2]), (0, *sizes[1::2])):
        if digital:
            first = base + -(-analog // _WORD_BITS)
            count = min(digital, _BIT_COUNT)
            end = min(first + -(-count // _WORD_BITS), base + _WORD_COUNT)
            parts.append((base, range(first, end), range(base, base + count)))
    return parts


def stored_range(table: Table, span: range) -> range:
    """Return the addresses at which the image stores values that a master writes to `span`.

    For outputs these are the addresses at which masters read them back, else `span` itself.
    """
    for each, first, stands in _OUTPUTS:
        if table is each and span.start in first:
            by = stands.start - first.start
            return range(span.start + by, span.stop + by)
    return span


# The watchdog of a WAGO 750 coupler: registers 1000H to 100BH.
#
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
# There is no timer: at each request, the watchdog checks whether its time has passed.

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

    def note_request(self, function: int, now_ns: int) -> bool:
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
            0x07: self._refusing_data(self._read_first_inputs),
            0x0B: self._refusing_data(self._read_event_counter),
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
        if self._watchdog.note_request(pdu[0], now_ns):
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

    def present_values(self, table: Table, span: range) -> list[int]:
        return self._process.present_values(table, span)

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

    def _refusing_data(self, function: Callable[[bytes], bytes]) -> Callable[[bytes, int], bytes]:
        """Wrap the handler of a function code whose requests have no data: one with data gets an
        exception.
        """

        def handle(pdu: bytes, now_ns: int) -> bytes:
            if len(pdu) > 1:
                return exception_pdu(pdu[0], self.profile.exceptions.value)
            return function(pdu)

        return handle

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
