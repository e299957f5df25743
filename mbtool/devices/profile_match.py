"""Says which profiles explain what was seen of a slave, how well, and why."""

# Every different request is asked of a profile: would the device answer it? An answer where it
# would, and a refusal where it would not, speak for the profile. An answer to what it lacks, a
# refusal of what it has, and one that says that a function is lacking where something else is, or
# the other way round, speak against it. Exceptions that its manual does not have, and a line or a
# unit that it cannot be on, count against it, too.
#
# Nothing say a silence, exceptions that are about no function, address or quantity (a state, a
# gateway, a maker's own), a refused value, which stands for itself and not for its address, and a
# refused 17H, of which nobody knows whether it was the reading or the writing.
#
# A model code is decisive either way: the answer to 42H of an FA3 module is its model. Vendor and
# product names that the slave gives (2B/0E, 11H) speak for the profile that they name.
#
# Names of points tell no devices apart: another device that answers at the same addresses has no
# fewer for want of a longer manual. They are counted, and only put those in order that explain a
# slave equally well, which are a tie and told as one.

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.devices.block_reads import can_be_read
from mbtool.devices.observed_slave import ObservedSlave
from mbtool.devices.references import write_reference
from mbtool.modbus.adu import Transport
from mbtool.modbus.functions import FUNCTIONS, WRITE_LIMIT_17H, ExceptionCode, function_name

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mbtool.devices.model import Profile
    from mbtool.devices.observed_slave import ObservedRequest, Replies
    from mbtool.modbus.tables import Table

_REFUSALS = frozenset(
    (
        ExceptionCode.ILLEGAL_FUNCTION,
        ExceptionCode.ILLEGAL_DATA_ADDRESS,
        ExceptionCode.ILLEGAL_DATA_VALUE,
    )
)
_READ_WRITE = 0x17
_CLEAR = 0.9
"""What share of the requests a profile must explain to be named as the device."""
_MAX_REASONS = 6
_UNCONFIRMED = ", though no refusal, model code or name confirms it"
_LEAST_WORD = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class ProfileMatch:
    """How well one profile explains one slave."""

    profile: str
    explained: int
    """Different requests that ended as the profile says."""
    contradicted: int
    named: int
    """Addresses asked for that the profile has a point for."""
    addresses: int
    """Addresses asked for."""
    is_model: bool
    """The slave gave the profile's model code."""
    is_other_model: bool
    """It gave another's."""
    is_called_so: bool
    """Its own words name the profile's vendor or model."""
    refused: int
    """Requests that it refused as the profile says."""
    reasons: tuple[str, ...]
    against: tuple[str, ...]

    @property
    def share(self) -> float:
        told = self.explained + self.contradicted
        return self.explained / told if told else 0.0

    @property
    def score(self) -> int:
        """0 to 100."""
        if self.is_other_model:
            return 0
        if self.is_model:
            return 100
        certain = 5 * self.is_called_so + 5 * (self.refused > 0)
        return int(90 * self.share + certain) if self.explained else 0

    @property
    def is_confirmed(self) -> bool:
        """Whether more speaks for it than that it answered, which many devices would have."""
        return self.is_model or self.is_called_so or self.refused > 0

    @property
    def rank(self) -> tuple[bool, bool, float]:
        """What is greater is better; equal ranks are a tie."""
        return self.is_model, self.is_called_so, self.share

    @property
    def is_plausible(self) -> bool:
        """Whether the slave may well be this device."""
        if self.is_other_model:
            return False
        return self.is_model or (self.explained > 0 and self.share >= _CLEAR)


@dataclass(frozen=True, slots=True)
class MatchResult:
    """The profiles for one slave, the best first, and what to make of them."""

    seen: ObservedSlave
    matches: tuple[ProfileMatch, ...]

    @property
    def best(self) -> tuple[ProfileMatch, ...]:
        """The one that explains it best, or those that do so equally well; none if none does."""
        plausible = [one for one in self.matches if one.is_plausible]
        return tuple(one for one in plausible if one.rank == plausible[0].rank)

    @property
    def sentence(self) -> str:
        seen, best = self.seen, self.best
        if not seen.answered:
            return "never answered, so nothing tells what it is"
        if not best:
            nearest = next((one.profile for one in self.matches if one.explained), None)
            also = f"; the nearest is {nearest}" if nearest is not None else ""
            return f"none of the profiles explains it{also}"
        if len(best) == 1:
            unsure = "" if best[0].is_confirmed else _UNCONFIRMED
            return f"explained best by {best[0].profile}{unsure}"
        *others, last = (one.profile for one in best)
        names = f"{', '.join(others)} and {last}"
        asked = len(seen.asked)
        what = "one request" if asked == 1 else f"{asked} different requests"
        return f"a tie of {names}: nothing in {what} tells them apart"


