"""Says of what was heard at one line setting how well each way to read it explains it."""

# Bytes that were heard at one setting tell of several, since 7 data bits with parity are 8 without
# (Serial Line V1.02, 2.5.1 and 2.5.2: both characters have 10 bits):
#
#     heard as    may be
#     8E1, 8O1    RTU or ASCII with this format
#     8N1         RTU or ASCII 8N1; ASCII 7E1, 7O1, 7N2 by its eighth bit
#
# The second stop bit is silence to whoever listens, so 8N2 is heard as 8N1.
#
# At a wrong parity many receivers hear the right bytes: all of 8O1 at 8E1, and of 8N1 those that,
# like a 16550, take the missing stop bit for the next start bit. Only the errors that the driver
# marks tell them apart; of parity and framing errors it does not say which.
#
# A setting is judged by the bytes that stand in frames with a correct CRC or LRC, less those that
# arrived damaged. Chance gives a frame of 16 bits of CRC now and then, never several in a row.
#
# Holds what the splitters hold, and counts.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import LineSettings, SerialFormat
from mbtool.modbus.adu import Adu, Skipped
from mbtool.serial_line.ascii import AsciiSplitter
from mbtool.serial_line.rtu import RtuSplitter

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

SURE_FRAMES = 3
SURE_FIT = 0.9
"""What noise between frames and the frame in whose middle one began to listen may cost."""
LIKELY_FRAMES = 2
LIKELY_FIT = 0.3
ENOUGH_WITHOUT_FRAME = 48
"""Bytes after which a setting that explains nothing is given up."""
ENOUGH_WITHOUT_FIT = 200
"""Bytes after which one whose frames are few, or damaged, is."""
ENOUGH = 600
"""Bytes after which more would not change the judgement."""

BAUD_RATES = (19200, 9600, 115200, 38400, 57600, 4800, 2400, 1200)


def settings_to_try() -> list[SerialFormat]:
    """What to listen to, the likelier first."""
    # Even parity before none: without marks, some receivers hear 8E1 as 8N1, and the frames have
    # correct CRCs, but they would have at 8E1 too, and the times would be right.
    usual = [SerialFormat(baud, 8, parity, 1) for baud in BAUD_RATES for parity in "EN"]
    return usual + [SerialFormat(baud, 8, "O", 1) for baud in BAUD_RATES]


def other_parity(line: SerialFormat) -> SerialFormat:
    """What sounds the same where a driver marks no errors, and all wrong where it does."""
    return SerialFormat(line.baud, line.data_bits, "O" if line.parity == "E" else "E", 1)


@dataclass(frozen=True, slots=True)
class SettingsScore:
    """How well settings explain what was heard."""

    settings: LineSettings
    frames: int
    """With a correct CRC or LRC."""
    failures: int
    """Runs of bytes that are no such frame."""
    framed: int
    """Bytes in frames."""
    heard: int
    damaged: int
    """Bytes whose parity or stop bit these settings call wrong."""

    @property
    def fit(self) -> float:
        """The share of the bytes that is explained, 0 to 1."""
        if not self.heard:
            return 0.0
        return self.framed / self.heard * (1 - min(self.damaged / self.heard, 1))

    @property
    def is_sure(self) -> bool:
        return self.frames >= SURE_FRAMES and self.fit >= SURE_FIT

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
    """What was heard at one setting, read in every way that it may be meant."""

    def __init__(self, heard_as: SerialFormat, *, only_ascii: bool = False) -> None:
        self.heard = 0
        self.marked = 0
        """How many bytes the driver called damaged."""
        self._readings = [one for one in _readings(heard_as) if one.is_ascii or not only_ascii]

    def feed(self, data: bytes, damaged: Sequence[int], ts_ns: int) -> None:
        """Take one read, the places of its damaged bytes, and the time of its last byte."""
        self.heard += len(data)
        self.marked += len(damaged)
        for reading in self._readings:
            reading.feed(data, damaged, ts_ns)

    def advance(self, now_ns: int) -> None:
        """Learn that the line was silent from the last byte until now."""
        for reading in self._readings:
            reading.count(reading.splitter.advance(now_ns))

    @property
    def is_decided(self) -> bool:
        """Whether more would not change the judgement."""
        best = self.scores()[0]
        return (
            best.is_sure
            or self.heard >= ENOUGH
            or (self.heard >= ENOUGH_WITHOUT_FRAME and not best.frames)
            or (self.heard >= ENOUGH_WITHOUT_FIT and best.fit < LIKELY_FIT)
        )

    def scores(self) -> list[SettingsScore]:
        """Every way to read it, the best first."""
        scores = [reading.score(self.heard) for reading in self._readings]
        return sorted(scores, key=lambda score: score.rank, reverse=True)


View = tuple[bytes, int]
"""The bytes as settings have them, and how many of them are damaged."""


class _SettingsReading:
    """One way to read what is heard."""

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
            # A frame whose bit 7 is parity is read, but it speaks for 7 data bits.
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
        _SettingsReading(LineSettings(heard_as), _as_heard),
        _SettingsReading(LineSettings(heard_as, ascii=True), _as_heard),
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


def _as_heard(data: bytes, damaged: Sequence[int]) -> View:
    return data, len(damaged)


def _seven_bits(parity: str) -> Callable[[bytes, Sequence[int]], View]:
    """Take the eighth bit for parity; for a first stop bit where there is none."""
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
