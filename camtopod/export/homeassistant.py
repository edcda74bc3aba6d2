"""Home Assistant by MQTT discovery: a device for the daemon and one for each camera.

Pure: state of the site in, messages (topic -> text) out. `camtopod bridge` publishes them, all
retained except those of `walk_messages`.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Iterable, Mapping
from typing import Any

import msgspec
from msgspec import Struct

from camtopod import __version__, codec
from camtopod.export.arrivals import NO_ARRIVAL, Awaited, Passing, look_at
from camtopod.records import DaemonStatus, Prediction, Topology
from camtopod.topology import links_between_views
from camtopod.words import (
    ELSEWHERE,
    LEAVES,
    LIKELY,
    UNKNOWN,
    CameraState,
    DaemonState,
    alarms_in_words,
    headline,
)

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
    Entity(
        "between",
        "Between cameras",
        topic="between",
        more={"state_class": "measurement", "icon": "mdi:transit-connection-variant"},
    ),
)
CAMERA_ENTITIES = (
    Entity("online", "Online", component="binary_sensor", more={"device_class": "connectivity"}),
    Entity("events", "Events", more={"state_class": "total_increasing"}),
    Entity("zones", "Zones", more=_DIAGNOSTIC),
    Entity("next", "Next camera", topic="prediction"),
    Entity("look", "Look at", topic="prediction"),
    Entity("expected", "Expected", topic="expected", component="binary_sensor"),
    Entity("look_here", "Look here", topic="look_here", component="binary_sensor"),
    Entity(
        "arrival",
        "Arrival",
        topic="arrival",
        component="event",
        more={"event_types": ["new", "continued", "uncertain"], "icon": "mdi:walk"},
    ),
)
PASSAGES_MAX = 50
"""Number of the newest passages of a walk in its message."""


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

    @property
    def walk(self) -> str:
        """Each entry with its walk."""
        return f"{self.prefix}/{self.site}/walk"

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
    topics: Topics, daemon: DaemonState, status: DaemonStatus, topology: Topology | None
) -> Messages:
    """Return the messages with the state of the site.

    daemon, status: state of the daemon, and its latest status.
    """
    state: dict[str, Any] = {
        "problem": _switch(daemon.look == "bad"),
        "state": daemon.words,
        "reason": daemon.reason,
        **dict.fromkeys(("version", "cameras", "links", "score", "usual")),
    }
    alarm: dict[str, Any] = {"alarm": "none"}
    if topology is not None:
        state["version"] = topology.version
        state["cameras"] = len(topology.cameras)
        state["links"] = len(links_between_views(topology))
        if topology.score is not None:
            state["score"] = round(100.0 * topology.score.top1, 1)
            state["usual"] = round(100.0 * topology.score.baseline_top1, 1)
    for newest in [alarm for alarm in alarms_in_words(topology) if alarm.open][:1]:
        alarm = {
            "alarm": newest.title[:255],  # all that Home Assistant takes
            "detail": newest.detail,
            "version": newest.version,
            "at": _iso(newest.t),
        }
    between: dict[str, Any] = dict.fromkeys(("between", "low", "high", "since", "pairs"))
    if daemon.live and (estimate := status.between) is not None:
        ends = {"low": estimate.low, "high": estimate.high, "since": _iso(estimate.since)}
        between = {"between": round(estimate.number, 1), **ends, "pairs": estimate.pairs}
    return {
        topics.daemon: ("offline", "online")[daemon.live],
        topics.topic_of("", "state"): _json(state),
        topics.topic_of("", "alarm"): _json(alarm),
        topics.topic_of("", "between"): _json(between),
    }


def camera_state(topics: Topics, camera: CameraState, zones: int) -> Messages:
    """Return the messages with the state of a camera; ``zones``: their number."""
    state = {
        "online": _switch(camera.alive and camera.state in ("running", ELSEWHERE)),
        "state": camera.state,
        "reason": camera.reason,
        "events": camera.events or 0,
        "zones": zones,
    }
    return {topics.topic_of(camera.id, "state"): _json(state)}


def prediction_state(topics: Topics, prediction: Prediction) -> Messages:
    """Return the message with the headline of the latest exit's prediction.

    ``from`` and ``until`` are the times by which 10 and 90 percent of the objects have arrived,
    if they are known. ``look`` is the other camera that most probably sees the object now or, if
    none does, next, with the probability ``sees``.
    """
    answer = headline(prediction)
    nouns = {prediction.camera: "returns", LEAVES: "leaves", UNKNOWN: "unknown"}
    rows = [row for row in prediction.next if row.camera == answer.place and not row.prior]
    times = (rows[0].q10, rows[0].q90) if rows else (math.nan, math.nan)
    from_, until = (_iso(prediction.t + max(t, 0.0)) for t in times)
    look, sees = look_at(prediction)
    state = {
        "next": nouns.get(answer.place, answer.place),
        "probability": round(answer.probability, 3),
        "words": answer.words,
        "zone": prediction.zone,
        "left": _iso(prediction.t),
        "from": from_,
        "until": until,
        "look": look,
        "sees": round(sees, 3),
    }
    return {topics.topic_of(prediction.camera, "prediction"): _json(state)}


def arrival_states(
    topics: Topics, camera: str, expected: Mapping[str, Awaited], looks: Mapping[str, Awaited]
) -> Messages:
    """Return the messages that say whether somebody is about to come, and whether to look.

    expected, looks: by camera.
    """
    messages = {}
    for field, arrivals in (("expected", expected), ("look_here", looks)):
        arrival = arrivals.get(camera, NO_ARRIVAL)
        state = {
            field: _switch(arrival.probability > LIKELY),
            "probability": round(arrival.probability, 3),
            "camera": arrival.camera,
            "from": _iso(arrival.from_),
            "until": _iso(arrival.until),
        }
        messages[topics.topic_of(camera, field)] = _json(state)
    return messages


def walk_messages(topics: Topics, entry: Passing) -> Messages:
    """Return the messages of an entry: its match with its walk, and the first time an event."""
    match = entry.match
    passages = [
        {"camera": passage.camera, "t": passage.t, "track": passage.track}
        for passage in entry.passages[-PASSAGES_MAX:]
    ]
    walk = msgspec.to_builtins(match) | {"passages": passages}
    if entry.was is not None:
        walk["was"] = entry.was
    if entry.again:
        return {topics.walk: _json(walk | {"again": True})}

    outcomes: list[tuple[float, str, str | None]] = [(match.new, "new", None)]
    outcomes += [(passage.probability, "continued", passage.camera) for passage in match.from_]
    probability, kind, camera = max(outcomes, key=lambda outcome: outcome[0])
    event = {
        "event_type": kind if probability > LIKELY else "uncertain",
        "probability": round(probability, 3),
        "camera": camera,
        "walk": match.walk,
        "track": match.track,
        "entered": _iso(match.t),
    }
    return {topics.walk: _json(walk), topics.topic_of(match.camera, "arrival"): _json(event)}


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
        "availability": [{"topic": topic} for topic in available],
        "availability_mode": "all",
        **entity.more,
    }
    if entity.component != "event":  # whose JSON Home Assistant reads itself
        config["value_template"] = f"{{{{ value_json.{entity.field} }}}}"
        config["json_attributes_topic"] = state
    place = f"{PREFIX}_{_escaped(topics.site)}/{_escaped(camera or 'daemon')}-{entity.field}"
    return f"{topics.discovery}/{entity.component}/{place}/config", _json(config)


def _device(site: str, camera: str) -> dict[str, Any]:
    """Return a device; the ids of its entities begin with its name, so with the site."""
    whole = f"camtopod/{site}"
    device: dict[str, Any] = {"manufacturer": "camtopod", "name": f"{site} {camera or PREFIX}"}
    if camera:
        return device | {"identifiers": [f"{whole}/{camera}"], "via_device": whole}
    return device | {"identifiers": [whole], "sw_version": __version__}


def _escaped(name: str) -> str:
    """Return the name without dots, which Home Assistant refuses in a topic; unambiguous."""
    return name.replace("_", "__").replace(".", "_-")


def _iso(t: float | None) -> str | None:
    """Return a time as text; None for none, or an implausible one of another program."""
    if t is None or not codec.T_MIN <= t < codec.T_MAX:
        return None
    return datetime.datetime.fromtimestamp(t, datetime.UTC).isoformat(timespec="seconds")


def _switch(on: bool) -> str:
    """Return the state of a binary sensor."""
    return ("OFF", "ON")[on]


def _json(content: Any) -> str:
    return msgspec.json.encode(content).decode()
