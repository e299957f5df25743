"""Completes what a user types in bash, zsh and fish: `mbtool --install-completion`."""

# The library typer writes the script for the shell and completes commands and options. This module
# finds the values, by the metavar of a parameter: LINK gives the serial ports and interfaces of
# this machine, PROFILE the built-in profiles; for all other parameters the shell offers its files.
#
# bash divides words at `:`, `=` and `@`, and replaces only the text behind the last of them. So
# this module joins the parts of a word again, and leaves out of each value the text that bash
# keeps.

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, MutableMapping, Sequence

COMPLETE = "_MBTOOL_COMPLETE"
"""The shell sets this environment variable when it asks for completions."""
_BREAKS = ":=@"


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
    environment["COMP_WORDS"] = line
    environment["COMP_CWORD"] = str(len(line.split(" ")) - 1)


def with_completed_values(params: list[Any]) -> list[Any]:
    """Let the shell offer values for the parameters whose metavar is in _VALUES."""
    for param in params:
        values = _VALUES.get(_kind(getattr(param, "metavar", None) or ""))
        if values is not None:
            param.shell_complete = _completer(values)
    return params


def profile_names(_: str = "") -> list[str]:
    from mbtool.devices import builtin_profiles

    return sorted(builtin_profiles())


def items(values: Iterable[str], incomplete: str) -> Sequence[Any]:
    """Return the values that begin with the user's text, in the form that the shell expects."""
    from typer._click.shell_completion import CompletionItem

    left_out = 0
    if os.environ.get(COMPLETE) == "complete_bash":
        left_out = max(incomplete.rfind(one) for one in _BREAKS) + 1
    return [CompletionItem(one[left_out:]) for one in values if one.startswith(incomplete)]


def _completer(values: Callable[[str], Iterable[str]]) -> Callable[[Any, str], Sequence[Any]]:
    return lambda _, incomplete: items(values(incomplete), incomplete)


def _kind(metavar: str) -> str:
    parts = metavar.split("|")
    return "LINK" if "LINK" in parts else metavar


def _links(incomplete: str) -> Iterable[str]:
    from mbtool.ports.local_ports import local_ports
    from mbtool.sources.local_interfaces import local_interfaces

    links = [one.link for one in local_ports()] + [one.link for one in local_interfaces()]
    if incomplete.startswith("ascii"):
        return [f"ascii{one.removeprefix('rtu')}" for one in links if one.startswith("rtu:")]
    return links


def _assignments(incomplete: str) -> Iterable[str]:
    who, equals, _ = incomplete.partition("=")
    return [f"{who if equals else 'all'}={name}" for name in profile_names()]


_VALUES: dict[str, Callable[[str], Iterable[str]]] = {
    "LINK": _links,
    "PROFILE": profile_names,
    "NAME": profile_names,
    "WHO=PROFILE": _assignments,
    "UNIT[=PROFILE]": _assignments,
}
