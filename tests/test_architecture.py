"""What docs/architecture.md promises of the tree, and the docs of the program."""

from __future__ import annotations

import ast
import re
import shlex
import subprocess
import sys
import tomllib
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from typer.main import get_command

from mbtool.cli.main import app

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "mbtool"
TESTS = ROOT / "tests"
MODULES = sorted(path.relative_to(SOURCE) for path in SOURCE.rglob("*.py"))
PACKAGES = sorted(path for path in SOURCE.glob("*/__init__.py") if path.read_text().strip())
PAGES = sorted(
    [
        *ROOT.glob("*.md"),
        *ROOT.glob("docs/**/*.md"),
        *ROOT.glob("captures/*.md"),
        *ROOT.glob(".github/*.md"),
    ]
)

PURE_ROOMS = (
    "core", "modbus", "packets", "framing", "devices", "serial_line", "decode", "query",
    "ledger", "values", "troubles", "replay", "watching",
    "slave/device", "slave/families", "slave/faults",
)  # fmt: skip

ROOMS_OF_TESTS_ONLY = {
    "adversary", "benchmarks", "cases", "certificates", "differential", "docs", "end_to_end",
    "fuzz", "golden", "kills", "power_cuts", "properties", "real_drivers", "soak",
}  # fmt: skip
"""Folders of tests/ that test several rooms at once, or hold what tests read."""

MACHINE_PATH = re.compile(rb"/(?:home|root|tmp|work)/\w")


