"""Gives transactions the names of their devices."""

# A profile is compiled into a vocabulary once. What a request addresses (reference, places,
# findings) depends only on its function, addresses and quantities, and a master asks the same few
# things over and over: the vocabulary remembers them, at most _MAX_REMEMBERED, so that a repeated
# request costs one look-up and its values.
#
# Function 17H reads and writes: its reference names both, and its places are those written, from
# the request, which say so, and those read, from the response. Function 16H writes masks, no value.

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec

from mbtool.devices.assignment import Assignments
from mbtool.devices.identity import answer_word, identity_points
from mbtool.devices.model import AnswerWord, Point, PointType, Profile
from mbtool.devices.named_transaction import NamedTransaction, PointValue
from mbtool.devices.profile_checks import (
    Ranges,
    data_finding,
    exception_finding,
    fixed_data,
    has_other_data,
    request_findings,
    value_finding,
    value_ranges,
    values_outside,
)
from mbtool.devices.references import write_reference
from mbtool.devices.standard_checks import form_codes
from mbtool.devices.values import PointInstance, places_of, values_of
from mbtool.modbus.adu import Verdict
from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.identification import ENCAPSULATED, REPORT_SERVER_ID
from mbtool.modbus.tables import Table
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from mbtool.modbus.transaction import Transaction

_MAX_REMEMBERED = 4096

_MASK_WRITE = 0x16
_READ_WRITE = 0x17
_UNSOLICITED = Outcome.UNSOLICITED  # Python 3.11 takes long to find a member of an enumeration.


class Namer:
    """Names transactions by the profiles that the user assigned."""

    def __init__(self, assignments: Assignments | None = None) -> None:
        self._assignments = assignments or Assignments()
        self._neutral = _Vocabulary(None)
        self._vocabularies: dict[int, _Vocabulary] = {}

    def name(self, transaction: Transaction) -> NamedTransaction:
        """The same transaction with device, reference, points and findings.

        Those of one that is named already are replaced. Never raises, also for values that no wire
        carries.
        """
        profile = self._assignments.profile_for(transaction)
        return self._vocabulary(profile).name(transaction)

    def rename(self, named: NamedTransaction) -> NamedTransaction:
        """The same where the user assigned a profile; elsewhere as it is."""
        profile = self._assignments.profile_for(named)
        return named if profile is None else self._vocabulary(profile).name(named)

    def _vocabulary(self, profile: Profile | None) -> _Vocabulary:
        if profile is None:
            return self._neutral
        # By identity: it is quick, and the assignments keep every profile alive.
        vocabulary = self._vocabularies.get(id(profile))
        if vocabulary is None:
            vocabulary = self._vocabularies[id(profile)] = _Vocabulary(profile)
        return vocabulary


@dataclass(frozen=True, slots=True)
class _Meaning:
    """What one combination of function, addresses and quantities means."""

    function_name: str | None = None
    reference: str | None = None
    written: tuple[tuple[int, PointInstance], ...] = ()
    """Each place with the index of its first value."""
    read: tuple[tuple[int, PointInstance], ...] = ()
    answer: PointInstance | None = None
    findings: tuple[str, ...] = ()


