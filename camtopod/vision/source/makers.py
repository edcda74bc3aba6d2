"""Paths under which the common makers' cameras offer their streams.

An ``rtsp://`` URL without a path is tried with each of them.
"""

from __future__ import annotations

PATHS = {
    "Axis": "/axis-media/media.amp",
    "Bosch": "/rtsp_tunnel",
    "Dahua, Amcrest, Lorex": "/cam/realmonitor?channel=1&subtype=0",
    "Foscam": "/videoMain",
    "Hanwha, Samsung": "/profile2/media.smp",
    "Hikvision, Annke": "/Streaming/Channels/101",
    "Panasonic, i-PRO": "/MediaInput/stream_1",
    "Reolink": "/h264Preview_01_main",
    "Sony": "/video1",
    "TP-Link, Ezviz": "/stream1",
    "Ubiquiti": "/s0",
    "Uniview": "/media/video1",
    "Vivotek": "/live.sdp",
}
"""Path of the first camera's large stream, by makers."""


def streams_by_maker(source: str) -> dict[str, str]:
    """Return the URLs to try, by makers, for an ``rtsp://`` URL without a path; else none."""
    scheme, separator, rest = source.partition("://")
    bare = rest.rstrip("/")
    if scheme.lower() not in ("rtsp", "rtsps") or not separator:
        return {}
    if "/" in bare.rpartition("@")[2] or "?" in bare.rpartition("@")[2]:
        return {}
    return {maker: f"{scheme}://{bare}{path}" for maker, path in PATHS.items()}
