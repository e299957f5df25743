"""Makes .ci/requirements.txt and .ci/container.txt; docs/dependencies.md has the commands.

A report of pip lists each package that it chooses, with the hash of its file.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any, NamedTuple


class Locked(NamedTuple):
    """A package and the file that pip chose for it."""

    name: str
    version: str
    sha256: str


def locked(report: dict[str, Any]) -> list[Locked]:
    """The packages of a report, sorted by name, without mbtool itself."""
    return sorted(
        Locked(
            one["metadata"]["name"],
            one["metadata"]["version"],
            one["download_info"]["archive_info"]["hashes"]["sha256"],
        )
        for one in report["install"]
        if "archive_info" in one["download_info"] and one["metadata"]["name"] != "mbtool"
    )


def requirements(packages: list[Locked]) -> str:
    """The text of a file for `pip install --require-hashes -r`."""
    return "".join(f"{one.name}=={one.version} --hash=sha256:{one.sha256}\n" for one in packages)


def main() -> None:
    """Print the requirements."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("report", type=Path)
    given = parser.parse_args()
    report = json.loads(given.report.read_text(encoding="utf-8"))
    sys.stdout.write(requirements(locked(report)))


if __name__ == "__main__":
    main()
