"""Line statistics: learned costs of noise, merged and split frames; the longest response time."""

from __future__ import annotations

from math import inf, log2

from mbtool.serial_line import costs

# BurstStatistics learns whether an adapter may merge a request and its retry into one burst of
# bytes.
#
# A burst is the bytes from one silence of t3.5 to the next. An adapter or a program that holds
# bytes back for up to 255 ms delivers a request and its retry as one burst, like a request and its
# response. Then the silence between two frames does not tell who speaks. Such an adapter shows no
# short silence between bursts, since it delivers the next burst only when its time is over. Only a
# full buffer is delivered sooner, so the silences before and behind it are not counted.

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


_LEARNING_RATE = 1 / 32
"""The weight (0 to 1) of one frame when the frequency of an event is learned. With this weight a
few dozen frames outweigh the start value."""
_SLOW_LEARNING_RATE = 1 / 96
"""The weight (0 to 1) of one frame when the frequency of a rare event is learned, once many frames
were heard. If an event occurs once in 20 frames, a few dozen frames are too few to learn that."""
_RATE_DECAY = 31 / 32
"""The factor by which the weight of one frame shrinks with each frame, when the frequency of a rare
event is learned. The weight begins at _LEARNING_RATE and ends at _SLOW_LEARNING_RATE, so that the
first frames are learned faster."""

_AT_REST = 2**-24
"""A frequency (0 to 1) below this has the same effect as 0: the cost is at its upper limit, and
after the next event it differs by less than a ten thousandth of a bit."""


class LearnedCost:
    """A cost in bits, learned as the negative logarithm of a frequency."""

    __slots__ = (
        "_bits",
        "_final_rate",
        "_max_bits",
        "_min_bits",
        "_rate",
        "frequency",
        "is_at_rest",
    )

    def __init__(self, bits: float, limits: tuple[float, float], *, is_slow: bool = False) -> None:
        """`bits` is the start value; `limits` are the least and the most bits that it can become.

        `is_slow` is True for an event so rare that its frequency is learned from many frames.
        """
        self._min_bits, self._max_bits = limits
        self.frequency: float = 2**-bits
        """Share of frames, 0 to 1, that show the event with this cost. Recent frames weigh most."""
        self._rate = _LEARNING_RATE
        self._final_rate = _SLOW_LEARNING_RATE if is_slow else _LEARNING_RATE
        self._bits: float | None = bits
        """The cached value of the property `bits`; None if `frequency` has changed since."""
        self.is_at_rest = False
        """True if `frequency` is so low that another frame without the event changes no cost, so
        that `learn` need not be called for such a frame. This needs some hundred frames without
        the event. By then the learning rate has become the final one."""

    def learn(self, seen: bool) -> None:
        """Count one more frame; `seen` is True if the event with this cost occurred at it."""
        self.frequency += (seen - self.frequency) * self._rate
        if self._rate > self._final_rate:
            self._rate *= _RATE_DECAY
        self.is_at_rest = self.frequency < _AT_REST
        self._bits = None

    @property
    def bits(self) -> float:
        """The learned cost in bits, at least the lower and at most the upper limit."""
        if self._bits is None:
            bits = -log2(self.frequency) if self.frequency else self._max_bits
            self._bits = min(max(bits, self._min_bits), self._max_bits)
        return self._bits


class LineStatistics:
    """The learned costs of skipped bytes, noise, glued and split frames, and wrong bits."""

    def __init__(self, *, timed: bool = True) -> None:
        """`timed` is False if the bytes' times are not known: then no silence separates frames."""
        self.skip = LearnedCost(costs.SKIP, costs.SKIP_LIMITS)
        self.noise = LearnedCost(costs.NOISE, costs.NOISE_LIMITS, is_slow=True)
        self.glue = LearnedCost(costs.GLUED if timed else 0.0, costs.GLUED_LIMITS)
        self.split = LearnedCost(costs.SPLIT, costs.SPLIT_LIMITS)
        self.one_bit = LearnedCost(costs.RARE_ONE_BIT, costs.RARE_ONE_BIT_LIMITS)
        """The cost of explaining damage by one wrong bit, learned from damaged frames only."""


class LatencyStatistics:
    """Learns the longest time, in ns, from a request to its response: of a line, or only of the
    writes with one function to one unit.
    """

    __slots__ = ("_heard", "_longest_ns")

    INITIAL_NS = 200_000_000
    """The longest response time, in ns, that is assumed before the first response. It is
    that of slow devices."""
    MIN_NS = 10_000_000
    """The longest response time is never taken to be less than this, in ns, since adapters deliver
    bytes in blocks."""
    ENOUGH_RESPONSES = 16
    """The number of responses from which on INITIAL_NS no longer counts."""
    MIN_WRITE_NS = 20_000_000
    """A response to a write that takes no longer than this, in ns, is never late, however fast the
    line's reads are."""
    MIN_RETRY_NS = 60_000_000
    """No master repeats a request sooner than this, in ns, after the request."""
    ADAPTER_TIMER_NS = 255_000_000
    """The longest latency timer that an FTDI adapter can be set to, in ns."""
    MARGIN_DOUBLINGS = 0.25
    """A response counts as late if it takes 19 % longer (2 ** 0.25) than the longest response time
    of this line."""

    NEARLY = 1.05
    """A latency counts as heard before if it is at most 5 % longer than the longest one heard."""

    def __init__(self) -> None:
        self._heard = 0
        self._longest_ns = float(self.MIN_NS)

    def learn(self, latency_ns: int) -> None:
        """Note the latency (ns) of one more response.

        If it is shorter than the remembered longest latency, the latter is shortened by 1 %.
        """
        self._heard += 1
        self._longest_ns = max(latency_ns, self._longest_ns * 0.99, self.MIN_NS)

    def learn_capped(self, latency_ns: int) -> None:
        """Note the latency (ns) of a frame that may be no response.

        A latency above twice the remembered longest one counts as twice that one.
        """
        self.learn(min(latency_ns, 2 * int(self._longest_ns)))

    @property
    def is_known(self) -> bool:
        """True if ENOUGH_RESPONSES responses were heard, so that the longest latency is known."""
        return self._heard >= self.ENOUGH_RESPONSES

    def has_taken_as_long(self, latency_ns: int) -> bool:
        """True if the longest latency heard is at least `latency_ns`, or up to 5 % less."""
        return self._heard > 0 and latency_ns <= self._longest_ns * self.NEARLY

    def doublings_late(self, silence_ns: int, least_ns: int = 0) -> float:
        """Return the binary logarithm of a silence divided by the longest response time.

        The result is negative if the silence is shorter than the longest response time. The longest
        response time counts as at least `least_ns`.
        """
        longest_ns = max(self._longest_ns, least_ns)
        if self._heard < self.ENOUGH_RESPONSES and longest_ns < self.INITIAL_NS:
            # Before the first response, the longest response time is taken as INITIAL_NS. Each
            # response brings this value nearer to the longest time measured, by the same factor.
            # After ENOUGH_RESPONSES responses only the measured time counts.
            missing = 1 - self._heard / self.ENOUGH_RESPONSES
            longest_ns *= (self.INITIAL_NS / longest_ns) ** missing
        return log2(max(silence_ns, 1) / longest_ns)
