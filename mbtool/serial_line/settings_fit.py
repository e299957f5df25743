"""Scores how well each line setting and mode (RTU or ASCII) explains the bytes heard on a line."""

# Bytes heard at one setting are evidence for several, since 7 data bits with parity look like 8
# data bits without (Serial Line V1.02, 2.5.1 and 2.5.2: both characters have 10 bits):
#
#     heard as    may be
#     8E1, 8O1    RTU or ASCII with this format
#     8N1         RTU or ASCII 8N1; ASCII 7E1, 7O1, 7N2 by its eighth bit
#
# A listener hears the second stop bit as silence, so 8N2 is heard as 8N1.
#
# A port that is set to a wrong parity often delivers the right bytes. Set to 8E1 it delivers all
# bytes of an 8O1 line. It also delivers the bytes of an 8N1 line if its receiver, like a 16550,
# takes the missing stop bit for the next start bit. Only the errors that the driver marks show the
# wrong setting; the driver does not say whether the parity or the stop bit was wrong.
#
# A setting is scored by the bytes in frames with a correct CRC or LRC, less the bytes marked as
# damaged. A frame with a correct CRC appears by chance now and then, never several in a row.
#
# Memory: the incomplete frames in the splitters (ascii.py, rtu.py), and a few counts.

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mbtool.core import LineSettings, SerialFormat
from mbtool.modbus.adu import Adu, Skipped
from mbtool.serial_line.ascii import AsciiSplitter
from mbtool.serial_line.rtu import RtuSplitter

SURE_FRAMES = 3
"""Settings are sure only if at least this many frames have a correct CRC or LRC."""
SURE_FIT = 0.9
"""Settings are sure only if their fit (0 to 1) is at least this: up to a tenth of the bytes may be
noise, or a first frame whose beginning was not heard."""
LIKELY_FRAMES = 2
LIKELY_FIT = 0.3
"""Settings are likely if at least LIKELY_FRAMES frames have a correct CRC or LRC, and their fit is
at least LIKELY_FIT (0 to 1)."""
ENOUGH_WITHOUT_FRAME = 48
"""Listening at one serial format ends after this many bytes if no setting gives a frame with a
correct CRC or LRC."""
ENOUGH_WITHOUT_FIT = 200
"""Listening at one serial format ends after this many bytes if its best setting has a fit below
LIKELY_FIT."""
ENOUGH_BYTES = 600
"""Listening at one serial format ends after this many bytes: more would hardly change the
scores."""

BAUD_RATES = (19200, 9600, 115200, 38400, 57600, 4800, 2400, 1200)
"""The baud rates that are tried, the most frequent first."""


def settings_to_try() -> list[SerialFormat]:
    """Return the serial formats to listen at, the most usual first."""
    # Even parity before none: some receivers that mark no errors hear 8E1 as 8N1, with correct
    # CRCs. At 8E1 the CRCs are correct too, and so is the character time.
    usual = [SerialFormat(baud, 8, parity, 1) for baud in BAUD_RATES for parity in "EN"]
    return usual + [SerialFormat(baud, 8, "O", 1) for baud in BAUD_RATES]


def other_parity(line: SerialFormat) -> SerialFormat:
    """Return the format with parity odd if it is even, else even, and with one stop bit.

    A port delivers the same bytes with even and odd parity; only the errors that its driver marks
    differ.
    """
    return SerialFormat(line.baud, line.data_bits, "O" if line.parity == "E" else "E", 1)


@dataclass(frozen=True, slots=True)
class SettingsScore:
    """Counts that tell how well a line setting and mode (RTU or ASCII) explain the bytes heard."""

    settings: LineSettings
    frames: int
    """The number of frames with a correct CRC or LRC."""
    failures: int
    """The number of damaged frames plus the number of runs of other skipped bytes."""
    framed: int
    """The number of bytes in frames with a correct CRC or LRC."""
    heard: int
    damaged: int
    """The number of bytes whose parity or stop bit is wrong if these settings are right."""

    @property
    def fit(self) -> float:
        """Return the share of bytes in correct frames, times the share of undamaged bytes.

        The result is from 0 (nothing fits) to 1.
        """
        if not self.heard:
            return 0.0
        return self.framed / self.heard * (1 - min(self.damaged / self.heard, 1))

    @property
    def is_sure(self) -> bool:
        return self.frames >= SURE_FRAMES and self.fit >= SURE_FIT

    @property
    def is_pair(self) -> bool:
        """True if a few right frames explain nearly all bytes: a request and its response."""
        return self.frames >= LIKELY_FRAMES and self.fit >= SURE_FIT

    @property
    def is_likely(self) -> bool:
        return self.frames >= LIKELY_FRAMES and self.fit >= LIKELY_FIT

    @property
    def rank(self) -> tuple[float, int]:
        return self.fit, self.frames

    def __str__(self) -> str:
        check, mode = ("LRC", "ASCII") if self.settings.ascii else ("CRC", "RTU")
        all_frames = self.frames + self.failures
        damaged = f", {self.damaged} of {self.heard} bytes damaged" if self.damaged else ""
        return (
            f"{self.settings.format} {mode}: {self.frames} of {all_frames} frames have a correct "
            f"{check}{damaged}"
        )


