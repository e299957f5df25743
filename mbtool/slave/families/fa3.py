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

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from mbtool.modbus.pdu import exception_pdu
from mbtool.modbus.tables import Table
from mbtool.slave.device.behaviour import Behaviour, DeviceOutput
from mbtool.slave.device.connection_policy import Admission, ConnectionPolicy, KeepAlive, Loss, Peer

if TYPE_CHECKING:
    from mbtool.devices import Profile
    from mbtool.slave.device.image import RegisterImage

# The connection rules of an FA3 module (manual, chapters 10.2 and 10.3).
#
# Connections: two. When a third master connects, the master that was silent longest is
# disconnected.
#
# Alive check: TCP keep-alive, with its timers in holding registers 00F2H to 00F4H. A value outside
# its range acts as the nearest limit and reads back as written (assumed). A master that does not
# answer the probes is disconnected with alarm 0E30H. After that, the module rejects connections
# from this master's IP address for up to ten seconds, says the manual; here it is always ten
# seconds.
#
# Split reception: 00F5H is the longest time from the first part of a request to its last. A slower
# master is disconnected with alarm 0E40H.
#
# Remote reset (41H) closes all connections; for two seconds none is accepted.
#
# Memory: two peers, and an IP address for each failed alive check of the last ten seconds.

PLACES = 2
DISCONNECTING_NS = 10_000_000_000
RESETTING_NS = 2_000_000_000

START_INTERVAL = 0x00F2
INTERVAL = 0x00F3
COUNT = 0x00F4
SPLIT_RECEPTION = 0x00F5
TIMERS = range(START_INTERVAL, SPLIT_RECEPTION + 1)

ALARMS = {Loss.NOT_ALIVE: 0x0E30, Loss.SPLIT: 0x0E40}
LATEST_ALARM = 0x0001
"""The address of the input register RWr1, which holds the code of the latest alarm."""


class Fa3Connections(ConnectionPolicy):
    """Decides which TCP connections one module accepts, and when it closes them."""

    def __init__(
        self,
        profile: Profile,
        image: RegisterImage,
        *,
        alarm: Callable[[int], None],
        linked: Callable[[bool], None],
    ) -> None:
        """Take the functions to call.

        `alarm` is called with the code of each alarm. `linked` is called with True when the first
        master has connected, and with False when the last one has gone.
        """
        super().__init__(PLACES, math.inf)
        self._image = image
        self._alarm = alarm
        self._linked = linked
        self._ranges = {
            point.address: (point.minimum, point.maximum)
            for point in profile.points
            if point.table is Table.HOLDING_REGISTERS and point.address in TIMERS
        }
        self._alarm_names = {
            code: text
            for point in profile.points
            if point.table is Table.INPUT_REGISTERS and point.address == LATEST_ALARM
            for code, text in point.texts.items()
        }
        self._closed_until_ns: int | None = None
        self._rejected: dict[str, int] = {}
        """By IP address that may not connect at present, the time in ns when it may again."""

    @property
    def keep_alive(self) -> KeepAlive:
        return KeepAlive(self._timer(START_INTERVAL), self._timer(INTERVAL), self._timer(COUNT))

    @property
    def split_s(self) -> float:
        return self._timer(SPLIT_RECEPTION)

    @property
    def closed_until_ns(self) -> int | None:
        return self._closed_until_ns

    def admit(self, host: str, now_ns: int) -> Admission:
        if self._is_closed(now_ns) or self._rejected.get(host, now_ns) > now_ns:
            return Admission(None)
        leaves = None
        if len(self.peers) >= self.places:
            leaves = min(self.peers, key=lambda peer: peer.heard_ns)
            self.peers.remove(leaves)
            self.notes.append(
                f"a third connection, from {host}: the one from {leaves.host} is closed, which was "
                f"silent for {(now_ns - leaves.heard_ns) / 1e9:.1f} s"
            )
        peer = Peer(host, now_ns)
        self.peers.append(peer)
        if len(self.peers) == 1:
            self._linked(True)
        return Admission(peer, leaves)

    def lost(self, peer: Peer, loss: Loss, now_ns: int) -> None:
        if peer not in self.peers:
            return
        self.peers.remove(peer)
        if loss in ALARMS:
            self._alarm(ALARMS[loss])
            name = self._alarm_names.get(ALARMS[loss], "an alarm")
            rejected = f", and {peer.host} is rejected for {DISCONNECTING_NS / 1e9:.0f} s"
            self.notes.append(
                f"{name} ({ALARMS[loss]:04X}H): the connection from {peer.host} is closed"
                + (rejected if loss is Loss.NOT_ALIVE else "")
            )
        if loss is Loss.NOT_ALIVE:
            still = {host: until for host, until in self._rejected.items() if until > now_ns}
            self._rejected = {**still, peer.host: now_ns + DISCONNECTING_NS}
        if not self.peers:
            self._linked(False)

    def note_timers_changed(self) -> None:
        """Note that a master may have changed the times in registers 00F2H-00F5H.

        These are the keep-alive times and the time in which all parts of a request must arrive; the
        shell applies them.
        """
        self.changed = True

    def reset(self, now_ns: int) -> None:
        """Close all connections; accept none for RESETTING_NS (two seconds) after `now_ns`."""
        self._closed_until_ns = now_ns + RESETTING_NS
        self._rejected.clear()
        self.notes.append(
            f"remote reset: all connections are closed, and none is taken for "
            f"{RESETTING_NS / 1e9:.0f} s"
        )
        self.changed = True

    def _is_closed(self, now_ns: int) -> bool:
        return self._closed_until_ns is not None and now_ns < self._closed_until_ns

    def _timer(self, address: int) -> int:
        (value,) = self._image.get(Table.HOLDING_REGISTERS, address)
        lowest, highest = self._ranges.get(address, (None, None))
        value = value if lowest is None else max(value, int(lowest))
        return value if highest is None else min(value, int(highest))


