"""Runs the console blocks of the pages and compares their output: python -m tests.docs.console.

With --refresh PAGE... it writes the output of this run into the pages. In a page:

    ```console                      a terminal: lines with `$ ` are commands, others their output
    ```console title="Terminal 2"   another terminal of the same page
    ```toml title="pump.toml"       a block whose title is a file name: the page's reader makes it
    <!-- console: file site.mcap = captures/ft1a-touch-line.mcap -->   a file that the reader has
    <!-- console: made site.mcap = trouble -->   one that made_captures.py makes
    <!-- console: not run: REASON -->   the next block stays as it is; a reason of normalising.py
    ```sh                           commands without output; a test parses those of mbtool

A line `^C` is Ctrl-C; a block that begins without `$` goes on with what runs in its terminal. A
line `...` stands for any lines. Ports from 1500 to 1599 are exchanged for free ones. All else that
may differ is listed in normalising.py.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import socket
import sys
import tempfile
from dataclasses import dataclass, field
from difflib import unified_diff
from pathlib import Path
from typing import TYPE_CHECKING

from tests.docs.made_captures import CAPTURES
from tests.docs.normalising import agrees, normalised
from tests.docs.terminal import Running, preload

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).resolve().parents[2]
LANGUAGES = ("console", "sh")
ATTEMPTS = 3
"""How often a page is run until its output is right: on a busy machine, a virtual line is sometimes
so late that an answer comes in two parts."""
PAGES = sorted([ROOT / "README.md", *ROOT.glob("docs/**/*.md")])

_PART = re.compile(
    r"^<!-- console: (?P<order>.*?) -->$"
    r"|^(?P<fence>```+)(?P<language>[\w-]*)(?: title=\"(?P<title>[^\"]*)\")?\n"
    r"(?P<body>.*?)^(?P=fence)$",
    re.MULTILINE | re.DOTALL,
)
_PORT = re.compile(r"(?<=[: ])15\d\d\b")


@dataclass
class Step:
    """A command of a block with its output, or the output that follows of one that runs."""

    command: str | None
    expected: str = ""


@dataclass
class Page:
    """Runs the blocks of one page in a folder of its own."""

    path: Path
    is_refreshed: bool
    problems: list[str] = field(default_factory=list)
    not_run: list[str] = field(default_factory=list)
    commands: int = 0

    def __post_init__(self) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="mbtool-docs-"))
        self._terminals: dict[str, Running] = {}
        self._exchanged: dict[str, str] = {}
        self._is_next_left_out = False

    def run(self) -> None:
        text = self.path.read_text()
        self._to_come = list(self._all_steps(text))
        try:
            new = _PART.sub(self._part, text)
        finally:
            for one in reversed(self._terminals.values()):
                if one.code is None:
                    one.interrupt()
            shutil.rmtree(self._folder, ignore_errors=True)
        if self.is_refreshed and new != text:
            self.path.write_text(new)

    def _all_steps(self, text: str) -> Iterator[tuple[str, str | None]]:
        """Yield the terminal and the command of each step that is run."""
        is_left_out = False
        for part in _PART.finditer(text):
            if part["order"] is not None:
                is_left_out = is_left_out or part["order"].startswith("not run")
            elif part["language"] in LANGUAGES:
                if not is_left_out:
                    yield from ((part["title"] or "", one.command) for one in steps(part["body"]))
                is_left_out = False

    def _is_followed(self, title: str, step: Step) -> bool:
        """True if a command ends by itself, as another one follows in its terminal."""
        following = [command for terminal, command in self._to_come if terminal == title]
        return "^C\n" not in step.expected and following != [] and following[0] is not None

    def _part(self, part: re.Match[str]) -> str:
        if part["order"] is not None:
            self._obey(part["order"])
        elif part["language"] in LANGUAGES and self._is_next_left_out:
            self._is_next_left_out = False
        elif part["language"] in LANGUAGES:
            body = self._block(part["title"] or "", part["body"])
            return part[0].replace(part["body"], body) if self.is_refreshed else part[0]
        elif part["title"] and re.fullmatch(r"[\w./-]+\.\w+", part["title"]):
            file = self._folder / part["title"]
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(self._to_run(part["body"]))
        return part[0]

    def _obey(self, order: str) -> None:
        word, _, rest = order.partition(" ")
        if word == "file":
            name, _, source = rest.partition(" = ")
            (self._folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / source, self._folder / name)
        elif word == "made":
            name, _, source = rest.partition(" = ")
            self._make(name, CAPTURES[source]())
        elif order.startswith("not run: "):
            self._is_next_left_out = True
            self.not_run.append(order)
        else:
            raise ValueError(f"{self.path.name}: {order}: no such order")

    def _make(self, name: str, byte_times: str) -> None:
        (self._folder / "rs485.csv").write_text(byte_times)
        Running(f"mbtool convert rs485.csv {name}", self._folder).read_until()
        (self._folder / "rs485.csv").unlink()

    def _block(self, title: str, body: str) -> str:
        written = []
        for step in steps(body):
            self._to_come.remove((title, step.command))
            before, is_stopped, after = step.expected.partition("^C\n")
            one = self._start(title, step.command)
            said = 0 if step.command else len(one.whole_lines)
            self._wait(one, said, before, must_end=self._is_followed(title, step))
            output = one.whole_lines[said:]
            if is_stopped:
                # What a command says of Ctrl-C stands behind what it said before.
                mark = len(one.whole_lines)
                one.interrupt()
                ending = one.output[mark:]
                self._compare(step, before, self._to_show(output))
                self._compare(step, after, self._to_show(ending))
                shown = f"{self._to_show(output)}^C\n{self._to_show(ending)}"
            else:
                self._compare(step, step.expected, self._to_show(output))
                shown = self._to_show(output)
            if agrees(step.expected.replace("^C\n", ""), shown.replace("^C\n", "")):
                shown = step.expected
            written.append((f"$ {step.command}\n" if step.command else "") + shown)
        return "".join(written)

    def _start(self, title: str, command: str | None) -> Running:
        running = self._terminals.get(title)
        if command is None:
            assert running is not None, f"{self.path.name}: nothing runs in terminal {title!r}"
            return running
        self.commands += 1
        self._terminals[title] = one = Running(self._to_run(command), self._folder)
        return one

    def _wait(self, one: Running, said: int, expected: str, *, must_end: bool) -> None:
        """Wait until a command has ended or, if it runs on, has said what the page expects."""
        if must_end:
            one.read_until()
            return
        one.read_until(is_begun=True)
        if self.is_refreshed:
            one.read_while_it_talks()
        elif "...\n" in expected:
            one.read_until(
                is_enough=lambda: agrees(expected, self._to_show(one.whole_lines[said:]))
            )
        else:
            one.read_until(lines=one.whole_lines[:said].count("\n") + expected.count("\n"))

    def _compare(self, step: Step, expected: str, actual: str) -> None:
        if not agrees(expected, actual) and not self.is_refreshed:
            name = self.path.relative_to(ROOT)
            lines = unified_diff(
                normalised(expected).splitlines(), normalised(actual).splitlines(),
                "the page", "the run", lineterm="",
            )  # fmt: skip
            head = f"{name}: $ {step.command or '(goes on)'}"
            self.problems.append("\n".join((head, *lines)))

    def _to_run(self, text: str) -> str:
        return _PORT.sub(lambda port: self._free_port(port[0]), text)

    def _free_port(self, port: str) -> str:
        if port not in self._exchanged:
            with socket.create_server(("127.0.0.1", 0)) as server:
                self._exchanged[port] = str(server.getsockname()[1])
        return self._exchanged[port]

    def _to_show(self, text: str) -> str:
        text = text.replace(f"{self._folder}/", "").replace(str(self._folder), ".")
        for name, other in self._exchanged.items():
            text = text.replace(other, name)
        return re.sub(r"[ \t]+$", "", text, flags=re.MULTILINE)


def steps(body: str) -> list[Step]:
    """The commands of a block; a backslash at a line's end continues a command."""
    found: list[Step] = []
    lines = iter(body.splitlines(keepends=True))
    for line in lines:
        if line.startswith("$ "):
            command = line[2:].rstrip("\n")
            while command.endswith("\\"):
                command += "\n" + next(lines).rstrip("\n")
            found.append(Step(command))
        else:
            if not found:
                found.append(Step(None))
            found[-1].expected += line
    return found


