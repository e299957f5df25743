"""The costs, in bits, by which the search compares explanations of the bytes on a serial line."""

# A cost is a negative log-likelihood ratio to base 2: one bit more means half as likely. Costs of
# independent facts add up, and the search (search.py) takes the path of the lowest total. A correct
# CRC is evidence of 16 bits. The other values are estimates; each states its reason.
#
# Seven are only start values: the line statistics (line_statistics.py) replace them by what this
# line shows. The pair named *_LIMITS gives the least and the most that a learned cost can become.
#
# docs/rs485.md defines the terms: candidate, path, bus state, pending, late, retry, burst.

from __future__ import annotations

# Who speaks: the cost of a frame as a request or as a response, given the bus state.

REQUEST = 1.0
"""A request while none is pending: the ordinary case."""
NEW_REQUEST = 2.0
"""Extra for a request that this line has not carried before: masters poll the same list."""
RESPONSE = 0.0
"""A response that fits the pending request."""
PREVIOUS_UNANSWERED = 5.0
"""Extra for a request while another one is pending: one request in thirty on a bad line."""
RETRY = 4.0
"""The same when the request equals the pending one, as a retry does. Start value, learned."""
RETRY_LIMITS = (2.0, 5.5)
"""Limits of the learned cost of a retry."""
SECOND_RETRY = 2.0
"""The same for a retry of a retry: a slave that missed two requests often misses the third."""
REPEAT_AFTER_RESPONSE = 5.0
"""Extra for a request that equals the one just answered, where silences cannot tell it from a
second response: masters usually go on to the next request of their list. Start value, learned."""
REPEAT_AFTER_RESPONSE_LIMITS = (0.0, 10.0)
"""Limits of the learned cost of a repeat: 0 for a master whose list has a single request."""
LATE_RESPONSE = 2.0
"""A response to the overdue request, after its retry or after damage."""
LATE_RESPONSE_TO_OTHER = 5.0
"""The same after the master has sent a different request: about as rare as no response at all."""
MISMATCHED_RESPONSE = 10.0
"""A response with the pending request's unit and function that does not fit it otherwise."""
UNREQUESTED_RESPONSE = 12.0
"""A response that fits neither the pending nor the overdue request."""
RESPONSE_AFTER_DAMAGE = 4.0
"""The same after damage and with no request pending: its request may be among the damaged bytes."""
RESPONSE_AT_START = 6.0
"""The same as the first frame of a capture: its request came before the capture began."""
UNREQUESTED_EXCEPTION = 4.0
"""Extra for an exception response after damage to a function that was never requested of this unit:
masters poll the same list."""
REQUEST_FITS_PENDING = 9.0
"""Extra for calling a frame a request when unit, function and byte count are those of the expected
response, and the frame is implausible or unheard as a request."""
ECHO_OF_READ = 16.0
"""A response that equals its request although its function is no echo. For a read of bits, 24 bits
of data would have to agree by chance."""
REQUEST_EQUALS_RESPONSE = 12.0
"""Extra for a request identical to the last response: it is probably that response, repeated."""
UNLIKE_FIRST_RESPONSE = 6.0
"""Extra for a second response to the same request that differs from the first in length, or in
being an echo or not."""
ECHO_OF_UNKNOWN_FUNCTION = 4.0
"""A response that equals its request, of a function that mbtool does not know as an echo."""
ECHO_IN_TIME = -1.0
"""Lower cost when that echo arrives within this line's usual response time: masters wait longer
before a retry."""
MALFORMED = 6.0
"""The CRC is correct but the PDU breaks its function's rules: a test tool or an odd device."""
IMPLAUSIBLE_REQUEST = 6.0
"""Extra for a frame with the length of a request and contents that no master sends."""
RESERVED_UNIT = 3.0
"""Extra for units 248 to 255, which are reserved (Serial Line V1.02, 2.2)."""
EARLY_REQUEST = 4.0
"""Extra for a request while another one is pending for less than this line's longest response time:
masters wait longer."""
LATE = 3.0
"""A response that takes longer than the longest response time of this line."""
LATE_PER_DOUBLING = 3.0
"""Extra for each doubling of that time."""
MAX_LATENESS = 8.0
"""The most that lateness costs: above this, the time says nothing more."""
MAX_ECHO_LATENESS = 14.0
"""The same for an echo, which may be a retry instead: some masters wait very long before one."""
REVERSED_PAIR = 6.0
"""Extra for an echo after more than twice the silence before its request, while no frame has shown
a certain direction: the two are probably a response and the next request."""

# Where frames are: the cost of the segments of a path.

