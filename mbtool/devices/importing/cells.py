"""Reads the cells of a register list: numbers, factors, rights, tables, texts and ranges."""

# Each function reads the text of one cell as one kind of value, and returns None if the text is no
# such value. It knows the usual spellings in English, most of those in German and French, and
# decimal commas.

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from mbtool.devices.importing.columns import fold
from mbtool.devices.model import Access
from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.tables import DIGIT_TABLES, Table

NOTHING = frozenset(
    ("", "-", "--", "---", "\u2013", "\u2014", "n/a", "n.a.", "na", "none", "/", "null", "nil", "*")
)
"""The texts, in lower case, with which a list says that a cell has no value."""

MAX_DIGITS = 8
REGISTER_BITS = range(16)

_NUMBER = re.compile(r"[+-]?(?:\d{1,30}(?:[.,]\d{1,30})?|[.,]\d{1,30})(?:[eE][+-]?\d{1,3})?")


def is_nothing(text: str) -> bool:
    return text.strip().lower() in NOTHING


def parse_number(text: str) -> float | None:
    """Read a number: `0.1`, `0,1`, `1e-3`, `-5`, `0x0F`. A comma is a decimal comma.

    Returns an int for a whole number, and None if the text is no number.
    """
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
    """A scale factor as a cell of a register list writes it."""

    number: float
    divides: bool | None = None
    """True if the factor divides the number in the register, False if it multiplies it, None if
    the cell does not say which."""


_TEN_TO = re.compile(r"10\s*(?:\^|\*\*|[eE])\s*(?P<power>[+-]?\d{1,2})")


def parse_factor(text: str) -> Factor | None:
    """Read a scale factor: `0.1`, `/10`, `1/10`, `x0.1`, `*10`, `10^-1`, `10`.

    Returns None for 0, and for a text that is no number.
    """
    text = text.strip().replace("\u2212", "-").replace("\u00d7", "x").replace("\u00f7", "/")
    match = re.fullmatch(r"(?P<sign>1\s*/|[/:]|[xX*])?\s*(?P<number>.+?)", text)
    if match is None:
        return None
    power = _TEN_TO.fullmatch(match["number"])
    number = 10.0 ** int(power["power"]) if power else parse_number(match["number"])
    if not number or not math.isfinite(1 / number):
        return None
    sign = match["sign"]
    return Factor(number, None if sign is None else sign not in "xX*")


def parse_unit(text: str) -> tuple[float | None, str | None]:
    """Read a unit of measure. Returns the factor before it, 0.1 in `0.1 V`, and the unit itself.

    Each of the two is None if it is missing.
    """
    text = " ".join(text.split())
    if is_nothing(text):
        return None, None
    match = re.fullmatch(r"(?:[xX*]\s*)?(?P<number>[\d.,]+)\s*(?P<unit>[^\d\s.,/*^-].*)", text)
    number = parse_number(match["number"]) if match else None
    return (number, match["unit"]) if match and number else (None, text)


_ACCESS = {
    **dict.fromkeys(("r", "ro", "read", "readonly", "input", "lesen", "nurlesen", "lecture", "rd"),
                    Access.READ),
    **dict.fromkeys(("w", "wo", "write", "writeonly", "schreiben", "ecriture"), Access.WRITE),
    # "rwc" is R/WC in Schneider's lists: a register that only a command can write.
    **dict.fromkeys(("rw", "wr", "rwc", "readwritable", "lesenschreiben", "readwriteonly", "output",
                     "readwrite", "readandwrite", "randw", "rundw"), Access.READ_WRITE),
}  # fmt: skip


def parse_access(text: str) -> Access | None:
    """Read the access that a master has: `R`, `RO`, `R/W`, `read/write`, `W`, `lesen`.

    Returns None if the text is something else.
    """
    return _ACCESS.get(re.sub(r"[^a-z]+", "", fold(text)))


_TABLE_WORDS = (
    (r"dis[ck]rete|digitale? ?(?:inputs?|eing)|input ?(?:status|coils?|bits?|contacts?)|^di$"
     r"|^contacts?$|eingangs?(?:bits?|status)", Table.DISCRETE_INPUTS),
    (r"coils?|digitale? ?(?:outputs?|ausg)|output ?(?:bits?|coils?)|^do$|^co?$|spulen?\b|bobines?"
     r"|ausgangs?(?:bits?|status)", Table.COILS),
    (r"input ?reg(?:ister)?s?|analog(?:ue?|e)? ?(?:inputs?|eing)|^ir$|^ai$|^inputs?$"
     r"|eingangs ?reg|registres? d entree", Table.INPUT_REGISTERS),
    (r"hold(?:ing)?(?: ?reg(?:ister)?s?)?|analog(?:ue?|e)? ?(?:outputs?|ausg)|^hr$|^ao$"
     r"|^reg(?:ister)?s?$|halte ?reg|ausgangs ?reg|registres? de maintien",
     Table.HOLDING_REGISTERS),
)  # fmt: skip
_CODE = r"(?:0x[0-9a-f]{1,2}|[0-9a-f]{1,2}h|\d{1,2})(?![0-9a-z])"
_FUNCTION = (
    r"(?:\b(?:fct?|fn|fkt|func(?:tion)?s?|funktion(?:en)?)(?: ?s?codes?)?\b\.?"
    r"|\bfc(?=\d)|^f(?=\d))"
)
_AND = r"(?:\s*(?:[,;/+&|]|\band\b|\bund\b|\bor\b|\boder\b|\bet\b)\s*|\s+)"
_CODES = rf"{_CODE}(?:{_AND}(?:{_FUNCTION}\s*)?{_CODE})*"
_NAMED_CODES = re.compile(rf"{_FUNCTION}\s*[:=#]?\s*\(?(?P<codes>{_CODES})")
_ONLY_CODES = re.compile(rf"\(?(?P<codes>{_CODES})\)?")


