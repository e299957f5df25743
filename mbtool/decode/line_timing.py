"""Which silences hold on a serial line: the user's, a device's, or the standard's."""

# In this order: the options --t1-5 and --t3-5; what the LINK says; the profiles of the devices that
# can be on the line; baud rate and character format. A profile speaks for a line if it was assigned
# without an address and its device speaks the line's mode. Of several the shortest t3.5 counts,
# since each of them may send with it, and the longest t1.5 that is not longer.

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from mbtool.core import LinkSpec, SerialFormat, SerialLink, Silence, UsageError
from mbtool.devices import Assignments
from mbtool.modbus import Transport

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


@dataclass(frozen=True, slots=True)
class LineTiming:
    """What is known of silences beside the lines' own settings."""

    assignments: Assignments = field(default_factory=Assignments)
    t1_5: Silence | None = None
    t3_5: Silence | None = None

    @property
    def is_given(self) -> bool:
        """Whether the user says anything of silences."""
        return self.t1_5 is not None or self.t3_5 is not None

    def given(self, links: Sequence[LinkSpec]) -> list[LinkSpec]:
        """The links as the user wants them, so that a log says it too. Raises UsageError."""
        if self.is_given and not any(isinstance(link, SerialLink) for link in links):
            raise UsageError("--t1-5 and --t3-5 are for serial lines; none of the links is one")
        return [self._given(link) if isinstance(link, SerialLink) else link for link in links]

    def format_of(self, line: SerialLink) -> SerialFormat:
        """A line's settings with the silences that hold on it. Raises UsageError."""
        format_ = self._given(line).format
        if format_.t3_5 is None:
            t3_5 = _shortest(self._of_profiles(line, "t3_5"), format_)
            if t3_5 is not None and (format_.t1_5 is None or _ns(t3_5, format_) >= format_.t1_5_ns):
                format_ = replace(format_, t3_5=t3_5)
        if format_.t1_5 is None:
            fitting = [
                each
                for each in self._of_profiles(line, "t1_5")
                if _ns(each, format_) <= format_.t3_5_ns
            ]
            format_ = replace(format_, t1_5=_longest(fitting, format_))
        return format_

    def _given(self, line: SerialLink) -> SerialLink:
        return replace(line, format=line.format.with_silences(self.t1_5, self.t3_5))

    def _of_profiles(self, line: SerialLink, key: str) -> Iterable[Silence]:
        transport = Transport.ASCII if line.ascii else Transport.RTU
        for each in self.assignments:
            if each.who.host is None and transport in each.profile.transports:
                text = getattr(each.profile.timing, key)
                if text is not None:
                    yield Silence.parse(text)


def _ns(silence: Silence, format_: SerialFormat) -> int:
    return silence.ns(format_.baud, format_.character_bits)


def _shortest(silences: Iterable[Silence], format_: SerialFormat) -> Silence | None:
    return min(silences, key=lambda each: _ns(each, format_), default=None)


def _longest(silences: Iterable[Silence], format_: SerialFormat) -> Silence | None:
    return max(silences, key=lambda each: _ns(each, format_), default=None)
