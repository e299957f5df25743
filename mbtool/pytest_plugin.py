"""pytest fixtures for tests of programs that speak Modbus; docs/pytest.md describes them."""

# Each fixture is a function that makes a slave, a replay or a line, and ends it after the test. A
# slave listens on a TCP port of its own that the system chooses, so tests may run at the same time
# (pytest-xdist).
#
# If a test fails, the traffic of its slaves is written to logs before the slaves end, and a section
# of the report shows the last requests and where the logs are. A test that passes writes nothing.
#
# pytest loads this file at each start, so the fixtures import the rest of mbtool only when used.

from __future__ import annotations

import re
import shlex
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, cast

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator

    import mbtool

_Shell = TypeVar("_Shell", bound="mbtool.ObservedShell")

_OPTION = "--mbtool-logs"
_LAST_LINES = 20
"""The report of a failed test shows at most this many of the last requests to each slave."""
_NAME_LENGTH = 100
_SLAVES = pytest.StashKey["list[mbtool.ObservedShell]"]()
_FOLDER = pytest.StashKey[Path]()


class MakesSlave(Protocol):
    """The type of the fixture `mbtool_slave`, which takes the arguments of `mbtool.Slave`."""

    def __call__(self, profile: Any, /, on: str = ..., **options: Any) -> mbtool.Slave: ...


class MakesReplay(Protocol):
    """The type of the fixture `mbtool_replay`, which takes the arguments of `mbtool.Replay`."""

    def __call__(self, path: Any, /, on: str = ..., **options: Any) -> mbtool.Replay: ...


class MakesLine(Protocol):
    """The type of the fixture `mbtool_line`, which takes the arguments of `mbtool.line`."""

    def __call__(self, settings: str = ..., *, ends: int = ...) -> mbtool.SerialBench: ...


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.getgroup("mbtool").addoption(
        _OPTION,
        metavar="FOLDER",
        type=Path,
        help="Where the traffic of failed tests is kept. [default: pytest's temporary folder]",
    )


@pytest.fixture
def mbtool_slave(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[MakesSlave]:
    """Make slaves that answer during the test: `mbtool_slave("idec-ft1a-touch", image={...})`."""
    from mbtool.api.slaves import LOOPBACK, Slave

    with ExitStack() as ends:

        def make(profile: Any, /, on: str = LOOPBACK, **options: Any) -> mbtool.Slave:
            __tracebackhide__ = True
            _demand_known("mbtool_slave", Slave, options)
            for name in ("image", "faults"):
                if isinstance(options.get(name), str | Path):
                    options[name] = _beside(request, options[name])
            if isinstance(profile, str | Path) and str(profile).endswith(".toml"):
                profile = _beside(request, profile)
            return _start_slave(
                lambda: Slave(profile, on, **options), request, tmp_path_factory, ends
            )

        yield make


@pytest.fixture
def mbtool_replay(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[MakesReplay]:
    """Let a recording answer during the test: `mbtool_replay("site.mcap", match="image")`.

    The file is looked for beside the test's file, then in the current directory.
    """
    from mbtool.api.slaves import LOOPBACK, Replay

    with ExitStack() as ends:

        def make(path: Any, /, on: str = LOOPBACK, **options: Any) -> mbtool.Replay:
            __tracebackhide__ = True
            _demand_known("mbtool_replay", Replay, options)
            if isinstance(options.get("faults"), str | Path):
                options["faults"] = _beside(request, options["faults"])
            recording = _beside(request, path)
            return _start_slave(
                lambda: Replay(recording, on, **options), request, tmp_path_factory, ends
            )

        yield make


@pytest.fixture
def mbtool_line() -> Iterator[MakesLine]:
    """Make virtual serial lines, with `line.ports` and `line.link(0)`."""
    from mbtool.api.serial_bench import line

    with ExitStack() as opened:

        def make(settings: str = "rtu", *, ends: int = 2) -> mbtool.SerialBench:
            return opened.enter_context(line(settings, ends=ends))

        yield make


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Write the traffic of a failed test to logs, and add a section about it to the report.

    The test's slaves still run at this moment.
    """
    report = yield
    slaves = item.stash.get(_SLAVES, None)
    if report.failed and slaves and report.when != "teardown":
        text = "\n".join(
            _save_traffic(item, number, slave) for number, slave in enumerate(slaves, start=1)
        )
        report.sections.append(("Modbus traffic", text))
    return report


def _start_slave(
    make: Callable[[], _Shell],
    request: pytest.FixtureRequest,
    factory: pytest.TempPathFactory,
    ends: ExitStack,
) -> _Shell:
    """Start a slave, and remember it for the report and for the end of the test.

    An error of mbtool is one clear line, so it is raised without the traceback of mbtool's own
    calls.
    """
    __tracebackhide__ = True
    from mbtool.core.errors import MbtoolError

    try:
        slave = ends.enter_context(cast("Any", make()))
    except MbtoolError as error:
        raise error.with_traceback(None) from None
    item = request.node
    item.stash.setdefault(_SLAVES, []).append(slave)
    if _FOLDER not in item.stash:
        item.stash[_FOLDER] = request.config.getoption(_OPTION) or factory.getbasetemp() / "mbtool"
    return cast("_Shell", slave)


def _save_traffic(item: pytest.Item, number: int, slave: mbtool.ObservedShell) -> str:
    """Write the traffic of a slave to a log, and return the slave's text for the test report.

    `number` is the slave's number in the test, from 1; it is part of the log's name.
    """
    import mbtool

    lines = slave.lines()
    if not lines:
        return f"{slave.link}: no request came"
    path = item.stash[_FOLDER] / log_name(item.nodeid, number)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        slave.save_log(path)
        where = f"mbtool decode {shlex.quote(str(path))}"
    except (OSError, mbtool.MbtoolError) as error:
        where = f"no log was kept: {error}"
    shown = lines[-_LAST_LINES:]
    more = "" if len(shown) == len(lines) else f", the last {len(shown)}"
    count = len(slave.asked)
    heading = f"{slave.link}: {count} request{'s' * (count != 1)}{more}; {where}"
    return "\n".join((heading, *(f"  {one}" for one in shown)))


def log_name(test: str, number: int) -> str:
    """Return the file name of a log, unique for each test: `test_a.py-test_b-x-1-5b1f03d2-1.mcap`.

    Characters that do not belong in a file name are replaced, which may make the names of two tests
    equal. So the name gets eight hexadecimal digits of a hash of the test's full name.
    """
    from hashlib import sha256

    readable = re.sub(r"[^\w.-]+", "-", test)[-_NAME_LENGTH:].strip("-")
    return f"{readable}-{sha256(test.encode()).hexdigest()[:8]}-{number}.mcap"


def _demand_known(fixture: str, made: type, options: dict[str, Any]) -> None:
    """Raise TypeError for a name in `options` that is no argument of the class `made`.

    The message begins with the name of the fixture, and suggests a similar name.
    """
    __tracebackhide__ = True
    from difflib import get_close_matches
    from inspect import signature

    known = list(signature(made).parameters)[1:]
    for name in options:
        if name not in known:
            near = get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(known)}"
            raise TypeError(f"{fixture}() has no argument {name!r}; {hint}")


def _beside(request: pytest.FixtureRequest, path: Any) -> Path:
    """Return `path` in the folder of the test's file if a file is there; else `path` as given."""
    beside = request.path.parent / path
    return beside if beside.exists() else Path(path)
