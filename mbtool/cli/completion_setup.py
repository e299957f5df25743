"""Prints or installs the script with which a shell completes: --install-completion [SHELL]."""

# The scripts are those of the library typer. Its own options take no SHELL where it can detect the
# shell, and ignore the word behind them.

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import typer

from mbtool.cli.completion import COMPLETE
from mbtool.core import UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

INSTALL, SHOW = "--install-completion", "--show-completion"
_PROGRAM = "mbtool"
_THIS_SHELL = "this"
_SHELLS = ("bash", "zsh", "fish", "powershell", "pwsh")


def with_shell(args: Sequence[str]) -> list[str]:
    """Put a word behind --install-completion and --show-completion if no SHELL stands there."""
    made: list[str] = []
    for at, one in enumerate(args):
        made.append(one)
        if one in (INSTALL, SHOW) and args[at + 1 : at + 2] in ([], ["-h"], ["--help"]):
            made.append(_THIS_SHELL)
    return made


def install(shell: str | None) -> None:
    if shell is None:
        return
    from typer._completion_shared import install as install_script

    name = _named(INSTALL, shell)
    if name in ("powershell", "pwsh") and shutil.which(name) is None:
        raise UsageError(f"{INSTALL} {name}: there is no {name} on this machine")
    _, path = install_script(shell=name, prog_name=_PROGRAM, complete_var=COMPLETE)
    typer.echo(f"{path}: written; {name} completes mbtool in the next terminal")
    raise typer.Exit


def show(shell: str | None) -> None:
    if shell is None:
        return
    from typer._completion_shared import get_completion_script

    name = _named(SHOW, shell)
    script = get_completion_script(prog_name=_PROGRAM, complete_var=COMPLETE, shell=name)
    typer.echo(script)
    raise typer.Exit


def _named(option: str, shell: str) -> str:
    """Return the name of the shell that the user named, or of the one in which mbtool runs.

    Raises UsageError if completion is not known for that shell.
    """
    from typer._completion_shared import _get_shell_name

    name = _get_shell_name() if shell == _THIS_SHELL else shell
    if name not in _SHELLS:
        which = "this shell is not known" if name is None else f"there is none for {name}"
        raise UsageError(f"{option}: {which}; name one of {', '.join(_SHELLS)}")
    return name
