"""Every register, bit, code and limit in the tables of facts about the manuals is in a profile.

The facts are not part of this project: where they are absent, nothing is tested.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest

from mbtool.devices import load_profile, write_reference
from mbtool.devices.naming import Namer
from mbtool.modbus import FUNCTIONS, Table
from tests.captures import public_folder
from tests.devices.checking.talk import assigned, transaction

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.devices import Profile

HEX, WORD = r"[0-9A-F]{4}", r"[0-9A-F]{4}H?"
_TABLES = {
    "coil": Table.COILS, "input": Table.DISCRETE_INPUTS, "inputs": Table.DISCRETE_INPUTS,
    "coils": Table.COILS, "holding": Table.HOLDING_REGISTERS, "input reg": Table.INPUT_REGISTERS,
    "input regs": Table.INPUT_REGISTERS, "input register": Table.INPUT_REGISTERS,
}  # fmt: skip
FA3 = ("fa3-th1m16xc", "fa3-th1m16y", "fa3-th1m16ye", "fa3-at1m8x", "fa3-at1m8y")

Fact = tuple[str, bool]
"""What a fact is, and if it is in a profile."""


def _rows(text: str) -> list[list[str]]:
    """The cells of the rows of all tables in a text."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip(" *") for cell in line.strip("|").split("|")] for line in lines]


def _has(profile: Profile, function: int, address: int) -> bool:
    """True if the profile lets a master use this address with this function."""
    known = FUNCTIONS[function]
    is_there = known.table is not None and profile.allows(
        known.table, range(address, address + 1), writing=known.writes
    )
    return profile.rule(function) is not None and is_there


def _touch(text: str) -> Iterator[Fact]:
    profile = load_profile("idec-ft1a-touch")
    for cells in _rows(text):
        if len(cells) == 7 and re.match(HEX, cells[2]):
            name, first, last = cells[0].split()[-1], *cells[2].split(" ")[0].split("-")
            ends = [int(one) for one in cells[1].split("-")]
            for code in cells[5].split(", "):
                table = FUNCTIONS[int(code)].table
                for address, number in zip((first, last), ends, strict=True):
                    at = int(address, 16)
                    assert table is not None
                    reference = write_reference(profile, table, at)
                    right = reference == f"{name}{number}" and _has(profile, int(code), at)
                    yield f"{name}{number} with function {code}", right
        limit = re.match(r"1-(\d+) (words|bits)", cells[1]) if len(cells) == 5 else None
        if limit is not None:
            rule = profile.rule(int(cells[0]))
            yield f"limit of {cells[0]}", rule is not None and rule.limit == int(limit[1])
            codes = [int(code) for code in re.findall(r"\b0\d\b", cells[3])]
            documented = profile.documented_exceptions(int(cells[0]))
            yield f"exceptions of {cells[0]}", sorted(documented) == codes


def _smartaxis(text: str) -> Iterator[Fact]:
    profile = load_profile("idec-ft1a-smartaxis")
    for cells in _rows(text):
        ends = re.fullmatch(rf"({HEX})-({HEX})", cells[2]) if len(cells) == 5 else None
        if ends is None:
            continue
        names = re.findall(r"[A-Z]+\d+", cells[3])
        for code in re.findall(r"\d+", cells[4]):
            for at, name in zip((int(end, 16) for end in ends.groups()), names, strict=True):
                table = FUNCTIONS[int(code)].table
                assert table is not None
                right = _has(profile, int(code), at)
                if "(*)" not in cells[3]:  # The facts say that this end contradicts itself.
                    right = right and write_reference(profile, table, at).startswith(name)
                yield f"{name} with function {code}", right
    for codes, limit in re.findall(r"FC([\d/]+) \**1-(\d+) (?:bits|words)", text):
        for code in codes.split("/"):
            rule = profile.rule(int(code))
            yield f"limit of {code}", rule is not None and rule.limit == int(limit)
    yield "codes", sorted(profile.exceptions.documented) == [1, 2, 3]


def _fa3(text: str) -> Iterator[Fact]:
    profiles = [load_profile(name) for name in FA3]
    for cells in _rows(text):
        model = re.fullmatch(r"(00\d\dH)", cells[0])
        if model is not None:
            code = int(cells[0][:4], 16)
            one = next((each for each in profiles if each.model_code == code), None)
            yield f"model {cells[0]}", one is not None and one.name == cells[1].lower()
        timer = re.fullmatch(r"(00F[2-5])H", cells[0])
        if timer is not None:
            low, high = (int(one) for one in cells[2].split("-"))
            for profile in profiles:
                point = next(p for p in profile.points if p.address == int(timer[1], 16))
                figures = point.minimum, point.maximum, point.default
                yield f"{cells[0]} of {profile.name}", figures == (low, high, int(cells[3]))
        if len(cells) == 5 and re.fullmatch(r"[0-9A-F]{2}H?", cells[0]) and cells[0][0] == "4":
            rules = [profile.rule(int(cells[0][:2], 16)) for profile in profiles]
            yield f"function {cells[0]}", all(rule is not None for rule in rules)
        if len(cells) == 5 and cells[0] in ("Input", "Coil", "Input register", "Holding"):
            yield from _fa3_map(profiles, cells)
        if len(cells) == 5 and cells[0].replace("all", "AT1M8X/Y").startswith(("AT1", "TH1")):
            yield from _fa3_signal(cells)
    yield "codes", all(sorted(one.exceptions.documented) == [1, 2, 3] for one in profiles)


