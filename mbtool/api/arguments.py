"""Reads the arguments that several functions of the Python interface take."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from os import PathLike, fspath

from mbtool.core import UsageError
from mbtool.devices import Assignment, Assignments, NamedTransaction, Profile, load_profile
from mbtool.devices.assignment import parse_who

AnyPath = str | PathLike[str]
ProfileName = str | PathLike[str] | Profile
"""The name of a built-in profile, the path of a TOML file, or a loaded profile."""
Devices = Mapping[int | str, ProfileName]
"""The profiles of slaves. A key is a unit (5), or a text as in `--device`: "192.168.3.250/5",
"all"."""


def profile_of(name: ProfileName) -> Profile:
    """Load a profile, or return the one that is loaded already.

    Raises UsageError if no profile has this name, ProfileError if the profile is wrong.
    """
    return name if isinstance(name, Profile) else load_profile(fspath(name))


def assignments_of(devices: Devices | None) -> Assignments:
    """Load the profiles of `devices`. Raises UsageError for a key that names no slave."""
    if devices is not None and not isinstance(devices, Mapping):
        raise UsageError(f'devices: write a dictionary such as {{5: "NAME"}}, not {devices!r}')
    return Assignments(
        Assignment(parse_who(str(who)), profile_of(name)) for who, name in (devices or {}).items()
    )


def condition_of(where: str | None) -> Callable[[NamedTransaction], bool]:
    """Return the filter of a `--where` expression; without one every transaction passes.

    Raises UsageError for an expression that is wrong or can never be true.
    """
    if where is None:
        return lambda _: True
    from mbtool.query.where import parse_where

    return parse_where(where)
