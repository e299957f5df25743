"""Finds the profiles that fit the observed traffic of a slave, with a score and reasons."""

# For every different request, the profile predicts that the device accepts or refuses it. The
# prediction is compared with what the slave did.
#
# For the profile:      the slave responds as predicted; the identity that it reports (2B/0E, 11H)
#                       names the profile's vendor or model
# Against the profile:  the slave accepts what the profile refuses, or refuses what it accepts; the
#                       exception gives another reason than the profile (for example, "no such
#                       function" for a wrong address); the exception code is not in the manual; the
#                       device does not support the transport, or cannot have the unit number
# Neither:              no response; an exception for a reason other than function, address and
#                       quantity (a state, a gateway, a vendor's own code); a write refused for its
#                       value; a refused 17H, because either its read or its write may be the reason
#
# If the slave reports a model code, this alone decides: an FA3 module responds to 42H with the code
# of its model.
#
# The number of addresses that have names in a profile is no evidence, because a longer manual has
# more names. It only sorts profiles that explain a slave equally well; these are reported as a tie.

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.devices.observed_slave import ObservedSlave
from mbtool.devices.request_match import GroupedRequests, MatchCounts, compare_with_profile
from mbtool.modbus.adu import Transport

if TYPE_CHECKING:
    from mbtool.devices.model import Profile
    from mbtool.modbus.tables import Table

_MIN_SHARE = 0.9
"""A profile is plausible only if it explains at least this share of the requests, 0 to 1."""
_MAX_REASONS = 6
_UNCONFIRMED = ", though no refusal, model code or name confirms it"
_MIN_WORD_LETTERS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class ProfileMatch:
    """The evidence for and against one profile for one slave."""

    profile: str
    explained: int
    """Number of different requests that the slave accepted or refused as the profile predicts."""
    contradicted: int
    """Number of different requests that ended otherwise than predicted, plus contradictions about
    exception codes, transport and unit."""
    named: int
    """The number of those `addresses` that have a name in the profile."""
    addresses: int
    """Number of addresses that a master read or wrote with success."""
    is_model: bool
    """True if the slave reported the profile's model code."""
    is_other_model: bool
    """True if the slave reported another model code than the profile's."""
    has_name: bool
    """True if the identity that the slave reports names the profile's vendor or model."""
    refused: int
    """Number of different requests that the slave refused as the profile predicts."""
    reasons: tuple[str, ...]
    against: tuple[str, ...]

    @property
    def share(self) -> float:
        """The share of the evidence that speaks for the profile, 0 to 1; 0 without evidence."""
        total = self.explained + self.contradicted
        return self.explained / total if total else 0.0

    @property
    def score(self) -> int:
        """A score from 0 to 100 for how well the profile explains the slave.

        It is 100 or 0 if a model code decides. Otherwise `share` gives up to 90, and a name and a
        refusal that confirm the profile give 5 each.
        """
        if self.is_other_model:
            return 0
        if self.is_model:
            return 100
        confirmation = 5 * self.has_name + 5 * (self.refused > 0)
        return int(90 * self.share + confirmation) if self.explained else 0

    @property
    def is_confirmed(self) -> bool:
        """True if a model code, a name or a predicted refusal speaks for the profile.

        Accepted requests alone say little, because many devices accept the same requests.
        """
        return self.is_model or self.has_name or self.refused > 0

    @property
    def rank(self) -> tuple[bool, bool, float]:
        """The quality of the match, for comparison: `is_model`, `has_name` and `share`.

        The better of two matches has the greater rank; equal ranks are a tie.
        """
        return self.is_model, self.has_name, self.share

    @property
    def is_plausible(self) -> bool:
        """True if the slave is probably the device of this profile."""
        if self.is_other_model:
            return False
        return self.is_model or (self.explained > 0 and self.share >= _MIN_SHARE)


