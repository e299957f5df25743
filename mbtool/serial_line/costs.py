"""The costs, in bits, by which the search compares explanations of the bytes on a serial line."""

# A cost is a negative log-likelihood ratio to base 2: one bit more means half as likely. Costs of
# independent facts add up, and the search (search.py) takes the path (the explanation of all bytes)
# with the lowest total. A correct CRC is evidence of 16 bits. The other values are estimates; each
# states its reason.
#
# Nine costs are only start values: the line statistics (line_statistics.py) replace them by what
# this line shows. For such a cost, the pair named *_LIMITS gives the least and the most bits that
# it can become.
#
# docs/rs485.md defines the terms: candidate, path, bus state, pending, late, retry, burst.

from __future__ import annotations

from mbtool.modbus.functions import EXCEPTION_BIT, READ_REGISTERS
from mbtool.modbus.layouts import bit_bytes

# PDUs that have a correct form, but contents that no master or slave sends, or hardly ever.

COUNTS = frozenset((2, *range(11, 19)))
"""Sub-functions of 08 that read a register or a counter (V1.1b3, 6.8.1)."""
ODD_EXCEPTIONS = 0x40
"""No known device uses exception code 0, this exception code or a higher one."""


def is_implausible_request(pdu: bytes) -> bool:
    """True if a PDU with the form of a request has contents that no master sends.

    A request for a counter (function 08) always has 0000 as data (V1.1b3, 6.8.1).
    """
    if pdu[0] & EXCEPTION_BIT:
        return True
    return pdu[0] == 0x08 and int.from_bytes(pdu[1:3]) in COUNTS and any(pdu[3:])


def is_implausible_response(pdu: bytes) -> bool:
    """True if a PDU with the form of a response has contents that no slave sends.

    That is an odd number of bytes in a response that brings registers, or an exception code that
    neither the specification nor devices use.
    """
    if pdu[0] & EXCEPTION_BIT:
        return len(pdu) == 2 and not 0 < pdu[1] < ODD_EXCEPTIONS
    return pdu[0] in READ_REGISTERS and len(pdu) % 2 == 1


def is_counted(pdu: bytes) -> bool:
    """True if a PDU begins like a write request whose byte count agrees with its quantity."""
    match pdu[0]:
        case 0x0F:
            return len(pdu) > 5 and pdu[5] == bit_bytes(int.from_bytes(pdu[3:5]))
        case 0x10:
            return len(pdu) > 5 and pdu[5] == 2 * int.from_bytes(pdu[3:5])
        case 0x17:
            return len(pdu) > 9 and pdu[9] == 2 * int.from_bytes(pdu[7:9])
        case _:
            return False


def is_padded(request: bytes, response: bytes) -> bool:
    """True if the unused bits of a response to a read of bits, in its last byte, are 0.

    The standard demands it (V1.1b3, 6.1).
    """
    used = int.from_bytes(request[3:5]) % 8
    return not used or response[-1] >> used == 0


# The costs below tell who speaks: they are the costs of a frame as a request or as a response,
# given the bus state (which request is pending, and what came last).

