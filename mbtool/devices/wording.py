"""Describes a transaction in one line, in the words of its device's manual."""

# Examples of such lines, each with the addresses and the named values of a transaction:
#
#     0102H A/D conversion enable/disable setting: CH1 CH2 CH6 CH8 enabled
#     X10..X17 A/D conversion completion flag: CH1 CH2 CH6 CH8 on
#     RWr2..RWr9 digital operation value: CH1 12000, CH2 4000, ...
#     00F2H, write 0102H A/D conversion enable/disable setting: CH1 enabled; read ...        (17H)
#     HR400001..400002                                                  (no names in the manual)
#
# Points whose names differ only in the first word (CH1 digital value, CH2 digital value) are
# described in one phrase. Points whose name is their reference (X0, X1) come in one phrase at the
# end. A phrase about several bits names those that are 1.

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction, PointValue


def describe(transaction: NamedTransaction) -> str:
    """Describe the addresses of a transaction and its named values in one line; empty if it has
    neither.
    """
    if transaction.write_address is None:
        return _describe(transaction.reference or "", transaction.points)
    read = "; ".join(describe_points(transaction.read_points))
    written = describe_written(transaction)
    return f"{written}; read {read}" if read else written


def describe_written(transaction: NamedTransaction) -> str:
    """Describe the addresses of a transaction and the named values that it writes, in one line."""
    return _describe(transaction.reference or "", transaction.written_points)


def _describe(reference: str, points: Sequence[PointValue]) -> str:
    phrases = "; ".join(describe_points(points))
    if not phrases:
        return reference
    if phrases.startswith(f"{reference} "):
        return phrases  # The name has the reference already: T5 current value.
    joint = ": " if all(point.name == point.reference for point in points) else " "
    return f"{reference}{joint}{phrases}" if reference else phrases


def describe_points(points: Sequence[PointValue]) -> list[str]:
    """Describe points in phrases such as `digital value: CH1 12000, CH2 4000`.

    Points whose names differ only in the first word share a phrase. The phrases are in the order of
    the points; points without a name come last.
    """
    series: dict[str, list[tuple[str, PointValue]]] = {}
    for point in points:
        label = point.name.partition(" ")[0]
        series.setdefault(subject_of(point), []).append((label, point))
    unnamed = series.pop("", None)
    phrases = []
    for subject, members in series.items():
        if len(members) == 1:
            phrases.append(f"{members[0][1].name}: {members[0][1].text}")
        else:
            phrases.append(f"{subject}: {_values(members)}")
    if unnamed is not None:
        phrases.append(_values(unnamed, beside_others=bool(series)))
    return phrases


def subject_of(point: PointValue) -> str:
    """Return a point's name without its first word; the whole name if it has only one word.

    It is empty if the name is the point's reference.
    """
    if point.name == point.reference:
        return ""
    return point.name.partition(" ")[2] or point.name


def _values(members: Sequence[tuple[str, PointValue]], *, beside_others: bool = False) -> str:
    if not all(_is_bit(point) for _, point in members):
        return ", ".join(f"{label} {point.text}" for label, point in members)
    if len(members) == 1:
        label, point = members[0]
        return f"{label} {point.text}" if beside_others else point.text
    ones = [label for label, point in members if point.value == 1]
    if not ones:
        return f"{'others' if beside_others else 'all'} {members[0][1].text}"
    text = next(point.text for _, point in members if point.value == 1)
    return f"{' '.join(ones)} {text}"


def _is_bit(point: PointValue) -> bool:
    return point.value in (0, 1) and not point.text[:1].isdigit()
