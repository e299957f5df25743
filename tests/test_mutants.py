"""The command that changes the code, and what it takes for a change."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.mutants import (
    ROOT,
    Copy,
    Fate,
    Result,
    all_mutations,
    drawn,
    equivalents,
    killed_percent,
    report,
    room_tests,
    tried,
)
from tests.mutations import Mutation, enum_members, mutations_of

if TYPE_CHECKING:
    from pathlib import Path

ENUMS = {"Direction": ["REQUEST", "RESPONSE", "UNKNOWN"]}


def changed(source: str) -> set[str]:
    """The source with each mutation."""
    raw = source.encode()
    return {each.applied_to(raw).decode() for each in mutations_of("mbtool/core/x.py", raw, ENUMS)}


@pytest.mark.parametrize(
    ("source", "mutants"),
    [
        ("a < b", {"a <= b"}),
        ("a < b == c", {"a <= b == c", "a < b != c"}),
        ("(a) is not (b)", {"(a) is (b)"}),
        ("a not in b", {"a in b"}),
        ("x = 7", {"x = 8", "x = 6"}),
        ("x = 0x0f", {"x = 16", "x = 14"}),
        ("x = 0", {"x = 1"}),
        ("x = 60_000", {"x = 120000", "x = 30000"}),
        ("x = True", {"x = False"}),
        ("a and b and c", {"a or b and c", "a and b or c"}),
        ("not a", {"a"}),
        ("if a:\n    b", {"if not (a):\n    b"}),
        ("x = a if b else c", {"x = a if not (b) else c"}),
        ("x = (a) + (b)", {"x = (a) - (b)"}),
        ("x = a // b", {"x = a * b"}),
        ("x = a & b", {"x = a | b"}),
        ("x = Direction.UNKNOWN", {"x = Direction.REQUEST"}),
        ("f()", {"pass"}),
        ("a.b = c", {"pass"}),
        ("a += b", {"pass"}),
        ("def f():\n    return a", {"def f():\n    return None"}),
        ("def f():\n    return False", {"def f():\n    return True"}),
        ("def f():\n    return 0", {"def f():\n    return None", "def f():\n    return 1"}),
        ("def f():\n    raise A", {"def f():\n    pass"}),
        ("x = 'é' < b", {"x = 'é' <= b"}),
    ],
)
def test_mutations(source: str, mutants: set[str]) -> None:
    assert changed(source) == mutants


@pytest.mark.parametrize(
    "source",
    [
        '"""Docstring: 1 < 2."""',
        "x: Literal[7]",
        "def f(a: Literal[7]) -> Literal[8]: ...",
        "if TYPE_CHECKING:\n    f()",
        '__all__ = ["a", "b"]',
        "assert a < b",
        "@dataclass(frozen=True)\nclass A: ...",
        "class A(Struct, frozen=True): ...",
        "Item = Adu | Skipped | bytes",
        "x = f'{1}'",
        "def f():\n    return None",
    ],
)
def test_what_is_left_alone(source: str) -> None:
    assert changed(source) == set()


def test_the_place_and_the_texts_of_a_mutation_are_told() -> None:
    (one,) = mutations_of("mbtool/core/x.py", b"a\nb = c and d  # why\n")
    assert (one.line, one.key) == (2, ("mbtool/core/x.py", "b = c and d  # why", "and", "or"))
    assert str(one) == "mbtool/core/x.py:2: 'and' -> 'or' in: b = c and d  # why"


def test_every_mutation_is_python_and_each_differs_and_a_seed_draws_the_same_again() -> None:
    mutations = all_mutations(["framing"])
    assert drawn(mutations, "a", 20) == drawn(mutations, "a", 20) != drawn(mutations, "b", 20)
    assert len(drawn(mutations, "a", 10**6)) == len(mutations)
    assert len(set(mutations)) == len(mutations) > 100
    for one in mutations:
        source = (ROOT / one.path).read_bytes()
        compile(one.applied_to(source), one.path, "exec")
        assert one.applied_to(source) != source


def test_the_members_of_enums_are_found() -> None:
    assert enum_members(ROOT.glob("mbtool/core/*.py"))["Direction"] == ENUMS["Direction"]


def test_the_tests_of_a_module_come_before_those_of_its_room() -> None:
    first, *others = room_tests("mbtool/framing/mbap.py")
    assert first == "tests/framing/test_mbap.py"
    assert "tests/framing/test_skips.py" in others
    assert others[-1] == "tests/properties/test_streams.py"


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A small project with one module and one test."""
    for path, text in {
        "mbtool/__init__.py": "",
        "mbtool/core/__init__.py": "",
        "mbtool/core/bigger.py": "def bigger(a, b):\n    c = 0\n    return a if a > b else b\n",
        "tests/__init__.py": "",
        "tests/core/__init__.py": "",
        "tests/core/test_bigger.py": (
            "from mbtool.core.bigger import bigger\n\n\n"
            "def test_bigger():\n    assert (bigger(1, 2), bigger(2, 1)) == (2, 2)\n"
        ),
    }.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    return tmp_path


def test_mutations_are_tried_in_copies_and_the_survivors_are_those_that_no_test_notices(
    tree: Path,
) -> None:
    path = tree / "mbtool/core/bigger.py"
    whole = path.read_bytes()
    mutations = mutations_of("mbtool/core/bigger.py", whole)
    fates = {one.mutation.after: one.fate for one in tried(mutations, 2, tree)}
    # At a == b both are the same, so >= is equivalent; and nobody reads c.
    assert fates == {"1": Fate.SURVIVED, ">=": Fate.SURVIVED, "return None": Fate.KILLED}
    assert path.read_bytes() == whole


def test_a_mutant_that_does_not_end_is_killed(tree: Path, tmp_path: Path) -> None:
    forever = "def bigger(a, b):\n    while True:\n        pass\n"
    (tree / "mbtool/core/bigger.py").write_text(forever)
    copy = Copy(tmp_path / "copy", tree)
    assert not copy.tests_pass(["tests/core/test_bigger.py"], 0.5)


def test_equivalent_mutations_are_listed_with_their_reason(tmp_path: Path) -> None:
    path = tmp_path / "listed.toml"
    assert equivalents(path) == {}
    path.write_text(
        '[[mutation]]\nfile = "a.py"\nline = "a > b"\nbefore = ">"\nafter = ">="\nreason = "same"\n'
    )
    assert equivalents(path) == {("a.py", "a > b", ">", ">="): "same"}
    assert all(equivalents().values())


def test_the_share_is_told_for_each_room_without_what_is_equivalent() -> None:
    def one(room: str, fate: Fate) -> Result:
        return Result(Mutation(f"mbtool/{room}/x.py", 0, 1, "b", "a", 1, "a"), fate)

    results = [one("core", Fate.KILLED)] * 3
    results += [one("core", Fate.SURVIVED), one("query", Fate.EQUIVALENT)]
    assert killed_percent(results) == 75.0
    assert [line.split() for line in report(results).splitlines()] == [
        ["room", "killed", "survived", "equivalent", "share"],
        ["core", "3", "1", "0", "75.0", "%"],
        ["query", "0", "0", "1", "-"],
        ["all", "3", "1", "1", "75.0", "%"],
    ]
