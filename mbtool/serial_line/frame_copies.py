"""Recognises frames that come twice: an adapter hears what it sends, a repeater sends it again."""

# The copy follows its request within about one character time. How many copies prove that the
# adapter echoes depends on the silences that it lets through:
#
# - Silences are heard, and no request has come without a copy: one copy is enough if the request
#   cannot be a response by its form, since no master repeats a request without a silence of t3.5.
# - As above, but the adapter does not even show the short pause between request and copy: it may
#   have merged a request with its retry. So an earlier request that came twice must have got a
#   response.
# - No silences are heard: a copy may be a retry. So ENOUGH_COPIES requests in a row must have come
#   twice.
# - A request that came twice without a response counts neither for an echo nor against one: the
#   copy may be its retry.
#
# A repeater sends each frame again, so each response comes twice, too. No slave answers one request
# twice. So ENOUGH_COPIES responses in a row that came twice, each without a request between the
# two, prove a repeater. One response that came twice is enough if its request also came twice, and
# sooner than any master repeats a request. Before a repeater is proved, and after ENOUGH_SINGLE
# responses in a row without a copy, the second copy of a response counts as a response that nobody
# requested.
#
# Memory: the last request and the last response.

from __future__ import annotations

ENOUGH_COPIES = 3
"""This many requests in a row must come twice before the adapter counts as echoing, if silences are
not heard or if some request has come only once."""
ENOUGH_SINGLE = 3
"""After this many requests in a row without a copy, the adapter counts as not echoing."""
ECHOES = "this adapter echoes what it sends: the second copy of each request is no request"
ECHO = "the adapter's echo of the request before"
REPEATS = "a repeater sends each frame again: the second copy of each response is no response"
REPEAT = "the repeater's copy of the response before"


