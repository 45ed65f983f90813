"""Compiled loop over the instructions of LZF, the compression of h5py."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.compiled.jit import loop


@loop()
def unpacked_size(packed: NDArray[np.uint8], limit: int) -> int:
    """Return how many bytes a block of LZF unpacks to, or a number above `limit` if more.

    An instruction below 32 is followed by so many bytes, and one more, to copy. In others, the
    upper three bits are the length of a reference, less 2; after 7, a byte is added to it. A byte
    of the offset follows (``lzf_d.c`` of LibLZF 3.6).
    """
    at, size = 0, 0
    while at < len(packed) and size <= limit:
        instruction = int(packed[at])
        at += 1
        if instruction < 32:
            at += instruction + 1
            size += instruction + 1
        else:
            length = instruction >> 5
            if length == 7 and at < len(packed):
                length += int(packed[at])
                at += 1
            at += 1
            size += length + 2
    return size
