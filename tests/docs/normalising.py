"""What may differ between a page and a run of its commands, and which are not run: two lists."""

# Output that does not depend on times (of a capture, of a profile) is equal as it stands; the list
# counts only where it is not.

from __future__ import annotations

import re

DIFFERENCES = (
    (
        "remark on reads that came late",
        r"(?m)^\w+: a silence (?:of t3\.5 or longer|longer than t1\.5) inside .*\n",
        "",
    ),
    ("time of day", r"\b\d\d:\d\d:\d\d(?:\.\d+)?", "TIME"),
    ("date", r"\b20\d\d-\d\d-\d\d\b", "DATE"),
    ("latency in the table's column, in ms", r"(?<=TIME) +[\d.]+(?= )", " MS"),
    ("seconds since, or until", r"(?m)^( +\d+) +\d+\.\d{3} +[\d.]+(?= )", r"\1 TIME MS"),
    ("duration", r"\b\d+(?:\.\d+)? ?(ns|us|ms|s|min|h)\b", r"N \1"),
    ("rate, load, share", r"\b\d+(?:\.\d+)?(?= ?(?:%|/s|bytes|KiB|MiB|KB|MB))", "N"),
    ("decimal number", r"(?<![\d.])\d+\.\d+(?![\d.])", "N.N"),
    ("port that the system chose", r"(?<=127\.0\.0\.1:)\d{5}\b", "PORT"),
    ("pseudo-terminal", r"/dev/pts/\d+", "/dev/pts/N"),
    ("run of spaces, as wide as its numbers", r"[ \t]+", " "),
    ("line of a table, as wide as its columns", r"[─━-]{3,}", "---"),
    ("space at a line's end", r"(?m) +$", ""),
)
"""What, how it is found, and what stands for it."""

NOT_RUN = (
    "installs into the reader's environment",
    "needs an adapter or a device",
    "needs other machines",
    "needs packages from a registry",
    "needs the extra mbtool[plot]",
    "needs jq, which is no dependency",
    "takes minutes",
)
"""The reasons for which a block of commands is not run. Those of mbtool in it are parsed."""


def normalised(text: str) -> str:
    """A text without what differs from run to run."""
    for _, pattern, stands_for in DIFFERENCES:
        text = re.sub(pattern, stands_for, text)
    return text


def agrees(expected: str, actual: str) -> bool:
    """True if an output is the one of a page; a line `...` of the page stands for any lines."""
    if expected == actual:
        return True
    pattern = re.escape(normalised(expected)).replace(re.escape("...\n"), r"(?:.*\n)*?")
    return re.fullmatch(pattern, normalised(actual)) is not None
