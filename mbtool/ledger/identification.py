"""Decides which device profile fits a slave, with a score from 0 to 100, or that none fits."""

# A few different requests fit the profiles of many devices, because most devices answer a read of
# their first registers. So a profile fits only if all of these conditions are met:
#
# - no other profile explains the slave's responses as well;
# - something confirms it that other devices do not share: the model code, the model's name in the
#   identity texts, or BOUNDARIES accepted address ranges that end where the profile says;
# - MIN_EXPLAINED different requests were accepted or refused as the profile predicts;
# - its score is above FITS:
#
#       score = 100 * explained / (explained + 5 * contradicted + 2)
#
#   `explained` is the number of different requests that ended as the profile predicts,
#   `contradicted` the number of those that ended differently. The model code counts as MODEL_WEIGHT
#   explained requests and the name as NAME_WEIGHT. The 2 keeps the score low after few requests.
#
# If the profile does not fit, the score is at most UNCONFIRMED.

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from mbtool.core.moments import counted
from mbtool.devices.block_reads import can_be_read
from mbtool.devices.profile_match import MatchResult, ProfileMatch, match_profiles
from mbtool.devices.request_match import compare_with_profile
from mbtool.ledger.inventory_ranges import listed
from mbtool.ledger.inventory_rows import ProfileFit

if TYPE_CHECKING:
    from mbtool.devices.model import Profile
    from mbtool.devices.observed_slave import ObservedSlave

FITS = 80
"""A profile fits a slave only if its score (0 to 100) is above this."""
UNCONFIRMED = 60
"""The greatest score (0 to 100) of a profile that does not fit."""
MIN_EXPLAINED = 4
"""A profile fits a slave only if at least this many different requests were accepted or refused as
the profile predicts."""
MODEL_WEIGHT = 10
"""The model code counts as this many explained requests."""
NAME_WEIGHT = 5
"""The model's name in an identity text counts as this many explained requests."""
BOUNDARIES = 2
"""A profile fits only if at least this many accepted address ranges end where it says, if neither
model code nor name confirms it."""
_CONTRADICTION = 5
"""A request that ended otherwise than the profile predicts counts this many times in the score."""
_UNASKED = 2
"""This number is added to the requests by which the score is divided, so that it is low after few
requests."""
_FEW_TIES = 3
"""A text names at most this many profiles that fit equally well."""
_MODEL_WORD = re.compile(r"(?=[a-z0-9]*\d)(?=[a-z0-9]*[a-z])[a-z0-9]{4,}")
"""A word of at least 4 letters and digits with both in it, such as lt830. Such a word names a
model; a word of letters alone may be a vendor's name."""
_ADDRESS_REFUSALS = frozenset((0x02, 0x03))


def identify(slave: ObservedSlave, profiles: Sequence[Profile]) -> ProfileFit:
    """Compare the requests and responses of a slave with the profiles, and choose the one that
    fits.

    If none fits, the result has the reason.
    """
    if len(slave.requests) < MIN_EXPLAINED:
        return ProfileFit(why=_too_few(len(slave.requests)))
    result = match_profiles(slave, profiles)
    if not result.matches or not result.matches[0].explained:
        return ProfileFit(why="no request ended as any profile's manual says")
    best = result.matches[0]
    profile = next(one for one in profiles if one.name == best.profile)
    confirmation = _confirmation(slave, profile, best)
    score = _score(slave, profile, best)
    doubt, names_best = _doubt(result, profile, confirmation, score)
    if doubt:
        score = min(score, UNCONFIRMED)
    has_ties = len(_ties(result)) > 1
    return ProfileFit(
        profile=None if doubt else best.profile,
        nearest=best.profile if doubt and not has_ties else None,
        score=score,
        why=doubt or confirmation,
        why_names_nearest=names_best and not has_ties,
        evidence=list(best.reasons),
        against=list(best.against),
    )


def _score(slave: ObservedSlave, profile: Profile, match: ProfileMatch) -> int:
    if match.is_other_model:
        return 0
    explained = match.explained + MODEL_WEIGHT * match.is_model
    explained += NAME_WEIGHT * _names_model(slave, profile)
    return 100 * explained // (explained + _CONTRADICTION * match.contradicted + _UNASKED)


