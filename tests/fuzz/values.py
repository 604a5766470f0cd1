"""Pictures whose values are not what a camera counts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import hypothesis.strategies as st
import numpy as np
from numpy.typing import NDArray

__all__ = ["VALUE_TYPES", "odd_values", "other_text"]

Picture = NDArray[Any]
VALUE_TYPES = (
    "float16",
    "float32",
    "float64",
    "int8",
    "int16",
    "int32",
    "uint32",
    "uint64",
    "int64",
)
_GAINS = (1.0, 1 / 65535, 1e-3, -1.0, 0.0, 1e-30, 1e-300, 1e30, 1e300, 37.5)
_FILLERS = (np.nan, np.inf, -np.inf, -9999.0, 3.4e38, -3.4e38, 65535.0, 0.0, 1e-45)


@st.composite
def odd_values(draw: st.DrawFn) -> Callable[[Picture, str], Picture]:
    """A function that scales a picture, shifts it, wraps it round, and puts fillers into it."""
    gain, offset = draw(st.sampled_from(_GAINS)), draw(st.sampled_from((0.0, -3e4, -1.0, 0.5)))
    filler, share = draw(st.sampled_from(_FILLERS)), draw(st.sampled_from((0.0, 0.01, 0.6, 1.0)))
    wrap = draw(st.booleans())

    def odd(picture: Picture, dtype: str) -> Picture:
        with np.errstate(all="ignore"):
            values = picture.astype(np.float64) + offset
            values = (values % 65536 if wrap else values) * gain
            values[np.random.default_rng(0).random(values.shape) < share] = filler
            return values.astype(dtype)

    return odd


_WORDS = (
    *(b"'<u2'", b"'|O'", b"'<f8'", b"'>i4'", b"[('a', '<u2')]", b"False", b"True", b"(3, 60, 80)"),
    *(b"(3, 60, 80)", b"(-3, 60, 80)", b"(3, 60, 8000000000)", b"()", b"NAXIS1  =", b"NAXIS3  ="),
    *(b"BITPIX  =", b"-64", b"-32", b"  8", b" 16", b" 64", b"SIMPLE", b"XTENSION", b"IMAGE"),
    *(b"BZERO   =", b"BSCALE  =", b"BLANK   =", b"32768", b"END     ", b"ZNAXIS1 =", b"RICE_1"),
    *(
        b"PCOUNT  =",
        b"  60",
        b"  80",
        b"9999999999",
        b"nan",
        b"frames.npy",
        b"entry",
        b"PK\x01\x02",
    ),
)


@st.composite
def other_text(draw: st.DrawFn, data: bytes) -> bytes:
    """Bytes in which some words of headers were replaced by others of any length."""
    for _ in range(draw(st.integers(1, 3))):
        word, other = draw(st.sampled_from(_WORDS)), draw(st.sampled_from(_WORDS))
        if draw(st.booleans()):
            other = other[: len(word)].ljust(len(word))
        data = data.replace(word, other, draw(st.sampled_from((1, 1, 9))))
    return data