def prepare() -> Path:
    """Set the variables of all commands; returns the folder with the script `mbtool`."""
    tools = Path(tempfile.mkdtemp(prefix="mbtool-docs-bin-"))
    script = tools / "mbtool"
    script.write_text(f'#!/bin/sh\nexec {sys.executable} -m mbtool "$@"\n')
    script.chmod(0o755)
    python = tools / "python"
    python.write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    python.chmod(0o755)
    pytest = tools / "pytest"
    pytest.write_text(f'#!/bin/sh\nexec {sys.executable} -m pytest "$@"\n')
    pytest.chmod(0o755)
    os.environ.update(
        PATH=f"{tools}:{os.environ['PATH']}", HOME=str(tools), NO_COLOR="1", TERM="dumb",
        LANG="C.UTF-8",        PYTHONPATH=str(ROOT), XDG_CONFIG_HOME=str(tools),
    )  # fmt: skip
    for name in ("COLUMNS", "LINES"):
        os.environ.pop(name, None)
    return tools


def main() -> int:
    parser = argparse.ArgumentParser(description="Run the console blocks of the pages.")
    parser.add_argument("pages", nargs="*", type=Path)
    parser.add_argument("--refresh", action="store_true", help="write the output into the pages")
    chosen = parser.parse_args()
    preload()
    tools = prepare()
    problems: list[str] = []
    commands = 0
    try:
        for path in [one.resolve() for one in chosen.pages] or PAGES:
            for _ in range(ATTEMPTS):
                page = Page(path, chosen.refresh)
                page.run()
                if not page.problems:
                    break
            problems += page.problems
            commands += page.commands
            for reason in page.not_run:
                print(f"{path.relative_to(ROOT)}: {reason}", file=sys.stderr)
    finally:
        shutil.rmtree(tools, ignore_errors=True)
    print("\n".join([*problems, f"{commands} commands, {len(problems)} differ"]))
    if problems:
        print("after a change that is meant: python -m tests.docs.console --refresh PAGE...")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
