"""Writes the part of docs/python.md that comes from docstrings: `python -m tests.interface_page`.

tests/api/test_interface_page.py checks that the page is up to date.
"""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from pathlib import Path

import mbtool

PAGE = Path(__file__).parents[1] / "docs" / "python.md"
BEGIN = "<!-- From here on the page is made of docstrings: python -m tests.interface_page -->"
FUNCTIONS = ("open", "sniff", "line")
CLASSES = (
    "Capture", "LiveCapture", "Slave", "Replay", "ObservedShell", "Decoder", "SerialBench",
    "PointRow", "Finding", "Trouble",
)  # fmt: skip
_WIDTH = 96
_SPECIAL = ("__aiter__", "__getitem__", "__setitem__", "__iter__")


def interface_text() -> str:
    """The part of the page, in Markdown."""
    parts = [BEGIN, "## Functions"]
    parts += [_function(f"mbtool.{name}", getattr(mbtool, name), "###") for name in FUNCTIONS]
    parts.append("## Classes")
    parts += [_class(name) for name in CLASSES]
    parts.append("## Errors\n\nThe text of an error is one line for the user.")
    errors = [name for name in mbtool.__all__ if name.endswith("Error")]
    rows = [f"| `mbtool.{name}` | {_summary(getattr(mbtool, name))} |" for name in errors]
    parts.append("\n".join(("| error | when |", "|---|---|", *rows)))
    return "\n\n".join(parts) + "\n"


def written_page(page: str) -> str:
    """The page with the part of docstrings as it must be."""
    return page.partition(BEGIN)[0] + interface_text()


def _class(name: str) -> str:
    cls = getattr(mbtool, name)
    parts = [f"### mbtool.{name}", _text(cls.__doc__)]
    if "__init__" in vars(cls) and name in ("Decoder", "Replay", "Slave"):
        parts += [_code(f"mbtool.{name}", cls.__init__), _text(cls.__init__.__doc__)]
    for fields in _fields(cls):
        parts.append(fields)
    for member, value in vars(cls).items():
        if (member.startswith("_") and member not in _SPECIAL) or not _own_doc(value):
            continue
        if isinstance(value, property):
            parts.append(f"**`{member}`**: {_text(value.__doc__)}")
        elif inspect.isfunction(value):
            parts.append(f"{_code(member, value)}\n\n{_text(value.__doc__)}")
    return "\n\n".join(parts)


def _own_doc(value: object) -> bool:
    return isinstance(value, property) or (inspect.isfunction(value) and bool(value.__doc__))


def _fields(cls: type) -> list[str]:
    """The attributes that have a docstring below them, and all fields of a named tuple."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(cls)))
    is_tuple = issubclass(cls, tuple)
    found = []
    for body in (
        one.body for one in ast.walk(tree) if isinstance(one, ast.ClassDef | ast.FunctionDef)
    ):
        for node, after in zip(body, [*body[1:], None], strict=True):
            if not isinstance(node, ast.AnnAssign | ast.Assign):
                continue
            target = node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
            name = ast.unparse(target).removeprefix("self.")
            doc = _doc_node(after)
            if not name.startswith("_") and name.isidentifier() and (doc or (is_tuple and not doc)):
                found.append(f"**`{name}`**{': ' if doc else ''}{_text(doc)}")
    return found


def _doc_node(node: ast.stmt | None) -> str:
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return inspect.cleandoc(str(node.value.value))
    return ""


def _function(name: str, function: object, level: str) -> str:
    return f"{level} {name}\n\n{_code(name, function)}\n\n{_text(function.__doc__)}"


def _code(name: str, function: object) -> str:
    """The signature as a block of code, a parameter in each line if it is long."""
    signature = inspect.signature(function)  # type: ignore[arg-type]
    parameters = [one for key, one in signature.parameters.items() if key != "self"]
    signature = signature.replace(parameters=parameters)
    text = f"{name}{signature}".replace("'", "")
    text = re.sub(r"= <?(tcp:[^,)]*)", r'= "\1"', text)
    text = re.sub(r"= (rtu(?:@[\w-]+)?|auto|image|last|recorded)\b", r'= "\1"', text)
    text = text.removesuffix(" -> None") if name.startswith("mbtool.") else text
    if len(text) > _WIDTH:
        begin, _, rest = text.partition("(")
        inside, _, end = rest.rpartition(")")
        lines = re.split(r", (?=[\w*]+(?:[:,]|$))", inside)
        text = "\n".join((f"{begin}(", *(f"    {one}," for one in lines), f"){end}"))
    return f"```python\n{text}\n```"


def _summary(value: object) -> str:
    return _text(value.__doc__).partition("\n\n")[0].replace("\n", " ")


def _text(doc: str | None) -> str:
    return inspect.cleandoc(doc or "")


if __name__ == "__main__":
    PAGE.write_text(written_page(PAGE.read_text()))
