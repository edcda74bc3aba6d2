"""The formats that `camtopod ingest` reads: a row each, from which parser and help are made."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from camtopod.adapt.adapter import Adapter
from camtopod.adapt.axis import Axis
from camtopod.adapt.deepstream import DeepStream
from camtopod.adapt.frigate import Frigate
from camtopod.adapt.mot import Mot
from camtopod.adapt.onvif import Onvif
from camtopod.adapt.scenescape import SceneScape


class Format(NamedTuple):
    """One format."""

    lines: str
    """What its lines are."""
    make: Callable[[Any], Adapter] | None = None
    """Makes its adapter of the parsed command line; None for event lines. Raises `ValueError` for
    options without sense.
    """
    options: tuple[str, ...] = ()
    """Names of its options."""
    mqtt: bool = True
    """Its lines may come from an MQTT broker."""


FORMATS = {
    "jsonl": Format("event lines as `camtopod grab --out` writes them", mqtt=False),
    "frigate": Format(
        "messages of frigate/events (mosquitto_sub -t frigate/events)",
        lambda options: Frigate(dict(options.size), options.label),
        ("size", "label", "rename"),
    ),
    "mot": Format(
        "a MOTChallenge text file",
        lambda options: Mot(options.camera, dict(options.size), options.fps, options.start or 0.0),
        ("size", "camera", "fps", "start"),
        mqtt=False,
    ),
    "scenescape": Format(
        "messages of scenescape/data/camera/ID",
        lambda options: SceneScape(dict(options.size), options.label, options.tracked),
        ("size", "label", "tracked", "rename"),
    ),
    "axis": Format(
        "messages of AXIS scene metadata",
        lambda options: Axis(options.camera, options.label),
        ("label", "camera", "rename"),
    ),
    "onvif": Format(
        "scene descriptions of Profile M, XML documents or JSON messages",
        lambda options: Onvif(options.camera, options.label),
        ("label", "camera", "rename"),
    ),
    "deepstream": Format(
        "messages of nvmsgconv",
        lambda options: DeepStream(dict(options.size), options.camera, options.label),
        ("size", "label", "camera", "rename"),
    ),
}
"""All formats, by name."""
