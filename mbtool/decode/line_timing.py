"""Chooses the silences t1.5 and t3.5 of a serial line."""

# The first source that gives a silence wins:
#
#     1  the options --t1-5 and --t3-5
#     2  the link spec
#     3  the profiles of the devices that can be on the line
#     4  the standard, from baud rate and character format
#
# A profile counts for a line if it was assigned without a host address and supports the line's mode
# (RTU or ASCII). If several profiles count, the shortest t3.5 is taken, because the device with
# this t3.5 may pause only that long between frames. The t1.5 is then the longest one that does not
# exceed this t3.5.

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

from mbtool.core import LinkSpec, SerialFormat, SerialLink, Silence, UsageError
from mbtool.devices import Assignments
from mbtool.modbus import Transport


@dataclass(frozen=True, slots=True)
class LineTiming:
    """Fills in t1.5 and t3.5 of serial lines, from options (`t1_5`, `t3_5`) and device profiles."""

    assignments: Assignments = field(default_factory=Assignments)
    t1_5: Silence | None = None
    t3_5: Silence | None = None
    response_timeout: Silence | None = None
    """The time after which the master repeats a request, from an option; None without the option:
    the decoder then learns the time from the line."""

    @property
    def is_given(self) -> bool:
        """True if an option gives a silence or the response timeout."""
        return any((self.t1_5, self.t3_5, self.response_timeout))

    def given(self, links: Sequence[LinkSpec]) -> list[LinkSpec]:
        """Return the links with the silences that the options give; a log then records them.

        Raises UsageError if silences are given and no link is a serial line, or if they contradict
        each other.
        """
        if self.is_given and not any(isinstance(link, SerialLink) for link in links):
            raise UsageError(
                "--t1-5, --t3-5 and --response-timeout are for serial lines; "
                "none of the links is one"
            )
        return [
            self._with_given_silences(link) if isinstance(link, SerialLink) else link
            for link in links
        ]

    def format_of(self, line: SerialLink) -> SerialFormat:
        """Return a line's settings with t1.5 and t3.5 filled in.

        Raises UsageError if the silences contradict each other.
        """
        format_ = self._with_given_silences(line).format
        if format_.t3_5 is None:
            t3_5 = _shortest(self._silences_of_profiles(line, "t3_5"), format_)
            if t3_5 is not None and (
                format_.t1_5 is None or _silence_ns(t3_5, format_) >= format_.t1_5_ns
            ):
                format_ = replace(format_, t3_5=t3_5)
        if format_.t1_5 is None:
            fitting = [
                each
                for each in self._silences_of_profiles(line, "t1_5")
                if _silence_ns(each, format_) <= format_.t3_5_ns
            ]
            format_ = replace(format_, t1_5=_longest(fitting, format_))
        return format_

    def response_timeout_ns(self, line: SerialFormat) -> int | None:
        """The response timeout of the master, in ns; None if it was not given."""
        return None if self.response_timeout is None else _silence_ns(self.response_timeout, line)

    def _with_given_silences(self, line: SerialLink) -> SerialLink:
        return replace(line, format=line.format.with_silences(self.t1_5, self.t3_5))

    def _silences_of_profiles(self, line: SerialLink, key: str) -> Iterable[Silence]:
        transport = Transport.ASCII if line.ascii else Transport.RTU
        for each in self.assignments:
            if each.who.host is None and transport in each.profile.transports:
                text = getattr(each.profile.timing, key)
                if text is not None:
                    yield Silence.parse(text)


def _silence_ns(silence: Silence, format_: SerialFormat) -> int:
    return silence.ns(format_.baud, format_.character_bits)


def _shortest(silences: Iterable[Silence], format_: SerialFormat) -> Silence | None:
    return min(silences, key=lambda each: _silence_ns(each, format_), default=None)


def _longest(silences: Iterable[Silence], format_: SerialFormat) -> Silence | None:
    return max(silences, key=lambda each: _silence_ns(each, format_), default=None)
