"""What state a camera or the daemon is in, and how it, a prediction and an alarm are said.

Every display (page, terminal, MQTT bridge), `str` and the log take their words from here, so that
the same status is the same words everywhere. Pure: no clock; `camtopod.statuses` collects what a
display has received.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Literal

from msgspec import Struct
from msgspec.structs import replace

if TYPE_CHECKING:  # which take their words from here
    from camtopod.records import (
        Alarm,
        DaemonStatus,
        InView,
        Look,
        Match,
        MatchedPassage,
        NextCamera,
        Prediction,
        Status,
        Topology,
    )

LIKELY = 0.5
"""A probability above this is likely: more than all else together."""
OUTCOMES_SAID = 3
"""Most outcomes of a prediction that are said in words."""
SHARE_SAID_MIN = 0.01
"""Least probability of an outcome that is said in words."""
SILENT_STATUSES = 2.5
"""Status intervals after which a sender is silent: two statuses are lost, not one that is late."""
SILENT_SECONDS_MIN = 5.0
"""Least silence that counts: a busy machine may send nothing for some seconds."""
OLD_SECONDS = 86_400.0
"""A day: event time after which a camera without a grabber is gone, an alarm is no longer open, and
a backlog is counted in days."""
AHEAD_SECONDS = 1.0
"""Time by which a camera's clock may be ahead without being said to be."""
TEXT_MAX = 500
"""Longest state or reason of a sender that is shown, characters."""
LEAVES = "leaves the site"
"""Place of an object that is not seen again, in words."""
UNKNOWN = "not known yet"
"""Place of an object of which nothing is known, in words."""
ELSEWHERE = "other program"
"""State of a camera whose events come without the status of a grabber."""

Appearance = Literal["good", "warn", "bad", "off"]
"""How a state is shown: fine, worth a look, needs attention, or nothing to say of it."""
_LOOKS: dict[str, Appearance] = {
    "running": "good",
    "ended": "off",
    "no grabber": "off",
    ELSEWHERE: "off",
    "gone": "off",
    "forgotten": "off",
}
"""How the states that need no attention are shown."""
STARTING = ("not opened yet", "not connected yet")
"""Reasons of a grabber that has just begun, and so needs no attention."""
ABSENT = ("gone", "forgotten")
"""States of cameras that are no longer there, which are listed last."""


class CameraState(Struct, frozen=True):
    """The state of a camera.

    state: of its grabber; or ``forgotten``, ``silent``, ``gone``, ``no grabber``, `ELSEWHERE`.
    reason: why, in words; "" if there is nothing to say.
    alive: True while its events can come.
    events: since the daemon's start; None if the daemon does not count them.
    newest (Unix seconds): event time of its newest event; None if unknown.
    has_grabber: True while a grabber makes its events, however well; a film's has ended.
    """

    id: str
    state: str
    reason: str
    look: Appearance
    alive: bool
    events: int | None
    newest: float | None
    has_grabber: bool = False


class DaemonState(Struct, frozen=True):
    """The state of the daemon.

    live: False if nothing has been heard of it for too long.
    words: its state, alarms, and cameras that need attention.
    """

    live: bool
    words: str
    reason: str
    look: Appearance


class AlarmWords(Struct, frozen=True):
    """An alarm in words.

    title: what has changed. open: whether it still needs attention (`alarms_in_words`).
    """

    title: str
    subject: str
    detail: str
    version: int
    t: float
    open: bool


class Headline(Struct, frozen=True):
    """What is said of a prediction.

    place: the camera that is named first, `LEAVES` or `UNKNOWN`, which are no ids of cameras.
    probability: of that.
    words: the likeliest outcomes.
    """

    place: str
    probability: float
    words: str


def present_of(now: float, newest: float) -> float:
    """Return the moment from which a site's times are counted, Unix seconds.

    It is ``now``, or, if the newest event is older than `OLD_SECONDS`, the time of that event:
    probably a recording is played.

    newest: -infinity if there is no event.
    """
    return newest if OLD_SECONDS <= now - newest < math.inf else now


# --- states


def silent_after(status: Status, daemon: Status) -> float:
    """Return the time (seconds) without a status after which its sender is silent.

    It is of the sender's own status interval; of one that does not say it, the daemon's.
    """
    interval = status.status_seconds or daemon.status_seconds or 0.0
    return max(SILENT_STATUSES * interval, SILENT_SECONDS_MIN)


