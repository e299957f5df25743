"""Makes the lines above and below the table of `mbtool watch`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import PurePath
from typing import TYPE_CHECKING

from mbtool.cli.keys import clock_text
from mbtool.core.moments import counted
from mbtool.views.tables import printable
from mbtool.views.watch_columns import Spans, cut_spans
from mbtool.workflows.watch import FileFeed, WatchFeed

if TYPE_CHECKING:
    from mbtool.cli.watching.watch_views import WatchView
    from mbtool.watching.watched import Watched

_KEYS = (
    ("?", "keys"),
    ("q", "quit"),
    ("1-6", "view"),
    ("/", "filter"),
    ("\\", "off/on"),
    ("space", "freeze"),
    ("enter", "detail"),
    ("f", "find"),
    ("m", "mark"),
    ("s", "save"),
    ("o", "sort"),
    ("c", "columns"),
    ("x", "format"),
)
_FILE_KEYS = (
    ("p", "play"),
    ("+-", "speed"),
    ("<>", "ends"),
    (".", "step"),
)
_LONG_PLACE = 4
"""The text of a place is long if it takes more than this part (one in 4) of the line's
characters."""


class Brevity(Enum):
    """The lengths of the line above the table, from the longest to the shortest."""

    NONE = 0
    """The whole line."""
    SOME = 1
    """The line without the number of events."""
    MOST = 2
    """The line also without the number of transactions, if nothing is marked."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScreenState:
    """The state of the screen that the lines above and below the table show."""

    feed: WatchFeed
    place: str
    """The name of the links or files that are watched."""
    recording: str | None
    """The path of the log that is written; None if none is."""
    is_frozen: bool
    where: str
    """The text of the filter; empty if there is none."""
    filter_is_on: bool


def tabs_text(
    views: Sequence[WatchView], shown: int, notes: Sequence[str] = (), width: int = 0
) -> Spans:
    """Return the names of the views with their keys; that of index `shown` is in reverse.

    `notes` has a text on this view in several lengths: the first one that has room behind the names
    is shown at the end of the line of `width` characters.
    """
    spans: Spans = []
    for at, view in enumerate(views):
        title = f"{at + 1} {view.name} "
        spans.append((title, "bold reverse" if at == shown else ""))
    room = width - sum(len(text) for text, _ in spans)
    note = next((one for one in notes if len(one) <= room), None)
    return spans if note is None else [*spans, (f"{note:>{room}}", "yellow")]


def status_text(state: ScreenState, width: int) -> Spans:
    """Return the line above the table, cut to `width` characters.

    It says what is watched, how many transactions and events were heard, and the filter. Under a
    filter, where that has no room, the number of events is left out and the words are fewer; in the
    end the filter is cut, unless the name of what is watched is long.
    """
    place: Spans = [(f"  {printable(state.place)}", "")]
    room = width - len(place[0][0])
    for brevity in Brevity if state.where else (Brevity.NONE,):
        spans = _status_spans(state, brevity)
        if sum(len(text) for text, _ in spans) <= room:
            return cut_spans([*spans, *place], width)
    if state.where and len(place[0][0]) <= width // _LONG_PLACE:
        return [*cut_spans(spans, room), *place]
    return cut_spans([*spans, *place], width)


def _status_spans(state: ScreenState, brevity: Brevity) -> Spans:
    spans: Spans = []
    if state.is_frozen:
        spans.append((" FROZEN ", "bold reverse"))
        spans.append((" ", ""))
    if state.recording is not None:
        spans.append((f"rec {printable(PurePath(state.recording).name)}  ", "bold red"))
    if isinstance(state.feed, FileFeed):
        spans.append((f"{_position(state.feed)}  ", "bold"))
    return [*spans, *_count_spans(state, brevity)]


def _count_spans(state: ScreenState, brevity: Brevity) -> Spans:
    """Return how much was heard and how much is marked, then the filter and how much passes it."""
    watched = state.feed.watched
    heard = counted(watched.whole.account.transactions, "transaction", ",")
    if brevity is Brevity.NONE:
        heard = f"{heard}, {counted(watched.whole.account.events.total(), 'event', ',')}"
    counts: Spans = [(heard, "")]
    if watched.marked:
        counts.append((f", {len(watched.marked)} marked", "green"))
    if not state.where:
        return counts
    if not state.filter_is_on or watched.filtered is None:
        return [*counts, (f"  filter off: {state.where}", "dim")]
    passing = (f"{_passing(watched, brevity)}: {state.where}", "bold cyan")
    if brevity is Brevity.MOST and not watched.unfiltered and not watched.marked:
        return [passing]
    return [*counts, ("  ", ""), passing]


def _passing(watched: Watched, brevity: Brevity) -> str:
    """Return how many transactions pass the filter, and of how many if it has not seen all.

    With the greatest brevity also of how many if it has, as their number stands nowhere else then.
    """
    passed = 0 if watched.filtered is None else watched.filtered.account.transactions
    word = "passes" if passed == 1 else "pass"
    if watched.unfiltered:
        seen = watched.whole.account.transactions - watched.unfiltered
        return f"{passed:,} of {'the ' * (brevity is Brevity.NONE)}last {seen:,} {word}"
    if brevity is Brevity.MOST:
        return f"{passed:,} of {watched.whole.account.transactions:,} {word}"
    return f"{passed:,} {word}"


def keys_line(width: int, *, is_of_files: bool) -> Spans:
    """Return the keys with their meanings, as many as fit `width` characters.

    If files are watched, the keys to play them are among the first.
    """
    keys = (*_KEYS[:3], *_FILE_KEYS, *_KEYS[3:]) if is_of_files else _KEYS
    spans: Spans = []
    used = 0
    for key, word in keys:
        if used + len(key) + len(word) + 3 > width:
            break
        spans += [(key, "bold"), (f" {word}  ", "")]
        used += len(key) + len(word) + 3
    return spans


def _position(feed: FileFeed) -> str:
    if not feed.is_read:
        return "reading"
    if feed.is_behind:
        return f"reading to {clock_text(feed.position_ns)}"
    length_ns = feed.last_ns - feed.first_ns
    place = f"{clock_text(feed.position_ns)} of {clock_text(length_ns)}"
    if feed.is_playing:
        return f"playing {place} x{feed.speed:g}"
    return place if feed.position_ns >= length_ns else f"paused {place} x{feed.speed:g}"
