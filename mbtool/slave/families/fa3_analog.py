"""The FA3 modules FA3-AT1M8X and FA3-AT1M8Y: settings, conversion and outputs of eight channels."""

# Source: the modules' manual, chapter 10.5. Settings take effect with the "initial data setting":
# the master sets Y9, the module reads the settings and sets X9, the master clears Y9, and the
# module clears X9. Conversion starts with the first initial data setting. Before it, and after a
# remote reset, the values and flags that a master reads are 0 (assumed), and so is every output
# (assumed).
#
# FA3-AT1M8X. RWr2 to RWr9 of the image hold the inputs as digital values from 0 to 16000. A master
# reads them averaged and scaled. X10 to X17 are set once a channel's first value is complete; until
# then, after an initial data setting, RWr keeps the previous value. A disabled channel reads 0.
# Assumed: averaging process 3 is a moving average; the time of a conversion (conversion.py); a time
# or count of 0 means sampling.
#
# FA3-AT1M8Y. A channel puts out its digital value if D/A conversion (0102H) and its output (Y10 to
# Y17) are enabled, else 0. While no master is connected, a channel set to HOLD keeps its last
# output and one set to CLEAR gives 0. The digital values 0 to 16000 stand for 1 to 5 V (chapter
# 10.5: 3600 is 1.9 V). The manual does not say what the module does with a value outside the
# warning limits: here the output follows the value, and the text shown to people says that it is
# outside them.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.modbus.tables import Table
from mbtool.slave.device.behaviour import DeviceOutput
from mbtool.slave.families.conversion import (
    CONVERSION_NS,
    FULL_SCALE,
    MovingMean,
    PeriodMean,
    Processing,
    Sampling,
    scaled,
)
from mbtool.slave.families.fa3 import Fa3, overlap

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.devices import Profile
    from mbtool.slave.device.image import RegisterImage

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

    def _words(self, span: range) -> list[int]:
        return self.image.get(Table.HOLDING_REGISTERS, span.start, len(span))

    def _numbers(self, span: range) -> list[int]:
        return [_signed(word) for word in self._words(span)]

    def _enabled(self, address: int) -> list[bool]:
        """Return True for each channel whose bit in the register at `address` is 0 (enabled)."""
        (word,) = self.image.get(Table.HOLDING_REGISTERS, address)
        return [not word >> channel & 1 for channel in CHANNELS]

    def _nibbles(self) -> list[int]:
        low, high = self._words(_BY_CHANNEL)
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
        processes, averages = self._nibbles(), self._words(_AVERAGING)
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