def _fa3_map(profiles: list[Profile], cells: list[str]) -> Iterator[Fact]:
    spans = re.findall(rf"(?:(TH|AT) )?({HEX})(?:-({HEX}))?", cells[1])
    for profile in profiles:
        for family, first, last in spans:
            if family and f"-{family.lower()}" not in profile.name:
                continue
            for code in re.findall(r"\b(?:0\d|0F|10)\b", cells[4]) or ["03", "06", "10"]:
                ends = {int(first, 16), int(last or first, 16)}
                if "hole" in cells[2]:
                    right = not any(_has(profile, int(code, 16), at) for at in ends)
                else:
                    right = all(_has(profile, int(code, 16), at) for at in ends)
                yield f"{cells[0]} {first} of {profile.name} with {code}", right


def _fa3_signal(cells: list[str]) -> Iterator[Fact]:
    models = {"AT1M8X/Y": FA3[3:], "TH1M16Y/YE": FA3[1:3], "all": FA3}
    names = models.get(cells[0], (f"fa3-{cells[0].lower()}",))
    place = re.match(r"(input regs?|inputs?|coils?|holding)", cells[2])
    kind = "holding" if place is None else place[1]
    ends = [int(one, 16) for one in re.findall(HEX, cells[2])]
    if place is None:
        ends = [int(one, 16) for one in re.findall(rf"\b({HEX})H", cells[1])]
    for name in names:
        table = _TABLES[kind]
        points = [point for point in load_profile(name).points if point.table is table]
        covered = {address for point in points for address in point.all_addresses}
        for address in ends:
            yield f"{cells[1]} of {name}, {address:04X}", address in covered


def _lt830(text: str) -> Iterator[Fact]:
    profile = load_profile("chino-lt830")
    for code, limits in re.findall(r"(\d\d): (\d+/\d+)", text):
        ascii_limit, limit = (int(one) for one in limits.split("/"))
        rule = profile.rule(int(code))
        right = rule is not None and rule.limit == limit
        right = right and (rule is None or (rule.ascii_limit or limit) == ascii_limit)
        yield f"limit of {code}", right
    for reference, table in ((1, 0), (10001, 1), (30001, 3), (40001, 2)):
        kind = list(Table)[table]
        yield f"class {reference}", write_reference(profile, kind, 0) == str(reference)
    for code in (0x01, 0x02, 0x03, 0x11, 0x12):
        yield f"code {code:02X}", code in profile.exceptions.documented
    names = {point.name: point.address for point in profile.points}
    yield "AT, P, I, D", names == {"AT": 100, "P": 205, "I": 206, "D": 207}
    yield "units 1-99", profile.last_unit == 99


def _wago(text: str) -> Iterator[Fact]:
    profile = load_profile("wago-750")
    begin, end = text.index("* Watchdog:"), text.index("* Examples: FC3")
    addresses = re.findall(r"(?<![0-9A-F])([12]0[0-9A-F]{2})(?![0-9A-FH])", text[begin:end])
    for address in sorted(set(addresses)):
        at = int(address, 16)
        right = any(_has(profile, code, at) for code in (3, 4, 6, 16))
        yield f"register {address}", right
    for first, last, code in (
        ("0000", "00FF", 3), ("0200", "02FF", 3), ("6000", "62FC", 3), ("7000", "72FC", 3),
        ("0000", "00FF", 6), ("0200", "02FF", 6), ("0000", "01FF", 1), ("0200", "03FF", 1),
        ("3000", "35F7", 1), ("4000", "45F7", 1), ("0000", "01FF", 5), ("0200", "03FF", 5),
    ):  # fmt: skip
        for address in (first, last):
            yield f"{address} with {code}", _has(profile, code, int(address, 16))
            assert address in text
    for code in (1, 2, 3, 4, 5, 6, 7, 11, 15, 16, 22, 23):
        yield f"function {code}", profile.rule(code) is not None
    limits = {1: 2000, 2: 2000, 3: 125, 4: 125, 15: 256, 16: 100}
    for code, limit in limits.items():
        rule = profile.rule(code)
        yield f"limit of {code}", rule is not None and rule.limit == limit


@pytest.mark.parametrize(
    ("section", "of", "number"),
    [(1, _touch, 24), (2, _smartaxis, 57), (3, _fa3, 178), (4, _lt830, 16), (5, _wago, 86)],
)
def test_each_fact_of_the_tables_is_in_a_profile(section: int, of: object, number: int) -> None:
    folder = public_folder()
    path = folder.parent / "FACTS.md"
    if not path.is_file():
        pytest.skip("the facts about the manuals are absent")
    text = path.read_text(encoding="utf-8")
    part = re.split(r"^## \d+\. ", text, flags=re.MULTILINE)[section]
    facts: list[Fact] = [*of(part)]  # type: ignore[operator]
    assert [what for what, is_there in facts if not is_there] == []
    assert len(facts) == number


def test_codes_of_the_models_are_read_in_the_words_of_the_manual() -> None:
    for name in FA3:
        profile = load_profile(name)
        answer = f"42 {profile.model_code:04X}"
        one = transaction("42 00", answer, profile=name)
        assert Namer(assigned(name)).name(one).points[0].text == name.upper()
