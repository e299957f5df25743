"""Names transactions: adds device, references, point values and findings from profiles."""

# A profile is compiled once, into a _Vocabulary, which names transactions. The reference, the
# points and most findings of a request depend only on its function, addresses and quantities. A
# master repeats the same few requests, so the vocabulary caches the results for at most _MAX_CACHED
# requests. Naming a repeated request then costs one look-up and the decoding of its values.
#
# A register of the device can hold the scale of a point, as a power of ten (`scale_from`). Values
# are scaled with the power that the slave gave last, in the same response or an earlier one
# (sunspec_map.py).
#
# Function 17H reads and writes. Its reference has both ranges. Its points are the written ones,
# with values from the request, and the read ones, with values from the response. Function 16H
# writes masks, which are no values, so it has no points.

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import msgspec

from mbtool.core.limits import LAST_UNIT
from mbtool.devices.assignment import Assignments
from mbtool.devices.identity import answer_word, identity_points
from mbtool.devices.model import AnswerWord, Point, Profile
from mbtool.devices.named_transaction import NamedTransaction, PointValue
from mbtool.devices.point_types import PointType
from mbtool.devices.profile_checks import (
    Ranges,
    data_finding_code,
    exception_finding_code,
    fixed_data,
    has_other_data,
    request_findings,
    unit_finding_code,
    value_finding_code,
    value_ranges,
    values_outside,
    written_by_17h,
)
from mbtool.devices.references import SHORT_WORDS, write_reference
from mbtool.devices.response_checks import response_findings
from mbtool.devices.standard_checks import form_codes, request_codes
from mbtool.devices.sunspec_map import ScaleFactors
from mbtool.devices.values import PointInstance, point_instances, point_values
from mbtool.modbus.adu import Verdict
from mbtool.modbus.functions import (
    FUNCTIONS,
    MASK_WRITE_REGISTER,
    READ_WRITE_REGISTERS,
    TABLE_FUNCTIONS,
)
from mbtool.modbus.identification import ENCAPSULATED, REPORT_SERVER_ID
from mbtool.modbus.tables import Table
from mbtool.modbus.transaction import Outcome, Transaction

_MAX_CACHED = 4096
_MAX_CACHED_POINTS = 65_536


_WITHOUT_REQUEST = frozenset((Outcome.UNSOLICITED, Outcome.NOT_CAPTURED))
"""The outcomes of transactions that may have only a response and no request."""


class Namer:
    """Adds names and findings to transactions, from the profiles that the user assigned."""

    def __init__(self, assignments: Assignments | None = None) -> None:
        self._assignments = assignments or Assignments()
        self._vocabularies = {id(None): _Vocabulary(None)}
        """The vocabularies by the id() of their profile, as an id() is found faster than a profile.
        It stays valid, because the assignments keep every profile alive."""

    @property
    def assignments(self) -> Assignments:
        """The profiles in use."""
        return self._assignments

    def name(self, transaction: Transaction) -> NamedTransaction:
        """Return a copy of a transaction with its device, reference, points and findings.

        They replace those that the transaction has. Never raises, not even for numbers that are
        impossible on a wire.
        """
        profile = self._assignments.profile_for(transaction)
        vocabulary = self._vocabularies.get(id(profile)) or self._vocabulary(profile)
        return vocabulary.name(transaction)

    def rename(self, named: NamedTransaction) -> NamedTransaction:
        """Name a transaction again if its slave has a profile; otherwise return it unchanged."""
        profile = self._assignments.profile_for(named)
        return named if profile is None else self._vocabulary(profile).name(named)

    def depends_on_values(self, transaction: Transaction) -> bool:
        """True if the names or findings of a transaction depend on more than its slave, function,
        addresses, quantities and exception code.

        False if all transactions that are equal in these have the same names and findings, provided
        that request and response have the form of their function.
        """
        return self._vocabulary(self._assignments.profile_for(transaction)).depends(transaction)

    def as_kind(self, named: NamedTransaction) -> NamedTransaction:
        """Return a copy of a usual read or write (one of the functions 01 to 06, 0F and 10 in
        hexadecimal, whose ADUs have the right form) with the reference of its addresses and the
        findings that do not depend on values. Its device, and the names of its function and
        exception, must be right already. If names depend on values, `with_values` adds them.
        """
        profile = self._assignments.profile_for(named)
        return self._vocabulary(profile).as_kind(named)

    def with_values(self, named: NamedTransaction) -> NamedTransaction:
        """Return a copy of a transaction with the points and findings of its own values.

        All else that a profile names must be right already.
        """
        profile = self._assignments.profile_for(named)
        return self._vocabulary(profile).with_values(named)

    def _vocabulary(self, profile: Profile | None) -> _Vocabulary:
        vocabulary = self._vocabularies.get(id(profile))
        if vocabulary is None:
            vocabulary = self._vocabularies[id(profile)] = _Vocabulary(profile)
        return vocabulary