# The code below simulates the averaging and scaling of an analog input over time (FA3 modules).
#
# A simulated input keeps its value until it is set again. A real module converts the input every
# CONVERSION_NS, and makes one of these of the converted values, as the channel's setting says:
#
#     sampling   each value as it is
#     period     the mean of each period; a period is a time or a number of conversions
#     moving     the mean of the last N conversions, N from the setting
#
# Here, a mean is computed from the input's values and how long each of them lasted; this gives the
# same result as averaging the conversions. There is no result before the first period, or the first
# N conversions, are complete. Fractions are cut off, as in the manual's example of scaling, where
# 37.5 becomes 37.
#
# Memory: a moving mean keeps the last MAX_STEPS changes of the input. If its window begins earlier
# than the oldest of them, it uses that change's value for the time before.

FULL_SCALE = 16000
CONVERSION_NS = 1_000_000
"""Time in ns between two conversions of a channel. Assumed: the manual does not state it."""
MAX_STEPS = 1024

_LOWEST, _HIGHEST = -0x8000, 0x7FFF


class Processing(Protocol):
    """Computes the value that masters read from the values of an input.

    No call may have an earlier time than the call before it.
    """

    def feed(self, value: int, now_ns: int) -> None:
        """Set the input to this value from `now_ns` on."""

    def result(self, now_ns: int) -> int | None:
        """Return the computed value at `now_ns`, or None before the first mean is complete."""


class Sampling:
    """Returns the input's present value, without averaging."""

    def __init__(self) -> None:
        self._value: int | None = None

    def feed(self, value: int, now_ns: int) -> None:
        self._value = value

    def result(self, now_ns: int) -> int | None:
        return self._value


class PeriodMean:
    """Averages the input over periods of equal length that follow each other without a gap.

    Its result is the mean of the last complete period.
    """

    def __init__(self, period_ns: int, value: int, now_ns: int) -> None:
        self._period_ns = period_ns
        self._value = value
        self._begun_ns = self._known_ns = now_ns
        self._sum = 0
        """The sum of value times duration in ns, from the period's begin to `_known_ns`."""
        self._mean: int | None = None

    def feed(self, value: int, now_ns: int) -> None:
        self._advance(now_ns)
        self._value = value

    def result(self, now_ns: int) -> int | None:
        self._advance(now_ns)
        return self._mean

    def _advance(self, now_ns: int) -> None:
        periods, into_ns = divmod(now_ns - self._begun_ns, self._period_ns)
        if not periods:
            self._sum += self._value * (now_ns - self._known_ns)
        else:
            rest_ns = self._begun_ns + self._period_ns - self._known_ns
            ended = self._sum + self._value * rest_ns
            self._mean = (
                divide_towards_zero(ended, self._period_ns) if periods == 1 else self._value
            )
            self._begun_ns = now_ns - into_ns
            self._sum = self._value * into_ns
        self._known_ns = now_ns


