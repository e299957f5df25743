"""Types of arrays, and functions that read structures at many offsets at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Int64s = npt.NDArray[np.int64]
Uint64s = npt.NDArray[np.uint64]
Bools = npt.NDArray[np.bool_]
Octets = npt.NDArray[np.uint8]
Numbers = Int64s | npt.NDArray[np.uint16]


def narrow(numbers: Int64s) -> Numbers:
    """The same numbers in 16 bits if they have room, as those are sorted several times as fast."""
    has_room = len(numbers) and numbers.min() >= 0 and numbers.max() < 1 << 16
    return numbers.astype(np.uint16) if has_room else numbers


def gather(octets: Octets, places: Int64s, dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    """Read a structure at each offset of `places`; all structures lie inside `octets`."""
    # Copying whole items of plain bytes is several times as fast as copying fields.
    size = dtype.itemsize
    count = max(len(octets) - size + 1, 0)
    items = np.ndarray((count,), np.dtype(f"V{size}"), octets.data, strides=(1,))
    return items[places].view(dtype)


def pieces(octets: Octets, starts: Int64s, sizes: Int64s) -> Octets:
    """The bytes of many pieces in one array: `sizes[i]` bytes from `starts[i]` on, for each i."""
    return octets[ranges(starts, sizes)]


def ranges(starts: Int64s, sizes: Int64s) -> Int64s:
    """The numbers of many ranges in one array: `sizes[i]` numbers from `starts[i]` on."""
    ends = np.cumsum(sizes)
    total = int(ends[-1]) if len(ends) else 0
    return np.repeat(starts - ends + sizes, sizes) + np.arange(total)
