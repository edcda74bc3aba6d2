"""The smaller stream of a camera, by the form of its URL.

Cameras offer each view in several sizes, and most makers name the streams alike. A guess that is
wrong cannot be opened, so it has to be tried.
"""

from __future__ import annotations

import re

ENOUGH_HEIGHT = 360
"""Height (pixels) of a stream that is big enough.

Pictures are analysed at 320 pixels of width (setting `working_width`), and a person has to be a
tenth of the height: 36 pixels of 360.
"""
ENOUGH_FPS = 6.5
"""Frame rate of a stream that is fast enough, for 7 pictures a second (setting `analysed_fps`)."""

_FORMS: tuple[tuple[str, str], ...] = (
    # Hikvision, and cameras that are sold under other names
    (r"(/Streaming/channels/\d*)01(?=$|[/?])", r"\g<1>02"),
    (r"(/h26[45]/ch\d+)/main/", r"\g<1>/sub/"),
    # Dahua, Amcrest
    (r"(/cam/realmonitor\?(?:.*&)?subtype)=0(?=$|&)", r"\g<1>=1"),
    # Reolink; the smaller stream is H.264 in any case
    (r"/h26[45](Preview_\d+)_main$", r"/h264\g<1>_sub"),
    (r"/(Preview_\d+)_main$", r"/\g<1>_sub"),
    # TP-Link
    (r"/stream1$", "/stream2"),
    # Foscam
    (r"/videoMain$", "/videoSub"),
    # Uniview
    (r"(/unicast/c\d+)/s0/", r"\g<1>/s1/"),
    (r"/media/video1$", "/media/video2"),
    # Axis
    (r"(/axis-media/media\.amp)$", rf"\g<1>?resolution=640x{ENOUGH_HEIGHT}"),
)
"""Form of the path of a large stream, and what it is replaced with for the smaller one."""


def smaller_stream(url: str) -> str | None:
    """Return the URL under which the camera's smaller stream may be found; None if unknown."""
    scheme, separator, rest = url.partition("://")
    host, slash, path = rest.partition("/")
    if not separator or not slash:
        return None

    # A password may contain a slash; forms are looked for behind the host.
    at = path.rfind("@")
    host = host + slash + path[: at + 1]
    path = path[at + 1 :]
    for form, smaller in _FORMS:
        found, count = re.subn(form, smaller, "/" + path, count=1, flags=re.IGNORECASE)
        if count:
            return f"{scheme}://{host}{found.removeprefix('/')}"
    return None
