"""The entry of the command line: mbtool COMMAND."""

# Each command has a file of its own, named below. It imports modules that are slow to load only
# when it runs, calls a workflow and prints the result. Only this file turns errors into a line and
# an exit code.
#
# Python's collector of cyclic garbage runs less often than usual: a decoder makes many objects, and
# few cycles among them. stats of a large file then takes 7 % less time.
#
# Help is printed without the library rich, which would take words in brackets as markup.

from __future__ import annotations

import errno
import gc
import inspect
import os
import shutil
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from importlib import import_module
from importlib.machinery import SourceFileLoader
from io import TextIOWrapper
from pathlib import Path
from threading import Timer
from types import CodeType
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command, get_group

from mbtool.cli import exit_codes
from mbtool.cli.command import Command, with_plain_values
from mbtool.cli.completion import COMPLETE, is_asked, join_words
from mbtool.cli.examples import examples_of, first_steps
from mbtool.cli.talk import Interrupted, say
from mbtool.core import InputError, LinkError, MbtoolError, OutputError, UsageError
from mbtool.version import __version__

_WRITE_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EBADF, errno.EFBIG)
"""The errno values with which the system refuses to write to a file that is already open."""


class _Root(TyperGroup):
    """The group of all commands, each loaded when it is called."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self._table = CommandTable()
        commands: Any = self._table
        self.commands = commands

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        commands, self.commands = self.commands, self._table.listed()
        super().format_commands(ctx, formatter)
        self.commands = commands

    def get_params(self, ctx: Any) -> list[Any]:
        return with_plain_values(super().get_params(ctx))

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, with_shell(args))


app = typer.Typer(
    cls=_Root,
    name="mbtool",
    help="Capture, decode and replay Modbus: serial lines, TCP, and the devices' own words.",
    rich_markup_mode=None,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"mbtool {__version__}")
        raise typer.Exit


_AGAIN_S = 0.02
"""Time in seconds after which an ignored Ctrl-C is repeated; the finalizer has ended by then."""
NEW_OBJECTS = 20_000
"""The garbage collector runs when there are this many more objects that can be part of a cycle."""


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_version, is_eager=True)
    ] = False,
    install_completion: Annotated[
        str | None,
        typer.Option(
            INSTALL,
            metavar="[SHELL]",
            help="Let bash, zsh, fish, powershell or pwsh complete. [default: this shell]",
            callback=install,
            is_eager=True,
        ),
    ] = None,
    show_completion: Annotated[
        str | None,
        typer.Option(
            SHOW,
            metavar="[SHELL]",
            help="Print the script for it, to look at or change it.",
            callback=show,
            is_eager=True,
        ),
    ] = None,
) -> None:
    if context.invoked_subcommand is None:
        for line in first_steps():
            say(line)
        raise typer.Exit(exit_codes.USAGE)


def main() -> None:
    """Run the command line and exit with its code."""
    if is_asked():
        from typer._completion_classes import completion_init

        join_words(os.environ)
        completion_init()
        get_command(app).main(prog_name="mbtool")
    gc.set_threshold(NEW_OBJECTS, *gc.get_threshold()[1:])
    _open_standard_descriptors()
    # If a stream was closed before the program began, it is None; its output is dropped.
    sys.stdout = sys.stdout or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    sys.stderr = sys.stderr or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    # On a terminal without Unicode, print escapes such as \xe4 instead of raising an error.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    # During the command, SIGTERM and SIGHUP (the terminal is gone) interrupt like Ctrl-C, so the
    # command completes its open files. After the command no file is open, so these signals end the
    # process at once, with the command's exit code. Ctrl-C is ignored then, since it could
    # interrupt the interpreter's exit and replace that code. SIGHUP stays ignored under nohup.
    hangup = getattr(signal, "SIGHUP", signal.SIGINT)  # Windows has no SIGHUP.
    sys.unraisablehook = _interrupt_again
    try:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        for number in (signal.SIGINT, hangup):
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, signal.default_int_handler)
        code = run(sys.argv[1:])
    except KeyboardInterrupt:  # It came before the command or after it.
        say("interrupted")
        code = exit_codes.INTERRUPTED
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in (signal.SIGTERM, hangup):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, lambda *_: os._exit(code))
    # If Ctrl-C interrupts code that Python runs from a string, as dataclasses do, Python later ends
    # by SIGINT and not with the exit code. Running another string prevents that.
    exec("")
    sys.exit(code)


def _interrupt_again(ignored: sys.UnraisableHookArgs) -> None:
    """Repeat Ctrl-C if Python has ignored it, as it does in a finalizer or a weak reference's call.

    Any other ignored exception is printed, except that of an event loop which could not be made:
    why it could not is an error of its own.
    """
    if issubclass(ignored.exc_type, KeyboardInterrupt):
        Timer(_AGAIN_S, _interrupt_process).start()
    elif getattr(ignored.object, "__qualname__", "") != "BaseEventLoop.__del__":
        sys.__unraisablehook__(ignored)


def _interrupt_process() -> None:
    """Send Ctrl-C to the process, so that it also ends a call in which the main thread waits."""
    if sys.platform == "win32":  # There, os.kill ends the process.
        signal.raise_signal(signal.SIGINT)
    else:
        os.kill(os.getpid(), signal.SIGINT)


def _open_standard_descriptors() -> None:
    """Open the null device for each standard stream that is closed.

    Otherwise the next file that is opened would get the descriptor 0, 1 or 2 of that stream.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # The system uses the lowest free descriptor.