def match(seen: ObservedSlave, profiles: Iterable[Profile]) -> MatchResult:
    """Compare a slave with profiles."""
    in_ascii = seen.transports == {Transport.ASCII}
    given = seen.given()
    matches = [
        _match(seen, profile.in_mode(Transport.ASCII) if in_ascii else profile, given)
        for profile in profiles
    ]
    # Those of another model come last, whatever else speaks for them.
    matches.sort(
        key=lambda one: (
            one.is_other_model,
            *(-part for part in one.rank),
            -one.named,
            one.profile,
        )
    )
    return MatchResult(seen, tuple(matches))


def _match(seen: ObservedSlave, profile: Profile, given: dict[Table, bytearray]) -> ProfileMatch:
    reasons: list[str] = []
    against: list[str] = []
    is_model, is_other = _compare_models(seen, profile, reasons, against)
    is_called_so = _compare_words(seen, profile, reasons)
    explained, contradicted, refusals = _compare_requests(seen, profile, against)
    if explained:
        count = explained + contradicted
        what = "the one request" if count == 1 else f"{explained} of {count} different requests"
        reasons.append(f"{what} ended as it says")
    contradicted += _compare_exceptions(seen, profile, against)
    contradicted += _compare_transports(seen, profile, against)
    contradicted += _compare_unit(seen, profile, against)
    addresses = sum(here.count(1) for here in given.values())
    named = min(_named(given, profile), addresses)
    if named:
        reasons.append(f"names {named} of {addresses} addresses asked for")
    return ProfileMatch(
        profile=profile.name,
        explained=explained,
        contradicted=contradicted,
        named=named,
        addresses=addresses,
        is_model=is_model,
        is_other_model=is_other,
        is_called_so=is_called_so,
        refused=len(refusals),
        reasons=tuple([*reasons, *refusals][:_MAX_REASONS]),
        against=tuple(against[:_MAX_REASONS]),
    )


def _compare_requests(
    seen: ObservedSlave, profile: Profile, against: list[str]
) -> tuple[int, int, list[str]]:
    """How many requests ended as the profile says, how many did not, and whose refusal it says."""
    explained, contradicted = 0, 0
    refusals: list[str] = []
    for ask, replies in seen.asked.items():
        problem, would = _expected(profile, ask)
        told = _told(profile, ask, replies, would=would)
        if told is None:
            continue
        other = "" if told or would else _other_refusal(profile, ask, replies)
        if other:
            contradicted += 1
            against.append(f"{_said(profile, ask)} refused by {other}, though {problem}")
        elif told is would:
            explained += 1
            if not told:
                refusals.append(f"{_said(profile, ask)} refused, as {problem}")
        else:
            contradicted += 1
            against.append(
                f"{_said(profile, ask)} {'answered' if told else 'refused'}, though {problem}"
            )
    return explained, contradicted, refusals


def _told(profile: Profile, ask: ObservedRequest, replies: Replies, *, would: bool) -> bool | None:
    """Whether the slave does what is asked; None where its replies do not tell."""
    if replies.ok:
        return True
    codes = profile.exceptions
    refusals = _REFUSALS | {codes.function, codes.address, codes.value}
    refused = refusals.intersection(replies.exceptions)
    if ask.function == _READ_WRITE:
        refused &= {codes.function}
    elif ask.writes and would and codes.value not in (codes.function, codes.address):
        refused -= {codes.value}
    return False if refused else None


def _other_refusal(profile: Profile, ask: ObservedRequest, replies: Replies) -> str:
    """The code of a refusal that is for another reason than the profile's; empty for the same."""
    lacks = profile.exceptions.function
    others = {profile.exceptions.address, profile.exceptions.value} - {lacks}
    given = set(replies.exceptions)
    is_lacking = profile.rule(ask.function) is None
    is_other = lacks not in given if is_lacking else not given & others and lacks in given
    return " and ".join(f"{code:02X}" for code in sorted(given)) if is_other and others else ""


def _expected(profile: Profile, ask: ObservedRequest) -> tuple[str, bool]:
    """Whether a device of the profile would do what is asked, and the rule that says so."""
    rule = profile.rule(ask.function)
    if rule is None:
        return f"it has no function {ask.function:02X}", False
    if ask.table is None or ask.address is None:
        return f"it has function {ask.function:02X}", True
    known = FUNCTIONS.get(ask.function)
    if ask.function == _READ_WRITE and ask.writes:
        limit: int | None = rule.write_limit or WRITE_LIMIT_17H
    else:
        limit = rule.limit or (known.limit if known is not None else None)
    if limit is not None and not 1 <= ask.quantity <= limit:
        return f"its limit is {limit}", False
    is_in_areas = profile.allows(ask.table, ask.span)
    if ask.writes and not profile.allows(ask.table, ask.span, writing=True):
        return ("one cannot write there" if is_in_areas else "it is outside its areas"), False
    if not ask.writes and not can_be_read(profile, ask.table, ask.span):
        return ("one cannot read there" if is_in_areas else "it is outside its areas"), False
    return "its manual has that", True