class _Vocabulary:
    """A profile, made ready for naming."""

    def __init__(self, profile: Profile | None) -> None:
        self.profile = profile
        self._device = profile.name if profile is not None else None
        self._places: dict[tuple[Table, bool], list[PointInstance]] = {}
        """By table, and whether it is written."""
        self._addresses: dict[tuple[Table, bool], list[int]] = {}
        self._remembered: dict[tuple[int | None, ...], _Meaning] = {}
        self._ranges: Ranges = {}
        self._fixed_data: dict[int, bytes] = {}
        if profile is not None:
            self._compile(profile)

    def name(self, transaction: Transaction) -> NamedTransaction:
        meaning = self._meaning(transaction)
        points = _points(meaning, transaction)
        function_name, exception_name = transaction.function_name, transaction.exception_name
        if meaning.function_name is not None:
            function_name = meaning.function_name
        if transaction.exception is not None and self.profile is not None:
            exception_name = self.profile.exception_name(transaction.exception)
        named = transaction
        if not isinstance(named, NamedTransaction):
            named = NamedTransaction(**msgspec.structs.asdict(transaction))
        return msgspec.structs.replace(
            named,
            function_name=function_name,
            exception_name=exception_name,
            device=self._device,
            reference=meaning.reference,
            points=points,
            findings=self._findings(meaning, transaction, points),
        )

    def _findings(
        self, meaning: _Meaning, transaction: Transaction, points: list[PointValue]
    ) -> list[str]:
        if transaction.verdicts and Verdict.AMBIGUOUS in transaction.verdicts:
            return []  # Its bytes may be another frame's, which would say something else.
        # What nobody asked for was not asked for wrongly.
        asked = transaction.outcome is not _UNSOLICITED
        findings = [*meaning.findings] if asked else []
        findings += form_codes(transaction)
        profile = self.profile
        if profile is not None:
            fixed = self._fixed_data.get(transaction.function)
            if fixed is not None and asked and has_other_data(transaction, fixed):
                findings.append(data_finding(profile, transaction.function))
            if transaction.exception is not None:
                undocumented = exception_finding(profile, transaction.exception)
                findings += [undocumented] if undocumented is not None else []
            if self._ranges and transaction.request_values and meaning.written and points:
                written = points
                if transaction.function == _READ_WRITE:
                    written = [point for point in points if point.written]
                if values_outside(self._ranges, written):
                    findings.append(value_finding(profile, transaction.function))
        return findings

    def _compile(self, profile: Profile) -> None:
        self._ranges = value_ranges(profile)
        self._fixed_data = fixed_data(profile)
        for table in Table:
            for writing in (False, True):
                places = places_of(profile, table, writing=writing)
                self._places[table, writing] = places
                self._addresses[table, writing] = [place.address for place in places]

    def _meaning(self, transaction: Transaction) -> _Meaning:
        function = transaction.function
        key = (
            function,
            transaction.address,
            transaction.quantity,
            transaction.write_address,
            0 if transaction.write_address is None else len(transaction.request_values or ()),
        )
        meaning = self._remembered.get(key)
        if meaning is None:
            if len(self._remembered) >= _MAX_REMEMBERED:
                self._remembered.clear()
            meaning = self._remembered[key] = self._work_out(transaction)
        return meaning

    def _work_out(self, transaction: Transaction) -> _Meaning:
        function, address, quantity = (
            transaction.function,
            transaction.address,
            transaction.quantity,
        )
        findings = tuple(request_findings(self.profile, transaction))
        title: str | None = None
        answer: PointInstance | None = None
        if self.profile is not None:
            rule = self.profile.rule(function)
            if rule is not None:
                title = rule.title
                answer = _answer_place(rule.answer, function) if rule.answer is not None else None
        known = FUNCTIONS.get(function)
        if known is None or known.table is None or address is None:
            return _Meaning(title, answer=answer, findings=findings)
        writes = known.writes and function != _READ_WRITE
        reference = write_reference(self.profile, known.table, address, quantity, writing=writes)
        places = self._between(known.table, address, max(quantity or 1, 1), writing=writes)
        if function == _READ_WRITE and transaction.write_address is not None:
            start, count = transaction.write_address, len(transaction.request_values or ())
            written = write_reference(self.profile, known.table, start, count, writing=True)
            return _Meaning(
                title,
                reference=f"{reference}, write {written}",
                written=self._between(known.table, start, count, writing=True),
                read=places,
                findings=findings,
            )
        if function == _MASK_WRITE:
            places = ()
        return _Meaning(
            title,
            reference=reference,
            written=places if known.writes else (),
            read=() if known.writes else places,
            findings=findings,
        )

    def _between(
        self, table: Table, address: int, quantity: int, *, writing: bool
    ) -> tuple[tuple[int, PointInstance], ...]:
        """The places whose registers or bits are all in a range, each with its index there.

        What has no name beside others that have one goes by its reference.
        """
        addresses = self._addresses.get((table, writing), [])
        first = bisect_left(addresses, address)
        last = bisect_left(addresses, address + quantity)
        places = self._places[table, writing][first:last] if last > first else []
        # What a block holds is there for who asks from its beginning, and then nothing else is.
        block = address if any(place.block == address for place in places) else None
        whole = [
            place
            for place in places
            if place.block == block and place.address + place.words <= address + quantity
        ]
        if whole and sum(place.words for place in whole) < quantity:
            whole = self._with_unnamed(whole, table, range(address, address + quantity), writing)
        return tuple((place.address - address, place) for place in whole)

    def _with_unnamed(
        self, places: list[PointInstance], table: Table, span: range, writing: bool
    ) -> list[PointInstance]:
        named = {word for each in places for word in range(each.address, each.address + each.words)}
        kind = PointType.BIT if table.is_bits else PointType.UINT16
        for address in span:
            if address not in named:
                reference = write_reference(self.profile, table, address, writing=writing)
                point = Point(name=reference, table=table, address=address, type=kind)
                places.append(PointInstance(point, address, reference))
        return sorted(places, key=lambda place: place.address)


def _answer_place(answer: AnswerWord, function: int) -> PointInstance:
    point = Point(
        name=answer.name,
        table=Table.HOLDING_REGISTERS,  # Not looked at: the word has no address.
        address=0,
        type=PointType.UINT16,
        texts=answer.texts,
    )
    return PointInstance(point, 0, f"{function:02X}H")


def _points(meaning: _Meaning, transaction: Transaction) -> list[PointValue]:
    points: list[PointValue] = []
    if meaning.written and transaction.request_values:
        points += values_of(meaning.written, transaction.request_values)
        if transaction.function == _READ_WRITE:
            points = [msgspec.structs.replace(point, written=True) for point in points]
    if meaning.read and transaction.response_values:
        points += values_of(meaning.read, transaction.response_values)
    if meaning.answer is not None:
        word = answer_word(transaction)
        if word is not None:
            points.append(meaning.answer.value([word]))
    if transaction.function in (REPORT_SERVER_ID, ENCAPSULATED):
        points += identity_points(transaction)
    return points
