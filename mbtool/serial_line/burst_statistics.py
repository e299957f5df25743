"""Learns if an adapter may merge a request and its retry into one burst of bytes."""

# A burst is the bytes from one silence of t3.5 to the next. An adapter or a program that holds
# bytes back for up to 255 ms delivers a request and its retry as one burst, like a request and its
# response. Then the silence between two frames does not tell who speaks. Such an adapter shows no
# short silence between bursts, since it delivers the next burst only when its time is over. Only a
# full buffer is delivered sooner, so the silences before and behind it are not counted.

from __future__ import annotations

from math import inf

MAX_GLUED = 2**-0.8
"""If at most this share of the frames (57 %) is glued, with no silence before the frame, silences
are taken as evidence of who speaks."""
ENOUGH_BURSTS = 3
"""After this many bursts (bytes between two silences) that were no full buffer, the shortest
silence counts as known."""
MERGING_NS = 100_000_000
"""If no silence between bursts is shorter than this, in ns, the adapter may hold bytes back for so
long that it merges a request and its retry."""
BUFFER_SIZES = 32, 62
"""A full buffer of an adapter holds a multiple of 32 or of 62 bytes."""
SILENCE_GROWTH = 1.01
"""Each burst makes the remembered shortest silence 1 % longer, so that an old one is forgotten."""


class BurstStatistics:
    """Tracks the shortest recent silence between bursts, once the adapter has merged frames."""

    __slots__ = (
        "_bursts", "_shortest_ns", "_silence_ns", "_size", "_was_full", "has_merged",
        "may_merge_retry", "merges_briefly",
    )  # fmt: skip

    def __init__(self) -> None:
        self.has_merged = False
        """True once two frames came with no time between them. Until then nothing is learned."""
        self.may_merge_retry = False
        """True if a request and its retry may come as one burst."""
        self.merges_briefly = False
        """True if a silence between bursts was too short for a request and its retry to come as one
        burst."""
        self._size = 0
        """The number of bytes of the current burst so far."""
        self._silence_ns = inf
        """The silence before the current burst, in ns; inf if it is unknown or lies inside a frame,
        so that it does not count."""
        self._was_full = False
        """True if the burst before the current one was a full buffer."""
        self._shortest_ns = inf
        """The shortest recent silence between two bursts, in ns; inf before the first one."""
        self._bursts = 0
        """The number of bursts before which the silence was compared with the shortest one."""

    def hear_frame(self, silence_ns: int, size: int, cut: int, *, is_glued: bool) -> None:
        """Note a frame of `size` bytes; `is_glued` is True if the silence before it is below t3.5.

        `silence_ns` is that silence. `cut` is the offset of the last silence inside the frame;
        `size` if there is none.
        """
        self.has_merged = True
        if is_glued:
            self._size += cut
        else:
            self._begin_burst(silence_ns, cut)
        if cut < size:
            self._begin_burst(inf, size - cut)

    def _begin_burst(self, silence_ns: float, size: int) -> None:
        """Count the burst that a silence has ended; the next one begins with `size` bytes.

        `silence_ns` is the silence between the two.
        """
        first, second = BUFFER_SIZES
        is_full = self._size % first == 0 or self._size % second == 0
        self._shortest_ns *= SILENCE_GROWTH
        if not (is_full or self._was_full or self._silence_ns == inf):
            self._bursts += 1
            if self._silence_ns < self._shortest_ns:
                self._shortest_ns = self._silence_ns
        is_known = self._bursts >= ENOUGH_BURSTS
        self.may_merge_retry = is_known and self._shortest_ns >= MERGING_NS
        self.merges_briefly = is_known and self._shortest_ns < MERGING_NS
        self._was_full, self._size, self._silence_ns = is_full, size, silence_ns
