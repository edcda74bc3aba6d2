"""Find the streams of cameras of which only the host is known, for `camtopod init`."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ThreadPoolExecutor

from msgspec import Struct

from camtopod.cli.cameras import onvif
from camtopod.cli.cameras.naming import free_name
from camtopod.redact import remember
from camtopod.vision.source import Probe, streams_by_maker

ENOUGH_HEIGHT = 360
"""Height (pixels) of a stream that is big enough: pictures are analysed at 320 pixels of width."""
ENOUGH_FPS = 6.5
"""Frame rate of a stream that is fast enough, for 7 pictures a second (setting `analysed_fps`)."""
_NOT_THERE = re.compile(r"\((?!401|403)4\d\d\)")
"""Status in the problem of a stream that the camera does not have."""

Look = Callable[[Mapping[str, str]], Mapping[str, Probe]]
"""Probes sources by name."""


class Findings(Struct):
    """Streams of the cameras that were asked, by camera id."""

    urls: dict[str, str] = {}
    """Source of each camera that has one."""
    reasons: dict[str, str] = {}
    """Why a camera has no source."""
    remarks: dict[str, list[str]] = {}
    """Remarks on a camera, in addition to those of a probe."""
    other_urls: dict[str, str] = {}
    """Where the streams of some may be, too."""


def streams_by_onvif(cameras: Mapping[str, str], names: Collection[str] = ()) -> Findings:
    """Replace ``onvif://`` sources among the cameras by RTSP URLs of streams that are big enough.

    Each further lens of a camera, and channel of a recorder, becomes a camera with a number.

    cameras: source by camera id.
    names: camera ids that the further ones must not have.
    """
    result = Findings()
    used_names = {*names, *cameras}
    with ThreadPoolExecutor(16) as pool:
        answers = {
            name: pool.submit(onvif.streams, source)
            for name, source in cameras.items()
            if source.startswith(f"{onvif.SCHEME}://")
        }
        for name, source in cameras.items():
            if name not in answers:
                result.urls[name] = source
                continue
            remember(source)  # a camera may repeat the password in what it says
            try:
                streams = answers[name].result()
            except onvif.OnvifError as error:
                result.reasons[name] = str(error)
            else:
                used_names |= _add_views(result, name, streams, used_names)
    return result


def _add_views(
    result: Findings, name: str, streams: list[onvif.Stream], used_names: Collection[str]
) -> set[str]:
    """Add a camera for each of the video sources of one; return their names, with its own."""
    views: dict[str, list[onvif.Stream]] = {}
    for stream in streams:
        views.setdefault(stream.video_source, []).append(stream)
    names = {name}
    for number, view in enumerate(views.values(), 1):
        camera = name
        if number > 1:
            camera = free_name(name, {*used_names, *names})
            names.add(camera)
        readable = [stream for stream in view if not stream.problem]
        if readable:
            stream = _big_enough(readable)
            result.urls[camera] = stream.url
            if stream.remark:
                result.remarks[camera] = [stream.remark]
            if stream.other_url:
                result.other_urls[camera] = stream.other_url
        else:
            result.reasons[camera] = view[0].problem
        if len(views) > 1:
            remark = f"video source {number} of {len(views)} of {name}: a lens or a channel"
            result.remarks.setdefault(camera, []).insert(0, remark)
    return names


def streams_as_named(
    other_urls: Mapping[str, str], probes: Mapping[str, Probe], look: Look
) -> dict[str, tuple[str, Probe]]:
    """Return (URL, probe) of cameras that can be opened at their other URL alone.

    probes: the results of probing the cameras' own URLs.
    """
    trials = {name: url for name, url in other_urls.items() if probes[name].problem}
    return {
        name: (trials[name], probe) for name, probe in look(trials).items() if not probe.problem
    }


def streams_by_path(
    cameras: Mapping[str, str], probes: Mapping[str, Probe], look: Look
) -> dict[str, tuple[str, str, Probe]]:
    """Return (URL, makers, probe) of cameras whose URL has no path and could not be opened.

    The paths of the common makers are tried, unless the camera is away or refuses the password:
    some cameras lock a user out who tries too often.

    probes: the results of probing the cameras' own URLs.
    """
    guesses = {
        f"{name} {maker}": url
        for name, source in cameras.items()
        if _NOT_THERE.search(probes[name].problem)
        for maker, url in streams_by_maker(source).items()
    }
    result: dict[str, tuple[str, str, Probe]] = {}
    for key, probe in look(guesses).items():
        name, _, maker = key.partition(" ")
        if not probe.problem and name not in result:
            result[name] = guesses[key], maker, probe
    return result


def _big_enough(streams: list[onvif.Stream]) -> onvif.Stream:
    """Return the smallest stream that is big and fast enough, else the camera's first one."""
    enough = [
        stream
        for stream in streams
        if stream.height >= ENOUGH_HEIGHT and (stream.fps >= ENOUGH_FPS or stream.fps == 0.0)
    ]
    return min(enough, key=lambda stream: stream.width * stream.height, default=streams[0])
