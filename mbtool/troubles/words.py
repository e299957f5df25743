"""The one table of words: for each kind of trouble its severity, cause and remedy."""

# docs/troubles.md has a section for each row, with a picture of the bytes or packets; a test
# compares the two. In the templates, {who}, {link}, {count} and {of} are those of the Trouble; the
# other names are its figures. The order of the rows is the order in which troubles are told.

from __future__ import annotations

from dataclasses import dataclass

from mbtool.devices.checking.rules import Severity


@dataclass(frozen=True, slots=True)
class Words:
    """The words of one kind of trouble."""

    code: str
    severity: Severity
    cause: str
    """What is wrong, as a clause; a template."""
    remedy: str
    """What to do, in the imperative; a template."""
    noun: str = "unit"
    """What several troubles of the kind are counted by: unit, link, master."""
    many: str = "have this trouble"
    """What several of them do, for a sentence such as `12 units never answer`."""
    explains: tuple[str, ...] = ()
    """The codes of broken rules that this trouble is the cause of; they are told no second time."""


_E, _W, _N = Severity.ERROR, Severity.WARNING, Severity.NOTE

_ROWS = (
    # Nothing can be read, or only one side.
    Words(
        "LINE-SETTINGS", _E,
        "of {bytes} bytes of {link} {read} can be read{settings}: the settings are wrong",
        "{advice}", "line", "are unreadable", ("RTU-202", "RTU-201", "RTU-204"),
    ),
)  # fmt: skip

WORDS = {row.code: row for row in _ROWS}
