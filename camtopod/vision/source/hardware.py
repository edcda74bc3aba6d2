"""Hardware decoding: what this machine and this build of FFmpeg can do, and how OpenCV is asked.

OpenCV tries the kinds of devices named by the FFmpeg option ``hw_decoders_any`` in turn and decodes
in software if none of them works. Its own default names Intel's driver of VAAPI alone, so the kinds
are always named here. V4L2 is a decoder of its own for each codec (``video_codec``), without such a
fallback.
"""

from __future__ import annotations

import ctypes
import glob
import os
import re
from collections.abc import Sequence
from functools import cache
from typing import Literal, NamedTuple, get_args

import cv2

Kind = Literal["vaapi", "cuda", "v4l2"]
"""A way to decode in hardware."""

KINDS: tuple[Kind, ...] = get_args(Kind)
_TITLES: dict[Kind, str] = {"vaapi": "VAAPI", "cuda": "CUDA", "v4l2": "V4L2"}
_DEVICES: dict[Kind, tuple[str, ...]] = {
    "vaapi": ("/dev/dri/renderD*",),
    "cuda": ("/dev/nvidia[0-9]*",),
    "v4l2": ("/dev/video*",),
}
"""Device files of each kind, as patterns."""
V4L2_DECODERS = {
    "avc1": "h264_v4l2m2m",
    "h264": "h264_v4l2m2m",
    "hev1": "hevc_v4l2m2m",
    "hevc": "hevc_v4l2m2m",
    "hvc1": "hevc_v4l2m2m",
}
"""FFmpeg's V4L2 decoder by the four-character code of a codec."""

_failed: set[Kind] = set()
"""Kinds that are there and have not worked in this process."""
OPENS_MAX = 3
"""Times that a source is opened at most, until it is known how to decode it."""


class Support(NamedTuple):
    """Whether one kind of hardware decoding can work."""

    kind: Kind
    built: bool | None
    """FFmpeg was built with it; None if its libraries cannot be asked."""
    device: bool
    """There is a device of this kind that this user may use."""

    @property
    def usable(self) -> bool:
        """Return True if it is worth trying."""
        return self.built is not False and self.device

    @property
    def words(self) -> str:
        """The same in words."""
        title = _TITLES[self.kind]
        if self.built is False:
            return f"{title}: not in this build of FFmpeg"
        built = "in this build" if self.built else "maybe in this build"
        where = " or ".join(_DEVICES[self.kind])
        return f"{title}: {built}, {'a' if self.device else 'no'} usable device ({where})"


@cache
def support() -> tuple[Support, ...]:
    """Return what can work here, a kind each; asked once, when the first source opens."""
    return tuple(Support(kind, _built().get(kind), _has_device(kind)) for kind in KINDS)


def kinds_for(wanted: str) -> tuple[Kind, ...]:
    """Return the kinds to try for a setting, without those that cannot work."""
    if wanted == "none":
        return ()
    return tuple(
        one.kind
        for one in support()
        if one.usable and one.kind not in _failed and wanted in ("any", one.kind)
    )


def give_up(kind: Kind) -> None:
    """Do not try a kind again in this process: it is there, and did not work."""
    _failed.add(kind)


def fallback(wanted: str) -> str:
    """Return a sentence for people: what was asked for cannot be had, and why."""
    why = [one.words for one in support() if wanted in ("any", one.kind)]
    if any(one.usable for one in support() if wanted in ("any", one.kind)):
        why.append("this source could not be decoded with it")
    return (
        f"hardware_decoding = {wanted} does not work here, so pictures are decoded in software "
        f"({'; '.join(why)})"
    )


def device_options(kinds: Sequence[Kind]) -> str:
    """Return FFmpeg's option for kinds that are devices; "" if there is none among them."""
    devices = [kind for kind in kinds if kind != "v4l2"]
    return f"hw_decoders_any;{','.join(devices)}" if devices else ""


def v4l2_options(codec: str) -> str:
    """Return FFmpeg's option for V4L2, for a codec's four-character code; "" if it has none."""
    decoder = V4L2_DECODERS.get(codec.lower(), "")
    return f"video_codec;{decoder}" if decoder and _has_decoder(decoder) is not False else ""


def describe() -> str:
    """Return a line about all kinds."""
    return "; ".join(one.words for one in support())


def _has_device(kind: Kind) -> bool:
    return any(
        os.access(path, os.R_OK | os.W_OK)
        for pattern in _DEVICES[kind]
        for path in glob.glob(pattern)
    )


def _built() -> dict[Kind, bool]:
    """Return which kinds FFmpeg was built with; nothing if its libraries cannot be asked."""
    utilities = _library("avutil")
    if utilities is None:
        return {}
    names = set()
    utilities.av_hwdevice_get_type_name.restype = ctypes.c_char_p
    device = 0
    while device := utilities.av_hwdevice_iterate_types(device):
        names.add(utilities.av_hwdevice_get_type_name(device).decode())
    built: dict[Kind, bool] = {"vaapi": "vaapi" in names, "cuda": "cuda" in names}
    decoders = [_has_decoder(decoder) for decoder in V4L2_DECODERS.values()]
    if None not in decoders:
        built["v4l2"] = any(decoders)
    return built


def _has_decoder(name: str) -> bool | None:
    """Return whether FFmpeg has a decoder; None if it cannot be asked."""
    codecs = _library("avcodec")
    if codecs is None:
        return None
    codecs.avcodec_find_decoder_by_name.restype = ctypes.c_void_p
    return bool(codecs.avcodec_find_decoder_by_name(name.encode()))


@cache
def _library(name: str) -> ctypes.CDLL | None:
    """Return FFmpeg's library that OpenCV has loaded; None if it is part of another file."""
    assert cv2.__version__, "loaded with OpenCV"
    pattern = re.compile(rf"\S*/lib{name}\b\S*\.so\S*")
    try:
        with open("/proc/self/maps", encoding="utf-8", errors="replace") as maps:
            found = next((match[0] for line in maps if (match := pattern.search(line))), None)
        return None if found is None else ctypes.CDLL(found)
    except OSError:
        return None
