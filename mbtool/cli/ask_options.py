"""The arguments and options that `mbtool read`, `write` and `poll` share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from mbtool.cli.options import Format, condition
from mbtool.cli.output_path import demand_new
from mbtool.cli.talk import say
from mbtool.cli.tls_options import TargetTlsOptions
from mbtool.core import LinkSpec, SerialLink, TargetTls, UsageError, parse_link
from mbtool.core.limits import RESPONSE_TIMEOUT_S
from mbtool.core.link_spec import ANSWERED
from mbtool.core.moments import DAY_NS, parse_duration
from mbtool.core.numbers import UNITS, parse_number, parse_unit

if TYPE_CHECKING:
    from mbtool.cli.output import RecordOutput
    from mbtool.devices import NamedTransaction, Profile
    from mbtool.master.links import MasterLink
    from mbtool.views.table_options import TableOptions
    from mbtool.workflows.ask import Asker
    from mbtool.workflows.shared.questions import Wording

LinkArgument = Annotated[
    str,
    typer.Argument(
        metavar="LINK",
        help="Where the slave is: rtu:PORT@19200-8E1, ascii:PORT@9600-7E1, tcp:HOST:PORT or "
        "rtu+tcp:HOST:PORT.",
    ),
]
ReferencesArgument = Annotated[
    list[str],
    typer.Argument(
        metavar="REFERENCE",
        help="What to read: HR400001..400010 or the name of a point, as the device's manual writes "
        "them (with --device); 'holding 0..9', 'coil 3', 'hr 0x10' by the address on the wire; "
        "0..9 with --function. A type may follow: hr10:f32cdab, 40011:u32, 'holding 0..9:i16'.",
    ),
]
ListenOption = Annotated[
    str | None,
    typer.Option(
        "--listen",
        metavar="TIME",
        help="On a serial line, listen first for so long, and send nothing if another master asks "
        "there. 0s: send at once. [default: 1s, or 5s if anything is heard]",
    ),
]
TimeoutOption = Annotated[
    float,
    typer.Option(
        "--timeout",
        metavar="S",
        min=0.001,
        max=3600,
        help="As the master: how long to wait for an answer, in seconds.",
    ),
]
RecordOption = Annotated[
    str | None,
    typer.Option(
        "--record",
        "-w",
        metavar="FILE.mcap",
        help="On a serial line: log all that is heard, our requests as a link of its own.",
    ),
]
_MOST_LISTEN_NS = DAY_NS


def listen_ns(text: str | None) -> int | None:
    """Parse the value of --listen; None if it is not given. Raises UsageError if it is no time up
    to a day.
    """
    return None if text is None else parse_duration(text, "--listen", 0, _MOST_LISTEN_NS)


@contextmanager
def recorded(
    master: MasterLink, link: LinkSpec, record: str | None, *, overwrite: bool
) -> Iterator[None]:
    """While the context is open, log the line of `master` to the file of --record, if there is one.

    Raises UsageError if the file cannot be created, or if the link is no serial line.
    """
    if record is None:
        yield
        return
    from mbtool.devices import Assignments
    from mbtool.master.links import SerialMaster
    from mbtool.workflows.shared.asked_log import AskedLog

    if not isinstance(link, SerialLink) or not isinstance(master, SerialMaster):
        raise UsageError(
            f"--record {record}: logs a serial line; on TCP, ask through a tap: mbtool sniff "
            "tap:LISTEN=TARGET -w FILE.mcap"
        )
    with AskedLog(record, link, Assignments([]), overwrite=overwrite) as log:
        master.on_bytes = lambda data, at_ns, is_ours: log.add(data, at_ns, is_ours=is_ours)
        yield


@dataclass(frozen=True, slots=True)
class AskOptions(TargetTlsOptions):
    """The options of `read`, `write` and `poll` about the slave and about the requests."""

    heading: ClassVar[str] = "Options"

    unit: Annotated[str, typer.Option("--unit", metavar="UNIT", help="The unit to ask.")] = "1"
    device: Annotated[
        str | None,
        typer.Option(
            "--device",
            metavar="PROFILE",
            help="The device's profile: a built-in name (see mbtool devices) or the path of a TOML "
            "file. It gives references, names, limits and meanings; 5=PROFILE does, too.",
        ),
    ] = None
    function: Annotated[
        str | None,
        typer.Option(
            "--function",
            metavar="CODE",
            help="The function to use: 1 to 4 to read, 5, 6, 15 or 16 to write. A REFERENCE may "
            "then be an address alone. [default: the one for the table]",
        ),
    ] = None
    timeout: TimeoutOption = RESPONSE_TIMEOUT_S
    listen: ListenOption = None
    between: Annotated[
        bool,
        typer.Option(
            "--between",
            help="On a serial line that another master polls: send only in its pauses, if they are "
            "long enough.",
        ),
    ] = False

    record: RecordOption = None
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the file of --record if there is one.")
    ] = False

    def read(
        self, link_text: str, references: Sequence[str], *, writes: bool = False
    ) -> AskedSlave:
        """Combine LINK, the references with their types, and the options. With `writes`, each
        reference has a value.

        Raises UsageError for a text that is not understood.
        """
        from mbtool.workflows.ask import transport_of
        from mbtool.workflows.shared.questions import Wording
        from mbtool.workflows.shared.typed_references import typed_references

        demand_new(self.record, overwrite=self.overwrite)
        link = parse_link(link_text, ANSWERED)
        unit = parse_unit(self.unit, "--unit")
        profile = self._profile(unit)
        if profile is not None:
            profile = profile.with_limits_of(transport_of(link))
        code = None
        if self.function is not None:
            code = parse_number(self.function, "function code", UNITS, "--function")
        plain, profile = typed_references(references, profile, code, writes=writes)
        timeout_ns = round(self.timeout * 1e9)
        return AskedSlave(
            link,
            unit,
            profile,
            Wording(profile, code),
            plain,
            timeout_ns,
            self.target(),
            listen_ns(self.listen),
            self.between,
            self.record,
            self.overwrite,
        )

    def _profile(self, unit: int) -> Profile | None:
        from mbtool.devices import load_profile, parse_assignment

        if self.device is None:
            return None
        if "=" not in self.device:
            return load_profile(self.device)
        assignment = parse_assignment(self.device)
        if assignment.who.unit not in (None, unit):
            raise UsageError(f"--device {self.device}: unit {unit} is asked; see --unit")
        return assignment.profile


@dataclass(frozen=True, slots=True)
class AskedSlave:
    """The slave that gets the requests, with everything that the options say about it."""

    link: LinkSpec
    unit: int
    profile: Profile | None
    wording: Wording
    references: list[str]
    """The references (and values) that the user gave, without their types."""
    timeout_ns: int
    tls: TargetTls | None
    listen_ns: int | None
    """The time (ns) to listen for another master before the first request; None for the default."""
    is_between: bool
    """True if requests are sent in the pauses of another master."""
    record: str | None
    """The log to which the line is written; None for none."""
    overwrite: bool

    @contextmanager
    def open(
        self,
        format_: Format,
        table: TableOptions,
        *,
        is_summed: bool = True,
        if_interrupted: str = "interrupted",
    ) -> Iterator[tuple[Asker, RecordOutput]]:
        """Open the link and standard output; yield the asker, which sends requests, and the output.

        With `is_summed`, a line that counts the transactions is printed at the end. If Ctrl-C
        comes before the first transaction, it prints `if_interrupted` instead. Raises LinkError if
        the slave cannot be reached, or if another master asks on the line.
        """
        from mbtool.cli.output import open_output
        from mbtool.master.links import open_master
        from mbtool.workflows.ask import Asker

        with (
            open_master(self.link, self.timeout_ns, say, self.tls) as master,
            recorded(master, self.link, self.record, overwrite=self.overwrite),
        ):
            master.take_line(self.listen_ns, between=self.is_between)
            asker = Asker(master, self.link, self.unit, self.profile)
            with open_output(
                None,
                format_,
                None,
                asker.profile_for,
                condition(None),
                table=table,
                is_summed=is_summed,
                if_interrupted=if_interrupted,
            ) as out:
                yield asker, out


def print_asked(asker: Asker, out: RecordOutput, pdu: bytes) -> NamedTransaction:
    """Send the request `pdu`, print its transaction on `out`, and return the transaction.

    Bytes received that are no response are printed before it, as events.
    """
    transaction, events = asker.ask(pdu)
    for event in events:
        out.add(event)
    out.add(transaction)
    out.wait()
    return transaction