def _said(profile: Profile, ask: ObservedRequest) -> str:
    if ask.table is None or ask.address is None:
        return f"{ask.function:02X} {function_name(ask.function)}"
    where = write_reference(profile, ask.table, ask.address, ask.quantity, writing=ask.writes)
    return f"{ask.function:02X} {where}"


def _compare_models(
    seen: ObservedSlave, profile: Profile, reasons: list[str], against: list[str]
) -> tuple[bool, bool]:
    """Whether the slave gave this model's code, or another's."""
    function = model_function(profile)
    if function is None or profile.model_code is None:
        return False, False
    codes = {word for asked, word in seen.answer_words if asked == function}
    if profile.model_code in codes:
        reasons.append(f"{function:02X}H was answered {profile.model_code:04X}H, its model code")
        return True, False
    if not codes:
        return False, False
    given = ", ".join(f"{code:04X}H" for code in sorted(codes))
    against.append(
        f"{function:02X}H was answered {given}, and its model code is {profile.model_code:04X}H"
    )
    return False, True


def model_function(profile: Profile) -> int | None:
    """The function that gives the model code: its answer has a text for it."""
    for code, rule in profile.functions.items():
        if rule.answer is not None and profile.model_code in rule.answer.texts:
            return int(code, 16)
    return None


def _compare_words(seen: ObservedSlave, profile: Profile, reasons: list[str]) -> bool:
    """Whether what the slave says of itself names the profile's vendor or device."""
    known = _words(f"{profile.vendor} {profile.title} {profile.name}")
    hits = {
        name: sorted(known & _words(text))
        for name, text in seen.identity.items()
        if known & _words(text)
    }
    if hits:
        reasons.append(
            "it says of itself: "
            + ", ".join(f"{name} {seen.identity[name]!r}" for name in sorted(hits))
        )
    return bool(hits)


_COMMON = frozenset(
    ("modbus", "slave", "module", "device", "input", "inputs", "output", "outputs", "digital",
     "analog", "unit", "series", "type", "interface", "network", "controller", "electric", "with",
     "unknown", "operator", "company", "product", "code", "traffic", "coupler", "recorder",
     "corporation", "fieldbus")
)  # fmt: skip


def _words(text: str) -> set[str]:
    words = re.findall(r"[a-z0-9]+", text.lower())
    return {word for word in words if len(word) >= _LEAST_WORD} - _COMMON


def _compare_exceptions(seen: ObservedSlave, profile: Profile, against: list[str]) -> int:
    codes = {code for one in seen.asked.values() for code in one.exceptions}
    strange = sorted(codes - set(profile.exceptions.documented))
    against += [f"exception {code:02X} is none of its manual's" for code in strange]
    return len(strange)


def _compare_transports(seen: ObservedSlave, profile: Profile, against: list[str]) -> int:
    """What the line speaks; a serial device may stand behind a gateway, no other on a line."""
    spoken = set(profile.transports)
    if seen.transports & spoken or not seen.transports:
        return 0
    heard = ", ".join(sorted(seen.transports))
    is_on_line = all(one.is_serial for one in seen.transports)
    if is_on_line or not any(one.is_serial for one in spoken):
        against.append(f"it speaks {', '.join(sorted(spoken))}, and this is {heard}")
        return 1 + len(seen.asked)
    against.append(f"it is a serial device, and this is {heard}: only behind a gateway")
    return 1


def _compare_unit(seen: ObservedSlave, profile: Profile, against: list[str]) -> int:
    """Whether it can be that unit, which on a line is the number that it was given."""
    last = profile.last_unit
    on_line = any(one.is_serial for one in seen.transports)
    if last is None or not on_line or seen.unit <= last:
        return 0
    against.append(f"it can be unit 1 to {last}, and this is {seen.unit}")
    return 1 + len(seen.asked)


def _named(given: dict[Table, bytearray], profile: Profile) -> int:
    """How many of the addresses have points."""
    return sum(
        given[point.table].count(1, address, address + point.words)
        for point in profile.points
        for address in point.addresses
    )


def models_of(profiles: Iterable[Profile]) -> dict[tuple[int, int], Profile]:
    """Which profile a model code stands for, by the function that gives it and the code."""
    return {
        (function, profile.model_code): profile
        for profile in profiles
        if profile.model_code is not None and (function := model_function(profile)) is not None
    }
