"""Shortens the names of points in cells of live tables, so that their values have room."""

# The text of a cell with points is `digital operation value: CH1 12000, CH2 4000`, or, if the
# values have just changed, `CH1 digital operation value 12000`. Here CH1 is called the label, the
# rest of the name the subject. Labels are kept, because they distinguish the values of one row.
# Subjects lose their ends, the longest subjects first. If even LEAST characters of each are too
# many, the subject that all values of a row share is left out: the detail of the row shows the full
# name.

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

from mbtool.devices import NamedTransaction, PointValue, describe_points, subject_of
from mbtool.views.watch_columns import CUT, Spans

LEAST = 10
"""A name is cut to no fewer characters than this."""


def cut_name(name: str, width: int) -> str:
    """Return a name of at most `width` characters; a longer one loses its end."""
    return name if len(name) <= width else f"{name[: width - len(CUT)].rstrip()}{CUT}"


def with_short_names(spans: Spans, one: NamedTransaction, width: int) -> Spans:
    """Return spans with the names of a transaction's points as short as `width` characters demand.

    A span is `name value` of one point, or has the text of `describe_points` in it.
    """
    excess = sum(len(text) for text, _ in spans) - width
    if excess <= 0 or not one.points:
        return spans
    subjects = Counter(subject_of(point) for point in one.points)
    del subjects[""]  # An empty subject: the name is the reference.
    if not subjects:
        return spans
    shown = _NamesInCell(spans, one, subjects)
    longest = _longest(shown.names(), excess)
    if longest < LEAST and len(subjects) == 1:
        return shown.shortened(lambda _: "")
    return shown.shortened(lambda name: cut_name(name, max(longest, LEAST)))


def _longest(names: Sequence[str], excess: int) -> int:
    """Return the number of characters to which all longer names are cut, to save `excess` in all.

    Return 0 if even that is not enough.
    """
    lengths = sorted(map(len, names))
    limit = lengths[-1] if lengths else 0
    while limit and excess > 0:
        limit -= 1
        excess -= sum(length > limit for length in lengths)
    return limit


class _NamesInCell:
    """The points of a transaction as the spans of a cell show them."""

    def __init__(self, spans: Spans, one: NamedTransaction, subjects: Mapping[str, int]) -> None:
        """`subjects` says how many points share a subject."""
        self._spans, self._subjects = spans, subjects
        texts = {text for text, _ in spans}
        self._alone = [point for point in one.points if f"{point.name} {point.text}" in texts]
        others = [point for point in one.points if f"{point.name} {point.text}" not in texts]
        self._described: dict[str, Sequence[PointValue]] = {}
        """The points of each text of `describe_points` that the spans have."""
        for points in (others, one.read_points, one.written_points):
            whole = "; ".join(describe_points(points))
            if whole and any(whole in text for text in texts):
                self._described.setdefault(whole, points)

    def names(self) -> list[str]:
        """Return the names that can be shortened, each as often as it is shown."""
        names = [self._name(point) for point in self._alone]
        for points in self._described.values():
            names += {subject_of(point): self._name(point) for point in points}.values()
        return names

    def shortened(self, shorten: Callable[[str], str]) -> Spans:
        """Return the spans with shorter names."""
        alone = {
            f"{point.name} {point.text}": (
                f"{self._short_name(point, shorten)} {point.text}".lstrip()
            )
            for point in self._alone
        }
        described = {
            whole: "; ".join(self._phrases(points, shorten))
            for whole, points in self._described.items()
        }
        result = []
        for text, style in self._spans:
            new = alone.get(text, text)
            for whole, shorter in described.items() if new == text else ():
                new = new.replace(whole, shorter)
            result.append((new, style))
        return result

    def _name(self, point: PointValue) -> str:
        """Return the part of a point's name that can be shortened: the subject, or a name that has
        no label.
        """
        subject = subject_of(point)
        return point.name if self._subjects.get(subject) == 1 else subject

    def _short_name(self, point: PointValue, shorten: Callable[[str], str]) -> str:
        subject = subject_of(point)
        if not subject:
            return point.name
        if self._subjects[subject] == 1:
            return shorten(point.name)
        return f"{point.name.partition(' ')[0]} {shorten(subject)}".rstrip()

    def _phrases(self, points: Sequence[PointValue], shorten: Callable[[str], str]) -> list[str]:
        """Return the phrases of `describe_points` with short names; the values stay as they are."""
        series: dict[str, list[PointValue]] = {}
        for point in points:
            series.setdefault(subject_of(point), []).append(point)
        series.pop("", None)
        phrases = describe_points(points)
        for at, (subject, members) in enumerate(series.items()):
            is_alone = len(members) == 1
            values = phrases[at].removeprefix(f"{members[0].name if is_alone else subject}: ")
            name = self._short_name(members[0], shorten) if is_alone else shorten(subject)
            # If the subject is shortened to an empty text, there is no colon either.
            colon = ":" if shorten(subject) else ""
            phrases[at] = f"{name}{colon} {values}".lstrip()
        return phrases