@dataclass(frozen=True, slots=True)
class _Meaning:
    """The names and findings that follow from a request's function, addresses and quantities."""

    function_name: str | None = None
    reference: str | None = None
    written: tuple[tuple[int, PointInstance], ...] = ()
    """The points that the request writes, each with the index of its first value in the request."""
    read: tuple[tuple[int, PointInstance], ...] = ()
    """The points that the response has, each with the index of its first value in the response."""
    answer: PointInstance | None = None
    """The word in the response to a vendor's own function, as a point; None for other functions."""
    answer_texts: Mapping[int, str] = field(default_factory=dict)
    """The meaning of each value of the word in `answer`."""
    findings: tuple[str, ...] = ()

    def scaled(self, powers: Mapping[str, int]) -> _Meaning:
        """Return a copy whose points are scaled, where a point has its scale in a register of the
        device (`scale_from`).

        `powers` has the power of ten in such a register, by the name of the register's point.
        """
        return replace(
            self,
            written=tuple(
                (at, each.scaled_by(powers.get(each.scale_from or ""))) for at, each in self.written
            ),
            read=tuple(
                (at, each.scaled_by(powers.get(each.scale_from or ""))) for at, each in self.read
            ),
        )


class _Vocabulary:
    """Names transactions with one profile, or without one.

    The profile is compiled once, so that naming is fast.
    """

    def __init__(self, profile: Profile | None) -> None:
        self.profile = profile
        self._rules = profile if profile is not None and profile.has_rules else None
        """The profile, if it states rules; None if it only names points."""
        self._device = self._rules.name if self._rules is not None else None
        self._points: dict[tuple[Table, bool], list[PointInstance]] = {}
        """The points sorted by address. The key is the table and a flag: True for the points that a
        write may contain, False for those that a read may contain."""
        self._addresses: dict[tuple[Table, bool], list[int]] = {}
        """The first address of each point in `_points`, in the same order."""
        self._cache: dict[tuple[object, ...], _Meaning] = {}
        self._cached_points = 0
        """The number of points of all results in `_cache`."""
        own = profile.last_unit if profile is not None else None
        self._last_unit = LAST_UNIT if own is None else own
        """The highest unit that a slave with this profile has on a serial line."""
        self._scale_factors: ScaleFactors | None = None
        self._ranges: Ranges = {}
        self._fixed_data: dict[int, bytes] = {}
        self._joined: JoinedWords | None = None
        self._silent = frozenset[int]()
        """The functions to whose requests the manual states no response."""
        if profile is not None:
            self._compile(profile)

    def depends(self, transaction: Transaction) -> bool:
        """See Namer.depends_on_values."""
        if self.profile is None:
            return False
        meaning, function = self._meaning(transaction), transaction.function
        has_values = meaning.written or meaning.read or meaning.answer is not None
        rule = self.profile.rule(function)
        has_form = rule is not None and (rule.echoes or rule.answer is not None)
        learns = self._scale_factors is not None
        return bool(has_values or has_form or learns or function in self._fixed_data)

    def with_values(self, named: NamedTransaction) -> NamedTransaction:
        """See Namer.with_values."""
        meaning = self._scaled_meaning(named)
        points = self._points_of(meaning, named)
        findings = self._findings(meaning, named, points)
        return msgspec.structs.replace(named, points=points, findings=findings)

    def _points_of(self, meaning: _Meaning, transaction: Transaction) -> list[PointValue]:
        points = _points(meaning, transaction)
        if self._joined is None or not points:
            return points
        return self._joined.words(transaction, points)

    def _scaled_meaning(self, transaction: Transaction) -> _Meaning:
        meaning = self._meaning(transaction)
        if self._scale_factors is None:
            return meaning
        return meaning.scaled(self._scale_factors.update(transaction, meaning.read))

    def name(self, transaction: Transaction) -> NamedTransaction:
        meaning = self._scaled_meaning(transaction)
        points = self._points_of(meaning, transaction)
        fields = msgspec.structs.asdict(transaction)
        if meaning.function_name is not None:
            fields["function_name"] = meaning.function_name
        if transaction.exception is not None and self.profile is not None:
            fields["exception_name"] = self.profile.exception_name(transaction.exception)
        fields["device"] = self._device
        fields["reference"] = meaning.reference
        fields["points"] = points
        fields["findings"] = self._findings(meaning, transaction, points)
        if transaction.outcome is Outcome.NO_ANSWER and transaction.function in self._silent:
            fields["outcome"] = Outcome.OK  # The manual states that success has no response.
        return NamedTransaction(**fields)

    def as_kind(self, named: NamedTransaction) -> NamedTransaction:
        """See Namer.as_kind."""
        known = FUNCTIONS.get(named.function)
        if self.profile is None and known is not None and known.table and named.address is not None:
            # The general way below gives the same, but takes three times as long.
            address, quantity = named.address, named.quantity
            codes = [*request_codes(named.function, address, quantity), *form_codes(named)]
            reference = write_reference(None, known.table, address, quantity)
            return msgspec.structs.replace(named, reference=reference, points=[], findings=codes)
        meaning = self._meaning(named)
        findings = self._findings(meaning, named, [])
        return msgspec.structs.replace(
            named, reference=meaning.reference, points=[], findings=findings
        )

    def _findings(
        self, meaning: _Meaning, transaction: Transaction, points: list[PointValue]
    ) -> list[str]:
        if transaction.verdicts and Verdict.AMBIGUOUS in transaction.verdicts:
            return []  # An ambiguous frame may have been misread.
        # Without a request, no rule about requests can be broken.
        has_request = (
            transaction.outcome not in _WITHOUT_REQUEST or transaction.request_ns is not None
        )
        findings = [*meaning.findings] if has_request else []
        findings += form_codes(transaction)
        profile = self._rules
        if transaction.unit > self._last_unit and transaction.transport.is_serial:
            findings.append(unit_finding_code(profile, transaction.unit))
        if profile is not None:
            fixed = self._fixed_data.get(transaction.function)
            if fixed is not None and has_request and has_other_data(transaction, fixed):
                findings.append(data_finding_code(profile, transaction.function))
            if transaction.response_raw is not None:
                findings += response_findings(profile, transaction, findings)
            if transaction.exception is not None:
                undocumented = exception_finding_code(
                    profile, transaction.function, transaction.exception
                )
                findings += [undocumented] if undocumented is not None else []
            if self._ranges and transaction.request_values and meaning.written and points:
                written = points
                if transaction.function == READ_WRITE_REGISTERS:
                    written = [point for point in points if point.written]
                if values_outside(self._ranges, written):
                    findings.append(value_finding_code(profile, transaction.function))
        return findings

    def _compile(self, profile: Profile) -> None:
        self._ranges = value_ranges(profile)
        self._joined = JoinedWords.of(profile)
        self._fixed_data = fixed_data(profile)
        self._silent = frozenset(
            int(code, 16) for code, rule in profile.functions.items() if not rule.answers
        )
        sources = {one.scale_from for one in profile.points if one.scale_from is not None}
        if sources:
            self._scale_factors = ScaleFactors(sources)
        for table in Table:
            for writing in (False, True):
                points = point_instances(profile, table, writing=writing)
                self._points[table, writing] = points
                self._addresses[table, writing] = [point.address for point in points]

    def _meaning(self, transaction: Transaction) -> _Meaning:
        function = transaction.function
        key = (
            function,
            transaction.address,
            transaction.quantity,
            transaction.write_address,
            0 if transaction.write_address is None else len(transaction.request_values or ()),
            None if transaction.write_address is None else written_by_17h(transaction),
        )
        meaning = self._cache.get(key)
        if meaning is None:
            if len(self._cache) >= _MAX_CACHED or self._cached_points >= _MAX_CACHED_POINTS:
                self._cache.clear()
                self._cached_points = 0
            meaning = self._cache[key] = self._find_meaning(transaction)
            self._cached_points += len(meaning.read) + len(meaning.written)
        return meaning

    def _find_meaning(self, transaction: Transaction) -> _Meaning:
        function, address = transaction.function, transaction.address
        quantity = transaction.quantity
        findings = tuple(request_findings(self._rules, transaction))
        title: str | None = None
        answer: PointInstance | None = None
        texts: Mapping[int, str] = {}
        if self.profile is not None:
            rule = self.profile.rule(function)
            if rule is not None:
                # A function with addresses in a table keeps the standard's name here; the title in
                # the profile is shown only by `mbtool devices`.
                title = None if function in TABLE_FUNCTIONS else rule.title
                if rule.answer is not None:
                    answer, texts = _answer_point(rule.answer, function), rule.answer.texts
        known = FUNCTIONS.get(function)
        if known is None or known.table is None or address is None:
            return _Meaning(title, answer=answer, answer_texts=texts, findings=findings)
        writes = known.writes and function != READ_WRITE_REGISTERS
        reference = write_reference(self.profile, known.table, address, quantity, writing=writes)
        # A slave refuses a request for more addresses than the function's limit.
        count = min(max(quantity or 1, 1), known.limit)
        points = self._points_in(known.table, address, count, writing=writes)
        if function == READ_WRITE_REGISTERS and transaction.write_address is not None:
            start, count = transaction.write_address, len(transaction.request_values or ())
            said = transaction.written_quantity
            written = write_reference(self.profile, known.table, start, said, writing=True)
            return _Meaning(
                title,
                reference=f"{reference}, write {written}",
                written=self._points_in(known.table, start, count, writing=True),
                read=points,
                findings=findings,
            )
        if function == MASK_WRITE_REGISTER:
            points = ()
        return _Meaning(
            title,
            reference=reference,
            written=points if known.writes else (),
            read=() if known.writes else points,
            findings=findings,
        )

    def _points_in(
        self, table: Table, address: int, quantity: int, *, writing: bool
    ) -> tuple[tuple[int, PointInstance], ...]:
        """Return the points that are completely among the `quantity` addresses from `address` on,
        each with the index of its first value there.

        If there are any, each of these addresses without a point gets one, named by its reference.
        `writing` is True for the points that a write may contain.
        """
        addresses = self._addresses.get((table, writing), [])
        first = bisect_left(addresses, address)
        last = bisect_left(addresses, address + quantity)
        points = self._points[table, writing][first:last] if last > first else []
        # A block is a range of registers that a device returns only to a read from the block's
        # first address on. Such a read has only points of this block; any other read has only
        # points outside all blocks.
        block = address if any(point.block == address for point in points) else None
        complete = [
            point
            for point in points
            if point.block == block and point.address + point.words <= address + quantity
        ]
        if complete and sum(point.words for point in complete) < quantity:
            span = range(address, address + quantity)
            complete = self._with_unnamed(complete, table, span, writing)
        return tuple((point.address - address, point) for point in complete)

    def _with_unnamed(
        self, points: list[PointInstance], table: Table, span: range, writing: bool
    ) -> list[PointInstance]:
        named = {word for each in points for word in range(each.address, each.address + each.words)}
        kind = PointType.BIT if table.is_bits else PointType.UINT16
        for address in span:
            if address not in named:
                reference = write_reference(self.profile, table, address, writing=writing)
                name = reference if self._rules is not None else f"{SHORT_WORDS[table]}{address}"
                point = Point(name=name, table=table, address=address, type=kind)
                points.append(PointInstance(point, address, reference))
        return sorted(points, key=lambda point: point.address)


