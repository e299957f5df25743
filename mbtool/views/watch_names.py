"""Shortens the names of points in cells of live tables, so that their values have room."""

# A cell with points reads `digital operation value: CH1 12000, CH2 4000`, or, where they have just
# changed, `CH1 digital operation value 12000`. CH1 is called the label here, the rest the subject.
# Labels are kept, as they tell the values of one row apart. Subjects lose letters, then words, and
# the subject that all values of a row share is left out: the detail of the row shows the full name.

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING

from mbtool.devices import describe_points, subject_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from mbtool.devices import NamedTransaction, PointValue
    from mbtool.views.watch_columns import Spans

_LONGEST_WORD = 5
"""Words with more letters than this are shortened to their first three and a full stop."""
_WORDS = 2
"""The number of words that are kept of a subject if there is no room for more."""
_LONG = re.compile(rf"[^\W\d_]{{{_LONGEST_WORD + 1},}}")


def short_name(name: str, width: int) -> str:
    """Return a name of at most `width` characters if shorter words suffice; else a longer one."""
    return name if len(name) <= width else _abbreviated(name)


def with_short_names(spans: Spans, one: NamedTransaction, width: int) -> Spans:
    """Return spans with the names of a transaction's points as short as `width` characters demand.

    A span is `name value` of one point, or has the text of `describe_points` in it.
    """
    subjects = Counter(subject_of(point) for point in one.points)
    del subjects[""]  # A name that is the reference stays.
    shorten: Callable[[str], str]
    shorter = spans
    for shorten in (_abbreviated, _left_out if len(subjects) == 1 else _beginning):
        if sum(len(text) for text, _ in shorter) <= width:
            break
        short = {point.name: _short(point, subjects, shorten) for point in one.points}
        shorter = _replaced(spans, one, short, shorten)
    return shorter


def _short(point: PointValue, subjects: Mapping[str, int], shorten: Callable[[str], str]) -> str:
    """Return the short name of a point; `subjects` says how many points share a subject."""
    subject = subject_of(point)
    if not subject:
        return point.name
    if subjects[subject] == 1:
        return shorten(point.name)
    return f"{point.name.partition(' ')[0]} {shorten(subject)}".rstrip()


def _replaced(
    spans: Spans, one: NamedTransaction, short: Mapping[str, str], shorten: Callable[[str], str]
) -> Spans:
    """Return spans with short names: those of single points in `short`, by name, and of series."""
    lone = {
        f"{point.name} {point.text}": f"{short[point.name]} {point.text}".lstrip()
        for point in one.points
    }
    texts = {text for text, _ in spans}
    others = [point for point in one.points if f"{point.name} {point.text}" not in texts]
    described = {
        "; ".join(describe_points(points)): "; ".join(_phrases(points, short, shorten))
        for points in (others, one.read_points, one.written_points)
        if points
    }
    result = []
    for text, style in spans:
        new = lone.get(text, text)
        for whole, shorter in described.items() if new == text else ():
            new = new.replace(whole, shorter)
        result.append((new, style))
    return result


def _phrases(
    points: Sequence[PointValue], short: Mapping[str, str], shorten: Callable[[str], str]
) -> list[str]:
    """Return the phrases of `describe_points` with short names; the values stay as they are."""
    series: dict[str, list[str]] = {}
    for point in points:
        series.setdefault(subject_of(point), []).append(point.name)
    series.pop("", None)
    phrases = describe_points(points)
    for at, (subject, names) in enumerate(series.items()):
        is_lone = len(names) == 1
        values = phrases[at].removeprefix(f"{names[0] if is_lone else subject}: ")
        name = short[names[0]] if is_lone else shorten(subject)
        # Nothing stands between label and value where the subject is left out.
        colon = ":" if shorten(subject) else ""
        phrases[at] = f"{name}{colon} {values}".lstrip()
    return phrases


def _abbreviated(name: str) -> str:
    """Shorten the long words: `dig. ope. value`."""
    return _LONG.sub(lambda word: f"{word[0][:3]}.", name)


def _beginning(name: str) -> str:
    name = _abbreviated(name)
    words = name.split(" ")
    return name if len(words) <= _WORDS else f"{' '.join(words[:_WORDS])}.."


def _left_out(_: str) -> str:
    return ""
