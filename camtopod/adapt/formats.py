"""The formats that `camtopod ingest` reads: a row each, from which parser and help are made."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from types import MappingProxyType
from typing import NamedTuple

from camtopod.adapt.adapter import ANY_CAMERA, Adapter, Sizes
from camtopod.adapt.axis import Axis
from camtopod.adapt.deepstream import DeepStream
from camtopod.adapt.frigate import Frigate
from camtopod.adapt.mot import Mot
from camtopod.adapt.onvif import Onvif
from camtopod.adapt.scenescape import SceneScape


class FormatOptions(NamedTuple):
    """Options of all formats; a format has some of them."""

    size: Sizes = MappingProxyType({})
    label: Collection[str] = ()
    camera: str | None = None
    tracked: bool = False
    fps: float | None = None
    start: float | None = None


class Format(NamedTuple):
    """One format."""

    lines: str
    """What its lines are."""
    make: Callable[[FormatOptions], Adapter] | None
    """Makes its adapter; None for event lines. Raises `ValueError` for options without sense."""
    options: Mapping[str, str] = MappingProxyType({})
    """Names of its options, each with what it means for this format, or empty."""
    needs: tuple[str, ...] = ()
    """Options that it cannot do without."""
    mqtt: bool = True
    """Its lines may come from an MQTT broker."""
    no_events: str = "no object entered or left, or only objects that are not among --label"
    """Why well-formed lines may give no events."""


def _mot(given: FormatOptions) -> Mot:
    assert given.camera is not None
    assert given.fps is not None
    size = given.size.get(given.camera) or given.size.get(ANY_CAMERA)
    if size is None:
        raise ValueError(f"--size is for another camera than {given.camera}")
    return Mot(given.camera, size, given.fps, given.start or 0.0)


_ONE_CAMERA = "the id of the one camera (default: as the topic or the message names it)"

FORMATS = {
    "jsonl": Format("event lines as `camtopod grab --out` writes them", None, mqtt=False),
    "frigate": Format(
        "messages of frigate/events, one a line (mosquitto_sub -t frigate/events)",
        lambda given: Frigate(given.size, given.label),
        {"size": "detect width and height, not needed if Frigate sends path_data", "label": ""},
        no_events="no object entered or left, or only objects that are stationary or not among "
        "--label",
    ),
    "mot": Format(
        "a MOTChallenge text file",
        _mot,
        {
            "size": "",
            "camera": "the camera's id",
            "fps": "frames per second",
            "start": "event time of the first frame (default 0)",
        },
        needs=("camera", "fps", "size"),
        mqtt=False,
        no_events="boxes with an id below 0 (untracked detections) or a confidence of 0 belong to "
        "no track",
    ),
    "scenescape": Format(
        "messages of scenescape/data/camera/ID, one a line",
        lambda given: SceneScape(given.size, given.label, given.tracked),
        {"size": "", "label": "", "tracked": "ids come from a tracker (gvatrack in the pipeline)"},
    ),
    "axis": Format(
        "AXIS scene metadata, frames or object tracks, one message a line",
        lambda given: Axis(given.camera, given.label),
        {"label": "", "camera": _ONE_CAMERA},
    ),
    "onvif": Format(
        "scene descriptions of Profile M, XML documents or JSON messages",
        lambda given: Onvif(given.camera, given.label),
        {"label": "", "camera": _ONE_CAMERA},
    ),
    "deepstream": Format(
        "messages of nvmsgconv, one a line",
        lambda given: DeepStream(given.size, given.camera, given.label),
        {"size": "nvstreammux width and height", "label": "", "camera": _ONE_CAMERA},
        no_events="no object entered or left, the objects have no tracker's id, or they are not "
        "among --label",
    ),
}
"""All formats, by name."""
