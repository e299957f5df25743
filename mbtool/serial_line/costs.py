"""What speaks for and against an explanation of the bytes on an RTU line, in bits."""

# A bit is a factor of two in likelihood, so costs add where probabilities multiply. The cheapest
# explanation of all bytes is taken (tiling.py). What a CRC proves is 16 bits; the other figures are
# judgements, with their reasons. What a line teaches about itself (turns.py, habits.py) replaces
# them within the limits given here.

from __future__ import annotations

# Whose turn it is.

REQUEST = 1.0
"""A request while none waits: what a line is made of."""
NEW_REQUEST = 2.0
"""More for a request that this line has not heard before: masters repeat a list."""
ANSWER = 0.0
"""The response that the waiting request asks for."""
UNANSWERED = 5.0
"""A request while another waits: about one in thirty on a bad line."""
REPEATED = 4.0
"""The same, with the very request that waits: a retry is the usual reason. Learned, from 2
to 5.5."""
REPEATED_LIMITS = (2.0, 5.5)
REPEATED_AGAIN = 2.0
"""The same of one that had been repeated already: what does not answer twice seldom does then."""
ASKED_AGAIN = 5.0
"""A request right behind its own answer: a master goes on to the next of its list, and asks again
only where it has a list of one. Where silences do not tell it from a late second answer. Learned,
from 0 to 10."""
ASKED_AGAIN_LIMITS = (0.0, 10.0)
LATE_ANSWER = 2.0
"""The response to a request that the master has already repeated, or that was damaged."""
LATE_ELSEWHERE = 5.0
"""The same where the master has gone on to another request: about as rare as no answer at all."""
WRONG_ANSWER = 10.0
"""A response of the unit and function that wait, which does not fit what was asked."""
STRAY_ANSWER = 12.0
"""A response to nothing: another request waits, or none does."""
ANSWER_WHEN_LOST = 4.0
"""The same behind damage, in which its request may have gone unheard."""
ANSWER_AT_START = 6.0
"""The same as the first frame of a capture."""
UNASKED = 4.0
"""More for an exception behind damage, to a function that its unit was not asked for as long as
this line is heard: masters repeat a list."""
FITS_AS_ANSWER = 9.0
"""More for a request that is none by its form, or was never heard, and is just what the waiting one
asks for: unit, function and byte count."""
ECHO_OF_A_READ = 16.0
"""A response that is its very request, of a function that says nothing of the kind: as with a read
of bits, where 24 would have to agree."""
REQUEST_LIKE_ANSWER = 12.0
"""More for a request that is what was just answered to another: the answer has come twice."""
UNLIKE_ANSWERS = 6.0
"""More for a late answer that has not the length of the one that came in time, or is an echo where
that was none."""
ECHO_OF_UNKNOWN = 4.0
"""A response that repeats its request, of a function that no table says to do so."""
ECHO_IN_TIME = -1.0
"""Less for one that comes as soon as answers do here: masters wait longer before they repeat."""
MALFORMED = 6.0
"""The CRC is right and the form is not: a tester, or a device with ways of its own."""
ODD_REQUEST = 6.0
"""The form is that of a request, and it says what none does."""
UNLIKELY_UNIT = 3.0
"""Units 248 to 255 are reserved (Serial Line V1.02, 2.2)."""
EARLY_REPEAT = 4.0
"""A request behind another within the longest latency of the line: masters wait longer."""
LATE = 3.0
"""A response later than the longest latency of the line."""
LATE_PER_OCTAVE = 3.0
"""More for each doubling."""
MOST_FOR_LATENESS = 8.0
MOST_FOR_LATE_ECHO = 14.0
"""The same of an answer that may be a repeated request instead: masters wait for very long."""
BACKWARDS = 6.0
"""An echo that answers after more than twice the silence before its request, on a line of which
nothing is sure."""

# Where frames are.

