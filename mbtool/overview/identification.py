"""Decides which device profile fits a slave, with a score from 0 to 100, or that none fits."""

# A few different requests fit the profiles of many devices, because most devices answer a read of
# their first registers. So a profile fits only if all of these conditions hold:
#
# - no other profile explains the slave's responses as well;
# - something confirms it that other devices do not share: the model code, the model's name in the
#   identity texts, or BOUNDARIES accepted address ranges that end where the profile says;
# - MIN_EXPLAINED different requests were accepted or refused as the profile predicts;
# - its score is above FITS:
#
#       score = 100 * explained / (explained + 5 * contradicted + 2)
#
#   `explained` and `contradicted` are the numbers of different requests that ended as the profile
#   predicts, and otherwise. The model code counts as MODEL_WEIGHT explained requests and the name
#   as NAME_WEIGHT. The 2 keeps the score low after few requests.
#
# If the profile does not fit, the score is at most UNCONFIRMED.

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from mbtool.core.wording import counted
from mbtool.devices.block_reads import can_be_read
from mbtool.devices.profile_match import match_profiles
from mbtool.overview.inventory_rows import ProfileFit

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.devices.model import Profile
    from mbtool.devices.observed_slave import ObservedSlave
    from mbtool.devices.profile_match import MatchResult, ProfileMatch

FITS = 80
UNCONFIRMED = 60
MIN_EXPLAINED = 4
MODEL_WEIGHT = 10
NAME_WEIGHT = 5
BOUNDARIES = 2
_CONTRADICTION = 5
_UNASKED = 2
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
        return ProfileFit(why=_too_little(len(slave.requests)))
    result = match_profiles(slave, profiles)
    if not result.matches or not result.matches[0].explained:
        return ProfileFit(why="nothing that it answers is like any profile")
    best = result.matches[0]
    profile = next(one for one in profiles if one.name == best.profile)
    confirmation = _confirmation(slave, profile, best)
    score = _score(slave, profile, best)
    doubt, names_best = _doubt(result, confirmation, score)
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


def _doubt(result: MatchResult, confirmation: str, score: int) -> tuple[str, bool]:
    """The reason, as a text for the user, why the best profile of `result` may not fit the slave,
    and True if the text names this profile.

    The text is empty if it fits. `score` is that profile's score, and `confirmation` the text of
    `_confirmation`.
    """
    best = result.matches[0]
    asked = _requests(best.explained + best.contradicted)
    ties = _ties(result)
    if best.is_other_model:
        return "its model code is another's", False
    if best.contradicted and score <= FITS:
        example = f"for example {best.against[0]}"
        text = f"{best.profile} would answer {best.contradicted} of {asked} otherwise, {example}"
        return text, True
    if len(ties) > 1 and not best.is_model:
        return f"{asked} fit {len(ties)} profiles equally well", False
    if not confirmation:
        text = f"{asked} fit {best.profile}, but so would other devices: nothing shows its model"
        return text, True
    if best.explained < MIN_EXPLAINED or score <= FITS:
        return _too_little(best.explained + best.contradicted), False
    return "", False


def _too_little(requests: int) -> str:
    return f"{_requests(requests)} {'tells' if requests == 1 else 'tell'} too little"


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
