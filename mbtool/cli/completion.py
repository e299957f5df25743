"""Completes what a user types in bash, zsh and fish: `mbtool --install-completion`."""

# The library typer writes the script for the shell and completes commands and options. This module
# finds the values, by the metavar of a parameter: LINK gives the serial ports and interfaces of
# this machine, PROFILE the built-in profiles; for all other parameters the shell offers its files.
#
# bash divides words at `:`, `=` and `@`, and replaces only the text behind the last of them. So
# this module joins the parts of a word again, and leaves out of each value the text that bash
# keeps. A word that begins with a quote is not divided.

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, MutableMapping, Sequence
from glob import escape, iglob
from typing import Any

COMPLETE = "_MBTOOL_COMPLETE"
"""The shell sets this environment variable when it asks for completions."""
_QUOTED = "_MBTOOL_QUOTED"
"""This module sets this environment variable if the word to complete begins with a quote."""
_BREAKS = ":=@"
_LISTENERS = ("sniff", "stats", "watch")
"""The commands that also listen on network interfaces, so that the completion offers these. The
links of all other commands are serial ports."""


def is_asked() -> bool:
    """True if a shell runs mbtool only to complete a line."""
    return COMPLETE in os.environ


def join_words(environment: MutableMapping[str, str]) -> None:
    """Join the parts into which bash has divided words at `:`, `=` and `@`, up to the cursor.

    Changes COMP_WORDS and COMP_CWORD in `environment`.
    """
    if environment.get(COMPLETE) != "complete_bash" or "COMP_WORDS" not in environment:
        return
    words = environment["COMP_WORDS"].split("\n" if "\n" in environment["COMP_WORDS"] else None)
    cursor = int(environment.get("COMP_CWORD", "0"))
    current = words[cursor] if cursor < len(words) else ""
    line = " ".join([*words[:cursor], current])
    line = re.sub(rf" ?([{_BREAKS}]) ?", r"\1", line)
    if current.startswith(('"', "'")):
        environment[_QUOTED] = "1"
    environment["COMP_WORDS"] = line
    from typer._click.shell_completion import split_arg_string

    environment["COMP_CWORD"] = str(len(split_arg_string(line)) - (not line.endswith(" ")))


def with_completed_values(params: list[Any], command: str | None) -> list[Any]:
    """Let the shell offer values for the parameters of a command that have an entry in _VALUES."""
    for param in params:
        metavar = getattr(param, "metavar", None) or ""
        own = [_VALUES[key] for one in param.opts if (key := f"{one} {metavar}") in _VALUES]
        kinds = [_VALUES[kind] for kind in metavar.split("|") if kind in _VALUES]
        for values in (*own, *kinds):
            param.shell_complete = _completer(
                values,
                has_interfaces=command in _LISTENERS,
                has_files="FILE" in metavar.split("|"),
            )
    return params


def profile_names(_: str = "") -> list[str]:
    from mbtool.devices import builtin_profiles

    return sorted(builtin_profiles())


def items(values: Iterable[str], incomplete: str) -> Sequence[Any]:
    """Return the values that begin with the user's text, in the form that the shell expects."""
    from typer._click.shell_completion import CompletionItem

    left_out = 0
    if os.environ.get(COMPLETE) == "complete_bash" and _QUOTED not in os.environ:
        left_out = max(incomplete.rfind(one) for one in _BREAKS) + 1
    return [CompletionItem(one[left_out:]) for one in values if one.startswith(incomplete)]


def _completer(
    values: Callable[[str], Iterable[str]], *, has_interfaces: bool, has_files: bool
) -> Callable[[Any, str], Sequence[Any]]:
    """Return a function that returns the values which begin with the user's text.

    Without `has_interfaces`, network interfaces are left out. With `has_files`, files and folders
    follow the values; if there are no values, the shell offers its files itself.
    """

    def completed(_: Any, incomplete: str) -> Sequence[Any]:
        some = [one for one in values(incomplete) if has_interfaces or not one.startswith("net:")]
        found = items(some, incomplete)
        if not found or not has_files:
            return found
        files = (
            f"{one}/" if os.path.isdir(one) else one for one in iglob(f"{escape(incomplete)}*")
        )
        return [*found, *items(sorted(files), incomplete)]

    return completed


def _links(incomplete: str) -> Iterable[str]:
    from mbtool.ports.local_ports import local_ports
    from mbtool.sources.local_interfaces import local_interfaces

    links = [one.link for one in local_ports()] + [one.link for one in local_interfaces()]
    if incomplete.startswith("ascii"):
        return [f"ascii{one.removeprefix('rtu')}" for one in links if one.startswith("rtu:")]
    return links


def _player_links(incomplete: str) -> Iterable[str]:
    who, equals, _ = incomplete.partition("=")
    return [f"{who}{equals}{one}" if equals else one for one in _VALUES["LINK"]("")]


def _lines(_: str) -> Iterable[str]:
    return ["rtu@9600-8E1", "rtu@19200-8E1", "rtu@115200-8N1", "ascii@9600-7E1"]


def _columns(incomplete: str) -> Iterable[str]:
    from mbtool.views.table_options import TableColumn

    return _behind_commas(incomplete, TableColumn)


def _codes(incomplete: str) -> Iterable[str]:
    from mbtool.devices.checking.rules import RULES

    codes = sorted(one.code for one in RULES.values() if not one.is_of_devices)
    return _behind_commas(incomplete, [*sorted({one.split("-")[0] for one in codes}), *codes])


def _behind_commas(incomplete: str, names: Iterable[str]) -> Iterable[str]:
    before, comma, _ = incomplete.rpartition(",")
    return [f"{before}{comma}{one}" for one in names]


def _assignments(incomplete: str) -> Iterable[str]:
    who, equals, _ = incomplete.partition("=")
    return [f"{who if equals else 'all'}={name}" for name in profile_names()]


_VALUES: dict[str, Callable[[str], Iterable[str]]] = {
    "LINK": _links,
    "[WHO=]LINK": _player_links,
    "PROFILE": profile_names,
    "NAME": profile_names,
    "WHO=PROFILE": _assignments,
    "UNIT[=PROFILE]": _assignments,
    "--link LINE": _lines,
    "--columns NAMES": _columns,
    "--select CODE": _codes,
    "--ignore CODE": _codes,
}
"""The values by metavar, or by option and metavar."""