class FrameCopies:
    """Finds the copies of requests that an adapter hears, and of all frames behind a repeater."""

    __slots__ = (
        "_has_single", "_is_certain", "_is_copied", "_is_surely_copied", "_repeat_reason",
        "_repeated", "_single_responses", "_singles", "copied", "copies", "echoes", "last",
        "last_response", "reason", "repeats",
    )  # fmt: skip

    def __init__(self) -> None:
        self.echoes = False
        """True once the adapter is known to echo; False again after ENOUGH_SINGLE requests in a row
        without a copy."""
        self.reason = ECHOES
        """The text that gives the reason for the next skipped copy: ECHOES for the first copy, then
        the shorter ECHO."""
        self.last = b""
        """The last frame if it was a request and has not been copied; otherwise empty."""
        self.copied = b""
        """The last request if the last frame was its copy; otherwise empty."""
        self._is_certain = False
        """True if the request in `last` cannot be a response, and no response can equal it."""
        self._is_copied = False
        """True if the last request came twice and no other frame has come since."""
        self._is_surely_copied = False
        """True if the last request came twice, and the second time too soon for a retry."""
        self.copies = 0
        """The number of requests in a row that came twice and then had a response."""
        self._singles = 0
        """The number of requests in a row that came only once, that is without a copy."""
        self._has_single = False
        """True if some request has come only once, that is without a copy."""
        self.repeats = False
        """True once a repeater is known to send each frame again; False again after ENOUGH_SINGLE
        responses in a row without a copy."""
        self.last_response = b""
        """The last frame if it was a response and has not been copied; otherwise empty."""
        self._repeated = 0
        """The number of responses in a row that came twice."""
        self._single_responses = 0
        """The number of responses in a row that came only once."""
        self._repeat_reason = REPEATS

    def awaits(self, data: bytes) -> bool:
        """True if the undecided bytes `data` may begin a copy of the last frame."""
        if self.repeats and self.last_response.startswith(data):
            return True
        return self.echoes and self.last.startswith(data)

    def takes_copy(self, *, glued: bool, exact: bool = True) -> bool:
        """Decide if bytes equal to the last request are its copy; True if so, not a new frame.

        `glued` is True if silences are heard and no silence separates the request from these bytes.
        `exact` is True if the adapter shows the pause between the request and these bytes, which is
        shorter than t3.5. If it does not, it may have merged a request with its retry. Then an
        earlier request must have had a copy and a response.
        """
        is_heard = glued and not self._has_single and (exact or self.copies > 0)
        is_enough = self.copies >= ENOUGH_COPIES or is_heard
        # A write and its response are equal, too. But if all requests so far came twice, these
        # bytes are a copy.
        is_certain = self._is_certain or (self.copies >= ENOUGH_COPIES and not self._has_single)
        if not self.echoes and not (is_certain and is_enough):
            return False
        self.echoes = True
        self._singles, self.last, self.copied = 0, b"", self.last
        self._is_surely_copied = glued
        return True

    def takes_repeated(self, data: bytes) -> bool:
        """True if `data` begins with a repeater's copy of the last response."""
        if not (self.repeats or self._is_surely_copied) or not self.last_response:
            return False
        if not data.startswith(self.last_response):
            return False
        self.repeats, self.copies = True, max(self.copies, ENOUGH_COPIES)
        self.last_response, self._single_responses = b"", 0
        return True

    def copied_size(self, data: bytes) -> int:
        """Return the number of bytes at the start of `data` that are a retry of the last request
        and its copy.

        The adapter copies each request that the master sends, so a retry comes twice, too. `data`
        may hold only the beginning of these two frames. The result is 0 if `data` begins with
        anything else, or if the last frame was no copy. It is also 0 behind a repeater, which
        copies responses, too.
        """
        if self.repeats:
            return 0
        both = self.copied + self.copied
        return min(len(data), len(both)) if both.startswith(data[: len(both)]) else 0

    def may_copy(self, raw: bytes, following: bytes) -> bool:
        """True if a frame may be a request or its copy, although the adapter is not known to echo.

        That is so if the last requests came twice, too few to be sure, and a frame equal to this
        one comes directly before or behind it. `raw` is this frame; `following` the bytes behind.
        """
        if self.echoes or self._has_single or not 0 < self.copies < ENOUGH_COPIES:
            return False
        return raw == self.last or following.startswith(raw)

    def may_copy_retry(self, raw: bytes, following: bytes) -> bool:
        """True if a frame behind a copied request may be its retry: it is equal, and comes twice.

        It may also be the response, with the same request again behind it.
        """
        return not self.repeats and raw == self.copied and following.startswith(raw)

    def said_of_response(self) -> str:
        """Return the reason for skipping the copy of a response, as a text."""
        reason, self._repeat_reason = self._repeat_reason, REPEAT
        return reason

    def said(self) -> str:
        """Return the reason for skipping a copy, as a text.

        The reason for the first copy says that the adapter echoes, the later ones are shorter.
        """
        reason, self.reason = self.reason, ECHO
        return reason

    def hear_request(self, raw: bytes, *, is_certain: bool, is_soon: bool = False) -> None:
        """Note that a request with the bytes `raw` was heard.

        `is_certain` is True if this frame cannot be a response, and no response can equal it.
        `is_soon` is True if it came sooner after the frame before than any master repeats a
        request.
        """
        self.copied = b""
        if self.last_response:
            self.last_response = b""
            if self._repeated or self.repeats:
                self._end_single_response()
        if self.last == raw and is_certain and not self.echoes:
            self._is_copied, self._is_surely_copied, self.last = True, is_soon, b""
            return
        self._is_copied = self._is_surely_copied = False
        if self.last:
            self._end_single()
        self.last, self._is_certain = raw, is_certain

    def hear_response(self, raw: bytes, *, is_certain: bool) -> None:
        """Note that a response with the bytes `raw` was heard.

        `is_certain` is True if its function has responses that differ from their requests.
        """
        self.copied = b""
        if not self.last and raw == self.last_response:
            self._repeated += 1
            self.last_response, self.repeats = b"", self._repeated >= ENOUGH_COPIES
            return
        if self.last_response and (self._repeated or self.repeats):
            self._end_single_response()
        if is_certain and raw == self.last:  # The slave or the adapter repeats the whole request.
            self._is_copied, self._is_surely_copied, self.last = True, False, b""
            self.last_response = b""
            return
        self.last_response = raw if is_certain or self.repeats else b""
        if self._is_copied:
            self._is_copied, self.copies = False, self.copies + 1
        if self.last:
            # Without a copy so far there is nothing to end; this makes decoding polls 1 % faster.
            if self.copies or self.echoes or not self._has_single:
                self._end_single()
            self.last = b""

    def _end_single_response(self) -> None:
        """Count the last response as one without a copy."""
        self._repeated = 0
        self._single_responses += 1
        if self.repeats and self._single_responses >= ENOUGH_SINGLE:
            self.repeats, self._repeat_reason = False, REPEATS

    def _end_single(self) -> None:
        """Count the last request as one without a copy.

        Nothing is counted if the frame may have been a response and the adapter is not known to
        echo.
        """
        if not (self._is_certain or self.echoes):
            return
        self._has_single = True
        self.copies = 0
        self._singles += 1
        if self.echoes and self._singles >= ENOUGH_SINGLE:
            self.echoes, self.reason = False, ECHOES
