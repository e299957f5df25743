"""The commands of mbtool by name; the module of a command is imported when it is looked up."""

# Importing all commands takes as long as decoding a small file. So a command line imports only the
# command that it names. The help of mbtool itself, which lists all, needs the docstrings of their
# functions only; it takes these from the compiled modules, without running them.

from __future__ import annotations

import inspect
from collections.abc import Mapping
from importlib import import_module
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperCommand
from typer.main import get_group

from mbtool.cli.command import Command

if TYPE_CHECKING:
    from collections.abc import Iterator

_MODULES = {
    **{name: name for name in ("sniff", "status", "decode", "inventory", "check", "stats")},
    **{name: name for name in ("watch", "report", "plot", "convert", "recover", "replay", "diff")},
    "slave": "slave",
    "read": "ask",
    "write": "ask",
    "poll": "poll",
    "scan": "scan",
    "test": "conformance",
    "find": "find",
    "devices": "devices",
    **{name: name for name in ("links", "doctor", "line", "demo", "extcap")},
}
"""The module of this package that has a command's function, by command in the order of the help."""

# Newer versions of Wireshark give options that mbtool does not know; they are ignored.
# A negative number is no option of find.
_SETTINGS = {
    "find": {"ignore_unknown_options": True},
    "extcap": {"ignore_unknown_options": True, "allow_extra_args": True},
}


class CommandTable(Mapping[str, Any]):
    """Maps the name of each command to its typer command, and loads it at the first look-up."""

    def __init__(self) -> None:
        self._loaded: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._loaded:
            self._loaded[name] = _load(name, _MODULES[name])
        return self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        return iter(_MODULES)

    def __len__(self) -> int:
        return len(_MODULES)

    def __contains__(self, name: object) -> bool:
        return name in _MODULES

    def listed(self) -> dict[str, Any]:
        """Return commands that have the right names and help texts, but no options: enough for a
        list of them.
        """
        found = {}
        for name, module in _MODULES.items():
            text = _docstring(name, module)
            found[name] = self[name] if text is None else TyperCommand(name, help=text)
        return found


def _docstring(name: str, module: str) -> str | None:
    """Return the docstring of the function of a command; None if it is none."""
    full = f"{__package__}.{module}"
    compiled = SourceFileLoader(full, str(Path(__file__).with_name(f"{module}.py"))).get_code(full)
    for code in () if compiled is None else compiled.co_consts:
        if isinstance(code, CodeType) and code.co_name == name and code.co_consts:
            text = code.co_consts[0]
            return inspect.cleandoc(text) if isinstance(text, str) else None
    return None


def _load(name: str, module: str) -> Any:
    function = getattr(import_module(f"mbtool.cli.{module}"), name)
    app = typer.Typer(rich_markup_mode=None)
    if isinstance(function, typer.Typer):  # It has subcommands.
        app.add_typer(function, name=name)
    else:
        app.command(name, cls=Command, context_settings=_SETTINGS.get(name))(function)
    return get_group(app).commands[name]
