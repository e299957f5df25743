"""The command that installs an extra where this mbtool is installed."""

from __future__ import annotations

import sys

import pytest

from mbtool.core import extras


@pytest.mark.parametrize(
    ("prefix", "command"),
    [
        ("/users/a/.local/share/pipx/venvs/mbtool", "pipx inject mbtool"),
        (
            "/users/a/.local/share/uv/tools/mbtool",
            "uv pip install --python /users/a/.local/share/uv/tools/mbtool",
        ),
        ("/users/a/venv", f"{sys.executable} -m pip install"),
    ],
)
def test_the_command_is_that_of_the_installer(
    monkeypatch: pytest.MonkeyPatch, prefix: str, command: str
) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda _: object())
    assert extras.installer("textual>=8.2,<9", prefix=prefix) == f"{command} 'textual>=8.2,<9'"


def test_where_pip_is_not_installed_that_of_the_system_installs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda _: None)
    command = extras.installer("pyyaml>=6", prefix="/users/a/venv")
    assert command == f"python3 -m pip --python {sys.executable} install 'pyyaml>=6'"


def test_an_error_names_the_extra_and_its_command(monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = ["rich>=13", "textual<9,>=8.2; extra == 'watch'", "pyarrow; extra == 'columns'"]
    monkeypatch.setattr("importlib.metadata.requires", lambda _: wanted)
    text = str(extras.missing_extra("watch", "watch"))
    assert text.startswith("watch needs the extra mbtool[watch]: ")
    assert text.endswith(" install 'textual<9,>=8.2'")