REQUEST = 1.0
"""The cost, in bits, of a request while none is pending: the ordinary case."""
NEW_REQUEST = 2.0
"""Extra cost, in bits, of a request that this line has not carried before: masters poll the same
list again and again."""
RESPONSE = 0.0
"""The cost, in bits, of a response that fits the pending request."""
PREVIOUS_UNANSWERED = 5.0
"""Extra cost, in bits, of a request that differs from the one still pending: on a bad line, one
request in thirty gets no response. A start value, which the line's history replaces."""
PREVIOUS_UNANSWERED_LIMITS = (2.0, 5.0)
"""The least and the most, in bits, that the learned cost of a request behind an unanswered one can
become. It is low while somebody looks which units exist."""
RETRY = 4.0
"""Extra cost, in bits, of a request that equals the one still pending, as a retry does. A start
value, which the line statistics replace."""
RETRY_LIMITS = (2.0, 7.0)
"""The least and the most, in bits, that the learned cost of a retry can become."""
SECOND_RETRY = 2.0
"""Extra cost, in bits, of a retry of a retry: a slave that missed two requests often misses the
third."""
REPEAT_AFTER_RESPONSE = 5.0
"""Extra cost, in bits, of a request that equals the one just answered, if silences cannot tell it
from a second response: masters usually go on to the next request of their list. A start value,
which the line statistics replace."""
REPEAT_AFTER_RESPONSE_LIMITS = (0.0, 10.0)
"""The least and the most, in bits, that the learned cost of a request that equals the one just
answered can become. It becomes 0 for a master that sends a single request again and again."""
REPEAT_AGAIN = 1.0
"""Extra cost, in bits, of a request that equals the last two requests, which both had a response: a
master that writes one value in a loop goes on with it."""
LATE_RESPONSE = 2.0
"""The cost, in bits, of a response to a request that the master has given up (an overdue request),
after its retry or after damaged bytes."""
LATE_RESPONSE_TO_OTHER = 5.0
"""The cost, in bits, of a response to a request that the master has given up, when it has already
sent a different request: about as rare as no response at all."""
MISMATCHED_RESPONSE = 10.0
"""The cost, in bits, of a response that has the unit and function of the pending request, but
cannot answer it."""
MISMATCHED_ECHO = 16.0
"""The cost, in bits, of a response to 05, 06, 08, 15H or 16H that repeats another address than that
of its request: slaves limit values, but do not change addresses."""
WRONG_ECHO = 8.0
"""The cost, in bits, of a response to 05, 06 or 16H that repeats the address of its request and
another value, as of a slave that limits the value."""
WHOLE_ECHO = 10.0
"""The cost, in bits, of a response to 0FH or 10H that repeats the whole request. It is higher than
WRONG_ECHO, as fewer slaves do so."""
WRONG_ECHO_AGAIN = 3.0
"""This number of bits is subtracted from WRONG_ECHO or WHOLE_ECHO for each such response that the
unit has probably given to this function, up to WRONG_ECHOES times: the slave does so again."""
WRONG_ECHOES = 2
"""Each of this many first wrong echoes of a unit makes the next one WRONG_ECHO_AGAIN bits cheaper;
further ones do not."""
WRONG_ECHO_OF_SILENT_UNIT = 6.0
"""Extra cost, in bits, of a wrong echo from a unit that has left requests unanswered and never sent
a response that differs from its request: it may be absent, and the frame another request."""
WRONG_ECHO_OF_NEW_UNIT = 3.0
"""Extra cost, in bits, of a wrong echo from a unit of which nothing else is known."""
REWRITE = 3.0
"""Extra cost, in bits, of a request that writes another value to the address that the last request
wrote, before it was answered. A start value, which the line's history replaces."""
REWRITE_LIMITS = (0.5, 6.0)
"""The least and the most, in bits, that the learned cost of such a request can become. It is low on
a line whose master sends one set point after the other."""
UNREQUESTED_RESPONSE = 12.0
"""The cost, in bits, of a response that fits neither the pending request nor one that the master
has given up."""
REQUEST_ON_THE_SLAVES_SIDE = 12.0
"""Extra cost, in bits, of a request if only the slaves are heard (one pair of a four-wire line).
There a response that nobody requested costs nothing extra."""
RESPONSE_AFTER_DAMAGE = 4.0
"""The cost, in bits, of a response without a request when damaged bytes came before it and no
request is pending: its request may be among the damaged bytes."""
RESPONSE_AT_START = 6.0
"""The cost, in bits, of a response as the first frame of a capture: its request came before the
capture began."""
UNREQUESTED_EXCEPTION = 4.0
"""Extra cost, in bits, of an exception response that follows damaged bytes, if its function was
never requested of its unit: masters poll the same list."""
REQUEST_FITS_PENDING = 9.0
"""Extra cost, in bits, of calling a frame a request when its unit, function and byte count are
those of the expected response, and as a request it is implausible or was never heard before."""
ECHO_OF_READ = 16.0
"""The cost, in bits, of a response that equals its request, if slaves do not echo that function.
For a read of bits, 24 bits of data would have to agree by chance."""
REQUEST_EQUALS_RESPONSE = 12.0
"""Extra cost, in bits, of a request that equals the last response: it is probably that response
again."""
UNLIKE_FIRST_RESPONSE = 6.0
"""Extra cost, in bits, of a second response to the same request, if it differs in length from the
first, or if only one of the two equals the request."""
ECHO_OF_UNKNOWN_FUNCTION = 4.0
"""The cost, in bits, of a response that equals its request, if mbtool does not know whether slaves
echo that function."""
ECHO_IN_TIME = -1.0
"""This negative number of bits is added to the cost of a response that equals its request, if
mbtool does not know the function and the response comes within this line's longest response time.
Masters wait longer before a retry, so the frame is no retry."""
MALFORMED = 6.0
"""The cost, in bits, of a frame whose CRC is correct but whose PDU breaks the rules of its
function: a test tool or an odd device sent it."""
IMPLAUSIBLE_REQUEST = 6.0
"""Extra cost, in bits, of a frame with the length of a request and contents that no master
sends."""
RESERVED_UNIT = 3.0
"""Extra cost, in bits, of a frame with a unit of 248 to 255, which are reserved (Serial Line V1.02,
2.2)."""
EARLY_REQUEST = 4.0
"""Extra cost, in bits, of a request when another one has been pending for less than this line's
longest response time: masters wait longer."""
SLOW_DOUBLINGS = 3.0
"""An echo (a response that equals its request) of a function that was not heard before may take up
to 8 times (3 doublings) as long as the longest response of this line: writes to an EEPROM do."""
SHORT_PAUSE = 5.0
"""Extra cost, in bits, of a request that equals the one just answered and comes sooner than this
master ever sends its next request after a response: the frame is probably the response to a
retry."""
SHORT_PAUSE_SHARE = 0.5
"""A pause (from a response to the next request) is short if it is shorter than this share of the
shortest pause of the line so far."""
USUAL_PAUSE = 3.0
"""Extra cost, in bits, of a second response to a request and its retry that comes as late after the
first response as this master sends its next request: slaves answer what they have received at
once."""
USUAL_PAUSE_SHARE = 0.9
"""A silence may be the master's pause if it is at least this share (0 to 1) of the shortest pause
of the line so far: times differ by a few milliseconds."""
LATE = 3.0
"""The cost, in bits, of a response that takes longer than the longest response time of this
line."""
LATE_PER_DOUBLING = 3.0
"""Extra cost, in bits, of a response that takes twice as long as the longest response time of this
line; four times as long costs this twice, and so on."""
MAX_LATENESS = 8.0
"""The most bits that the lateness of a response costs: even later ones are no less likely."""
MAX_ECHO_LATENESS = 14.0
"""The most bits that lateness costs for an echo (a response that equals its request). It is higher
than for other responses, since a late echo may be a retry instead: some masters wait very long
before a retry."""
SHORT_TIMEOUT = 4.0
"""Extra cost, in bits, of a retry that comes 100 ms after its request: half of 200 ms, which is
about the shortest timeout of masters. A retry after 50 ms costs this twice, and so on. Used if this
master's timeout is not known."""
LATE_BEFORE_TIMEOUT = 3.0
"""The most bits that lateness costs for an echo (a response that equals its request) if the master
is known to wait that long."""
LATE_AS_OTHERS = 2.0
"""The most bits that lateness costs for an echo (a response that equals its request) if other units
or functions of this line have taken as long for an echo."""
NEAR_TIMEOUT = 1.5
"""An echo (a response that equals its request) costs this many bits more than a retry if it comes
when the master's timeout is certainly over, and this many bits less if it comes when the timeout
may just be over. So a frame near the timeout is ambiguous."""
NEAR_DOUBLINGS = 0.8
"""A frame that equals its request and comes at the master's timeout is surely a retry only if the
timeout is this many doublings (1.7 times) longer than the longest response time of this line."""
SOONER = 0.8
"""An echo (a response that equals its request) was no retry if the master sends its next request in
less than this share (0 to 1) of the time that the echo took: after a retry it would have waited as
long again."""
SILENT_UNIT = 3.5
"""The cost, in bits, of a response that equals its request, from a unit that has never sent any
other response, on a line where other units have: the unit may be absent, and the frame a retry."""
MIN_UNANSWERED = 1.0
"""The least extra cost, in bits, of one more request without a response, to a unit that is probably
absent."""
REVERSED_PAIR = 6.0
"""Extra cost, in bits, of an echo (a response that equals its request) when the silence before it
is more than twice the silence before its request, and no frame so far had a certain direction: the
two frames are probably a response and the next request."""

