"""mbtool scan: find the units on a link, and the registers that each lets read."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli import exit_codes
from mbtool.cli.ask_options import ListenOption, RecordOption, TimeoutOption, listen_ns, recorded
from mbtool.cli.option_groups import with_option_groups
from mbtool.cli.options import ListFormat
from mbtool.cli.output_file import demand_writable
from mbtool.cli.profile_files import demand_new, give, is_file
from mbtool.cli.talk import Interrupt, interruptible, say, shown_progress
from mbtool.cli.tls_options import TargetTlsOptions
from mbtool.core import InputError, LinkError, LinkSpec, TcpLink, UsageError, parse_link
from mbtool.core.errors import reason_of
from mbtool.core.link_spec import ANSWERED
from mbtool.core.numbers import parse_number
from mbtool.core.replacing import replace_content

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction
    from mbtool.master.links import MasterLink
    from mbtool.workflows.scan import FoundUnit, Scan, ScanState

_UNITS = range(256)
_ADDRESSES = range(0x10000)
_NETWORK = re.compile(r"(?P<scheme>(?:rtu\+)?tcp:)(?P<network>[0-9.]+/\d+)(?P<port>:\d+)?")
_MOST_HOSTS = 1024
_HEXADECIMAL = re.compile(r"0x[0-9a-f]{1,4}", re.IGNORECASE)
_MOST_RESUMED_BYTES = 16 << 20
"""A larger file of --resume is refused: this program wrote none."""
_WORDS = {
    "holding_registers": "holding",
    "input_registers": "input",
    "coils": "coil",
    "discrete_inputs": "discrete",
}


@with_option_groups
def scan(
    links: Annotated[
        list[str],
        typer.Argument(
            metavar="LINK",
            help="Where to ask: rtu:PORT@19200-8E1, ascii:PORT@9600-7E1, tcp:HOST:PORT or "
            "rtu+tcp:HOST:PORT; of a network tcp:10.0.0.0/28:502.",
        ),
    ],
    *,
    units: Annotated[
        str,
        typer.Option("--units", metavar="RANGE", help="The units to ask, as in 1..20,40."),
    ] = "1..247",
    addresses: Annotated[
        str,
        typer.Option(
            "--addresses",
            metavar="RANGE",
            help="The addresses to read in each table, on the wire, from 0: 0..9999, 0x10..0x1f.",
        ),
    ] = "0..9999",
    units_only: Annotated[
        bool, typer.Option("--units-only", help="Find units, and read no registers.")
    ] = False,
    every: Annotated[
        bool,
        typer.Option(
            "--every",
            help="Try each address. Without it, areas are looked for at multiples of 10 and of 16.",
        ),
    ] = False,
    rate: Annotated[
        float,
        typer.Option(
            "--rate",
            metavar="N",
            min=0.01,
            max=10_000,
            help="Send at most so many requests in 1 s.",
        ),
    ] = 50.0,
    timeout: TimeoutOption = 0.3,
    listen: ListenOption = None,
    between: Annotated[
        bool, typer.Option("--between", help="Send only in the pauses of another master.")
    ] = False,
    resume: Annotated[
        Path | None,
        typer.Option(
            "--resume", metavar="FILE", help="Keep what is found in FILE, and go on from there."
        ),
    ] = None,
    output: Annotated[
        str | None,
        typer.Option("-o", "--output", metavar="FILE.toml", help="Write a profile of the unit."),
    ] = None,
    record: RecordOption = None,
    overwrite: Annotated[
        bool,
        typer.Option("--overwrite", help="Replace the files of --output and --record, if any."),
    ] = False,
    format_: Annotated[ListFormat, typer.Option("--format", help="How to print.")] = "table",
    tls: TargetTlsOptions,
) -> None:
    """Find units on a link, and their registers.

    Each unit is asked for a register, an echo and its identification; any answer counts, also a
    refusal. Only reads are sent, never a write. Exit 1 if no unit answers.
    """
    from mbtool.logs.opening import check_log_path
    from mbtool.master.links import open_master

    numbers = parse_ranges(units, "--units", _UNITS)
    (asked_addresses, *more) = _spans(addresses, "--addresses", _ADDRESSES)
    if more:
        raise UsageError(f"--addresses {addresses}: name one range, as in 0..9999")
    specs = [parse_link(one, ANSWERED) for text in links for one in _hosts(text)]
    if len(specs) > 1 and (resume or output or record):
        raise UsageError("--resume, --record and -o are for one LINK")
    if output is not None:
        demand_new(output, overwrite=overwrite)
    if record is not None:
        check_log_path(record, overwrite=overwrite)
    target = tls.target()
    found: list[ScanState] = []
    refused: LinkError | None = None
    with interruptible() as interrupt:
        for spec in specs:
            state = _state(resume, spec, numbers, None if units_only else asked_addresses)
            try:
                with (
                    open_master(spec, round(timeout * 1e9), say, target) as master,
                    recorded(master, spec, record, overwrite=overwrite),
                ):
                    master.take_line(listen_ns(listen), between=between)
                    runner = _Runner(master, spec, state, interrupt, resume, timeout)
                    runner.run(numbers, None if units_only else asked_addresses, rate, every=every)
                    if output is not None and not interrupt.asked:
                        runner.write_profile(output, overwrite=overwrite)
            except LinkError as error:
                refused = error
            found.append(state)
            if interrupt.asked:
                break
    _print(found, format_)
    for state in found:
        for remark in state.remarks:
            say(f"mbtool: {state.link}: {remark}")
    if refused is not None and len(specs) == 1:
        raise refused
    count = sum(len(state.units) for state in found)
    if not count and refused is not None and len(specs) == len(found):
        say(f"mbtool: {refused}")
    if interrupt.asked:
        say("interrupted; what is printed was found until then")
        raise typer.Exit(exit_codes.INTERRUPTED)
    if not count:
        say("no unit answered")
        raise typer.Exit(exit_codes.NO)


def parse_ranges(text: str, option: str, allowed: range) -> list[int]:
    """Return the numbers of a text such as `1..20,40`, each once, in its order.

    Raises UsageError if the text is no list of numbers, or if a number is not in `allowed`.
    """
    return list(dict.fromkeys(at for span in _spans(text, option, allowed) for at in span))


def _spans(text: str, option: str, allowed: range) -> list[range]:
    spans = []
    for part in text.split(","):
        first, dots, last = part.strip().partition("..")
        begin = parse_number(_decimal(first), "number", allowed, option)
        end = parse_number(_decimal(last), "number", allowed, option) if dots else begin
        if end < begin:
            raise UsageError(f"{option} {part.strip()}: write the smaller number first")
        spans.append(range(begin, end + 1))
    return spans


def _decimal(text: str) -> str:
    return str(int(text, 16)) if _HEXADECIMAL.fullmatch(text) else text


def _hosts(text: str) -> list[str]:
    """Return the links of all hosts of a network, as in tcp:10.0.0.0/28:502; any other text as it
    is. Raises UsageError for a wrong network, or for more than 1,024 hosts.
    """
    match = _NETWORK.fullmatch(text)
    if match is None:
        return [text]
    try:
        network = ipaddress.ip_network(match["network"], strict=False)
    except ValueError as error:
        raise UsageError(f"{text}: {error}; write a network such as tcp:10.0.0.0/28:502") from error
    if network.num_addresses > _MOST_HOSTS:
        raise UsageError(f"{text}: {network.num_addresses:,} hosts, at most {_MOST_HOSTS:,}")
    return [f"{match['scheme']}{host}{match['port'] or ''}" for host in network.hosts()]


def _state(
    resume: Path | None, spec: LinkSpec, numbers: list[int], addresses: range | None
) -> ScanState:
    """Return what the file of --resume says, or an empty state if there is no file yet.

    Raises InputError if the file is none of --resume, or is of another scan; UsageError if it
    cannot be written.
    """
    import msgspec

    from mbtool.workflows.scan import ScanState

    span = None if addresses is None else (addresses.start, addresses.stop - 1)
    if resume is None or not resume.exists():
        if resume is not None:
            demand_writable(resume)
        return ScanState(link=str(spec), numbers=numbers, addresses=span)
    if not resume.is_file():
        raise InputError(f"--resume {resume}: is no regular file")
    try:
        with resume.open("rb") as stream:
            raw = stream.read(_MOST_RESUMED_BYTES + 1)
    except OSError as error:
        raise InputError(f"--resume {resume}: cannot be read: {reason_of(error)}") from error
    if len(raw) > _MOST_RESUMED_BYTES:
        raise InputError(
            f"--resume {resume}: is longer than {_MOST_RESUMED_BYTES >> 20} MiB, so a scan did not "
            "write it"
        )
    try:
        state = msgspec.json.decode(raw, type=ScanState)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputError(f"--resume {resume}: a scan did not write it: {error}") from error
    for what, kept, asked in (
        ("of", state.link, str(spec)),
        ("with --units", _ranges(state.numbers), _ranges(numbers)),
        ("with --addresses", state.addresses or span, span or state.addresses),
    ):
        if kept != asked:
            kept, asked = (each if isinstance(each, str) else _span(each) for each in (kept, asked))
            raise InputError(f"--resume {resume}: is {what} {kept}, and {asked} is asked for")
    demand_writable(resume)
    state.addresses = state.addresses or span
    return state


def _span(ends: tuple[int, int] | None) -> str:
    return "" if ends is None else f"{ends[0]}..{ends[1]}"


def _ranges(numbers: list[int]) -> str:
    """Return numbers as --units takes them: `1..20,40`."""
    spans: list[list[int]] = []
    for number in numbers:
        if spans and spans[-1][-1] + 1 == number:
            spans[-1][1:] = [number]
        else:
            spans.append([number])
    return ",".join("..".join(map(str, span)) for span in spans)


class _Runner:
    """Scans one link, keeps what is found, and shows how far it is."""

    def __init__(
        self,
        master: MasterLink,
        spec: LinkSpec,
        state: ScanState,
        interrupt: Interrupt,
        resume: Path | None,
        timeout_s: float,
    ) -> None:
        from mbtool.workflows.ask import Asker

        def ask(unit: int, pdu: bytes) -> NamedTransaction:
            return Asker(master, spec, unit, None).ask(pdu)[0]

        self._ask: Callable[[int, bytes], NamedTransaction] = ask
        self._spec = spec
        self.state = state
        self._interrupt = interrupt
        self._resume = resume
        self._timeout_ns = round(timeout_s * 1e9)

    def run(self, units: list[int], addresses: range | None, rate: float, *, every: bool) -> None:
        """Find the units, and with `addresses` their areas; end early after Ctrl-C."""
        from mbtool.workflows.scan import Scan

        work = Scan(
            self._ask,
            self.state,
            is_tcp=isinstance(self._spec, TcpLink),
            every=every,
            interval_ns=round(1e9 / rate),
            late_ns=self._timeout_ns,
        )
        with shown_progress() as show:
            for text in self._steps(work, units, addresses):
                show(f"{text}; {len(self.state.units)} found, {work.asked:,} requests")
                if self._resume is not None:
                    self._keep(self._resume)
                if self._interrupt.asked:
                    break

    def _steps(self, work: Scan, units: list[int], addresses: range | None) -> Iterator[str]:
        for unit in work.units(units):
            yield f"unit {unit}"
        if addresses is None:
            return
        for found in list(self.state.units):
            for table, at in work.scan_registers(found.unit, addresses):
                yield f"unit {found.unit}, {table.value} up to {at - 1}"

    def _keep(self, file: Path) -> None:
        import msgspec

        from mbtool.cli.output import as_output_error

        text = msgspec.json.format(msgspec.json.encode(self.state), indent=2)
        with as_output_error(str(file)):
            replace_content(file.resolve(), text)

    def write_profile(self, output: str, *, overwrite: bool) -> None:
        """Read all areas once more, and draft a profile from the answers."""
        from mbtool.devices.profile_template import name_for
        from mbtool.values.draft import draft_profile
        from mbtool.workflows.scan import final_reads
        from mbtool.workflows.shared.observed_slaves import ObservedSlaves

        if not self.state.areas:
            say(f"mbtool: no registers can be read, so no profile is written to {output}")
            return
        units = {area.unit for area in self.state.areas}
        if len(units) > 1:
            raise UsageError(f"-o {output}: {len(units)} units have registers; add --units N")
        (unit,) = units
        slaves = ObservedSlaves(with_values=True)
        slaves.add(self._ask(unit, pdu) for pdu in final_reads(self.state, unit))
        name = name_for(output) if is_file(output) else f"unit-{unit}"
        drafted = draft_profile(slaves.only("--units"), name, str(self._spec))
        give(drafted.text, output, overwrite=overwrite)


def _print(found: list[ScanState], format_: ListFormat) -> None:
    """Print the units and areas found, as a table or as JSON lines."""
    if format_ == "jsonl":
        import msgspec

        for state in found:
            for one in state.units:
                areas = [area for area in state.areas if area.unit == one.unit]
                row = {
                    "link": state.link,
                    **msgspec.to_builtins(one),
                    "areas": [
                        {"table": area.table, "first": area.first, "last": area.last}
                        for area in areas
                    ],
                }
                typer.echo(msgspec.json.encode(row).decode())
        return
    from rich.text import Text

    from mbtool.cli.console import PipeConsole
    from mbtool.views.tables import plain, plain_table

    table = plain_table("link", "unit", "answer", "what can be read")
    for state in found:
        for unit in state.units:
            told = Text("\n").join(plain(line) for line in _lines(state, unit))
            number = "any" if unit.is_any else str(unit.unit)
            table.add_row(plain(state.link), number, plain(unit.sign), told)
    if table.row_count:
        PipeConsole().print(table)


def _lines(state: ScanState, unit: FoundUnit) -> list[str]:
    """Return the lines about what a unit is and what it lets read: `holding 0..9, 20`."""
    spans: dict[str, list[str]] = {}
    for area in state.areas:
        if area.unit == unit.unit:
            ends = dict.fromkeys((area.first, area.last))
            spans.setdefault(area.table, []).append("..".join(map(str, ends)))
    return [*unit.identity, *(f"{_WORDS[name]} {', '.join(spans[name])}" for name in spans)]
