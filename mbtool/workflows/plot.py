"""Collects values over time from captures, to be plotted or listed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import InputError, UsageError, WireEvent
from mbtool.devices.spans import names_table
from mbtool.values.chosen_values import ChosenValues, NamedAddresses
from mbtool.values.guessed_series import with_guesses
from mbtool.values.values import SeriesKey, Values
from mbtool.workflows.shared.questions import Wording
from mbtool.workflows.shared.read_all import Watch, unwatched
from mbtool.workflows.shared.reading import Reading, ReadingOptions

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction, Profile
    from mbtool.values.value_series import ValueSeries
    from mbtool.workflows.shared.time_window import TimeWindow


class PlottedValues(NamedTuple):
    """Values over time, and the times (UTC ns) at which the first transaction begins and the last
    one ends.
    """

    series: dict[SeriesKey, ValueSeries]
    begin_ns: int
    end_ns: int
    left_out: int
    """The number of points and registers that were left out, because there were too many."""


class PlotRun:
    """Reads files once, and collects the values of points and registers over time."""

    def __init__(
        self,
        files: Sequence[str],
        options: ReadingOptions,
        texts: Sequence[str],
        window: TimeWindow,
        wanted: Callable[[NamedTransaction], bool],
        *,
        guesses: bool = True,
    ) -> None:
        """Prepare to read. With `guesses`, registers that are surely one number are one series.

        `texts` are the names or addresses of the points and registers to collect; if it is empty,
        all are collected. Only transactions in `window` are used, and only those for which `wanted`
        returns True.
        """
        self.reading = Reading(files, options)
        self._texts, self._window, self._wanted = texts, window, wanted
        self._guesses = guesses
        self.error: InputError | None = None
        """The error of a file that could be read only in part; None if all files were read to their
        ends."""

    def take(self, watch: Watch = unwatched) -> PlottedValues:
        """Read the files as far as they can be read, and return the values.

        `watch` passes on the records as they are read, and may show the progress. Raises UsageError
        if one of `texts` names no value in the files, InputError if an error comes before the first
        transaction.
        """
        chosen = ChosenValues(self._texts, _parse_addresses, self.reading.profile_for)
        values = chosen if self._texts else Values()
        begin_ns = end_ns = 0
        try:
            for one in self._window.begun(watch(self.reading, self.reading.records())):
                if isinstance(one, WireEvent) or one not in self._window or not self._wanted(one):
                    continue
                begin_ns = min(begin_ns or one.start_ns, one.start_ns)
                end_ns = max(end_ns, one.response_ns or one.start_ns)
                values.add(one)
        except InputError as error:
            if not begin_ns:
                raise
            self.error = error
        missing = [text for text in self._texts if text not in chosen.found]
        if missing and begin_ns:
            raise UsageError(_why_missing(missing[0], self._texts))
        left_out = values.left_out if isinstance(values, Values) else len(values.left_out)
        asked = values.requests if isinstance(values, Values) else ()
        series = with_guesses(values.series, asked) if self._guesses else values.series
        return PlottedValues(series, begin_ns, end_ns, left_out)


def _why_missing(text: str, texts: Sequence[str]) -> str:
    """Return the message about `text`, one of the user's `texts`, that names no value."""
    behind = [*texts[texts.index(text) + 1 :], ""][0]
    if (
        _parse_addresses(text, None) is None
        and _parse_addresses(f"{text} {behind}", None) is not None
    ):
        return f"{text!r} names no value; put its address into the same quotes: '{text} {behind}'"
    if names_table(text):
        try:
            Wording(None).addresses(text)
        except UsageError as error:
            return str(error)
    return (
        f"{text!r}: no value of that name or address; without a REFERENCE, mbtool plot lists what "
        "there is"
    )


def _parse_addresses(text: str, profile: Profile | None) -> NamedAddresses | None:
    try:
        return NamedAddresses(*Wording(profile).addresses(text))
    except UsageError:
        return None