class MovingMean:
    """Averages the input over the last `window_ns` nanoseconds."""

    def __init__(self, window_ns: int, value: int, now_ns: int) -> None:
        self._window_ns = window_ns
        self._begun_ns = now_ns
        self._steps: deque[tuple[int, int]] = deque([(now_ns, value)], maxlen=MAX_STEPS)
        """The changes of the input: the time in ns, and the value from that time on."""

    def feed(self, value: int, now_ns: int) -> None:
        if value != self._steps[-1][1]:
            self._steps.append((now_ns, value))

    def result(self, now_ns: int) -> int | None:
        first_ns = now_ns - self._window_ns
        if first_ns < self._begun_ns:
            return None
        while len(self._steps) > 1 and self._steps[1][0] <= first_ns:
            self._steps.popleft()
        total, until_ns = 0, now_ns
        for since_ns, value in reversed(self._steps):
            total += value * (until_ns - max(since_ns, first_ns))
            until_ns = since_ns
        if until_ns > first_ns:  # The changes before were dropped.
            total += self._steps[0][1] * (until_ns - first_ns)
        return divide_towards_zero(total, self._window_ns)


def scaled(value: int, lower: int, upper: int) -> int:
    """Scale a digital value: 0 becomes `lower`, FULL_SCALE (16000) becomes `upper`.

    If `lower` and `upper` are equal, the value is returned unchanged.
    """
    if lower == upper:
        return value
    return nearest_signed(
        divide_towards_zero(lower * FULL_SCALE + value * (upper - lower), FULL_SCALE)
    )


def divide_towards_zero(dividend: int, divisor: int) -> int:
    """Return `dividend` / `divisor`, rounded towards 0 (// would round down: -7 / 2 is -3 here)."""
    quotient = abs(dividend) // divisor
    return quotient if dividend >= 0 else -quotient


def nearest_signed(value: int) -> int:
    """Return the number nearest to `value` that a signed register can hold."""
    return min(max(value, _LOWEST), _HIGHEST)


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
            self.connections.note_timers_changed()
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


# The FA3 modules FA3-AT1M8X and FA3-AT1M8Y: settings, conversion and outputs of eight channels.
#
# Source: the modules' manual, chapter 10.5. Settings take effect with the "initial data setting":
# the master sets Y9, the module reads the settings and sets X9, the master clears Y9, and the
# module clears X9. Conversion starts with the first initial data setting. Before it, and after a
# remote reset, the values and flags that a master reads are 0 (assumed), and so is every output
# (assumed).
#
# FA3-AT1M8X. RWr2 to RWr9 of the image hold the inputs as digital values from 0 to 16000. A master
# reads them averaged and scaled. X10 to X17 are set once a channel's first value is complete; until
# then, after an initial data setting, RWr keeps the previous value. A disabled channel reads 0.
# Assumed: averaging process 3 is a moving average; the time of a conversion (CONVERSION_NS); a time
# or count of 0 means sampling.
#
# FA3-AT1M8Y. A channel puts out its digital value if D/A conversion (0102H) and its output (Y10 to
# Y17) are enabled, else 0. While no master is connected, a channel set to HOLD keeps its last
# output and one set to CLEAR gives 0. The digital values 0 to 16000 stand for 1 to 5 V (chapter
# 10.5: 3600 is 1.9 V). The manual does not say what the module does with a value outside the
# warning limits: here the output follows the value, and the text shown to people says that it is
# outside them.

CHANNELS = range(8)

_INITIAL_SETTING = 0x09  # Y9, X9
_FLAGS = range(0x10, 0x18)  # X10 to X17, Y10 to Y17
_VALUES = range(0x02, 0x0A)  # RWr2 to RWr9, RWw2 to RWw9

_CONVERSION = 0x0102  # a bit for each channel; 0 enables conversion
_BY_CHANNEL = range(0x0105, 0x0107)  # 4 bits a channel: averaging process, or HOLD/CLEAR
_AVERAGING = range(0x0107, 0x010F)
_SCALING = 0x0133  # a bit for each channel; 0 enables scaling
_SCALING_LIMITS = range(0x0134, 0x0144)  # two registers a channel: lower and upper limit
_WARNING = 0x0107  # a bit for each channel; 0 enables the warning
_WARNING_LIMITS = range(0x0108, 0x0118)  # two registers a channel: upper and lower limit