class SettingsTrial:
    """The bytes heard at one serial format, scored for each line setting with which they may have
    been sent, as RTU and as ASCII.
    """

    def __init__(self, heard_as: SerialFormat, *, only_ascii: bool = False) -> None:
        self.heard = 0
        self.marked = 0
        """The number of bytes that the driver marked as damaged."""
        self._readings = [one for one in _readings(heard_as) if one.is_ascii or not only_ascii]

    def feed(self, data: bytes, damaged: Sequence[int], ts_ns: int) -> None:
        """Take the bytes of one read; `ts_ns` is the time at which the last byte ended.

        `damaged` are the offsets of the bytes that the driver marked as damaged.
        """
        self.heard += len(data)
        self.marked += len(damaged)
        for reading in self._readings:
            reading.feed(data, damaged, ts_ns)

    def advance(self, now_ns: int) -> None:
        """Note that the line was silent from the last byte until `now_ns`."""
        for reading in self._readings:
            reading.count(reading.splitter.advance(now_ns))

    @property
    def is_decided(self) -> bool:
        """True if enough bytes were heard: more would hardly change which settings are sure."""
        best = self.scores()[0]
        return (
            best.is_sure
            or self.heard >= ENOUGH_BYTES
            or (self.heard >= ENOUGH_WITHOUT_FRAME and not best.frames)
            or (self.heard >= ENOUGH_WITHOUT_FIT and best.fit < LIKELY_FIT)
        )

    def scores(self) -> list[SettingsScore]:
        """Return the score of each setting and mode, the best first."""
        scores = [reading.score(self.heard) for reading in self._readings]
        return sorted(scores, key=lambda score: score.rank, reverse=True)


View = tuple[bytes, int]
"""The bytes heard, in the form in which one setting reads them (with 7 data bits, bit 7 is
cleared), and the number of damaged bytes among them."""


class _SettingsReading:
    """The bytes heard, read with one line setting and mode, and the counts for its score."""

    def __init__(
        self, settings: LineSettings, view: Callable[[bytes, Sequence[int]], View]
    ) -> None:
        self._settings = settings
        self._view = view
        line = settings.format
        self.is_ascii = settings.ascii
        self.splitter = AsciiSplitter(line) if settings.ascii else RtuSplitter(line)
        self._frames = self._failures = self._framed = self._damaged = 0

    def feed(self, data: bytes, damaged: Sequence[int], ts_ns: int) -> None:
        meant, count = self._view(data, damaged)
        self._damaged += count
        self.count(self.splitter.feed(meant, ts_ns))

    def count(self, events: Sequence[Adu | Skipped]) -> None:
        for event in events:
            # An ASCII frame with a parity bit in bit 7 counts only for the settings with 7 data
            # bits.
            as_set = event.raw.isascii() or not self.is_ascii
            is_right = isinstance(event, Adu) and event.checksum is not None and event.checksum.ok
            is_frame = is_right and as_set
            self._frames += is_frame
            self._failures += not is_frame
            self._framed += len(event.raw) if is_frame else 0

    def score(self, heard: int) -> SettingsScore:
        return SettingsScore(
            self._settings, self._frames, self._failures, self._framed, heard, self._damaged
        )


def _readings(heard_as: SerialFormat) -> list[_SettingsReading]:
    baud = heard_as.baud
    readings = [
        _SettingsReading(LineSettings(heard_as), _unchanged_view),
        _SettingsReading(LineSettings(heard_as, ascii=True), _unchanged_view),
    ]
    if heard_as.parity != "N":
        return readings
    seven = (("E", 1), ("O", 1), ("N", 2))
    return readings + [
        _SettingsReading(
            LineSettings(SerialFormat(baud, 7, parity, stop_bits), ascii=True), _seven_bits(parity)
        )
        for parity, stop_bits in seven
    ]


def _unchanged_view(data: bytes, damaged: Sequence[int]) -> View:
    return data, len(damaged)


def _seven_bits(parity: str) -> Callable[[bytes, Sequence[int]], View]:
    """Make the function that reads bytes heard with 8 data bits as characters of 7.

    The eighth bit is then the parity bit or, if `parity` is "N", the first of two stop bits. The
    function takes the bytes and the offsets of those that the driver marked as damaged.
    """
    wrong = bytes(_is_wrong(byte, parity) for byte in range(256))
    low = bytes(byte & 0x7F for byte in range(256))

    def view(data: bytes, damaged: Sequence[int]) -> View:
        marked = frozenset(damaged)
        count = sum(flag or at in marked for at, flag in enumerate(data.translate(wrong)))
        return data.translate(low), count

    return view


def _is_wrong(byte: int, parity: str) -> bool:
    if parity == "N":
        return byte < 0x80
    return byte.bit_count() % 2 != (parity == "O")
