"""What stands in the cells of a register list: numbers, addresses, factors, rights, tables."""

# Each function reads one cell, or answers None where it holds nothing of that kind. They know the
# common ways of writing, with a decimal comma, too; what a whole column means by them is decided in
# addresses.py and rows.py.

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from mbtool.devices.model import Access
from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.tables import Table

NOTHING = frozenset(
    ("", "-", "--", "---", "\u2013", "\u2014", "n/a", "n.a.", "na", "none", "/", "null", "nil", "*")
)
"""Cells that say that there is nothing, in lower case."""

MAX_DIGITS = 8

_NUMBER = re.compile(r"[+-]?(?:\d{1,30}(?:[.,]\d{1,30})?|[.,]\d{1,30})(?:[eE][+-]?\d{1,3})?")


def is_nothing(text: str) -> bool:
    return text.strip().lower() in NOTHING


def parse_number(text: str) -> float | None:
    """`0.1`, `0,1`, `1e-3`, `-5`, `0x0F`; an int where it is whole. Commas are decimal commas."""
    text = text.strip().replace("\u2212", "-").replace("\u00a0", "")
    if re.fullmatch(r"0[xX][0-9A-Fa-f]{1,8}", text):
        return int(text, 16)
    if not _NUMBER.fullmatch(text):
        return None
    number = float(text.replace(",", "."))
    if not math.isfinite(number):
        return None
    return int(number) if number.is_integer() and abs(number) < 1e15 else number


@dataclass(frozen=True, slots=True)
class Factor:
    """What a cell says about scaling."""

    number: float
    divides: bool = False
    """The cell says to divide by it."""
    multiplies: bool = False
    """The cell says to multiply by it; where neither, the column must tell."""


_TEN_TO = re.compile(r"10\s*(?:\^|\*\*|[eE])\s*(?P<power>[+-]?\d{1,2})")


def parse_factor(text: str) -> Factor | None:
    """`0.1`, `/10`, `1/10`, `x0.1`, `*10`, `10^-1`, `10`; None for 0 and what is no number."""
    text = text.strip().replace("\u2212", "-").replace("\u00d7", "x").replace("\u00f7", "/")
    match = re.fullmatch(r"(?P<sign>1\s*/|[/:]|[xX*])?\s*(?P<number>.+?)", text)
    if match is None:
        return None
    power = _TEN_TO.fullmatch(match["number"])
    number = 10.0 ** int(power["power"]) if power else parse_number(match["number"])
    if not number:
        return None
    sign = (match["sign"] or "").strip()
    is_divided = sign.endswith("/") or sign == ":"
    return Factor(number, divides=is_divided, multiplies=bool(sign) and not is_divided)


def parse_unit(text: str) -> tuple[float | None, str | None]:
    """A unit, and the factor that stands before it in `0.1 V`."""
    text = " ".join(text.split())
    if is_nothing(text):
        return None, None
    match = re.fullmatch(r"(?:[xX*]\s*)?(?P<number>[\d.,]+)\s*(?P<unit>[^\d\s.,/*^-].*)", text)
    if match is None:
        return None, text
    number = parse_number(match["number"])
    return (number, match["unit"]) if number else (None, text)


_READ = frozenset(("r", "ro", "read", "readonly", "input", "lesen", "nurlesen", "lecture", "rd"))
_WRITE = frozenset(("w", "wo", "write", "writeonly", "wr", "schreiben", "ecriture"))


def parse_access(text: str) -> Access | None:
    """`R`, `RO`, `R/W`, `read/write`, `W`, `read only`; also `yes` and `no` where W is asked."""
    words = [word for word in re.split(r"[^a-z]+", text.lower()) if word]
    joined = "".join(words)
    if joined in _READ:
        return Access.READ
    if joined in _WRITE:
        return Access.WRITE
    is_both = joined in ("rw", "wr") or re.fullmatch(r"r(?:ead)?(?:and|und)?w(?:rite)?", joined)
    # R/WC, Schneider: written by a command.
    if is_both or joined in ("rwc", "readwritable", "lesenschreiben", "readwriteonly", "output"):
        return Access.READ_WRITE
    return None


