"""Finds the command that installs an optional extra of mbtool into the environment it runs in."""

from __future__ import annotations

import re
import shlex
import sys
from importlib.util import find_spec
from pathlib import Path

from mbtool.core.errors import UsageError


def missing_extra(what: str, extra: str) -> UsageError:
    """Return the error for a command that needs an extra which is not installed."""
    return UsageError(f"{what} needs the extra mbtool[{extra}]: {installer(*requirements(extra))}")


def requirements(extra: str) -> list[str]:
    """Return the requirements of an extra, without their markers (such as `; extra == "tls"`)."""
    from importlib import metadata  # Imports the package email; rarely needed.

    try:
        lines = metadata.requires("mbtool") or []
    except metadata.PackageNotFoundError:
        lines = []
    mark = re.compile(rf";.*\bextra\s*==\s*['\"]{extra}['\"]")
    found = [line.partition(";")[0].strip() for line in lines if mark.search(line)]
    return found or [f"mbtool[{extra}]"]


def installer(*packages: str, prefix: str = sys.prefix) -> str:
    """Return the command that installs packages into the environment that this mbtool runs in.

    `uv tool install --with` would remove what an earlier --with has installed, so for a tool of uv
    the packages are added to its environment. The venv that `make` creates has no pip of its own,
    so the pip of python3 installs into it.
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