def _answer_point(answer: AnswerWord, function: int) -> PointInstance:
    point = Point(
        name=answer.name,
        table=Table.HOLDING_REGISTERS,  # Any table: the word has no address.
        address=0,
        type=PointType.HEX16 if answer.texts else PointType.UINT16,  # without a text: 0099H
        texts=answer.texts,
    )
    return PointInstance(point, 0, f"{function:02X}H")


def _points(meaning: _Meaning, transaction: Transaction) -> list[PointValue]:
    points: list[PointValue] = []
    if meaning.written and transaction.request_values:
        points += point_values(meaning.written, transaction.request_values)
        if transaction.function == READ_WRITE_REGISTERS:
            points = [msgspec.structs.replace(point, written=True) for point in points]
    if meaning.read and transaction.response_values:
        points += point_values(meaning.read, transaction.response_values)
    if meaning.answer is not None:
        word = answer_word(transaction)
        if word is not None:
            answer = meaning.answer.value([word])
            text = meaning.answer_texts.get(word, answer.text)
            points.append(msgspec.structs.replace(answer, text=text))
    if transaction.function in (REPORT_SERVER_ID, ENCAPSULATED):
        points += identity_points(transaction)
    return points


# Words of values that follow from two registers: a unit that another register chooses, and an
# address in two registers.
#
# Both are keys of points in a profile:
#
#     units_from, units   FA3-AT1M8X: 5000 in 010CH is ms if the averaging process of CH6 (0106H) is
#                         the time average, and a number of times if it is the count average
#     after               FA3: 00F1H and 00F0H together are the IP address 192.168.3.250
#
# The register that chooses a unit may have been read or written in an earlier transaction.
#
# Memory: one number for each channel of the MAX_SLAVES slaves that were used last.

