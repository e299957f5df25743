"""Writes the page about many captures: a line for each file, the worst first."""

# It is HTML without a script. Texts of captures are escaped; the page's Content-Security-Policy
# permits nothing but its own style.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

from mbtool.core.moments import counted, percent
from mbtool.ledger.inventory_rows import iso_time
from mbtool.views.report.page import asset, csp_hash
from mbtool.views.tables import printable

if TYPE_CHECKING:
    from mbtool.views.report.contents import ReportWords

UNREAD = "unread"
"""The level of a file that could not be read at all."""
LEVELS = {UNREAD: "not read", "bad": "bad", "doubt": "doubt", "well": "well"}
"""The levels of a file, the worst first, and how the page calls them."""
_CLASSES = {UNREAD: "error", "bad": "error", "doubt": "warning", "well": "soft"}


@dataclass(frozen=True, slots=True, kw_only=True)
class FileVerdict:
    """What is wrong in one file."""

    file: str
    level: str
    """`unread`, or the level of a judgement: `bad`, `doubt` or `well`."""
    sentence: str
    """The worst trouble, or the statement that there is no trouble, or the reason why the file
    could not be read."""
    troubles: int = 0
    transactions: int = 0
    failed: int = 0
    """How many requests got no answer, a late one, a damaged one or an exception."""
    begin_ns: int | None = None
    """The first time in the file, in UTC ns; None if it has none."""

    @property
    def failed_share(self) -> float:
        return self.failed / self.transactions if self.transactions else 0.0


def worst_first(files: Sequence[FileVerdict]) -> list[FileVerdict]:
    """Sort files by level, number of troubles and share of failed requests, the worst first."""
    levels = list(LEVELS)
    return sorted(
        files,
        key=lambda one: (levels.index(one.level), -one.troubles, -one.failed_share, one.file),
    )


def folder_page(
    folder: str, files: Sequence[FileVerdict], words: ReportWords, version: str, made_ns: int
) -> str:
    """Return the page about the files of `folder` as HTML."""
    style = asset("page.css")
    policy = f"default-src 'none'; style-src {csp_hash(style)}; base-uri 'none'; form-action 'none'"
    title = words.title or f"mbtool report: {folder}"
    numbers = {level: sum(one.level == level for one in files) for level in LEVELS}
    told = [f"{number:,} {LEVELS[level]}" for level, number in numbers.items() if number]
    notes = "".join(f"<p class=words>{_text(line)}</p>" for line in words.note.splitlines() if line)
    where = f" · only {_text(words.where)}" if words.where else ""
    worst = next((level for level, number in numbers.items() if number), "doubt")
    rows = "".join(map(_row, worst_first(files)))
    heads = ("file", "verdict", "worst trouble", "more", "transactions", "failed", "begins (UTC)")
    kinds = ("name", "", "wide", "right", "right", "right", "")
    head = "".join(
        f'<th scope="col" class="{kind}">{name}</th>'
        for name, kind in zip(heads, kinds, strict=True)
    )
    made = iso_time(made_ns)[:19].replace("T", " ")
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{_text(title)}</title>
<style>{style}</style>
</head>
<body>
<header><p class="brand alone">mbtool <span>report</span></p></header>
<main>
<section id="verdict" class="{"bad" if worst == UNREAD else worst}">
<p class="overline"><strong>{_text(words.title)}</strong> {_text(folder)}{where}</p>
<h1>{counted(len(files), "file", ",")}: {", ".join(told)}</h1>
{notes}</section>
<section>
<h2>Files, the worst first</h2>
<div class="scroll" role="region" tabindex="0" aria-label="Files">
<table class="cards" role="table">
<thead role="rowgroup"><tr role="row">{head}</tr></thead>
<tbody role="rowgroup">{rows}</tbody>
</table></div>
<p class="soft">All of one file: mbtool report FILE -o FILE.html</p>
</section>
</main>
<footer>Made by mbtool {version} on {made} UTC. docs/report.md explains the page.</footer>
</body>
</html>
"""


def _row(one: FileVerdict) -> str:
    begin = "" if one.begin_ns is None else iso_time(one.begin_ns)[:19].replace("T", " ")
    failed = f"{one.failed:,} ({percent(one.failed_share)})" if one.failed else ""
    cells = (
        ("name", "", one.file),
        (f"nowrap {_CLASSES[one.level]}", "verdict", LEVELS[one.level]),
        ("wide bare", "", one.sentence),
        ("right", "more", f"{one.troubles - 1:,}" if one.troubles > 1 else ""),
        ("right", "transactions", f"{one.transactions:,}"),
        ("right", "failed", failed),
        ("nowrap", "begins", begin),
    )
    return "".join((
        '<tr role="row">',
        *(f'<td role="cell" class="{kind}" data-label="{label}">{_text(text)}</td>'
          for kind, label, text in cells),
        "</tr>\n",
    ))  # fmt: skip


def _text(text: str) -> str:
    return escape(printable(text))