_HOLD = 1
_MS = 1_000_000


class _Fa3Analog(Fa3):
    """The base class of both analog models: it takes over new settings when the
    master requests the "initial data setting" of the manual.
    """

    def __init__(self, profile: Profile, image: RegisterImage) -> None:
        super().__init__(profile, image)
        self._is_requested = False

    def written(self, table: Table, span: range, now_ns: int) -> None:
        super().written(table, span, now_ns)
        if table is Table.COILS and _INITIAL_SETTING in span:
            (request,) = self.image.get(Table.COILS, _INITIAL_SETTING)
            if request and not self._is_requested:
                self.take_settings(now_ns)
            self._is_requested = bool(request)
            self.image.set(Table.DISCRETE_INPUTS, _INITIAL_SETTING, [request])

    def restarted(self) -> None:
        self._is_requested = False
        self.image.set(Table.DISCRETE_INPUTS, _INITIAL_SETTING, [0])

    def take_settings(self, now_ns: int) -> None:
        """Called at each initial data setting: apply the settings in the holding registers."""

    def _holding_registers(self, span: range) -> list[int]:
        return self.image.get(Table.HOLDING_REGISTERS, span.start, len(span))

    def _numbers(self, span: range) -> list[int]:
        return [_signed(word) for word in self._holding_registers(span)]

    def _enabled(self, address: int) -> list[bool]:
        """Return True for each channel whose bit in the register at `address` is 0 (enabled)."""
        (word,) = self.image.get(Table.HOLDING_REGISTERS, address)
        return [not word >> channel & 1 for channel in CHANNELS]

    def _nibbles(self) -> list[int]:
        low, high = self._holding_registers(_BY_CHANNEL)
        return [(low | high << 16) >> 4 * channel & 0xF for channel in CHANNELS]


@dataclass(frozen=True, slots=True)
class _InputSetting:
    """The settings of one analog input, from the holding registers."""

    process: int
    average: int
    """Length of the average: a time in ms, or a number of conversions; 0 for no average."""
    limits: tuple[int, int]
    """The numbers that 0 and FULL_SCALE (16000) are scaled to; if they are equal, no scaling."""


@dataclass(slots=True)
class _InputChannel:
    """The conversion of one analog input, and the value that a master reads from it."""

    processing: Processing
    limits: tuple[int, int]
    value: int
    is_complete: bool = False


_NOT_STARTED: Sequence[_InputChannel | None] = (None,) * len(CHANNELS)


class Fa3AnalogInput(_Fa3Analog):
    """The behaviour of the FA3 module with eight analog inputs: FA3-AT1M8X."""

    def __init__(self, profile: Profile, image: RegisterImage) -> None:
        super().__init__(profile, image)
        self._channels: Sequence[_InputChannel | None] = _NOT_STARTED
        """The eight channels; None for one that is disabled or not started."""

    def restarted(self) -> None:
        super().restarted()
        self._channels = _NOT_STARTED

    def is_live(self, table: Table, span: range) -> bool:
        live = {Table.DISCRETE_INPUTS: _FLAGS, Table.INPUT_REGISTERS: _VALUES}.get(table)
        return live is not None and overlap(span, live)

    def shown(self, table: Table, span: range, values: list[int], now_ns: int) -> list[int]:
        live = _FLAGS if table is Table.DISCRETE_INPUTS else _VALUES
        for channel, one in enumerate(self.convert(now_ns)):
            address = live[channel]
            if address in span:
                flag, value = (False, 0) if one is None else (one.is_complete, one.value)
                shown = flag if live is _FLAGS else value & 0xFFFF
                values[address - span.start] = int(shown)
        return values

    def inputs_set(self, now_ns: int) -> None:
        self.convert(now_ns)

    def convert(self, now_ns: int) -> Sequence[_InputChannel | None]:
        """Convert the inputs that the image holds, and return the channels with their new values.

        There are eight items; a disabled channel is None. An average counts the new value of an
        input from `now_ns` on, and its old value until then.
        """
        for one, value in zip(self._channels, self._inputs(), strict=True):
            if one is not None:
                one.processing.feed(value, now_ns)
                result = one.processing.result(now_ns)
                if result is not None:
                    one.value, one.is_complete = scaled(result, *one.limits), True
        return self._channels

    def take_settings(self, now_ns: int) -> None:
        self._channels = self._begin(self.convert(now_ns), now_ns)

    def _inputs(self) -> list[int]:
        words = self.image.get(Table.INPUT_REGISTERS, _VALUES.start, len(_VALUES))
        return [_signed(word) for word in words]

    def _read_settings(self) -> list[_InputSetting | None]:
        converts, scales = self._enabled(_CONVERSION), self._enabled(_SCALING)
        processes, averages = self._nibbles(), self._holding_registers(_AVERAGING)
        limits = self._numbers(_SCALING_LIMITS)
        return [
            _InputSetting(
                processes[channel],
                averages[channel],
                (limits[2 * channel], limits[2 * channel + 1]) if scales[channel] else (0, 0),
            )
            if converts[channel]
            else None
            for channel in CHANNELS
        ]

    def _begin(
        self, before: Sequence[_InputChannel | None], now_ns: int
    ) -> list[_InputChannel | None]:
        """Start conversion with the settings in the holding registers; return the new channels.

        `before` has the eight channels so far, None for a channel that did not convert. Until its
        first new value is complete, a channel shows the value that it had in `before`, or 0.
        """
        channels: list[_InputChannel | None] = []
        for setting, value, last in zip(self._read_settings(), self._inputs(), before, strict=True):
            if setting is None:
                channels.append(None)
                continue
            processing = _processing(setting, value, now_ns)
            channels.append(_InputChannel(processing, setting.limits, last.value if last else 0))
        return channels


