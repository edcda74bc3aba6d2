"""A site as Home Assistant knows it by MQTT discovery: a device for the daemon and one for each
camera.

Pure: what is known of the site in, retained messages (topic -> text) out. `camtopod bridge`
publishes them.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterable
from typing import Any

import msgspec
from msgspec import Struct

from camtopod import __version__, codec
from camtopod.records import Alarm, CameraId, Prediction, Topology

DISCOVERY = "homeassistant"
"""Where Home Assistant looks for devices, unless it is told otherwise."""
PREFIX = "camtopod"
"""The first level of the topics for what is going on."""
STATE_CHARACTERS_MAX = 255
"""Home Assistant refuses longer states."""
NOBODY = "leaves"
"""In place of a camera: the object is probably not seen again."""

Messages = dict[str, str]


class Said(Struct, frozen=True):
    """What a camera's process says of itself in ``status/{camera}``."""

    state: str = ""
    reason: str = ""


class Counted(Struct, frozen=True):
    """What the daemon says of a camera."""

    events: int = 0
    alive: bool = False


class SiteSaid(Struct, frozen=True):
    """What the daemon says in ``status/daemon``."""

    state: str = ""
    reason: str = ""
    cameras: dict[CameraId, Counted] = {}


class Entity(Struct, frozen=True):
    """One figure of a device: ``field`` of the JSON on the ``topic`` below the device's own."""

    field: str
    name: str
    topic: str = "state"
    component: str = "sensor"
    more: dict[str, Any] = {}
    """What else Home Assistant is told of it."""


_DIAGNOSTIC = {"entity_category": "diagnostic"}
SITE_ENTITIES = (
    Entity("problem", "Problem", component="binary_sensor", more={"device_class": "problem"}),
    Entity("version", "Topology version", more=_DIAGNOSTIC),
    Entity("links", "Links", more=_DIAGNOSTIC),
    Entity(
        "score",
        "Predictions right",
        more={"unit_of_measurement": "%", "state_class": "measurement"},
    ),
    Entity("alarm", "Alarm", topic="alarm"),
)
CAMERA_ENTITIES = (
    Entity("online", "Online", component="binary_sensor", more={"device_class": "connectivity"}),
    Entity("events", "Events", more={"state_class": "total_increasing"}),
    Entity("zones", "Zones", more=_DIAGNOSTIC),
    Entity("next", "Next camera", topic="prediction"),
)


class Topics(Struct, frozen=True):
    """Where the messages of one site go."""

    site: str
    prefix: str = PREFIX
    discovery: str = DISCOVERY

    @property
    def bridge(self) -> str:
        """Says whether the messages are kept up to date."""
        return f"{self.prefix}/{self.site}/availability"

    @property
    def daemon(self) -> str:
        """Says whether the daemon is there."""
        return f"{self.prefix}/{self.site}/daemon/availability"

    def of(self, camera: str, topic: str) -> str:
        """What is going on at a camera, or ("") at the site."""
        device = f"camera/{camera}" if camera else "daemon"
        return f"{self.prefix}/{self.site}/{device}/{topic}"


def discovery(topics: Topics, cameras: Iterable[str]) -> Messages:
    """What Home Assistant needs to know of the site and of these cameras."""
    messages = dict(_announced(topics, "", entity) for entity in SITE_ENTITIES)
    for camera in cameras:
        messages |= dict(_announced(topics, camera, entity) for entity in CAMERA_ENTITIES)
    return messages


def site_state(topics: Topics, alive: bool, said: SiteSaid, topology: Topology | None) -> Messages:
    """``alive``: whether the daemon is there; ``said``: by it last."""
    running = alive and said.state == "running"
    score = None if topology is None else topology.score
    alarms = [] if topology is None else topology.alarms or []
    state = {
        "problem": "OFF" if running else "ON",
        "reason": said.reason if alive else "the daemon is not there",
        "version": None if topology is None else topology.version,
        "cameras": None if topology is None else len(topology.cameras),
        "links": None if topology is None else len(topology.links),
        "score": None if score is None else round(100.0 * score.top1, 1),
        "usual": None if score is None else round(100.0 * score.baseline_top1, 1),
    }
    return {
        topics.daemon: "online" if alive else "offline",
        topics.of("", "state"): _json(state),
        topics.of("", "alarm"): _json(_alarm(alarms[-1]) if alarms else {"alarm": "none"}),
    }


