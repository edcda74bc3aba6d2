"""Find the streams of cameras of which only the host is known, for `camtopod init`."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor

from camtopod.cli.cameras import onvif
from camtopod.vision.source import Probe, streams_by_maker

ENOUGH_HEIGHT = 360
"""Height (pixels) of a stream that is big enough: pictures are analysed at 320 pixels of width."""
ENOUGH_FPS = 6.5
"""Frame rate of a stream that is fast enough, for 7 pictures a second (setting `analysed_fps`)."""
_NOT_THERE = re.compile(r"\((?!401|403)4\d\d\)")
"""Status in the problem of a stream that the camera does not have."""

Look = Callable[[Mapping[str, str]], Mapping[str, Probe]]
"""Probes sources by name."""


def streams_by_onvif(cameras: Mapping[str, str]) -> tuple[dict[str, str], dict[str, str]]:
    """Replace ``onvif://`` sources among the cameras by RTSP URLs of streams that are big enough.

    cameras: source by camera id.

    Return the cameras whose source is known, and for the others why it is not.
    """
    names = [name for name, source in cameras.items() if source.startswith(f"{onvif.SCHEME}://")]
    urls = dict(cameras)
    reasons = {}
    with ThreadPoolExecutor(16) as pool:
        answers = {name: pool.submit(onvif.streams, cameras[name]) for name in names}
        for name, answer in answers.items():
            try:
                offers = answer.result()
            except onvif.OnvifError as error:
                reasons[name] = str(error)
                del urls[name]
            else:
                urls[name] = _big_enough(offers).url
    return urls, reasons


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
