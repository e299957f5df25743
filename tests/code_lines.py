"""Counts lines of code by room: python -m tests.code_lines [FOLDER].

Blank lines, comments and docstrings do not count. A room is a folder of mbtool/, or one of the
folders within slave/ and workflows/.
"""

from __future__ import annotations

import ast
import sys
import tokenize
from collections import Counter
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[1] / "mbtool"
_NO_CODE = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
    tokenize.ENCODING, tokenize.ENDMARKER,
}  # fmt: skip


def code_lines(path: Path) -> int:
    """Lines of one module that hold code."""
    lines: set[int] = set()
    with path.open("rb") as file:
        for token in tokenize.tokenize(file.readline):
            if token.type not in _NO_CODE:
                lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - _docstring_lines(path))


def _docstring_lines(path: Path) -> set[int]:
    """Lines of texts that stand alone: docstrings, also those under a field or a constant."""
    return {
        line
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }


def main() -> None:
    source = Path(sys.argv[1]) if len(sys.argv) > 1 else SOURCE
    rooms: Counter[str] = Counter()
    for path in source.rglob("*.py"):
        folders = path.relative_to(source).parts[:-1]
        rooms["/".join(folders) or "."] += code_lines(path)
    for room, count in sorted(rooms.items()):
        print(f"{count:7,}  {room}")  # noqa: T201
    print(f"{rooms.total():7,}  in all")  # noqa: T201


if __name__ == "__main__":
    main()
