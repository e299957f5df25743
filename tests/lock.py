"""Makes requirements-ci.txt and an SBOM from a report of pip; docs/dependencies.md has the command.

The report lists each package that `pip install '.[test]'` chooses, with the hash of its file.
"""

from __future__ import annotations

import argparse
import json
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
        if "archive_info" in one["download_info"]
    )


def requirements(packages: list[Locked]) -> str:
    """The text of a file for `pip install --require-hashes -r`."""
    return "".join(f"{one.name}=={one.version} --hash=sha256:{one.sha256}\n" for one in packages)


def bill_of_materials(packages: list[Locked]) -> dict[str, Any]:
    """A CycloneDX 1.6 document."""
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "components": [
            {
                "type": "library",
                "name": one.name,
                "version": one.version,
                "purl": f"pkg:pypi/{one.name.lower()}@{one.version}",
                "hashes": [{"alg": "SHA-256", "content": one.sha256}],
            }
            for one in packages
        ],
    }


def main() -> None:
    """Write both files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("report", type=Path)
    parser.add_argument("--requirements", type=Path)
    parser.add_argument("--sbom", type=Path)
    given = parser.parse_args()
    packages = locked(json.loads(given.report.read_text(encoding="utf-8")))
    if given.requirements is not None:
        given.requirements.write_text(requirements(packages), encoding="utf-8")
    if given.sbom is not None:
        text = json.dumps(bill_of_materials(packages), indent=1)
        given.sbom.write_text(f"{text}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
