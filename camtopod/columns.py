"""Columns of numbers as bytes, as the model of a version has them: little-endian, deflated.

In JSON, msgspec writes bytes in base64.
"""

from __future__ import annotations

import zlib
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

COLUMN_BYTES_MAX = 1 << 28
"""Largest size of a column, inflated; a larger one is refused."""

BITS = 20
"""Precision of a learned figure, about six digits: further ones depend on the order in which a
machine adds, and the digest is not to depend on that.
"""

NumberT = TypeVar("NumberT", bound=np.generic)


def packed(values: ArrayLike, kind: type[NumberT]) -> bytes:
    """Return numbers as a column of a type such as ``np.float32``."""
    return zlib.compress(np.asarray(values, _little(kind)).tobytes(), zlib.Z_BEST_SPEED)


def rounded(values: ArrayLike) -> NDArray[np.float32]:
    """Return numbers in single precision, rounded to `BITS` bits."""
    fraction, exponent = np.frexp(np.asarray(values, float))
    scale = float(1 << BITS)
    result: NDArray[np.float64] = np.ldexp(np.rint(fraction * scale) / scale, exponent)
    return result.astype(np.float32)


def figures(values: ArrayLike) -> bytes:
    """Return learned figures, rounded, as a column in single precision."""
    return packed(rounded(values), np.float32)


def numbers(raw: bytes, kind: type[NumberT], *shape: int) -> NDArray[NumberT]:
    """Return the numbers of a column, read-only; -1 in the shape stands for any length.

    An empty column is one of zeros. Raises ValueError if there are more or fewer numbers.
    """
    if not raw:
        return np.zeros([max(size, 0) for size in shape], kind)
    return np.frombuffer(inflated(raw), _little(kind)).reshape(shape)


def inflated(raw: bytes) -> bytes:
    """Return the bytes of the numbers of a column. Raises ValueError if it is no column."""
    inflater = zlib.decompressobj()
    try:
        plain = inflater.decompress(raw, COLUMN_BYTES_MAX)
    except zlib.error as error:
        raise ValueError(str(error)) from None
    if not inflater.eof:
        raise ValueError("a column is cut short or too large")
    return plain


def _little(kind: type[NumberT]) -> np.dtype[Any]:
    return np.dtype(kind).newbyteorder("<")
