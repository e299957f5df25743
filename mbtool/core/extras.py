"""Finds the command that installs an optional extra of mbtool into the environment it runs in."""

from __future__ import annotations

import re
import shlex
import sys
from importlib.util import find_spec
from pathlib import Path

from mbtool.core.errors import UsageError


def missing_extra(what: str, extra: str) -> UsageError:
    """Return the error for a missing optional extra; its text has the command that installs it.

    `what` names the feature that needs the extra.
    """
    return UsageError(f"{what} needs the extra mbtool[{extra}]: {installer(*requirements(extra))}")


def requirements(extra: str) -> list[str]:
    """Return the packages (with versions, as for pip) that an extra needs.

    If mbtool's own metadata does not list them, the result is only `mbtool[EXTRA]`.
    """
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

    `prefix` is the folder of that environment. If uv made it, `uv pip` adds the packages to it, as
    `uv tool install --with` would remove the packages of an earlier --with. An environment without
    pip, such as the one that `make` creates, gets the packages by the pip of python3.
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