def camera_states(
    daemon: DaemonStatus,
    grabbers: Mapping[str, tuple[Status, float]],
    topology: Topology | None,
    last_events: Mapping[str, float],
) -> list[CameraState]:
    """Return the state of each known camera, those that need attention first.

    grabbers: newest status of each camera, and the seconds since it was received.
    topology: the newest version.
    last_events: by camera, the time of its last event that was learned, Unix seconds.

    A forgotten camera is forgotten, whatever its grabber says: it was removed on purpose, so it is
    neither trouble nor fine; nothing is left of it once its grabber is silent. A grabber that has
    said nothing for `silent_after` is silent, unless it had ended: a film has nothing more to say.
    A camera without a grabber that works is gone after `OLD_SECONDS`, so that what was removed
    needs no attention for ever; if it has events, it is one of another program. All other states
    are the grabber's word: it needs attention unless it runs, has ended or has just begun. A camera
    that is there needs attention, too, while an alarm of it is open.
    """
    # Event time of each camera's newest event.
    newest: dict[str, float | None] = dict.fromkeys(grabbers)
    if topology is not None:
        newest |= {camera.id: last_events.get(camera.id) for camera in topology.cameras}
    for name, figures in daemon.cameras.items():  # counted since its start, perhaps of a backlog
        newest[name] = max(filter(None, (newest.get(name), figures.newest)), default=None)
    last = max([topology.as_of if topology else 0.0, *filter(None, newest.values())])
    alarms = {alarm.subject: alarm for alarm in alarms_in_words(topology) if alarm.open}

    silent = {
        name
        for name, (status, quiet) in grabbers.items()
        if status.state != "ended" and quiet > silent_after(status, daemon)
    }
    removed_names = daemon.names.forgotten.keys() - (grabbers.keys() - silent)
    states = []
    for name in newest.keys() - removed_names:
        t = newest[name]
        status = grabbers[name][0] if name in grabbers else None
        counts = daemon.cameras.get(name)
        is_old = t is not None and last - t > OLD_SECONDS
        state, reason = _state_of(name, daemon, status, name in silent, is_old)
        look: Appearance = "off" if reason in STARTING else _LOOKS.get(state, "bad")
        reasons = [reason]
        if counts is not None and (counts.ahead or 0.0) > AHEAD_SECONDS:
            reasons.append(f"clock {counts.ahead:.0f} s ahead")
        if name in alarms and state not in ABSENT:
            look = "bad"
            reasons.append(f"{alarms[name].title}: {alarms[name].detail}")
        is_there = counts.alive if counts is not None else status is not None
        states.append(
            CameraState(
                name,
                state,
                "; ".join(filter(None, reasons)),
                look,
                is_there and name not in silent and state not in ABSENT,
                None if counts is None else counts.events,
                t,
                status is not None and state not in (ELSEWHERE, "no grabber", "ended", *ABSENT),
            )
        )
    return sorted(states, key=lambda state: (state.look != "bad", state.state in ABSENT, state.id))


def _state_of(
    name: str, daemon: DaemonStatus, status: Status | None, is_silent: bool, is_old: bool
) -> tuple[str, str]:
    """Return state and reason of a camera by the rules of `camera_states`."""
    if name in daemon.names.forgotten:
        return "forgotten", f"its events are refused until `camtopod forget --take-back {name}`"
    figures = daemon.cameras.get(name)
    is_there = figures is not None and figures.alive
    if status is None or not status.state:
        if is_there or (figures is not None and figures.events and not is_old):
            return ELSEWHERE, ""
        return "gone" if is_old else "no grabber", ""
    if is_silent and is_old:
        return "gone", ""
    if is_silent:
        seconds = silent_after(status, daemon)
        return "silent", f"no status from its grabber for more than {seconds:.0f} s"
    present = daemon.names.renamed.get(name)
    reason = status.reason or (f"counts as {present}" if present else "")
    return status.state[:TEXT_MAX], reason[:TEXT_MAX]


def daemon_state(
    status: DaemonStatus,
    quiet: float,
    cameras: Sequence[CameraState] = (),
    alarms: Sequence[AlarmWords] = (),
    away: str = "",
) -> DaemonState:
    """Return the state of the daemon.

    status: its newest status; an empty one if none has been received.
    quiet: seconds since it was received.
    away: why nothing can be heard of the daemon; "" if it can.

    A daemon that is not heard of (`silent_after`) is silent, whatever it said last. One that
    works is good only if nothing on its site needs attention: a degraded daemon and cameras
    that need attention are bad, open alarms and its warnings are worth a look. While it catches
    up, what it says is old, so it is neither good nor bad.
    """
    if not (away or status.state):
        away = "no status of the daemon has been received yet"
    elif not away and quiet > (seconds := silent_after(status, status)):
        away = f"no status from the daemon for more than {seconds:.0f} s"
    if away:
        return DaemonState(False, "silent", away, "bad")

    words = [status.state[:TEXT_MAX]]
    reasons = [status.reason[:TEXT_MAX], *status.warnings]
    if (behind := status.catching_up) is not None:
        words.append(f"catching up, {100 * min(max(0.0, behind.share), 1.0) // 1:.0f} %")
        reasons.append(f"{behind.seconds / 60:.0f} minutes behind")
    if alarmed := sum(alarm.open for alarm in alarms):
        words.append(counted(alarmed, "alarm"))
    if ill := sum(camera.look == "bad" for camera in cameras):
        words.append(f"{counted(ill, 'camera needs', 'cameras need')} attention")
    looks: dict[Appearance, object] = {
        "bad": ill or status.state != "running",
        "warn": alarmed or status.warnings,
        "off": behind,
        "good": True,
    }
    look = next(look for look, applies in looks.items() if applies)
    return DaemonState(True, ", ".join(words), "; ".join(filter(None, reasons)), look)


