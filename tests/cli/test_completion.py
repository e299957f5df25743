"""Completion, as the three shells ask for it."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import completion
from mbtool.cli.completion import COMPLETE, join_words
from mbtool.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Callable

PATIENCE_S = 60


@pytest.fixture
def complete(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[[str, str], list[str]]:
    """What a shell is offered for a line; the cursor is at its end."""
    monkeypatch.setitem(
        completion._VALUES, "LINK", lambda _: ["rtu:/dev/ttyS0@19200-8E1", "net:eth0"]
    )

    def completed(shell: str, line: str) -> list[str]:
        monkeypatch.setenv(COMPLETE, f"complete_{shell}")
        monkeypatch.setenv("_TYPER_COMPLETE_ARGS", line)
        monkeypatch.setenv("_TYPER_COMPLETE_FISH_ACTION", "get-args")
        words = line
        for one in ":=@":
            words = words.replace(one, f"\n{one}\n")
        words = words.replace(" ", "\n").replace("\n\n", "\n")
        monkeypatch.setenv("COMP_WORDS", words)
        monkeypatch.setenv("COMP_CWORD", str(words.count("\n")))
        capsys.readouterr()
        with pytest.raises(SystemExit):
            main()
        return capsys.readouterr().out.split()

    return completed


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("mbtool pl", ["plot"]),
        ("mbtool sniff net:", ["eth0"]),
        ("mbtool sniff rtu:/dev/t", ["/dev/ttyS0@19200-8E1"]),
        ("mbtool watch n", ["net:eth0"]),
        ("mbtool decode x --device 5=fa3-th1m16y", ["fa3-th1m16y", "fa3-th1m16ye"]),
        ("mbtool devices idec-ft1a-t", ["idec-ft1a-touch"]),
        ("mbtool slave wa", ["wago-750"]),
        ("mbtool check --format s", ["sarif"]),
        ("mbtool decode pla", []),
    ],
)
def test_bash_gets_what_stands_behind_the_last_break(
    complete: Callable[[str, str], list[str]], line: str, offered: list[str]
) -> None:
    assert complete("bash", line) == offered


def test_fish_and_zsh_get_whole_words(complete: Callable[[str, str], list[str]]) -> None:
    assert complete("fish", "mbtool sniff net:") == ["net:eth0"]
    assert "net\\\\:eth0" in complete("zsh", "mbtool sniff net:")[-1]
    assert complete("zsh", "mbtool decode pla") == ["_files"]


def test_words_of_other_shells_stay() -> None:
    environment = {COMPLETE: "complete_zsh", "COMP_WORDS": "a : b", "COMP_CWORD": "2"}
    join_words(environment)
    assert environment["COMP_WORDS"] == "a : b"


def test_a_bash_with_the_script_completes(tmp_path: Path) -> None:
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("needs bash")
    program = tmp_path / "mbtool"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m mbtool "$@"\n')
    program.chmod(0o755)
    script = """
        PATH="$1:$PATH"; eval "$(mbtool --show-completion bash)"
        COMP_WORDS=(mbtool decode x --device 5 = fa3-a); COMP_CWORD=6
        _mbtool_completion mbtool; echo "${COMPREPLY[@]}"
    """
    done = subprocess.run(
        [bash, "--norc", "-c", script, "bash", str(tmp_path)],
        capture_output=True, text=True, timeout=PATIENCE_S, check=True,
        cwd=Path(__file__).resolve().parents[2],
    )  # fmt: skip
    assert done.stdout.split() == ["fa3-at1m8x", "fa3-at1m8y"]