def test_the_import_contracts_hold() -> None:
    lint_imports = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run(
        [lint_imports, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("room", PURE_ROOMS)
def test_a_pure_room_imports_nothing_that_does_input_or_output(room: str) -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    contract = next(
        one
        for one in settings["tool"]["importlinter"]["contracts"]
        if f"mbtool.{room.replace('/', '.')}" in one.get("source_modules", ())
    )
    forbidden = {*contract["forbidden_modules"], "ssl", "signal", "http", "urllib"}
    for path in SOURCE.glob(f"{room}/**/*.py"):
        roots = {name.partition(".")[0] for name in imports(path)}
        assert not forbidden & roots, path
        assert "import random" not in path.read_text(), "chance comes from a seeded Random"


def test_no_modules_import_each_other_in_a_circle_not_even_for_their_types() -> None:
    names = {
        ".".join(("mbtool", *module.with_suffix("").parts)).removesuffix(".__init__"): module
        for module in MODULES
    }
    needs = {
        name: {one for one in imported_modules(SOURCE / module) if one in names and one != name}
        for name, module in names.items()
    }
    while free := {name for name in needs if not needs[name] & needs.keys()}:
        needs = {name: others for name, others in needs.items() if name not in free}
    assert sorted(needs) == []


FIELD_NUMBERS = {
    "0x16": "modbus/functions.py:MASK_WRITE_REGISTER",
    "0x17": "modbus/functions.py:READ_WRITE_REGISTERS",
    "0x80": "modbus/functions.py:EXCEPTION_BIT",
    "247": "core/limits.py:LAST_UNIT",
    "502": "core/limits.py:MODBUS_PORT",
}
"""Numbers of the field as they are written, and the one constant that each is."""
EQUAL_BY_CHANCE = {"logs/layout.py:PRIVATE", "packets/link_layer.py:_HAS_QOS"}


@pytest.mark.parametrize("number", FIELD_NUMBERS)
def test_a_number_of_the_field_is_one_constant(number: str) -> None:
    found = set()
    for module in MODULES:
        for line in (SOURCE / module).read_text().splitlines():
            if match := re.fullmatch(rf"(\w+) = {number}(?:  #.*)?", line):
                found.add(f"{module}:{match[1]}")
    assert found - EQUAL_BY_CHANCE == {FIELD_NUMBERS[number]}


def test_core_needs_the_standard_library_only() -> None:
    for path in SOURCE.glob("core/*.py"):
        roots = {name.partition(".")[0] for name in imports(path)}
        assert roots <= sys.stdlib_module_names | {"mbtool"}, path


def test_every_room_has_a_folder_of_tests_and_no_folder_is_without_its_room() -> None:
    rooms = {path.name for path in SOURCE.iterdir() if (path / "__init__.py").exists()}
    folders = {path.name for path in TESTS.iterdir() if (path / "__init__.py").exists()}
    assert folders - ROOMS_OF_TESTS_ONLY == rooms


def test_every_room_within_a_room_has_a_folder_of_tests() -> None:
    inner = {path.parent.relative_to(SOURCE) for path in SOURCE.glob("*/*/__init__.py")}
    assert {str(one) for one in inner if not list((TESTS / one).glob("test_*.py"))} == set()


def test_a_class_name_stands_once_in_the_package() -> None:
    places: dict[str, list[str]] = {}
    for module in MODULES:
        for node in ast.walk(ast.parse((SOURCE / module).read_text())):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(str(module))
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: path.parent.name)
def test_a_package_lists_what_it_gives_in_order(package: Path) -> None:
    tree = ast.parse(package.read_text())
    given = {
        alias.asname or alias.name
        for node in tree.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    if not given:
        return
    (names,) = (
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
    )
    assert names == sorted(given, key=lambda name: (kind(name), name))


def commands() -> Iterator[tuple[str, str]]:
    """Each page's command lines of this program, without what a shell makes of their ends."""
    for page in PAGES:
        text = page.read_text()
        lines = re.findall(r"^ {4}(.+)$", text, re.MULTILINE)
        for block in re.findall(r"^```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
            lines += block.splitlines()
        for line in lines:
            command = re.sub(r"^(?:sudo )?(?:\.venv/bin/)?", "", line)
            if command.startswith("mbtool ") and "COMMAND" not in command:
                yield page.name, _until_the_shell_takes_over(command)


def _until_the_shell_takes_over(command: str) -> str:
    """A command line up to a comment, a pipe or a redirection."""
    lexer = shlex.shlex(command, posix=True, punctuation_chars="|>&")
    lexer.whitespace_split = True
    return shlex.join(takewhile(lambda word: word not in ("|", ">", "&"), lexer))


@pytest.mark.parametrize(("page", "line"), list(commands()))
def test_a_command_line_of_the_docs_can_be_given(page: str, line: str) -> None:
    root: Any = get_command(app)
    _, *arguments = shlex.split(line)
    context = root.make_context("mbtool", list(arguments))
    name, command, rest = root.resolve_command(context, arguments)
    with command.make_context(name, rest, parent=context):
        pass


def test_the_docs_name_every_command_and_no_other() -> None:
    root: Any = get_command(app)
    table = (ROOT / "docs" / "commands.md").read_text()
    assert set(re.findall(r"^\| `mbtool ([a-z]+)", table, re.MULTILINE)) == set(root.commands)
    for page in PAGES:
        named = set(re.findall(r"`mbtool ([a-z]+)[ `]", page.read_text()))
        assert named <= set(root.commands), page


def test_the_links_of_a_page_lead_somewhere() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
            if re.match(r"[a-z]+:", target):
                continue
            path, _, anchor = target.partition("#")
            file = (page.parent / path) if path else page
            assert file.exists(), (page, target)
            assert not anchor or anchor in anchors(file), (page, target)


def test_the_files_that_a_page_names_exist() -> None:
    """A path stands in back quotes; it is one of the repository, of the program or of its page."""
    for page in PAGES:
        for name in re.findall(r"`((?:[\w.-]+/)+(?:[\w-]+\.\w+)?)`", page.read_text()):
            places = (ROOT / name, SOURCE / name, page.parent / name)
            assert name.startswith("../") or any(one.exists() for one in places), (page, name)


def test_a_lint_message_leads_to_its_page() -> None:
    text = (ROOT / "pyproject.toml").read_text()
    targets = re.findall(r"(docs/[\w.-]+\.md)(?:#([\w-]+))?", text)
    assert targets
    for path, anchor in targets:
        assert not anchor or anchor in anchors(ROOT / path), (path, anchor)


def test_no_file_names_a_path_of_someones_machine() -> None:
    folders = (SOURCE, TESTS, ROOT / "docs", ROOT / "captures")
    files = [path for folder in folders for path in folder.rglob("*") if path.is_file()]
    files += [path for path in ROOT.iterdir() if path.is_file()]
    found = {
        str(path.relative_to(ROOT)): match[0].decode()
        for path in files
        if "__pycache__" not in path.parts
        if (match := MACHINE_PATH.search(path.read_bytes()))
    }
    assert found == {}


def imports(path: Path) -> Iterator[str]:
    """What a module imports, wherever in it, types' sake apart."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module


def imported_modules(path: Path) -> Iterator[str]:
    """The same, with the modules that are imported by name from their package."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                file = SOURCE.parent / node.module.replace(".", "/") / f"{alias.name}.py"
                yield f"{node.module}.{alias.name}" if file.exists() else node.module


def kind(name: str) -> int:
    """Constants first, then classes, then functions, as ruff sorts them."""
    return 0 if name.isupper() else 1 if name[0].isupper() else 2


def anchors(page: Path) -> set[str]:
    """The fragments that a page's headings have on GitHub."""
    headings = re.findall(r"^#+ +(.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading).lower().replace(" ", "-") for heading in headings}