MAX_SLAVES = 1024

_Slave = tuple[str, str | None, int]


class JoinedWords:
    """Finds the words of such values of the slaves with one profile."""

    def __init__(self, profile: Profile) -> None:
        self._fields = {
            point.name: point for point in profile.points if point.type is PointType.NIBBLE_FIELD
        }
        self._units: dict[str, tuple[int, str, dict[int, str]]] = {}
        """By name of a point: its channel, the beginning of the names of the fields that choose the
        unit, and the units by the number of the channel in that field."""
        self._after = {point.name: point.after for point in profile.points if point.after}
        for point in profile.points:
            if point.units_from is not None:
                for number in range(point.count):
                    channel = point.counted_from + number
                    name = point.name.replace("{n}", str(channel))
                    self._units[name] = channel, point.units_from, point.units
        self._slaves: dict[_Slave, dict[tuple[str, int], int]] = {}

    @classmethod
    def of(cls, profile: Profile) -> JoinedWords | None:
        """Return the words of a profile; None if it has no such points."""
        joined = cls(profile)
        return joined if joined._units or joined._after else None

    def words(self, transaction: Transaction, points: list[PointValue]) -> list[PointValue]:
        """Return the points of a transaction, with the words that follow from two registers."""
        chosen = self._chosen(transaction, points)
        shown = [self._with_unit(point, chosen) for point in points]
        return self._joined(shown) if self._after else shown

    def _chosen(
        self, transaction: Transaction, points: Sequence[PointValue]
    ) -> dict[tuple[str, int], int]:
        """By field and channel, the numbers that the slave holds, or that this request writes."""
        key = transaction.link, transaction.destination, transaction.unit
        known = self._slaves.pop(key, {})
        while len(self._slaves) >= MAX_SLAVES:
            del self._slaves[next(iter(self._slaves))]
        seen = {
            (name, channel): number
            for point in points
            if (field := self._fields.get(point.name)) is not None and point.value is not None
            for name in {one for _, one, _ in self._units.values()}
            if point.name.startswith(name)
            for channel, number in _channels(field, int(point.value))
        }
        after = {**known, **seen}
        is_held = transaction.outcome in (Outcome.OK, Outcome.LATE)
        self._slaves[key] = after if is_held else known
        return after

    def _with_unit(self, point: PointValue, chosen: dict[tuple[str, int], int]) -> PointValue:
        if point.name not in self._units:
            return point
        channel, field, units = self._units[point.name]
        unit = units.get(chosen.get((field, channel), -1))
        if unit is None:
            return point
        return msgspec.structs.replace(point, unit=unit, text=f"{point.value} {unit}")

    def _joined(self, points: list[PointValue]) -> list[PointValue]:
        by_name = {point.name: point for point in points}
        joined = []
        for point in points:
            earlier = by_name.get(self._after.get(point.name) or "")
            if earlier is not None:
                name = point.name.partition(" (")[0]
                reference = f"{point.reference}..{earlier.reference}"
                text = f"{earlier.text}.{point.text}"
                joined.append(PointValue(name=name, reference=reference, text=text))
            elif not any(
                first == point.name and last in by_name for last, first in self._after.items()
            ):
                joined.append(point)
        return joined


def _channels(field: Point, word: int) -> list[tuple[int, int]]:
    """The channels of a nibble field, each with its number."""
    return [
        (field.first_channel + index, word >> 4 * index & 0xF)
        for index in range(field.channels or 4)
    ]