def _doubt(
    result: MatchResult, profile: Profile, confirmation: str, score: int
) -> tuple[str, bool]:
    """The reason, as a text for the user, why `profile`, the best one of `result`, may not fit the
    slave, and True if the text names this profile.

    The text is empty if it fits. `score` is that profile's score, and `confirmation` the text of
    `_confirmation`.
    """
    best = result.matches[0]
    ties = _ties(result)
    if best.is_other_model:
        return "it says a model code that no profile has", False
    if best.contradicted and score <= FITS:
        example = _contradiction(result, profile)
        text = (
            f"{best.profile} comes nearest, but {_explained_share(best)} ended as its manual says"
        )
        return f"{text}; for example, {example}", True
    if len(ties) > 1 and not best.is_model:
        names = listed(sorted(ties), _FEW_TIES)
        return (
            f"{_explained_share(best)} ended as the manuals of {len(ties)} profiles say: {names}",
            False,
        )
    if not confirmation:
        text = (
            f"{_explained_share(best)} ended as the manual of {best.profile} says, but they would"
        )
        return f"{text} at other devices, too: nothing shows the model", True
    if best.explained < MIN_EXPLAINED or score <= FITS:
        return _too_few(best.explained), False
    return "", False


def _contradiction(result: MatchResult, profile: Profile) -> str:
    """Return a sentence on the first thing that speaks against the best profile."""
    compared = compare_with_profile(result.slave, profile)
    against = (one.contradiction for one in compared if one.is_against)
    return next(against, result.matches[0].against[0])


def _too_few(requests: int) -> str:
    is_too_few = "is too few" if requests == 1 else "are too few"
    return f"{_requests(requests)} {is_too_few} to tell which device it is"


def _explained_share(match: ProfileMatch) -> str:
    """Return which share of the requests ended as a profile's manual says."""
    asked = match.explained + match.contradicted
    if not match.contradicted:
        return f"all {_requests(asked)}"
    return f"only {match.explained} of {_requests(asked)}"


def _ties(result: MatchResult) -> list[str]:
    """The names of all profiles that share the best rank, including that of `result.matches[0]`."""
    return [one.profile for one in result.matches if one.rank == result.matches[0].rank]


def _requests(count: int) -> str:
    return counted(count, "request" if count == 1 else "different request")


def _confirmation(slave: ObservedSlave, profile: Profile, match: ProfileMatch) -> str:
    """A text on evidence that few devices but the profile's would give: a model code, a name, or
    the ends of address ranges. Empty if there is no such evidence.
    """
    if match.is_model:
        return "its model code and its answers"
    if _names_model(slave, profile):
        return "its own name for itself and its answers"
    ends = _boundaries(slave, profile)
    if ends >= BOUNDARIES:
        return f"its answers, and {ends} areas that end where its manual says"
    return ""


def _names_model(slave: ObservedSlave, profile: Profile) -> bool:
    """True if an identity text of the slave contains a word of the profile's name or title that
    names a model, such as lt830.
    """
    known = set(_MODEL_WORD.findall(f"{profile.title} {profile.name}".lower()))
    said = " ".join(slave.identity.values()).lower()
    return bool(known & set(_MODEL_WORD.findall(said)))


def _boundaries(slave: ObservedSlave, profile: Profile) -> int:
    """Count the accepted address ranges that end exactly where the profile says.

    Such an end counts only if the device refused a request that begins directly behind it or
    extends beyond it. Refused addresses far from accepted ones do not count, as every device
    refuses those.
    """
    accepted = slave.known_addresses()
    ends = set()
    for request, replies in slave.requests.items():
        table, span = request.table, request.span
        if table is None or request.address is None or replies.ok:
            continue
        if not _ADDRESS_REFUSALS.intersection(replies.exceptions):
            continue
        is_allowed = (
            profile.allows(table, span, writing=True)
            if request.writes
            else can_be_read(profile, table, span)
        )
        end = accepted[table].rfind(1, max(span.start - 1, 0), span.stop + 1)
        if not is_allowed and end >= 0:
            ends.add((table, end))
    return len(ends)
