"""The commands of mbtool by name; the module of a command is imported when it is looked up."""

# Importing all commands takes as long as decoding a small file. So a command line imports only the
# command that it names; only the help of mbtool itself, which lists them, imports all.

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

import typer
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


def _load(name: str, module: str) -> Any:
    function = getattr(import_module(f"mbtool.cli.{module}"), name)
    app = typer.Typer(rich_markup_mode=None)
    if isinstance(function, typer.Typer):  # It has subcommands.
        app.add_typer(function, name=name)
    else:
        app.command(name, cls=Command, context_settings=_SETTINGS.get(name))(function)
    return get_group(app).commands[name]