def camera_state(
    topics: Topics, camera: str, counted: Counted, said: Said | None, zones: int
) -> Messages:
    """``said``: by the camera's own process; those of another program's events do not speak."""
    online = counted.alive and (said is None or said.state == "running")
    told = said or Said()
    state = {
        "online": "ON" if online else "OFF",
        "state": told.state,
        "reason": told.reason,
        "events": counted.events,
        "zones": zones,
    }
    return {topics.of(camera, "state"): _json(state)}


def prediction_state(topics: Topics, prediction: Prediction) -> Messages:
    """The likeliest next camera of the last exit; ``from`` and ``until``: ten and ninety per cent
    are there by then.
    """
    shares = {NOBODY: prediction.leave}
    for one in prediction.next_:
        shares[one.camera] = shares.get(one.camera, 0.0) + one.probability
    camera, probability = max(shares.items(), key=lambda item: item[1])
    place = next((one for one in prediction.next_ if one.camera == camera), None)
    state = {
        "next": camera,
        "probability": round(probability, 3),
        "zone": prediction.zone,
        "left": _iso(prediction.t),
        "from": None if place is None else _iso(prediction.t + place.q10),
        "until": None if place is None else _iso(prediction.t + place.q90),
    }
    return {topics.of(prediction.camera, "prediction"): _json(state)}


def _announced(topics: Topics, camera: str, entity: Entity) -> tuple[str, str]:
    state = topics.of(camera, entity.topic)
    available = [topics.bridge] if entity.field == "problem" else [topics.bridge, topics.daemon]
    config = {
        "name": entity.name,
        "unique_id": f"camtopod/{topics.site}/{camera or 'daemon'}/{entity.field}",
        "device": _device(topics.site, camera),
        "origin": {"name": "camtopod", "sw_version": __version__},
        "state_topic": state,
        "value_template": f"{{{{ value_json.{entity.field} }}}}",
        "json_attributes_topic": state,
        "availability": [{"topic": topic} for topic in available],
        "availability_mode": "all",
        **entity.more,
    }
    place = f"{PREFIX}_{_escaped(topics.site)}/{_escaped(camera or 'daemon')}-{entity.field}"
    return f"{topics.discovery}/{entity.component}/{place}/config", _json(config)


def _device(site: str, camera: str) -> dict[str, Any]:
    whole = f"camtopod/{site}"
    if not camera:
        return {
            "identifiers": [whole],
            "name": f"camtopod {site}",
            "manufacturer": "camtopod",
            "sw_version": __version__,
        }
    return {
        "identifiers": [f"{whole}/{camera}"],
        "name": camera,
        "manufacturer": "camtopod",
        "via_device": whole,
    }


def _alarm(alarm: Alarm) -> dict[str, Any]:
    text = f"{alarm.kind} {alarm.subject}"[:STATE_CHARACTERS_MAX]
    return {"alarm": text, "detail": alarm.detail, "version": alarm.version, "at": _iso(alarm.t)}


def _escaped(name: str) -> str:
    """Home Assistant takes no dot in a topic; two names never become the same."""
    return name.replace("_", "__").replace(".", "_-")


def _iso(t: float) -> str | None:
    """A time that anybody may have made up."""
    if not codec.T_MIN <= t < codec.T_MAX:
        return None
    return datetime.datetime.fromtimestamp(t, datetime.UTC).isoformat(timespec="seconds")


def _json(noun: Any) -> str:
    return msgspec.json.encode(noun).decode()