@dataclass(frozen=True, slots=True)
class MatchResult:
    """The result of comparing one slave with all profiles; the best match comes first."""

    slave: ObservedSlave
    matches: tuple[ProfileMatch, ...]

    @property
    def best(self) -> tuple[ProfileMatch, ...]:
        """The best plausible profile, or several that fit equally well; empty if there is none."""
        plausible = [one for one in self.matches if one.is_plausible]
        return tuple(one for one in plausible if one.rank == plausible[0].rank)

    @property
    def sentence(self) -> str:
        best = self.best
        if not self.slave.has_responded:
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
        count = len(self.slave.requests)
        what = "one request" if count == 1 else f"{count} different requests"
        return f"a tie of {names}: nothing in {what} tells them apart"


def match_profiles(slave: ObservedSlave, profiles: Iterable[Profile]) -> MatchResult:
    """Compare a slave with profiles, and sort them by how well they explain the slave."""
    in_ascii = slave.transports == {Transport.ASCII}
    known, grouped = slave.known_addresses(), GroupedRequests(slave)
    addresses = sum(flags.count(1) for flags in known.values())
    matches = [
        _match(
            slave,
            profile.with_limits_of(Transport.ASCII) if in_ascii else profile,
            known,
            addresses,
            grouped,
        )
        for profile in profiles
    ]
    # If the slave reported a model code, put the profiles of other models last, even if everything
    # else fits.
    matches.sort(
        key=lambda one: (
            one.is_other_model,
            *(-part for part in one.rank),
            -one.named,
            one.profile,
        )
    )
    return MatchResult(slave, tuple(matches))


def _match(
    slave: ObservedSlave,
    profile: Profile,
    known: dict[Table, bytearray],
    addresses: int,
    grouped: GroupedRequests,
) -> ProfileMatch:
    """Compare a slave with a profile. `known` has the addresses that the slave accepted, of which
    there are `addresses`.
    """
    reasons: list[str] = []
    against: list[str] = []
    is_model, is_other = _compare_models(slave, profile, reasons, against)
    has_name = _compare_names(slave, profile, reasons)
    explained, contradicted, refused = counts = grouped.compare(profile)
    refusals = _reasons(slave, profile, counts, against)
    if explained:
        count = explained + contradicted
        what = "the one request" if count == 1 else f"{explained} of {count} different requests"
        reasons.append(f"{what} ended as it says")
    contradicted += _compare_exceptions(slave, profile, against)
    contradicted += _compare_transports(slave, profile, against)
    contradicted += _compare_unit(slave, profile, against)
    named = min(_count_named(known, profile), addresses)
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
        has_name=has_name,
        refused=refused,
        reasons=tuple([*reasons, *refusals][:_MAX_REASONS]),
        against=tuple(against[:_MAX_REASONS]),
    )


def _reasons(
    slave: ObservedSlave, profile: Profile, counts: MatchCounts, against: list[str]
) -> list[str]:
    """Return a sentence for each of the first _MAX_REASONS requests that the slave refused as
    predicted. Adds a sentence to `against` for each that ended otherwise, until it has
    _MAX_REASONS. `counts` has the numbers of both.
    """
    refusals: list[str] = []
    most_refusals = min(counts.refused, _MAX_REASONS)
    most_against = min(len(against) + counts.contradicted, _MAX_REASONS)
    for one in compare_with_profile(slave, profile):
        if len(refusals) == most_refusals and len(against) >= most_against:
            break  # To compare thousands of requests one by one would take long.
        if one.is_against and len(against) < most_against:
            against.append(f"{one.reference} {one.end}, though {one.rule}")
        elif not one.is_against and not one.is_accepted and len(refusals) < most_refusals:
            refusals.append(f"{one.reference} refused, as {one.rule}")
    return refusals


def _compare_models(
    slave: ObservedSlave, profile: Profile, reasons: list[str], against: list[str]
) -> tuple[bool, bool]:
    """Compare the model code that the slave reported with the profile's.

    Returns two flags: True if the slave reported the profile's code; True if it reported only other
    codes. Adds a sentence to `reasons` or `against` if it reported any.
    """
    function = model_function(profile)
    if function is None or profile.model_code is None:
        return False, False
    codes = {word for code, word in slave.answer_words if code == function}
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
    """Return the code of the function with which a master asks for the model code; None if the
    profile has no such function.

    It is the function for whose response the profile lists the model code with a meaning.
    """
    for code, rule in profile.functions.items():
        if rule.answer is not None and profile.model_code in rule.answer.texts:
            return int(code, 16)
    return None


