"""Recognises an adapter that hears what it sends, so that each request comes twice."""

# The copy follows its request within about one character time. How many copies prove that the
# adapter echoes depends on the silences that it lets through:
#
# - Silences are heard, and no request has come without a copy: one copy is enough if the request
#   cannot be a response by its form, since no master repeats a request without a silence of t3.5.
# - The same, but not even the short pause between request and copy is heard: the adapter may have
#   merged a request with its retry. So an earlier request that came twice must have got a response.
# - No silences are heard: a copy may be a retry. So ENOUGH_COPIES requests in a row must have come
#   twice.
# - A request that came twice without a response counts neither for an echo nor against one: the
#   copy may be its retry.
#
# Memory: the last request.

from __future__ import annotations

ENOUGH_COPIES = 3
"""This many requests in a row must come twice before the adapter counts as echoing, if silences are
not heard or if some request has come only once."""
ENOUGH_SINGLE = 3
"""After this many requests in a row without a copy, the adapter counts as not echoing."""
ECHOES = "this adapter echoes what it sends: the second copy of each request is no request"
ECHO = "the adapter's echo of the request before"


class AdapterEcho:
    """Finds the copies of requests that an adapter adds to what it hears."""

    __slots__ = (
        "_has_single", "_is_certain", "_is_copied", "_singles", "copied", "copies", "echoes",
        "last", "reason",
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
        self.copies = 0
        """The number of requests in a row that came twice and then had a response."""
        self._singles = 0
        """The number of requests in a row that came only once, that is without a copy."""
        self._has_single = False
        """True if some request has come only once, that is without a copy."""

    def awaits(self, data: bytes) -> bool:
        """True if the undecided bytes `data` may begin a copy of the last request."""
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
        return True

    def copied_size(self, data: bytes) -> int:
        """Return the number of bytes at the start of `data` that are a retry of the last request
        and its copy.

        The adapter copies each request that the master sends, so a retry comes twice, too. `data`
        may hold only the beginning of these two frames. The result is 0 if `data` begins with
        anything else, or if the last frame was no copy.
        """
        both = self.copied + self.copied
        return min(len(data), len(both)) if both.startswith(data[: len(both)]) else 0

    def may_copy(self, raw: bytes, following: bytes) -> bool:
        """True if a frame may be a request or its copy, although the adapter is not known to echo.

        That is so if all requests so far came twice, and a frame equal to this one comes directly
        before or behind it. `raw` is this frame, `following` the bytes behind it.
        """
        if self.echoes or self._has_single or not self.copies:
            return False
        return raw == self.last or following.startswith(raw)

    def said(self) -> str:
        """Return the reason for skipping a copy, as a text.

        The reason for the first copy says that the adapter echoes, the later ones are shorter.
        """
        reason, self.reason = self.reason, ECHO
        return reason

    def hear_request(self, raw: bytes, *, is_certain: bool) -> None:
        """Note that a request with the bytes `raw` was heard.

        `is_certain` is True if this frame cannot be a response, and no response can equal it.
        """
        self.copied = b""
        if self.last == raw and is_certain and not self.echoes:
            self._is_copied, self.last = True, b""
            return
        self._is_copied = False
        if self.last:
            self._end_single()
        self.last, self._is_certain = raw, is_certain

    def hear_response(self) -> None:
        """Note that a response was heard."""
        self.copied = b""
        if self._is_copied:
            self._is_copied, self.copies = False, self.copies + 1
        if self.last:
            self._end_single()
            self.last = b""

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
