"""Home Assistant by MQTT discovery: a device for the daemon and one for each camera.

Pure: state of the site in, retained messages (topic -> text) out. `camtopod bridge` publishes them.
"""

from __future__ import annotations

import datetime
from collections import defaultdict
from collections.abc import Iterable
from typing import Any

import msgspec
from msgspec import Struct

from camtopod import __version__, codec
from camtopod.records import CameraFigures, DaemonStatus, Prediction, Status, Topology
from camtopod.topology import links_between_views

DISCOVERY = "homeassistant"
"""Home Assistant's default topic prefix for discovery."""
PREFIX = "camtopod"
"""Default first level of the state topics."""

Messages = dict[str, str]
"""Payload by topic."""


class Entity(Struct, frozen=True):
    """One figure of a device: ``field`` of the JSON on ``topic`` below the device's own topic."""

    field: str
    name: str
    topic: str = "state"
    component: str = "sensor"
    more: dict[str, Any] = {}
    """Further settings of the entity for Home Assistant."""


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
    Entity("look", "Look at", topic="prediction"),
)


class Topics(Struct, frozen=True):
    """Topics of one site."""

    site: str
    prefix: str = PREFIX
    discovery: str = DISCOVERY

    @property
    def bridge(self) -> str:
        """Availability of the bridge, so whether the messages are kept up to date."""
        return f"{self.prefix}/{self.site}/availability"

    @property
    def daemon(self) -> str:
        """Availability of the daemon."""
        return self.topic_of("", "availability")

    def topic_of(self, camera: str, topic: str) -> str:
        """Return a topic of a camera, or of the site for ""."""
        device = f"camera/{camera}" if camera else "daemon"
        return f"{self.prefix}/{self.site}/{device}/{topic}"


def discovery(topics: Topics, cameras: Iterable[str]) -> Messages:
    """Return the discovery messages of the site and of the given cameras."""
    messages = dict(_announced(topics, "", entity) for entity in SITE_ENTITIES)
    for camera in cameras:
        messages |= dict(_announced(topics, camera, entity) for entity in CAMERA_ENTITIES)
    return messages


def site_state(
    topics: Topics, alive: bool, status: DaemonStatus, topology: Topology | None
) -> Messages:
    """Return the messages with the state of the site.

    alive: True if the daemon is running.
    status: its latest status.
    """
    state: dict[str, Any] = {
        "problem": _switch(not alive or status.state != "running"),
        "reason": status.reason,
        **dict.fromkeys(("version", "cameras", "links", "score", "usual")),
    }
    if not alive:
        state["reason"] = "the daemon is not running"
    alarm: dict[str, Any] = {"alarm": "none"}
    if topology is not None:
        state["version"] = topology.version
        state["cameras"] = len(topology.cameras)
        state["links"] = len(links_between_views(topology))
        if topology.score is not None:
            state["score"] = round(100.0 * topology.score.top1, 1)
            state["usual"] = round(100.0 * topology.score.baseline_top1, 1)
        for newest in (topology.alarms or [])[-1:]:
            alarm = {
                "alarm": f"{newest.kind} {newest.subject}"[:255],  # all that Home Assistant takes
                "detail": newest.detail,
                "version": newest.version,
                "at": _iso(newest.t),
            }
    return {
        topics.daemon: ("offline", "online")[alive],
        topics.topic_of("", "state"): _json(state),
        topics.topic_of("", "alarm"): _json(alarm),
    }


def camera_state(
    topics: Topics, camera: str, counted: CameraFigures, status: Status | None, zones: int
) -> Messages:
    """Return the messages with the state of a camera.

    status: of the camera's grabber; None if its events come from another program.
    """
    reported = status or Status()
    state = {
        "online": _switch(counted.alive and reported.state in ("", "running")),
        "state": reported.state,
        "reason": reported.reason,
        "events": counted.events,
        "zones": zones,
    }
    return {topics.topic_of(camera, "state"): _json(state)}


def prediction_state(topics: Topics, prediction: Prediction) -> Messages:
    """Return the message with the most likely next camera after the latest exit.

    ``from`` and ``until`` are the times by which 10 and 90 percent of the objects have arrived.
    ``look`` is the other camera that most probably sees the object now or, if none does, next,
    with the probability ``sees``.
    """
    next_: dict[str, float] = defaultdict(float)
    for one in prediction.candidates:
        next_[one.camera] += one.probability

    # The camera, or leaving the site, with the largest share.
    shares = {"leaves": prediction.leave, **next_}
    camera = max(shares, key=lambda name: shares[name])
    window: dict[str, str | None] = {"from": None, "until": None}
    for place in prediction.candidates:
        if place.camera == camera:
            window["from"] = _iso(prediction.t + place.q10)
            window["until"] = _iso(prediction.t + place.q90)
            break

    # The camera to look at; without overlapping views it follows from the next appearances.
    next_.pop(prediction.camera, None)
    looks = {one.camera: one.probability for one in prediction.look or []} or next_
    look, sees = max(looks.items(), key=lambda item: item[1], default=("none", 0.0))

    state = {
        "next": camera,
        "probability": round(shares[camera], 3),
        "zone": prediction.zone,
        "left": _iso(prediction.t),
        **window,
        "look": look,
        "sees": round(sees, 3),
    }
    return {topics.topic_of(prediction.camera, "prediction"): _json(state)}


def _announced(topics: Topics, camera: str, entity: Entity) -> tuple[str, str]:
    """Return topic and payload of the discovery message of an entity."""
    state = topics.topic_of(camera, entity.topic)
    available = [topics.bridge, topics.daemon]
    if entity.field == "problem":  # which says so while the daemon is away
        available.remove(topics.daemon)
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
    device: dict[str, Any] = {"manufacturer": "camtopod"}
    if camera:
        return device | {"identifiers": [f"{whole}/{camera}"], "name": camera, "via_device": whole}
    name = f"camtopod {site}"
    return device | {"identifiers": [whole], "name": name, "sw_version": __version__}


def _escaped(name: str) -> str:
    """Return the name without dots, which Home Assistant refuses in a topic; unambiguous."""
    return name.replace("_", "__").replace(".", "_-")


def _iso(t: float) -> str | None:
    """Return a time as text; None for an implausible time, as events come from other programs."""
    if not codec.T_MIN <= t < codec.T_MAX:
        return None
    return datetime.datetime.fromtimestamp(t, datetime.UTC).isoformat(timespec="seconds")


def _switch(on: bool) -> str:
    """Return the state of a binary sensor."""
    return ("OFF", "ON")[on]


def _json(content: Any) -> str:
    return msgspec.json.encode(content).decode()
