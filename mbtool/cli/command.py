"""A typer command whose help shows arguments as users write them: FILE, FILE..., [PATH]..."""

# typer shows the Python type behind each argument (FILE <list[str]>) and puts braces around it in
# the usage line. A metavar changes neither of these, so this class writes the help's arguments and
# usage line itself.
#
# typer converts values with pydantic, even texts and options that are not given. Loading pydantic
# takes a third of the time of a command that reads a small file. So _PlainValues converts texts and
# choices, and gives typer only other types and wrong values.

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Any, Literal, get_args, get_origin

from typer import BadParameter
from typer.core import TyperArgument, TyperCommand

from mbtool.cli.completion import is_asked, with_completed_values
from mbtool.cli.examples import examples_of
from mbtool.core import UsageError

_NUMBERS = {
    "Input should be a valid integer": "a whole number",
    "Input should be a valid number": "a number",
    "Input should be greater than or equal to": "at least",
    "Input should be less than or equal to": "at most",
}
"""The beginnings of pydantic's messages about a wrong number, and the words that replace them."""


_NO_NUMBERS = ("nan", "+nan", "-nan")
"""Texts that Python reads as a number which is neither below nor above any other."""
_FIRST_SECTION = "Options"
"""The heading in the help above options that have no other heading."""


def _heading(param: Any) -> str:
    return getattr(param, "rich_help_panel", None) or _FIRST_SECTION


def write_examples(context: Any, formatter: Any) -> None:
    """End the help of a command with its examples and the name of its documentation page."""
    examples = examples_of(context.command_path)
    if examples is None:
        return
    with formatter.section("Examples"):
        for line in examples[1:]:
            formatter.write(f"  {line}\n")
    formatter.write(f"\nMore: docs/{examples.page}.md\n")


class Command(TyperCommand):
    """The class of every command: `app.command(cls=Command)`."""

    def get_params(self, ctx: Any) -> list[Any]:
        params = with_plain_values(super().get_params(ctx))
        return with_completed_values(params, ctx.info_name) if is_asked() else params

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, with_plain_json(self.params, args))

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        options = [self.options_metavar] if self.options_metavar else []
        return [*options, *(_written(argument) for argument in self._arguments())]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        arguments = [
            (_written(argument), record[1])
            for argument in self._arguments()
            if (record := argument.get_help_record(ctx)) is not None
        ]
        if arguments:
            with formatter.section("Arguments"):
                formatter.write_dl(arguments)
        own = {name: one for one in self.params for name in one.opts}
        name = _json_name(own)
        sections: dict[str, list[tuple[str, str]]] = {_FIRST_SECTION: []}
        for param in self.get_params(ctx):
            record = param.get_help_record(ctx)
            if isinstance(param, TyperArgument) or record is None:
                continue
            options = sections.setdefault(_heading(param), [])
            options.append(record)
            if "--format" in param.opts and name is not None and "--json" not in own:
                options.append(("--json", f"Short for --format {name}."))
        for heading, options in sections.items():
            with formatter.section(heading):
                formatter.write_dl(options)
        write_examples(ctx, formatter)

    def _arguments(self) -> list[TyperArgument]:
        return [param for param in self.params if isinstance(param, TyperArgument)]


def with_plain_json(params: Sequence[Any], args: Sequence[str]) -> list[str]:
    """Replace --json and --format json by the option with which this command prints JSON.

    That is --format json, or --format jsonl for a command that prints only JSON lines, or --json. A
    command that has only --json accepts --format table, too, and ignores it. Raises UsageError if
    --json is given with another format.
    """
    options = {name: one for one in params for name in one.opts}
    name = _json_name(options)
    if name is None:
        return [*args]
    has_flag = "--json" in options
    plain = ["--json"] if has_flag else ["--format", name]
    made: list[str] = []
    left = iter(args)
    has_json, other = False, None
    for one in left:
        if one == "--":
            made += [one, *left]
            break
        value = next(left, None) if one == "--format" else one.removeprefix("--format=")
        if one == "--json":
            has_json = True
        elif one.startswith("--format") and value not in ("json", name):
            other = value
        if one != "--json" and not one.startswith("--format"):
            made.append(one)
        elif one == "--json" or value == "json":
            made += plain
        elif not has_flag or value != "table":
            made += [one] if one != "--format" or value is None else [one, value]
    if has_json and other is not None and not is_asked():
        raise UsageError(f"--json and --format {other} exclude each other")
    return made


def _json_name(options: dict[str, Any]) -> str | None:
    """Return the value of --format that prints JSON; None for a command that prints no JSON."""
    if "--json" in options:
        return "json"
    if "--format" not in options:
        return None
    choices = [str(one) for one in _choices(options["--format"])]
    return next((one for one in ("json", "jsonl") if one in choices), None)


def _choices(option: Any) -> Sequence[object]:
    """Return the values of an option whose type is an Enum or a Literal, also if it may be None."""
    type_ = option.type_descriptor.annotation
    for part in (type_, *get_args(type_)):
        if isinstance(part, type) and issubclass(part, Enum):
            return list(part)
        if get_origin(part) is Literal:
            return get_args(part)
    return ()


def with_plain_values(params: list[Any]) -> list[Any]:
    """Let typer convert the values of texts and choices without pydantic, which is slow to load."""
    for param in params:
        if param._runtime_param is None:
            param._runtime_param = _PlainValues()
    return params


class _PlainValues:
    """Converts the values of one parameter; typer calls it in place of pydantic."""

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """Convert a value of the command line to the parameter's type; the arguments are typer's.

        `value` is None for an option that was not given, else a text or several texts.
        """
        is_several = param.multiple or param.nargs == -1
        if value is None:
            return () if is_several else None
        type_ = param.type_descriptor.annotation
        if type_ is str and not is_several:
            return value
        if type_ == list[str]:
            return list(value)
        if isinstance(type_, type) and issubclass(type_, Enum) and value in list(type_):
            return type_(value)
        param._runtime_param = None  # typer then makes its own converter.
        try:
            return param.get_runtime_param().coerce(value, param=param, ctx=ctx)
        except BadParameter as error:
            error.message = _in_plain_words(error.message, value)
            raise


def _in_plain_words(message: str, value: Any) -> str:
    """Return pydantic's message about the wrong `value` in plain words, for the user."""
    if str(value).lower() in _NO_NUMBERS:
        return f"{value!r} is not a number"
    for beginning, words in _NUMBERS.items():
        if message.startswith(beginning):
            return f"{value!r} is not {words}{message.removeprefix(beginning).partition(',')[0]}"
    return message


def _written(argument: TyperArgument) -> str:
    name = argument.display_name_raw
    several = "..." if argument.nargs != 1 else ""
    return f"{name}{several}" if argument.required else f"[{name}]{several}"