SKIP = 8.0
"""Bytes that belong to no frame begin: rare on a line that works. Learned, from 3 to 10."""
SKIP_LIMITS = (3.0, 10.0)
NOISE = 7.0
"""The same behind a frame, of 00, F8, FC, FE or FF: what a line that turns around makes a receiver
hear. Learned, from 2 to 9."""
NOISE_LIMITS = (2.0, 9.0)
NOISE_AT_ONCE = 4.0
"""As often as one run after another can make it seem, before it is learned."""
SKIP_MORE = 0.25
"""Each further such byte, and each of a damaged frame."""
MOST_FOR_LENGTH = 12.0
"""All of them in one that silences bound, where frames are never glued: it is as long as it is."""
COINCIDENCE = 16.0
"""A correct CRC that is not taken for a frame."""
UNKNOWN_COINCIDENCE = 8.0
"""The same of a frame whose length only its CRC tells."""
DAMAGED = 10.0
"""A frame of the right size with a wrong CRC."""
DAMAGED_SIZE = 3.0
"""More where it has lost bytes, or its size is that of its burst."""
ONE_BIT = 2.0
"""A frame in which one wrong bit explains the CRC, or the size too: one in 400 others would do."""
ONE_BIT_MORE = 0.1
"""Each of its bytes: the more they are, the likelier is one that would do."""
FLIPPED = 2.0
"""More where damage on this line is seldom such. Learned, from 0.2 to 8."""
FLIPPED_LIMITS = (0.2, 8.0)
UNHEARD = 1.0
"""More for one that whom it was for has not understood either: damage is on the wire, or here."""
FORESEEN = -6.0
"""Less for a damaged or incomplete frame of which more than two bytes are as foreseen: a request
that was heard before up to its CRC, a response with the byte count that was asked for, and as
long as it is incomplete a write whose byte count agrees with its quantity."""
UNEXPECTED = 3.0
"""More for a damaged frame that the turn does not expect, or that its silences alone bound."""
OPEN = 0.5
"""The beginning of a frame whose end is still to come: it costs little to wait."""
WAIT = -4.0
"""Less for one behind a silence or another frame: to wait for what is likely loses nothing."""
OPEN_OVER_FRAME = 10.0
"""More where a whole frame begins there: the byte that is to come would have to be 00."""
OPEN_OVER_FRAME_DUE = 7.0
"""The same where a longer frame is due."""
OPEN_MORE = 0.1
"""Each of its bytes: what is long in coming may not come."""
OPEN_MORE_DUE = 0.02
"""The same of one that is due."""
OPEN_UNEXPECTED = 1.5
"""More where the turn does not expect it."""
GLUED = 2.0
"""A frame without a silence before it. Learned, from 0.2 to 8."""
GLUED_LIMITS = (0.2, 8.0)
NEVER = 5.0
"""Learned bits from which on frames are never glued here."""
TORN = 2.0
"""A silence of t3.5 inside a frame. Learned, from 0.2 to 5."""
TORN_LIMITS = (0.2, 5.0)
TORN_MORE = 0.25
"""Each further one: an adapter that tears does it all along."""
UNKNOWN_BETWEEN_SILENCES = 2.0
"""A frame of no known form whose CRC is right, which is a whole burst."""
UNKNOWN = 6.0
"""The same, found by its CRC alone among 253 lengths: 8 bits of its 16 are used up."""
UNKNOWN_DUE = 2.0
"""The same where it begins with the unit and function that wait, or were just answered: 16 bits
speak for it at once."""
ENDS_IN_ZERO = 5.0
"""More for such a frame that ends in 00: without that byte its CRC is right too. One frame in 256
ends so, and one stray byte in four is 00; so it is the line's habit of stray bytes that decides."""
ENDS_IN_ZERO_MORE = 6.0
"""Each further 00: 8 bits of chance in a CRC, 2 in stray bytes."""
ADHERES = 1.5
"""Less for such an end that a silence follows: a stray byte seldom comes without one before it."""

MARGIN = 12.0
"""Explanations that are so much worse than another are given up."""
OPEN_DOUBT = 3.0
"""One that waits for more and is so much dearer than another raises no doubt."""
OPEN_MARGIN = 24.0
"""The same beside one that waits for more: what is so much dearer need not be known meanwhile."""