@dataclass(frozen=True, slots=True)
class TableCell:
    """The table that a cell names, and the function codes in the cell if it names the table by
    codes.
    """

    table: Table | None
    """The table; None if the function codes belong to several tables, or to none of the four."""
    functions: tuple[int, ...] = ()
    """The function codes in the cell. Empty if it has none, or one that belongs to no table."""


def parse_table(text: str) -> TableCell | None:
    """Read a table's name: `Holding register`, `4x`, `HR`, `FC03/06`, `Eingangsregister (FC 04)`.

    Returns None if the text names no table. If it has function codes and words, the codes decide.
    """
    lowered = " ".join(re.sub(r"[_\-]", " ", text.lower()).split())
    if digit := re.fullmatch(r"([0134])\s?x+", lowered):
        return TableCell(DIGIT_TABLES[digit[1]])
    if codes := _ONLY_CODES.fullmatch(lowered) or _NAMED_CODES.search(lowered):
        return _table_of(re.findall(_CODE, codes["codes"]))
    words = fold(lowered)
    return next((TableCell(table) for one, table in _TABLE_WORDS if re.search(one, words)), None)


def _table_of(codes: list[str]) -> TableCell:
    numbers = [
        int(code.removesuffix("h"), 16)
        if code.startswith("0x") or code.endswith("h")
        else int(code)
        for code in codes
    ]
    # A list that says 10 means 10H, which writes registers; decimal 10 (0AH) is no function that
    # reads or writes a table.
    numbers = [16 if number == 10 else number for number in numbers]
    known = {FUNCTIONS[number].table if number in FUNCTIONS else None for number in numbers}
    functions = () if None in known else tuple(dict.fromkeys(numbers))
    return TableCell(known.pop() if len(known) == 1 else None, functions)


_VALUE = r"(?P<number>0[xX][0-9A-Fa-f]{1,4}|-?\d{1,10})"
_BIT = r"(?:bit|b)[ .]?(?P<number>\d{1,2})"
_IS = r"\s*(?:[=:]|->|\u2192|\s-\s|-(?=\s*[^\d\s]))\s*(?P<text>.+?)"


def parse_texts(text: str) -> dict[int, str] | None:
    """Read numbers with their texts: `0=stopped, 1=running`, `0: off 1: on`, or one in each line.

    Returns None if the text is prose.
    """
    return _parse_pairs(text, _VALUE, r"-?\d+\s*[=:]")


def parse_bits(text: str) -> dict[int, str] | None:
    """Read bits with their names: `Bit0: too hot, Bit1: low oil`, `Bit 3 = Alarm`.

    Returns None if the text is something else, or a bit is not 0 to 15.
    """
    bits = _parse_pairs(text, _BIT, r"[Bb](?:it)?[ .]?\d+\s*[=:]")
    return bits if bits is not None and max(bits) in REGISTER_BITS else None


def _parse_pairs(text: str, number: str, next_one: str) -> dict[int, str] | None:
    """Read pairs of a number and a text, such as `0=off, 1=on`; None if the text is no such list.

    `number` is the regular expression of the number in a pair. A line end or one of `;|,` separates
    pairs; where there is none, the regular expression `next_one` finds the beginning of a further
    pair.
    """
    pair = re.compile(rf"\s*{number}{_IS}\s*", re.IGNORECASE)
    splits = [text.split(sign) for sign in ("\n", ";", "|", ",")]
    splits.append(re.split(rf"\s+(?={next_one})", text))
    # A pair's text may itself contain a comma or another separator. Try the separators in the order
    # of the number of parts that they give, the greatest first.
    for parts in sorted(splits, key=len, reverse=True):
        pairs = [pair.fullmatch(part.rstrip(" ,;|")) for part in parts if part.strip()]
        found = {_parse_whole(one["number"]): one["text"] for one in pairs if one is not None}
        if found and len(found) == len(pairs):
            return found
    return None


def _parse_whole(digits: str) -> int:
    return int(digits, 16 if digits[:2].lower() == "0x" else 10)


_SPAN = re.compile(
    r"(?P<low>[+-]?[\d.,]+?)\s*(?:\.{2,3}|[-~\u2013\u2026]|to|bis)\s*(?P<high>[+-]?[\d.,]+)"
)


def parse_range(text: str) -> tuple[float, float] | None:
    """Read a range: `0..100`, `0 - 100`, `-50 to 150`, `0~65535`.

    Returns its least and its greatest number; None if the text is no range.
    """
    match = _SPAN.fullmatch(text.strip())
    if match is None:
        return None
    low, high = parse_number(match["low"]), parse_number(match["high"])
    return None if low is None or high is None or low > high else (low, high)