def run(arguments: list[str]) -> int:
    """Run one command, flush standard output, and return the exit code."""
    code = _run_command(arguments)
    try:
        sys.stdout.flush()
    except OSError as error:
        # Redirect standard output to nowhere. Otherwise the interpreter would flush it again when
        # it ends, and fail again.
        with suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError) and code != exit_codes.UNREADABLE:
            return _report_os_error(error)
    return code


def _run_command(arguments: list[str]) -> int:
    """Run one command, print its error if it raises one, and return the exit code."""
    root = get_command(app)
    try:
        with root.make_context("mbtool", arguments) as context:
            root.invoke(context)
    except typer.Exit as end:
        return end.exit_code
    except typer.TyperException as error:
        commands = root.commands if isinstance(root, TyperGroup) else {}
        path = ["mbtool", *(name for name in arguments[:1] if name in commands)]
        return _fail(_usage(error, " ".join(path)), exit_codes.USAGE)
    except (InputError, LinkError, OutputError) as error:
        return _fail(str(error), exit_codes.UNREADABLE)
    except MbtoolError as error:
        return _fail(str(error), exit_codes.USAGE)
    except Interrupted:
        return exit_codes.INTERRUPTED
    except (KeyboardInterrupt, typer.Abort):
        say("interrupted")
        return exit_codes.INTERRUPTED
    except BrokenPipeError:
        return exit_codes.DONE  # The reader of the output, such as head, has closed it.
    except OSError as error:
        return _report_os_error(error)
    return exit_codes.DONE


_SETTINGS = {
    "--link": "recorded bytes have them in --link rtu@19200-8E1",
    "--settings": "they are part of --settings 19200-8E1",
    "": "they are part of the LINK: rtu:/dev/ttyUSB0@19200-8E1",
}
_ELSEWHERE = {
    "--unit": {"--where": "choose a unit with --where 'unit == 5'"},
    "--function": {"--where": "choose functions with --where 'function in (3, 4)'"},
    "--filter": {"--where": "choose transactions with --where 'unit == 5'"},
    "--since": {"--start": "choose a time with --start"},
    "--until": {"--end": "choose a time with --end"},
    "--baud": _SETTINGS,
    "--baudrate": _SETTINGS,
    "--parity": _SETTINGS,
}
"""Advice for options that other programs have. Each maps to the mbtool option that does the same
and the advice. The advice is given only if the called command has this option; "" always holds."""


def _advice_for_foreign_option(option: str | None, context: typer.Context | None) -> str | None:
    """Return the advice in _ELSEWHERE for an option that the called command does not have.

    Returns None if there is no advice. `context` belongs to the called command.
    """
    parameters = context.command.params if context is not None else []
    own = {name for one in parameters for name in one.opts} | {""}
    return next(
        (text for name, text in _ELSEWHERE.get(option or "", {}).items() if name in own), None
    )


def _usage(error: typer.TyperException, command: str) -> str:
    """Return the message about a wrong command line; it ends with the command's --help.

    `command` is named if the error does not say in which command it arose.
    """
    message = error.format_message().replace("Value error, ", "").rstrip(".")
    context = getattr(error, "ctx", None)
    if context is not None and context.command.hidden:
        context = context.parent
    where = context.command_path if context is not None else command
    wanted = getattr(error, "option_name", None)
    if (instead := _advice_for_foreign_option(wanted, context)) is not None:
        message = f"{message.partition(' (')[0]}; {instead}"
    examples = examples_of(where)
    if message.startswith("Missing ") and examples is not None:
        message = f"{message}; for example: {examples.first}"
    return f"{message}; see {where} --help"


def _report_os_error(error: OSError) -> int:
    """Print an error of the operating system, usually from writing to standard output.

    Returns the exit code.
    """
    if error.errno in (errno.EMFILE, errno.ENFILE):
        message = "too many files are open; allow more with `ulimit -n 1024`"
    elif error.errno == errno.ENOENT and not _has_folder():
        message = "the current folder has been deleted; change to one that is there"
    elif error.filename is not None or error.errno not in _WRITE_ERRORS:
        message = str(error)
    else:
        message = f"standard output: cannot be written: {error.strerror}"
    return _fail(message, exit_codes.UNREADABLE)


def _has_folder() -> bool:
    try:
        os.getcwd()
    except OSError:
        return False
    return True


def _fail(message: str, code: int) -> int:
    """Print an error as one line; return `code`, the exit code."""
    say(f"mbtool: {' '.join(message.split())}", is_error=True)
    return code


