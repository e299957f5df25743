"""Prints all troubles that `check` tells of each capture in a folder, to be judged one by one.

python -m tests.adversary.told FOLDER
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from mbtool.core import InputError
from mbtool.workflows.check import CheckRun
from mbtool.workflows.shared.reading import ReadingOptions

if TYPE_CHECKING:
    from collections.abc import Iterator

SUFFIXES = (".pcap", ".pcapng", ".pcap.gz", ".mcap", ".sr", ".log", ".txt")


def told(path: Path) -> Iterator[str]:
    """The troubles of a capture, a line each; a line that says why if there are none."""
    run = CheckRun([str(path)], ReadingOptions())
    try:
        for _ in run.findings():
            pass
    except InputError as error:
        yield f"cannot be read: {error}"
    judgement = run.judgement()
    for trouble in judgement.troubles:
        for one in trouble.all:
            yield f"{one.severity:8} {one.code:16} {one.cause}"
    if not judgement.troubles:
        yield f"none     {judgement.summary}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("folder", type=Path)
    folder: Path = parser.parse_args().folder
    for path in sorted(folder.rglob("*")):
        if path.name.endswith(SUFFIXES) and path.is_file():
            sys.stdout.write(f"{path.relative_to(folder)}\n")
            sys.stdout.writelines(f"    {line}\n" for line in told(path))
            sys.stdout.flush()


if __name__ == "__main__":
    main()
