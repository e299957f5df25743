"""Names the command that installs an extra of this package where this mbtool is installed."""

from __future__ import annotations

import re
import shlex
import sys
from importlib.util import find_spec
from pathlib import Path

from mbtool.core.errors import UsageError


def missing_extra(what: str, extra: str) -> UsageError:
    """The error for a command that needs an extra which is not installed."""
    return UsageError(f"{what} needs the extra mbtool[{extra}]: {installer(*requirements(extra))}")


def requirements(extra: str) -> list[str]:
    """The requirements of an extra, without the marks that name it."""
    from importlib import metadata  # Loads the package email; no command needs it to run.

    try:
        lines = metadata.requires("mbtool") or []
    except metadata.PackageNotFoundError:
        lines = []
    mark = re.compile(rf";.*\bextra\s*==\s*['\"]{extra}['\"]")
    found = [line.partition(";")[0].strip() for line in lines if mark.search(line)]
    return found or [f"mbtool[{extra}]"]


def installer(*packages: str, prefix: str = sys.prefix) -> str:
    """The command that installs packages where this mbtool is installed.

    `uv tool install --with` would remove what an earlier --with has installed, so packages are
    added to the environment of a tool of uv. The venv that `make` creates has no pip of its own.
    """
    parts = Path(prefix).parts
    quoted = shlex.join(packages)
    python = shlex.quote(sys.executable)
    if "pipx" in parts:
        return f"pipx inject mbtool {quoted}"
    if "uv" in parts and "tools" in parts:
        return f"uv pip install --python {shlex.quote(prefix)} {quoted}"
    if find_spec("pip") is None:
        return f"python3 -m pip --python {python} install {quoted}"
    return f"{python} -m pip install {quoted}"