SKIP = 8.0
"""The first of some bytes that belong to no frame: rare on a good line. Start value, learned."""
SKIP_LIMITS = (3.0, 10.0)
"""Limits of the learned cost of skipped bytes."""
NOISE = 7.0
"""The same after a frame for a byte of 00, F8, FC, FE or FF, which receivers hear when the bus
changes direction. Start value, learned."""
NOISE_LIMITS = (2.0, 9.0)
"""Limits of the learned cost of such noise."""
MIN_NOISE_IN_WINDOW = 4.0
"""Each run of skipped bytes makes the next one in the same window 1 bit cheaper, down to this."""
SKIP_PER_BYTE = 0.25
"""Each further skipped byte, and each byte of a damaged frame."""
MAX_DAMAGED_LENGTH = 12.0
"""The most that the bytes of a damaged frame cost when silences bound it and frames are never glued
on this line: its length is then certain."""
CRC_COINCIDENCE = 16.0
"""A correct CRC of a known form that the path does not use as a frame: a chance of 1 in 65,536."""
UNKNOWN_CRC_COINCIDENCE = 8.0
"""The same without a known form: about 256 lengths were tried."""
DAMAGED = 10.0
"""A frame of the expected size with a wrong CRC."""
DAMAGED_OTHER_SIZE = 3.0
"""Extra when bytes of it were lost, or when only the silences around it give its size."""
ONE_WRONG_BIT = 2.0
"""A frame whose CRC becomes correct by changing one bit. For a frame of 20 bytes, one damage in 400
would show this by chance."""
ONE_WRONG_BIT_PER_BYTE = 0.1
"""Extra for each of its bytes: a longer frame has more bits that could explain a CRC by chance."""
RARE_ONE_BIT = 2.0
"""Extra for explaining damage by one wrong bit. Start value, learned."""
RARE_ONE_BIT_LIMITS = (0.2, 8.0)
"""Limits of that learned cost."""
NOT_UNDERSTOOD = 1.0
"""Extra for supposing that the addressee did not understand a damaged frame either: the damage may
be on the wire, or only in this tap."""
EXPECTED_CONTENT = -6.0
"""Lower cost when more than two bytes of a damaged or incomplete frame are as expected: a request
heard before, the expected byte count of a response, or a write whose byte count agrees with its
quantity."""
UNEXPECTED_DAMAGED = 3.0
"""Extra for a damaged frame that the bus state does not expect, or that only silences bound."""
INCOMPLETE = 0.5
"""The beginning of a frame whose other bytes may still arrive: waiting for them costs little."""
INCOMPLETE_IN_PLACE = -4.0
"""Lower cost when it follows a frame or a silence: a frame probably begins there."""
INCOMPLETE_OVER_FRAME = 10.0
"""Extra when a complete frame begins at the same byte: the next byte would have to be 00."""
INCOMPLETE_DUE_OVER_FRAME = 7.0
"""The same when the bus state expects the longer frame."""
INCOMPLETE_PER_BYTE = 0.1
"""Extra for each byte of an incomplete frame: the longer the wait, the less probable is its end."""
INCOMPLETE_DUE_PER_BYTE = 0.02
"""The same when the bus state expects the frame."""
INCOMPLETE_UNEXPECTED = 1.5
"""Extra for an incomplete frame that the bus state does not expect."""
GLUED = 2.0
"""A frame that begins without a silence before it. Start value, learned."""
GLUED_LIMITS = (0.2, 8.0)
"""Limits of the learned cost of glued frames."""
NEVER_GLUED = 5.0
"""When the learned cost of glued frames is above this, frames on this line are never glued."""
SPLIT = 2.0
"""A silence of t3.5 inside a frame. Start value, learned."""
SPLIT_LIMITS = (0.2, 5.0)
"""The least and the most, in bits, that the learned cost of such a silence can become."""
SPLIT_MORE = 0.25
"""Each further silence inside the same frame: an adapter that splits a frame splits it often."""
UNKNOWN_FORM_BURST = 2.0
"""A frame of no known form that has a correct CRC and fills a burst, silence to silence."""
UNKNOWN_FORM = 6.0
"""The same without the silences: one of 253 lengths has a correct CRC, which is 8 bits less
evidence."""
UNKNOWN_FORM_DUE = 2.0
"""The same when it begins with the unit and function of a request that is pending, overdue or just
answered: these two bytes are 16 bits of evidence."""
ENDS_IN_ZERO = 5.0
"""Extra when a frame of no known form ends in 00: its CRC is then correct without that byte too.
One frame in 256 ends in 00, and one stray byte in four is 00, so the frequency of stray bytes on
this line decides."""
ENDS_IN_ZERO_MORE = 6.0
"""Extra for each further 00: 8 bits of chance in a CRC against 2 bits in stray bytes."""
ZERO_BEFORE_SILENCE = 1.5
"""Taken off ENDS_IN_ZERO when a silence follows that 00: a stray byte usually has a silence before
it as well."""

# The beam.

BEAM_MARGIN = 12.0
"""Paths that cost so much more than the best path of at least the same length are dropped."""
INCOMPLETE_DOUBT = 3.0
"""A path to an incomplete frame that costs so much more than the best such path is not kept."""
INCOMPLETE_MARGIN = 24.0
"""Paths that cost so much more than the best path to an incomplete frame are dropped."""