class Fa3AnalogOutput(_Fa3Analog):
    """The behaviour of the FA3 module with eight analog outputs: FA3-AT1M8Y."""

    def __init__(self, profile: Profile, image: RegisterImage) -> None:
        super().__init__(profile, image)
        self._standing = [0] * len(CHANNELS)
        """The channels' outputs, as digital values, for the time in which no master is
        connected."""
        self._forget_settings()

    def restarted(self) -> None:
        super().restarted()
        self._standing = [0] * len(CHANNELS)
        self._forget_settings()

    def linked(self, is_linked: bool) -> None:
        if not is_linked:
            self._standing = [
                value if holds else 0
                for value, holds in zip(self._converted(), self._holds, strict=True)
            ]
        super().linked(is_linked)

    def outputs(self) -> tuple[DeviceOutput, ...]:
        values = self._converted() if self.is_linked else self._standing
        return tuple(
            DeviceOutput(f"CH{channel + 1}", value, self._text(channel, value))
            for channel, value in enumerate(values)
        )

    def _forget_settings(self) -> None:
        self._converts = self._holds = self._warns = [False] * len(CHANNELS)
        self._warning_limits = [(0, 0)] * len(CHANNELS)

    def take_settings(self, now_ns: int) -> None:
        self._converts = self._enabled(_CONVERSION)
        self._holds = [nibble == _HOLD for nibble in self._nibbles()]
        self._warns = self._enabled(_WARNING)
        limits = self._numbers(_WARNING_LIMITS)
        self._warning_limits = list(zip(limits[1::2], limits[::2], strict=True))

    def _converted(self) -> list[int]:
        enabled = self.image.get(Table.COILS, _FLAGS.start, len(_FLAGS))
        values = self._numbers(_VALUES)
        return [
            value if converts and enable else 0
            for value, converts, enable in zip(values, self._converts, enabled, strict=True)
        ]

    def _text(self, channel: int, value: int) -> str:
        lower, upper = self._warning_limits[channel]
        # At first both limits are 0; without this check nearly every value would be outside them.
        warns = self._warns[channel] and lower < upper and not lower <= value <= upper
        volts = f"{1 + 4 * value / FULL_SCALE:.3f} V"
        return f"{volts}, beyond its warning limits {lower}..{upper}" if warns else volts


def _processing(setting: _InputSetting, value: int, now_ns: int) -> Processing:
    if setting.average:
        match setting.process:
            case 1:  # time average
                return PeriodMean(setting.average * _MS, value, now_ns)
            case 2:  # count average
                return PeriodMean(setting.average * CONVERSION_NS, value, now_ns)
            case 3:  # moving average
                return MovingMean(setting.average * CONVERSION_NS, value, now_ns)
    return Sampling()


def _signed(word: int) -> int:
    return word - 0x10000 if word & 0x8000 else word
