"""Shortens the names of points in cells of live tables, so that their values have room."""

# A cell with points reads `digital operation value: CH1 12000, CH2 4000`, or, where they have just
# changed, `CH1 digital operation value 12000`. CH1 is called the label here, the rest the subject.
# Labels are kept, as they tell the values of one row apart. Subjects lose letters, then words, and
# the subject that all values of a row share is left out: the detail of the row shows the full name.

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from mbtool.devices import subject_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mbtool.devices import PointValue
    from mbtool.views.watch_columns import Spans

_LONGEST_WORD = 5
"""Words with more letters than this are shortened to their first three and a full stop."""
_WORDS = 2
"""The number of words that are kept of a subject if there is no room for more."""
_LONG = re.compile(rf"[^\W\d_]{{{_LONGEST_WORD + 1},}}")


def short_name(name: str, width: int) -> str:
    """Return a name of at most `width` characters if shorter words suffice; else a longer one."""
    return name if len(name) <= width else _abbreviated(name)


def with_short_names(spans: Spans, points: Sequence[PointValue], width: int) -> Spans:
    """Return spans with the names of `points` shortened as far as `width` characters demand."""
    subjects = _subjects(points)
    shorten: Callable[[str], str]
    for shorten in (_abbreviated, _left_out if len(subjects) == 1 else _beginning):
        if sum(len(text) for text, _ in spans) <= width:
            break
        spans = [(_replaced(text, subjects, shorten), style) for text, style in spans]
        subjects = [shorten(one) for one in subjects]
    return spans


def _subjects(points: Sequence[PointValue]) -> list[str]:
    """Return the subjects that several points share, and whole names of others; longest first."""
    members: dict[str, list[str]] = {}
    for point in points:
        members.setdefault(subject_of(point), []).append(point.name)
    members.pop("", None)
    found = (names[0] if len(names) == 1 else subject for subject, names in members.items())
    return sorted(found, key=len, reverse=True)


def _replaced(text: str, subjects: Sequence[str], shorten: Callable[[str], str]) -> str:
    for subject in subjects:
        short = shorten(subject)
        behind = "" if short else ":? "  # Nothing stands between label and value then.
        text = re.sub(f"{re.escape(subject)}{behind}", short.replace("\\", r"\\"), text)
    return text


def _abbreviated(name: str) -> str:
    """Shorten the long words: `dig. ope. value`."""
    return _LONG.sub(lambda word: f"{word[0][:3]}.", name)


def _beginning(name: str) -> str:
    words = name.split(" ")
    return name if len(words) <= _WORDS else f"{' '.join(words[:_WORDS])}.."


def _left_out(_: str) -> str:
    return ""
