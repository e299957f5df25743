"""The error classes."""

from __future__ import annotations

import pytest

from mbtool.core.errors import (
    CutError,
    DamageError,
    InputError,
    LinkError,
    MbtoolError,
    OutputError,
    ProfileError,
    UsageError,
)


def test_profile_error_names_file_key_and_problem() -> None:
    error = ProfileError("pump.toml", "areas[0].last", "ends before it begins")
    assert str(error) == "pump.toml: areas[0].last: ends before it begins"
    assert (error.file, error.key, error.problem) == (
        "pump.toml", "areas[0].last", "ends before it begins",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (ProfileError, UsageError),
        (CutError, InputError),
        (DamageError, InputError),
        (LinkError, MbtoolError),
        (OutputError, MbtoolError),
    ],
)
def test_error_is_caught_by_its_base_class(
    error: type[MbtoolError], kind: type[MbtoolError]
) -> None:
    assert issubclass(error, kind)
    assert issubclass(kind, MbtoolError)
