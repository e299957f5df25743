"""Types of numpy arrays, and functions that read structures or byte ranges at many offsets."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Int64s = npt.NDArray[np.int64]
Uint64s = npt.NDArray[np.uint64]
Bools = npt.NDArray[np.bool_]
Octets = npt.NDArray[np.uint8]
Numbers = Int64s | npt.NDArray[np.uint16]


def narrow(numbers: Numbers) -> Numbers:
    """Return the numbers as a uint16 array if all are from 0 to 65535, else the same int64 array.

    numpy sorts uint16 several times as fast as int64.
    """
    has_room = len(numbers) and numbers.min() >= 0 and numbers.max() < 1 << 16
    return numbers.astype(np.uint16) if has_room else numbers


def distinct(values: Numbers) -> list[int]:
    """Return the values that are in an array, each once and sorted."""
    # numpy.unique without indices would load the module numpy.ma, which takes 20 ms.
    found: list[int] = np.unique(values, return_index=True)[0].tolist()
    return found


class Groups:
    """Groups the indices of an array by its values; groups are sorted by value."""

    def __init__(self, values: Numbers) -> None:
        self.order: Int64s = np.argsort(narrow(values), kind="stable")
        """The indices of the first group, in order, then those of the next one, and so on."""
        some = values[self.order]
        is_new = np.append(True, some[1:] != some[:-1])[: len(some)]
        self.starts: Int64s = np.flatnonzero(is_new)
        """For each group, the place in `order` of its first index."""
        self.ends: Int64s = np.append(self.starts[1:], len(some))[: len(self.starts)]
        """For each group, the place in `order` behind its last index."""
        self.first: Int64s = self.order[self.starts]
        self.last: Int64s = self.order[self.ends - 1]
        self.number: Int64s = np.empty(len(some), np.int64)
        """For each index the number of its group."""
        self.number[self.order] = np.cumsum(is_new) - 1


def gather(octets: Octets, places: Int64s, dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    """Return one structure of the type `dtype` for each offset in `places`, read from `octets`.

    Offsets count bytes from the start of `octets`; each structure must lie completely inside it.
    """
    # Take each structure as `size` raw bytes (numpy's type V) first, then view these bytes as
    # `dtype`: numpy copies raw bytes several times as fast as structures with fields.
    size = dtype.itemsize
    count = max(len(octets) - size + 1, 0)
    items = np.ndarray((count,), np.dtype(f"V{size}"), octets.data, strides=(1,))
    return items[places].view(dtype)


def pieces(octets: Octets, starts: Int64s, sizes: Int64s) -> Octets:
    """Return many parts of `octets` joined in one array: for each i, the `sizes[i]` bytes from the
    offset `starts[i]` on.
    """
    return octets[ranges(starts, sizes)]


def ranges(starts: Int64s, sizes: Int64s) -> Int64s:
    """Return many integer ranges joined in one array: for each i, the `sizes[i]` consecutive
    integers from `starts[i]` on.
    """
    ends = np.cumsum(sizes)
    total = int(ends[-1]) if len(ends) else 0
    return np.repeat(starts - ends + sizes, sizes) + np.arange(total)
