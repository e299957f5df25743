"""Compares anonymous copies with their originals: python -m tests.differential.anonymous_copies.

For every capture of others, and those of this repository, `stats --json` and `check --json` of the
copy must say what they say of the original, but for names, addresses and times. Takes some minutes.
A capture that is cut or damaged has a whole copy, so `is_whole` may differ; foreign protocols that
are known by a text, as HTTP, have no name in the copy. Both are listed as explained.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

from tests.captures import public_folder
from tests.cli.test_anonymise import nameless

ROOT = Path(__file__).resolve().parents[2]
MBTOOL = str(Path(sys.executable).with_name("mbtool"))
NO_CAPTURES = {".md", ".json", ".py", ".csv", ".yaml", ".toml", ".html", ".zip", ".jsonl"}
MAX_BYTES = 30_000_000
_IPV6 = re.compile(r"\b[0-9a-f]{4}(?::{1,2}[0-9a-f]{1,4}){2,7}\b")
LINE = ("--link", "rtu@9600-8N1")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("part", nargs="*", help="only captures with this in their path")
    given = parser.parse_args()
    results: Counter[str] = Counter()
    for path in _captures():
        if not given.part or any(part in str(path) for part in given.part):
            told = _compared(path)
            results[told.partition(":")[0]] += 1
            print(f"{told:20} {path}", flush=True)  # noqa: T201
    print(", ".join(f"{count} {told}" for told, count in sorted(results.items())))  # noqa: T201
    sys.exit("DIFFERS" in results)


def _captures() -> list[Path]:
    folders = [ROOT / "captures", public_folder()]
    found = [path for folder in folders for path in sorted(folder.rglob("*")) if path.is_file()]
    return [
        path
        for path in found
        if path.suffix not in NO_CAPTURES and path.stat().st_size <= MAX_BYTES
    ]


def _compared(path: Path) -> str:
    settings = LINE if path.suffix == ".bin" or path.name.endswith(".hex.txt") else ()
    with tempfile.TemporaryDirectory() as folder:
        key, copy = Path(folder) / "key", Path(folder) / f"{path.stem}{_suffix(path)}"
        key.write_text("a long text")
        options = ("--anonymous", "--key", str(key), *settings)
        _run("convert", str(path), str(copy), *options)
        if not copy.exists():
            return "not read"
        explained = False
        for command in ("stats", "check"):
            # The records of an old log may lack fields that the copy has.
            afresh = ("--raw",) if path.suffix == ".mcap" else ()
            told = [_told(path, command, *settings, *afresh), _told(copy, command, *afresh)]
            if told[0] != told[1]:
                if _explained(told[0]) != _explained(told[1]):
                    return f"DIFFERS: {command}"
                explained = True
    return "explained" if explained else "equal"


def _suffix(path: Path) -> str:
    return ".mcap" if path.suffix == ".mcap" else ".pcapng"


def _told(path: Path, command: str, *options: str) -> Any:
    told = json.loads(_run(command, str(path), "--json", *options))
    for link in told.get("links", ()):
        link["link"] = "LINK"
        link["connections"] = len(link.get("connections") or ())
    # A link of a file that has no names is called after the file, which has the same name here.
    told = _without_link(nameless(told), path.stem)
    told = json.loads(_IPV6.sub("ADDRESS", json.dumps(told)))
    # Masters are in the order of their names, and so are findings of one time.
    for rows in [told.get("findings"), *(one["masters"] for one in told.get("links", ()))]:
        if rows:
            rows.sort(key=json.dumps)
    return told


def _without_link(value: Any, name: str) -> Any:
    if isinstance(value, dict):
        return {key: _without_link(one, name) for key, one in value.items() if key != "link"}
    if isinstance(value, list):
        return [_without_link(one, name) for one in value]
    return value.replace(name, "LINK") if isinstance(value, str) else value


def _explained(told: Any) -> Any:
    kept = {key: one for key, one in told.items() if key != "is_whole"}
    if "findings" in kept:
        kept["findings"] = [one for one in kept["findings"] if one.get("code") != "TCP-201"]
    return kept


def _run(*arguments: str) -> str:
    done = subprocess.run([MBTOOL, *arguments], capture_output=True, text=True, check=False)
    return done.stdout


if __name__ == "__main__":
    main()