def _compare_names(slave: ObservedSlave, profile: Profile, reasons: list[str]) -> bool:
    """True if the identity that the slave reports names the profile's vendor or device. Then adds a
    sentence to `reasons`.
    """
    known = _telling_words(f"{profile.vendor} {profile.title} {profile.name}")
    matching = {name: text for name, text in slave.identity.items() if known & _telling_words(text)}
    if matching:
        texts = ", ".join(f"{name} {text!r}" for name, text in sorted(matching.items()))
        reasons.append(f"it says of itself: {texts}")
    return bool(matching)


_COMMON_WORDS = frozenset(
    ("modbus", "slave", "module", "device", "input", "inputs", "output", "outputs", "digital",
     "analog", "unit", "series", "type", "interface", "network", "controller", "electric", "with",
     "unknown", "operator", "company", "product", "code", "traffic", "coupler", "recorder",
     "corporation", "fieldbus")
)  # fmt: skip


def _telling_words(text: str) -> set[str]:
    words = re.findall(r"[a-z0-9]+", text.lower())
    return {word for word in words if len(word) >= _MIN_WORD_LETTERS} - _COMMON_WORDS


def _compare_exceptions(slave: ObservedSlave, profile: Profile, against: list[str]) -> int:
    """Count the exception codes of the slave that the profile's manual does not list. Adds a
    sentence to `against` for each.
    """
    codes = {code for one in slave.requests.values() for code in one.exceptions}
    undocumented = sorted(codes - set(profile.exceptions.documented))
    against += [f"exception {code:02X} is none of its manual's" for code in undocumented]
    return len(undocumented)


def _compare_transports(slave: ObservedSlave, profile: Profile, against: list[str]) -> int:
    """Return the number of contradictions between the transports of the slave and of the profile.

    It is 0 if they have one in common, and 1 for a serial device on a network, which may be behind
    a gateway. In any other case it is so large that the explained requests cannot outweigh it.
    Unless it is 0, adds a sentence to `against`.
    """
    spoken = set(profile.transports)
    if slave.transports & spoken or not slave.transports:
        return 0
    heard = ", ".join(sorted(slave.transports))
    is_on_line = all(one.is_serial for one in slave.transports)
    if is_on_line or not any(one.is_serial for one in spoken):
        against.append(f"it speaks {', '.join(sorted(spoken))}, and this is {heard}")
        return 1 + len(slave.requests)
    against.append(f"it is a serial device, and this is {heard}: only behind a gateway")
    return 1


def _compare_unit(slave: ObservedSlave, profile: Profile, against: list[str]) -> int:
    """Return the number of contradictions about the slave's unit: 0 if the device can have this
    unit.

    Otherwise the number is so large that the explained requests cannot outweigh it, and a sentence
    is added to `against`.
    """
    last = profile.last_unit
    on_line = any(one.is_serial for one in slave.transports)
    if last is None or not on_line or slave.unit <= last:
        return 0
    against.append(f"it can be unit 1 to {last}, and this is {slave.unit}")
    return 1 + len(slave.requests)


def _count_named(known: dict[Table, bytearray], profile: Profile) -> int:
    """Count the addresses with a name in the profile that the slave accepted in a read or write.

    `known` has for each table one byte per address: 1 if the slave accepted the address, else 0.
    """
    return sum(
        known[point.table].count(1, address, address + point.words)
        for point in profile.points
        for address in point.addresses
    )


def models_of(profiles: Iterable[Profile]) -> dict[tuple[int, int], Profile]:
    """Return the profiles that have a model code. The key is the code of the function that reads
    the model code, and the model code.
    """
    return {
        (function, profile.model_code): profile
        for profile in profiles
        if profile.model_code is not None and (function := model_function(profile)) is not None
    }
