"""A command whose help shows arguments as a user writes them: FILE, FILE..., [PATH]..."""

# typer shows the Python type behind each argument (FILE <list[str]>) and puts braces around it in
# the usage line. A metavar changes neither, so this class writes both.

from __future__ import annotations

from typing import Any

from typer.core import TyperArgument, TyperCommand


class Command(TyperCommand):
    """The class of every command: `app.command(cls=Command)`."""

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
        options = [
            record
            for param in self.get_params(ctx)
            if not isinstance(param, TyperArgument)
            and (record := param.get_help_record(ctx)) is not None
        ]
        with formatter.section("Options"):
            formatter.write_dl(options)

    def _arguments(self) -> list[TyperArgument]:
        return [param for param in self.params if isinstance(param, TyperArgument)]


def _written(argument: TyperArgument) -> str:
    name = argument.display_name_raw
    several = "..." if argument.nargs != 1 else ""
    return f"{name}{several}" if argument.required else f"[{name}]{several}"