_TABLE_WORDS = (
    (r"discrete|digital ?inputs?|input ?(?:status|coils?|bits?|contacts?)|\bdi\b|contacts?",
     Table.DISCRETE_INPUTS),
    (r"coils?|digital ?outputs?|output ?(?:bits?|coils?)|\bdo\b|\bco\b|\bc\b", Table.COILS),
    (r"input ?reg(?:ister)?s?|analog(?:ue)? ?inputs?|\bir\b|\bai\b|^inputs?$",
     Table.INPUT_REGISTERS),
    (r"hold(?:ing)?(?: ?reg(?:ister)?s?)?|analog(?:ue)? ?outputs?|\bhr\b|\bao\b|^reg(?:ister)?s?$",
     Table.HOLDING_REGISTERS),
)  # fmt: skip
_DIGIT_TABLES = {
    "0": Table.COILS,
    "1": Table.DISCRETE_INPUTS,
    "3": Table.INPUT_REGISTERS,
    "4": Table.HOLDING_REGISTERS,
}


@dataclass(frozen=True, slots=True)
class CellAccess:
    """What a cell says about where a value stands and by which functions it is reached."""

    table: Table
    functions: tuple[int, ...] = ()


def parse_table(text: str) -> CellAccess | None:
    """`Holding register`, `4x`, `HR`, `03`, `FC03/06/16`, `3,16`, `0x04`, `coil`."""
    lowered = " ".join(re.sub(r"[_\-]", " ", text.lower()).split())
    digit = re.fullmatch(r"([0134])\s?x+", lowered)
    if digit:
        return CellAccess(_DIGIT_TABLES[digit[1]])
    numbers = _functions(lowered)
    if numbers is not None:
        return numbers
    for pattern, table in _TABLE_WORDS:
        if re.search(pattern, lowered):
            return CellAccess(table)
    return None


_FUNCTION_WORDS = re.compile(
    r"\b(?:fc|fn|func(?:tion)?s?|fct|code|modbus|f|and|und|or)\b\.?|(?<![a-z])fc?(?=\d)"
)


def _functions(text: str) -> CellAccess | None:
    plain = _FUNCTION_WORDS.sub(" ", text)
    tokens = [token for token in re.split(r"[\s,;/+&|()=:]+", plain) if token]
    codes = []
    for token in tokens:
        if not re.fullmatch(r"0x[0-9a-f]{1,2}|[0-9a-f]{1,2}h|\d{1,2}", token):
            return None
        is_hex = token.startswith("0x") or token.endswith("h")
        codes.append(int(token.removesuffix("h"), 16) if is_hex else int(token))
    # 10 beside 03 and 06 is 10H: no function 10 reaches a register.
    codes = [16 if code == 10 else code for code in codes]
    known = [FUNCTIONS.get(code) for code in codes]
    tables = {one.table if one is not None else None for one in known}
    table = tables.pop() if len(tables) == 1 else None
    return CellAccess(table, tuple(dict.fromkeys(codes))) if table is not None else None


_PAIR = re.compile(
    r"\s*(?P<value>0[xX][0-9A-Fa-f]{1,4}|-?\d{1,10})\s*(?:[=:]|->|\u2192|\s-\s|-(?=\s*[^\d\s]))\s*"
    r"(?P<text>.+?)\s*"
)


def parse_texts(text: str) -> dict[int, str] | None:
    """`0=stopped, 1=running`, `0: off; 1: on`, one to a line; None where it is prose."""
    splits = [[part for part in text.split(sign) if part.strip()] for sign in ("\n", ";", "|", ",")]
    # A text may have a comma in it, so the sign that gives the most pairs is the one between them.
    for parts in sorted(splits, key=len, reverse=True):
        pairs = [_PAIR.fullmatch(part) for part in parts]
        texts = {int(pair["value"], 0): pair["text"] for pair in pairs if pair is not None}
        if texts and len(texts) == len(parts):
            return texts
    return None


_SPAN = re.compile(
    r"(?P<low>[+-]?[\d.,]+?)\s*(?:\.{2,3}|[-~\u2013\u2026]|to|bis)\s*(?P<high>[+-]?[\d.,]+)"
)


def parse_range(text: str) -> tuple[float, float] | None:
    """`0..100`, `0 - 100`, `-50 to 150`, `0~65535`."""
    match = _SPAN.fullmatch(text.strip())
    if match is None:
        return None
    low, high = parse_number(match["low"]), parse_number(match["high"])
    return None if low is None or high is None or low > high else (low, high)