# The costs below tell where frames begin and end: they are the costs of the parts of an explanation
# (frames, damaged frames and skipped bytes).

SKIP = 8.0
"""The cost, in bits, of the first of several skipped bytes in a row (bytes that are in no frame):
they are rare on a good line. A start value, which the line statistics replace."""
SKIP_LIMITS = (3.0, 10.0)
"""The least and the most, in bits, that the learned cost of the first skipped byte can become."""
NOISE = 7.0
"""The cost, in bits, of a skipped byte of 00, F8, FC, FE or FF directly after a frame: receivers
hear such bytes when the bus changes direction. A start value, which the line statistics replace."""
NOISE_LIMITS = (2.0, 9.0)
"""The least and the most, in bits, that the learned cost of noise after a frame can become."""
MIN_NOISE_IN_WINDOW = 4.0
"""The least cost, in bits, of noise after a frame. Each group of skipped bytes makes the next group
in the same search 1 bit cheaper, but not cheaper than this."""
OFTEN_SKIPPED = 1 / 16
"""If at least this share of frames (0 to 1) has skipped bytes before it, or noise, these are
frequent on this line."""
SKIP_PER_BYTE = 0.25
"""The cost, in bits, of each skipped byte after the first, and of each byte of a damaged frame."""
MAX_DAMAGED_LENGTH = 12.0
"""The most bits that the length of a damaged frame costs if silences bound the frame and separate
all frames on this line: its length is then certain."""
CRC_COINCIDENCE = 16.0
"""The cost, in bits, of calling a correct CRC a coincidence, if the function code gives the frame's
length: random bytes have a correct CRC once in 65,536 times."""
UNKNOWN_CRC_COINCIDENCE = 8.0
"""The cost, in bits, of calling a correct CRC a coincidence, if the function code does not give the
frame's length. It is less than CRC_COINCIDENCE: about 256 lengths were tried, and each may have a
correct CRC by chance."""
DAMAGED = 10.0
"""The cost, in bits, of a frame with a wrong CRC that has the size its function tells: on a good
line, one frame in a thousand is damaged."""
DAMAGED_OTHER_SIZE = 3.0
"""Extra cost, in bits, of a damaged frame that lost bytes, or whose size only the silences around
it tell."""
ONE_WRONG_BIT = 2.0
"""The cost, in bits, of a damaged frame whose CRC becomes correct by changing one bit. By chance,
one in 400 frames of 20 bytes with any other damage would show this, too."""
ONE_WRONG_BIT_PER_BYTE = 0.1
"""Extra cost, in bits, of each byte of a frame with one wrong bit: in a longer frame, more bits
could by chance make the CRC correct."""
RARE_ONE_BIT = 2.0
"""Extra cost, in bits, of explaining damage by one wrong bit. A start value, which the line
statistics replace."""
RARE_ONE_BIT_LIMITS = (0.2, 8.0)
"""The least and the most, in bits, that the learned cost of one wrong bit can become."""
NOT_UNDERSTOOD = 1.0
"""Extra cost, in bits, of supposing that the addressee did not understand a damaged frame either:
the damage may have occurred on the wire, or only in this tap."""
EXPECTED_CONTENT = -6.0
"""This negative number of bits is added to the cost of a damaged or incomplete frame that is
expected by more than its unit and function: its contents equal a request heard before, it has the
length that the pending request asks for, or, if incomplete, it is a write request whose byte count
agrees with its quantity."""
UNEXPECTED_DAMAGED = 3.0
"""Extra cost, in bits, of a damaged frame that has not the unit and function of a pending or late
response, nor the contents of a known request, or whose size only the silences around it tell."""
INCOMPLETE = 0.5
"""The cost, in bits, of the beginning of a frame whose other bytes may still arrive: waiting for
them costs little."""
INCOMPLETE_IN_PLACE = -4.0
"""This negative number of bits is added to the cost of an incomplete frame that follows a frame or
a silence, since a frame probably begins there, or that has expected contents."""
INCOMPLETE_OVER_FRAME = 10.0
"""Extra cost, in bits, of an incomplete frame where a complete frame begins at the same byte."""
INCOMPLETE_DUE_OVER_FRAME = 7.0
"""Extra cost, in bits, of an incomplete frame where a complete frame begins at the same byte, if
the bus state expects the longer, incomplete one."""
INCOMPLETE_PER_BYTE = 0.1
"""Extra cost, in bits, of each byte of an incomplete frame: the longer the wait for its end, the
less probable is it that the end comes."""
INCOMPLETE_DUE_PER_BYTE = 0.02
"""Extra cost, in bits, of each byte of an incomplete frame that the bus state expects."""
INCOMPLETE_UNEXPECTED = 1.5
"""Extra cost, in bits, of an incomplete frame that the bus state does not expect."""
GLUED = 2.0
"""The cost, in bits, of a frame that begins without a silence before it. A start value, which the
line statistics replace."""
BEHIND_NOISE = 4.0
"""The upper limit, in bits, of the cost of a missing silence before a frame that has skipped bytes
before it and a silence behind it. The silence shows that the frame is not part of the registers of
a longer frame, as the CRC of that frame would follow."""
GLUED_LIMITS = (0.2, 8.0)
"""The least and the most, in bits, that the learned cost of a frame without a silence before it can
become."""
NEVER_GLUED = 5.0
"""If the learned cost of glued frames (frames without a silence between them) is above this, mbtool
supposes that frames on this line are never glued."""
SPLIT = 2.0
"""The cost, in bits, of a silence of t3.5 inside a frame. A start value, which the line statistics
replace."""
SPLIT_LIMITS = (0.2, 5.0)
"""The least and the most, in bits, that the learned cost of a silence inside a frame can become."""
SPLIT_MORE = 0.25
"""The cost, in bits, of each further silence inside the same frame: an adapter that splits a frame
in two often splits it into more pieces."""
UNKNOWN_FORM_BURST = 2.0
"""The cost, in bits, of a frame whose function does not tell its size, if its CRC is correct and it
extends from one silence to the next."""
UNKNOWN_FORM = 6.0
"""The cost, in bits, of a frame whose function does not tell its size, if its CRC is correct but
silences do not bound it. Any of 253 lengths might have had a correct CRC by chance, which is 8 bits
less evidence."""
UNKNOWN_FORM_DUE = 2.0
"""The cost, in bits, of a frame whose size neither its function nor silences tell, if it begins
with the unit and function of a request that is pending, given up or just answered: these two bytes
are 16 bits of evidence."""
ENDS_IN_ZERO = 5.0
"""Extra cost, in bits, of a frame that ends in 00, if its function does not tell its size: its CRC
is correct without that byte too. One frame in 256 ends in 00, and one stray byte in four is 00. So
the 00 may be either, and which is more likely depends on how frequent stray bytes are."""
ENDS_IN_ZERO_MORE = 6.0
"""Extra cost, in bits, of each further 00 at the end of a frame whose function code does not give
its size. It is 8 bits less 2 bits: one byte in 256 of a CRC is 00 (8 bits), but one stray byte in
four (2 bits). So the 00 is more likely to be a stray byte."""
ZERO_BEFORE_SILENCE = 1.5
"""This number of bits is subtracted from ENDS_IN_ZERO if a silence follows the 00 at the end of the
frame. A stray byte with a silence behind it usually has one before it, too. This 00 has none before
it, so it is less probably a stray byte."""

# The limits below tell which paths (explanations of the bytes so far) the search (search.py) drops
# because they cost too much.

BEAM_MARGIN = 12.0
"""A path (an explanation of the bytes up to an offset) is dropped if it costs this many bits more
than the best path of at least its length."""
INCOMPLETE_DOUBT = 3.0
"""A path (an explanation of the bytes) that ends in an incomplete frame is not kept if it costs
this many bits more than the best such path."""
INCOMPLETE_MARGIN = 24.0
"""A path (an explanation of the bytes) is dropped if it costs INCOMPLETE_DOUBT plus this many bits
more than the best path that ends in an incomplete frame."""
