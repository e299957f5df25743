"""Completion, as the three shells ask for it."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import completion, exit_codes
from mbtool.cli.completion import COMPLETE, join_words
from mbtool.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.cli.program import CommandLine

PATIENCE_S = 60
_BASH_WORD = re.compile(r"""'[^']*'?|"[^"]*"?|[:=@]|[^\s:=@]+""")


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
        words = "\n".join(_BASH_WORD.findall(line)) + "\n" * line.endswith(" ")
        monkeypatch.setenv(completion._QUOTED, "")
        monkeypatch.delenv(completion._QUOTED)
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
        ('mbtool sniff "net:e', ["net:eth0"]),
        ("mbtool plot x 'holding 0' --devi", ["--device"]),
        ("mbtool read ", ["rtu:/dev/ttyS0@19200-8E1"]),
        ("mbtool slave fa3-at1m8x --on n", []),
        ("mbtool replay x --on rtu:", ["/dev/ttyS0@19200-8E1"]),
        ("mbtool replay x --on a=r", ["rtu:/dev/ttyS0@19200-8E1"]),
        ("mbtool decode x --columns number,ti", ["number,time"]),
        ("mbtool check x --select SEC-20", [f"SEC-20{one}" for one in range(1, 6)]),
        ("mbtool check x --ignore SE,RTU-30", ["SE,RTU-301", "SE,RTU-302"]),
        ("mbtool decode x --link a", ["ascii@9600-7E1"]),
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


def test_links_and_files_are_offered_together(
    complete: Callable[[str, str], list[str]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rack").mkdir()
    (tmp_path / "north.pcap").touch()
    every = ["rtu:/dev/ttyS0@19200-8E1", "net:eth0", "north.pcap", "rack/"]
    assert complete("bash", "mbtool watch ") == every
    assert complete("bash", "mbtool stats n") == ["net:eth0", "north.pcap"]
    assert complete("bash", "mbtool watch ra") == []


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_of_the_shell_that_is_named_is_printed_and_installed(
    mbtool: CommandLine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, shell: str
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    script = mbtool("--show-completion", shell)
    assert f"_MBTOOL_COMPLETE=complete_{shell}" in script.out
    told = mbtool("--install-completion", shell)
    path = told.out.partition(": written; ")[0]
    assert told.out == f"{path}: written; {shell} completes mbtool in the next terminal\n"
    assert Path(path).read_text().strip() == script.out.strip()


@pytest.mark.parametrize("option", ["--install-completion", "--show-completion"])
def test_without_a_shell_it_is_the_one_around(
    mbtool: CommandLine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, option: str
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr("typer._completion_shared._get_shell_name", lambda: "fish")
    assert "fish" in mbtool(option).out
    monkeypatch.setattr("typer._completion_shared._get_shell_name", lambda: None)
    told = mbtool(option)
    assert told.code == exit_codes.USAGE
    assert told.err.startswith(f"mbtool: {option}: this shell is not known; name one of bash, ")


def test_a_shell_that_is_none_or_not_there_is_one_line(
    mbtool: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "")
    known = "bash, zsh, fish, powershell, pwsh"
    for option in ("--install-completion", "--show-completion"):
        told = mbtool(option, "tcsh")
        assert told.err == f"mbtool: {option}: there is none for tcsh; name one of {known}\n"
    told = mbtool("--install-completion", "pwsh")
    assert told.err == "mbtool: --install-completion pwsh: there is no pwsh on this machine\n"
    assert told.code == exit_codes.USAGE