# The commands of mbtool by name; the module of a command is imported when it is looked up.
#
# Importing all commands takes as long as decoding a small file. So a command line imports only the
# command that it names. The help of mbtool itself, which lists all, needs the docstrings of their
# functions only; it takes these from the compiled modules, without running them.

_MODULES = {
    **{name: name for name in ("sniff", "status", "decode", "inventory", "check", "stats")},
    **{name: name for name in ("watch", "report", "plot", "convert", "recover", "replay", "diff")},
    "slave": "slave",
    "read": "ask",
    "write": "ask",
    "poll": "poll",
    "scan": "scan",
    "test": "conformance",
    "find": "find",
    "devices": "devices",
    **{name: name for name in ("links", "doctor", "line", "demo", "extcap")},
}
"""The module of this package that has a command's function, by command in the order of the help."""

# Newer versions of Wireshark give options that mbtool does not know; they are ignored.
# A negative number is no option of find.
_CONTEXT_SETTINGS = {
    "find": {"ignore_unknown_options": True},
    "extcap": {"ignore_unknown_options": True, "allow_extra_args": True},
}


class CommandTable(Mapping[str, Any]):
    """Maps the name of each command to its typer command, and loads it at the first look-up."""

    def __init__(self) -> None:
        self._loaded: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._loaded:
            self._loaded[name] = _load(name, _MODULES[name])
        return self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        return iter(_MODULES)

    def __len__(self) -> int:
        return len(_MODULES)

    def __contains__(self, name: object) -> bool:
        return name in _MODULES

    def listed(self) -> dict[str, Any]:
        """Return commands that have the right names and help texts, but no options: enough for a
        list of them.
        """
        found = {}
        for name, module in _MODULES.items():
            text = _docstring(name, module)
            found[name] = self[name] if text is None else TyperCommand(name, help=text)
        return found


def _docstring(name: str, module: str) -> str | None:
    """Return the docstring of the function of a command; None if it has none."""
    full = f"{__package__}.{module}"
    compiled = SourceFileLoader(full, str(Path(__file__).with_name(f"{module}.py"))).get_code(full)
    for code in () if compiled is None else compiled.co_consts:
        if isinstance(code, CodeType) and code.co_name == name and code.co_consts:
            text = code.co_consts[0]
            return inspect.cleandoc(text) if isinstance(text, str) else None
    return None


def _load(name: str, module: str) -> Any:
    function = getattr(import_module(f"mbtool.cli.{module}"), name)
    app = typer.Typer(rich_markup_mode=None)
    if isinstance(function, typer.Typer):  # It has subcommands.
        app.add_typer(function, name=name)
    else:
        app.command(name, cls=Command, context_settings=_CONTEXT_SETTINGS.get(name))(function)
    return get_group(app).commands[name]


# The code below prints or installs the script with which a shell completes: --install-completion
# [SHELL].
#
# The scripts are those of the library typer. Its own options take no SHELL where it can detect the
# shell, and ignore the word behind them.

INSTALL, SHOW = "--install-completion", "--show-completion"
_PROGRAM = "mbtool"
_THIS_SHELL = "this"
_SHELLS = ("bash", "zsh", "fish", "powershell", "pwsh")


def with_shell(args: Sequence[str]) -> list[str]:
    """Put a word behind --install-completion and --show-completion if no SHELL stands there."""
    made: list[str] = []
    for at, one in enumerate(args):
        made.append(one)
        if one in (INSTALL, SHOW) and args[at + 1 : at + 2] in ([], ["-h"], ["--help"]):
            made.append(_THIS_SHELL)
    return made


def install(shell: str | None) -> None:
    if shell is None:
        return
    from typer._completion_shared import install as install_script

    name = _chosen_shell(INSTALL, shell)
    if name in ("powershell", "pwsh") and shutil.which(name) is None:
        raise UsageError(f"{INSTALL} {name}: there is no {name} on this machine")
    _, path = install_script(shell=name, prog_name=_PROGRAM, complete_var=COMPLETE)
    typer.echo(f"{path}: written; {name} completes mbtool in the next terminal")
    raise typer.Exit


def show(shell: str | None) -> None:
    if shell is None:
        return
    from typer._completion_shared import get_completion_script

    name = _chosen_shell(SHOW, shell)
    script = get_completion_script(prog_name=_PROGRAM, complete_var=COMPLETE, shell=name)
    typer.echo(script)
    raise typer.Exit


def _chosen_shell(option: str, shell: str) -> str:
    """Return the name of the shell that the user named, or of the one in which mbtool runs.

    Raises UsageError if completion is not known for that shell.
    """
    from typer._completion_shared import _get_shell_name

    name = _get_shell_name() if shell == _THIS_SHELL else shell
    if name not in _SHELLS:
        which = "this shell is not known" if name is None else f"there is none for {name}"
        raise UsageError(f"{option}: {which}; name one of {', '.join(_SHELLS)}")
    return name
