"""Refuses TOML and JSON texts that are too deep or have too long numbers for the parsers."""

# The parser of TOML needs memory that grows with the square of the number of parts of a dotted key:
# 40 kB of a.a.a...=1 take 1.6 GB. Parsers of JSON and of arrays call themselves once for each
# level. No file that mbtool reads has more than five levels. A whole number of more than 308 digits
# is no float, and Python does not write one of more than 4,300.
#
# A text that is neither TOML nor JSON may pass or be refused. The time is proportional to the
# length of the text, as each character is looked at a fixed number of times.

from __future__ import annotations

import re

MAX_DEPTH = 16
"""A text with more levels of brackets, or more parts in a dotted key (a.b.c), is refused."""

MAX_NUMBER = 100
"""A text with a number of more characters than this is refused."""

# In this regular expression only sets of characters are repeated possessively (`*+`), not groups:
# Python before 3.11.5 repeats groups wrongly.
_QUOTED_OR_COMMENT = re.compile(
    r'"""[^\\"]*+(?:(?:\\.|"(?!""))[^\\"]*+)*(?:"""|\\?\Z)'
    r"|'''[^']*+(?:'(?!'')[^']*+)*(?:'''|\Z)"
    r'|"[^"\\\n]*+(?:\\.[^"\\\n]*+)*"?'
    r"|'[^'\n]*+'?"
    r"|\#[^\n]*+",
    re.DOTALL,
)
"""Matches a quoted text (even without closing quotes) or a TOML comment. Brackets inside these do
not count as levels."""
_BETWEEN_KEYS = re.compile(r"[=\n,\[\]{}]")
_BRACKET = re.compile(r"[\[\]{}]")
_LONG_NUMBER = re.compile(rf"(?<![\w.])\d[\w.]{{{MAX_NUMBER},}}")


def why_refused(text: str) -> str | None:
    """Return one line for the user if a TOML or JSON text nests too deep or has a number that is
    too long; None if it does not.
    """
    bare = _QUOTED_OR_COMMENT.sub("_", text)
    depth = 0
    for bracket in _BRACKET.finditer(bare):
        depth += 1 if bracket[0] in "[{" else -1
        if depth > MAX_DEPTH:
            return f"nested too deep: more than {MAX_DEPTH} levels of brackets"
    if any(part.count(".") >= MAX_DEPTH for part in _BETWEEN_KEYS.split(bare)):
        return f"nested too deep: a key of more than {MAX_DEPTH} parts with dots between"
    if number := _LONG_NUMBER.search(bare):
        return f"{number[0][:16]}... is a number of more than {MAX_NUMBER} digits"
    return None