def counted(number: int, noun: str, nouns: str = "") -> str:
    """Return "1 camera", "2 cameras" and so on."""
    return f"{number} {noun if number == 1 else nouns or f'{noun}s'}"


# --- alarms


def alarm_title(alarm: Alarm) -> str:
    """Return what an alarm says has changed: ``link closed lobby/1 → hall/2``."""
    return f"{alarm.kind.replace('_', ' ')} {alarm.subject.replace('->', ' → ')}"


def alarms_in_words(topology: Topology | None) -> list[AlarmWords]:
    """Return the alarms of a version, newest first.

    An alarm is open for `OLD_SECONDS` unless the same subject has a later one, as alarms are
    not closed by hand; that a camera is back is news, but nothing to look after.
    """
    if topology is None:
        return []
    alarms = topology.alarms or []
    latest = {alarm.subject: alarm for alarm in alarms}
    return [
        AlarmWords(
            alarm_title(alarm),
            alarm.subject,
            alarm.detail,
            alarm.version,
            alarm.t,
            latest[alarm.subject] is alarm
            and alarm.kind != "camera_back"
            and topology.as_of - alarm.t < OLD_SECONDS,
        )
        for alarm in reversed(alarms)
    ]


# --- predictions


def when(row: NextCamera) -> str:
    """Return when an object appears, in words; where views overlap it may have done so already.

    Times that were not measured are not given as if they were.
    """
    if row.prior:
        return "no times known yet"
    if row.q90 < 0.5:
        return "in view now"
    if row.q10 < 0:
        return f"within {row.q90:.0f} s"
    return f"in {row.q10:.0f} to {row.q90:.0f} s"


def headline(prediction: Prediction) -> Headline:
    """Return what is said of a prediction: its likeliest outcomes, the first as the headline.

    An outcome is stated as a fact only if it is `LIKELY`. Otherwise the headline is the likeliest
    camera, which is the place to look at: "most likely" if no outcome is
    likelier, "perhaps" if leaving the site is. Who is likely in view now comes before all that may
    follow "otherwise". Leaving is left out where it is not learned yet whether objects do.
    """
    outcomes = _outcomes(prediction)
    is_unknown = prediction.prior or prediction.zone is None
    if is_unknown:
        outcomes = [outcome for outcome in outcomes if outcome.place != LEAVES]
    if not outcomes or (is_unknown and prediction.leave > LIKELY >= outcomes[0].probability):
        return Headline(UNKNOWN, prediction.leave, UNKNOWN)

    hedge = ""
    if outcomes[0].probability <= LIKELY:
        hedge = "most likely "
        if outcomes[0].place == LEAVES and outcomes[1:]:
            hedge = "perhaps "
            outcomes[:2] = reversed(outcomes[:2])
    words = [outcome.words for outcome in outcomes[:OUTCOMES_SAID]]
    views = len(seen_now(prediction))
    if 0 < views < len(words):  # the probabilities of what follows are no part of theirs
        words[views] = f"otherwise {words[views]}"
    return replace(outcomes[0], words=hedge + "; ".join(words))


def origin(match: Match) -> str:
    """Return the entry, and the cameras that its object may have come from, likeliest first."""
    entry = match.camera if match.track is None else f"{match.camera}, track {match.track}"
    cameras = sum_by_camera(match.from_)
    shares = [(match.new, "new"), *((cameras[name], f"from {name}") for name in cameras)]
    shares.sort(key=lambda share: -share[0])
    said = [f"{text} {100 * share:.0f} %" for share, text in shares if share >= SHARE_SAID_MIN]
    return f"{entry}: {'; '.join(said[:OUTCOMES_SAID])}"


def _outcomes(prediction: Prediction) -> list[Headline]:
    """Return the outcomes that are said, likeliest first, but who is in view now before all.

    The probabilities are the prediction's own: those of ``in_view``, of ``next`` and of leaving.
    """
    views = seen_now(prediction)
    shares = sum_by_camera(prediction.next) | {LEAVES: prediction.leave}
    outcomes = []
    for place, share in (shares | views).items():
        words = f"{place} {100 * share:.0f} %"
        if place == prediction.camera:
            words = f"back to {words}"
        if place in views:
            words += ", in view now"
        elif place != LEAVES:
            rows = [row for row in prediction.next if row.camera == place]
            words += f", {when(min(rows, key=lambda row: row.prior))}"
        if share >= SHARE_SAID_MIN:
            outcomes.append(Headline(place, share, words))
    return sorted(outcomes, key=lambda outcome: (outcome.place not in views, -outcome.probability))


def seen_now(prediction: Prediction) -> dict[str, float]:
    """Return the cameras that are likely to see the object now, with the probabilities."""
    shares = sum_by_camera(prediction.in_view or [])
    return {camera: min(share, 1.0) for camera, share in shares.items() if share > LIKELY}


def sum_by_camera(rows: Iterable[NextCamera | InView | Look | MatchedPassage]) -> dict[str, float]:
    """Return the sum of the probabilities by camera."""
    shares: dict[str, float] = defaultdict(float)
    for row in rows:
        shares[row.camera] += row.probability
    return dict(shares)
