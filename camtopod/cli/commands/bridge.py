"""`camtopod bridge`: show the site in Home Assistant, through an MQTT broker."""

from __future__ import annotations

import argparse
import contextlib
from collections import deque
from typing import Any

from camtopod import codec, mqtt
from camtopod.cli import exits
from camtopod.cli.common import (
    configuration,
    ends_within,
    reporting_to_systemd,
    start_logging,
    until_signal,
)
from camtopod.cli.events import broker_options
from camtopod.cli.site_choice import dial_as_reader
from camtopod.export import ExpectedArrivals, homeassistant
from camtopod.records import Match, Prediction
from camtopod.serve.bus import Bus, QueryError, TopologySubscriber
from camtopod.serve.runtime import STALL_SECONDS, Progress, wall
from camtopod.statuses import Statuses

LEAVE_SECONDS = 5.0
"""Time that a blocking part may delay the end after a signal."""
LOOK_SECONDS = 1.0
"""Interval at which changes are published."""
ANSWERS_MAX = 1000
"""Largest number of predictions and matches that wait to be published; older ones are dropped."""


def add_parser(add: Any) -> None:
    """Add `bridge`."""
    parser = add(
        description="Publishes the state of the site to an MQTT broker until interrupted. It uses "
        "Home Assistant's MQTT discovery: a device for the daemon and one for each camera appear "
        "there without further configuration.",
        epilog="example: camtopod bridge mqtt://camtopod@homeassistant.local",
    )
    parser.add_argument(
        "url",
        metavar="URL",
        help="broker as mqtt[s]://[USER@]HOST[:PORT][/PREFIX]; default PREFIX of the topics: "
        f"{homeassistant.PREFIX}",
    )
    parser.add_argument(
        "--discovery",
        metavar="PREFIX",
        default=homeassistant.DISCOVERY,
        help="Home Assistant's discovery prefix (default: %(default)s)",
    )
    broker_options.add_options(parser)


class HomeAssistantState:
    """Newest state of the site, filled by the bus's threads; at most ``cameras_max`` cameras."""

    def __init__(self, bus: Bus, topics: homeassistant.Topics, cameras_max: int) -> None:
        self._topics = topics
        self._cameras_max = cameras_max
        self._statuses = Statuses(wall)
        self._predictions: dict[str, Prediction] = {}
        self._answers: deque[Prediction | Match] = deque(maxlen=ANSWERS_MAX)
        """What `events` has not seen; the bus's threads append it."""
        self._arrivals = ExpectedArrivals()
        self._subscriber = TopologySubscriber(bus)
        bus.subscribe("status/*", self._statuses.on_status)
        bus.subscribe("prediction/*", self._on_prediction)
        bus.subscribe("match/*", self._on_match)
        with contextlib.suppress(QueryError):
            for key, payload in bus.query("status/*"):
                self._statuses.on_status(key, payload)

    def events(self, now: float) -> list[homeassistant.Messages]:
        """Return the messages of the entries since the last call, oldest first."""
        self._arrivals.forget_cameras(self._statuses.daemon.names.forgotten)
        result = []
        while self._answers:
            answer = self._answers.popleft()
            if isinstance(answer, Prediction):
                self._arrivals.left(answer)
            else:
                passages = self._arrivals.entered(answer)
                result.append(homeassistant.walk_messages(self._topics, passages))
        self._arrivals.forget(now)
        return result

    def messages(self, now: float) -> homeassistant.Messages:
        """Return the payload of every topic whose messages are retained."""
        self._subscriber.update()
        topics = self._topics
        topology = self._subscriber.topology
        zones = {}
        if topology is not None:
            zones = {camera.id: len(camera.zones) for camera in topology.cameras}
        statuses = self._statuses

        # Cameras, in a stable order.
        states = {
            state.id: state for state in statuses.cameras(topology) if codec.is_camera(state.id)
        }
        cameras = sorted(states)[: self._cameras_max]

        # Messages of the site, then of each camera.
        away = "" if self._subscriber.daemons else "the daemon is not running"
        daemon = statuses.daemon_state(topology, away)
        messages = homeassistant.discovery(topics, cameras)
        messages |= homeassistant.site_state(topics, daemon, statuses.daemon, topology)
        expected, looks = self._arrivals.expected(now), self._arrivals.looks(now)
        for camera in cameras:
            state = states[camera]
            if state.events is not None or state.state != "no grabber":  # it has been heard of
                messages |= homeassistant.camera_state(topics, state, zones.get(camera, 0))
            if (prediction := self._predictions.get(camera)) is not None:
                messages |= homeassistant.prediction_state(topics, prediction)
            if topology is not None:
                messages |= homeassistant.arrival_states(topics, camera, expected, looks)
        return messages

    def _on_prediction(self, key: str, payload: bytes) -> None:
        with contextlib.suppress(codec.Rejected):
            prediction = codec.read(Prediction, payload, pack=True)
            camera = prediction.camera
            if camera in self._predictions or len(self._predictions) < self._cameras_max:
                self._predictions[camera] = prediction
            self._answers.append(prediction)

    def _on_match(self, key: str, payload: bytes) -> None:
        with contextlib.suppress(codec.Rejected):
            match = codec.read(Match, payload, pack=True)
            if codec.is_camera(match.camera):
                self._answers.append(match)


def run(args: argparse.Namespace) -> None:
    """Publish until SIGTERM or SIGINT."""
    start_logging(args)
    config = configuration(args)
    target = broker_options.broker_of(args, args.url, homeassistant.PREFIX)

    # Connect to the bus and the broker, then publish changes.
    with contextlib.ExitStack() as stack, until_signal() as stop:
        stack.enter_context(ends_within(stop, LEAVE_SECONDS, args.with_parent))
        bus, config = dial_as_reader(args, config)
        stack.enter_context(bus)
        topics = homeassistant.Topics(config.site.name, target.prefix, args.discovery.strip("/"))
        site = HomeAssistantState(bus, topics, config.limits.cameras_max)
        with broker_options.connecting(exits.FAILED):
            retained_messages = stack.enter_context(
                contextlib.closing(mqtt.RetainedMessages(target, topics.bridge))
            )
        progress = Progress()
        mark = progress.watch("bridge", STALL_SECONDS)
        stack.enter_context(reporting_to_systemd(progress, f"publishing below {target.prefix}"))
        while not stop.is_set():
            mark.beat()
            now = wall()
            for messages in site.events(now):
                retained_messages.tell(messages)
            retained_messages.show(site.messages(now))
            stop.wait(LOOK_SECONDS)
