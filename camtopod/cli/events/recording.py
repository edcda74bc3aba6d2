"""The events of a recording: in order of time, each once, without stamps that are wrong.

All of a recording is read before its first event is used, so no event is late. Faults of its times
as a whole (`fault_of`) show in their span and digits, not in their size: they may count from 0.
"""

from __future__ import annotations

import heapq
import itertools
import math
import shutil
import sys
import tempfile
from array import array
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from io import BufferedReader
from typing import cast

import numpy as np
from msgspec import Struct, field

from camtopod.cli import exits
from camtopod.cli.events.event_lines import Line, LineReader, messages, open_input
from camtopod.cli.events.time_order import by_key, sorting, sorting_failure
from camtopod.cli.exits import InputError
from camtopod.codec import event_from_json, event_from_msgpack, stamp_of, to_msgpack
from camtopod.event_numbers import EventNumbers
from camtopod.event_time import utc_text
from camtopod.records import Event, Topology

DAY = 86_400.0
"""Difference from the lines around it from which a stamp is wrong, in seconds."""
WRONG_IN_A_ROW_MAX = 3
"""Most wrong stamps of a camera in a row; more are another part of the recording."""
HOUR = 3_600.0
"""Difference of a camera's neighbouring lines from which it is a step of time, in seconds."""
CAMERAS_HELD = 10_000
"""Lines after which they are counted by camera."""
DISORDER_MAX = 0.02
"""Largest share of a camera's lines with a step against the direction of most.

Beyond that the lines are in no order, and those around a line say nothing about it.
"""
LONELY_MAX = 0.1
"""Share of lines with few others within a day from which those at either end are not wrong."""
SAME_SECONDS = 1e-3
"""Difference of two times below which they are the same: many programs write milliseconds."""
FAULT_EVENTS_MIN = 50
"""Least number of events whose times are judged together."""
STAMPS_MAX = 1_000_000
"""Most events whose times are kept to be judged, the first ones."""
CAMERAS_NAMED = 5
"""Most cameras that a message names."""
FOREIGN_SHARE_MAX = 0.9
"""Largest share of events of cameras that a topology of the same site does not have."""
FAULT_RATE = 50.0
"""Events per second and camera that no camera has over a whole recording."""
FAULT_STEP = 20.0
"""Whole minutes and hundreds of seconds are multiples of it, in seconds."""


class _Course(Struct):
    """The times of one camera's lines, in the order of a file."""

    last: float
    """Time of the last line, if it was a step, of those that are not in ``outliers``."""
    rises: int = 0
    falls: int = 0
    """Number of steps of more than `HOUR` between lines that are right."""
    outliers: list[tuple[int, float]] = field(default_factory=list)
    """Place and time of the last lines, if they are more than a day from those before."""
    wrong: list[int] = field(default_factory=list)
    """Places of lines that those before and after them contradict."""

    def turn(self, place: int, t: float, latest: float) -> float:
        """Take a line after a step, or after outliers; return its time, NaN for an outlier.

        latest: time of the line before; NaN after an outlier.
        """
        if not self.outliers:
            self.last = latest
        if abs(t - self.last) <= DAY:
            self.wrong += [place for place, _ in self.outliers]
            self._move(t)
        elif self.outliers and abs(t - self.outliers[-1][1]) > DAY:
            self._move(self.outliers[-1][1])
            self.outliers = [(place, t)]
            return math.nan
        elif len(self.outliers) < WRONG_IN_A_ROW_MAX:
            self.outliers.append((place, t))
            return math.nan
        else:
            self._move(t)
        return t

    def is_ordered(self, lines: int) -> bool:
        """Return True if the camera's ``lines`` (a number) are mostly in order of time."""
        return min(self.rises, self.falls) <= DISORDER_MAX * lines

    def _move(self, t: float) -> None:
        self.rises += t > self.last + HOUR
        self.falls += t < self.last - HOUR
        self.last, self.outliers = t, []


class Survey:
    """Survey of files before their lines are used."""

    def __init__(self) -> None:
        self.cameras = Counter[str]()
        """Number of lines with a time."""
        self._hours = Counter[float]()

    def look(self, path: str, file: BufferedReader) -> tuple[bool, set[int]]:
        """Read a file; return whether it is in order of time, and the places of wrong lines."""
        newest = -math.inf
        is_ordered = True
        courses: dict[str, _Course] = {}
        latest: dict[str, float] = {}  # time of a camera's last line; NaN after an outlier
        cameras: list[str] = []
        hour_begin = hour_end = math.inf
        hour_lines = 0
        for place, (_, text) in enumerate(messages(path, file)):
            stamp = stamp_of(text) if isinstance(text, bytes) else None
            if stamp is None:
                continue
            camera, t = stamp
            is_ordered = is_ordered and t >= newest
            newest = t
            if hour_begin <= t < hour_end:
                hour_lines += 1
            else:
                self._hours[hour_begin // HOUR] += hour_lines
                hour_begin = t // HOUR * HOUR
                hour_end, hour_lines = hour_begin + HOUR, 1
            if -HOUR <= t - latest.get(camera, math.nan) <= HOUR:
                latest[camera] = t
            elif camera in courses:
                latest[camera] = courses[camera].turn(place, t, latest[camera])
            else:
                courses[camera] = _Course(t)
                latest[camera] = t
            cameras.append(camera)
            if len(cameras) == CAMERAS_HELD:
                self.cameras.update(cameras)
                cameras = []
        self._hours[hour_begin // HOUR] += hour_lines
        self.cameras.update(cameras)
        wrong: set[int] = set()
        for camera, course in courses.items():
            if course.is_ordered(self.cameras[camera]):
                wrong.update(course.wrong)
        return is_ordered, wrong

    def lonely_hours(self) -> set[float]:
        """Return the hours at either end with few lines, more than a day from all other lines."""
        lines = +self._hours  # without the hour before the first line
        parts: list[list[float]] = []
        for hour in sorted(lines):
            if not parts or hour - parts[-1][-1] > DAY / HOUR:
                parts.append([])
            parts[-1].append(hour)
        counts = [sum(lines[hour] for hour in part) for part in parts]
        lonely = [count <= WRONG_IN_A_ROW_MAX for count in counts]
        if sum(itertools.compress(counts, lonely)) >= LONELY_MAX * lines.total():
            return set()
        first, end = lonely.index(False), len(parts) - lonely[::-1].index(False)
        return {hour for part in (*parts[:first], *parts[end:]) for hour in part}


class Times:
    """The times of a recording together, of its first `STAMPS_MAX` events."""

    def __init__(self) -> None:
        self.stamps = array("d")
        """Seconds, as the events came."""
        self.cameras: set[str] = set()

    def add(self, event: Event) -> None:
        """Take an event into account."""
        if len(self.stamps) < STAMPS_MAX:
            self.stamps.append(event.t)
            self.cameras.add(event.camera)


def recorded(reader: LineReader, paths: Sequence[str], times: Times) -> Iterator[Line]:
    """Yield the lines of a recording, several files maybe, by event time; ``-`` is standard input.

    times: has the times in the end.

    Repeats are counted, and left out, except those that only their numbers tell (`once_by_number`).
    A stamp that its camera's lines around it contradict by more than a day, while they agree with
    each other, is rejected. Raises `InputError` if a file cannot be read, and `CommandError` if the
    disk is full.
    """
    if list(paths).count("-") > 1:
        raise InputError("standard input ('-') can be read once only")
    with ExitStack() as stack:
        survey = Survey()
        files = [(path, stack.enter_context(_known_to_its_end(path))) for path in paths]
        reader.files = [file for _, file in files]
        streams = []
        for path, file in files:
            begin = file.tell()
            is_ordered, wrong = survey.look(path, file)
            file.seek(begin)
            streams.append(_by_time(reader, path, file, survey, is_ordered, wrong))
        lines = (
            heapq.merge(*streams, key=lambda line: line.event.t) if len(streams) > 1 else streams[0]
        )
        yield from _once(reader, lines, times)


def recorded_as_written(
    reader: LineReader, path: str, file: BufferedReader, times: Times, set_aside: Counter[str]
) -> Iterator[Event]:
    """Yield the events of one file, as `recorded` does, but in the order of its lines.

    set_aside: has the number of lines of each camera up to here whose stamps are wrong. A program
        that numbers the events counts these, too: only a file that has grown shows that its last
        stamps were wrong, and the other events keep their numbers.
    """
    survey = Survey()
    begin = file.tell()
    is_ordered, wrong = survey.look(path, file)
    file.seek(begin)
    if is_ordered:
        right = right_lines(reader, path, file, survey, wrong, set_aside)
        yield from (line.event for line in _once(reader, right, times))
        return
    is_used = bytearray()  # by the place of the line
    for line in _once(reader, _by_time(reader, path, file, survey, is_ordered, wrong), times):
        is_used.extend(bytes(max(0, line.place + 1 - len(is_used))))
        is_used[line.place] = True
    file.seek(begin)
    for place, (_, text) in enumerate(messages(path, file)):
        if isinstance(text, bytes) and place in wrong and (stamp := stamp_of(text)):
            set_aside[stamp[0]] += 1
        elif isinstance(text, bytes) and place < len(is_used) and is_used[place]:
            yield event_from_json(text, lambda error: None)  # labels were counted before


@contextmanager
def _known_to_its_end(path: str) -> Iterator[BufferedReader]:
    """Open a file; of a pipe, a copy on disk. Raises `InputError`, `CommandError`."""
    with open_input(path) as file:
        if file.seekable():
            yield file
            return
        with tempfile.TemporaryFile() as copy:
            try:
                shutil.copyfileobj(file, copy)
                copy.seek(0)
            except OSError as error:
                raise sorting_failure(error) from None
            yield cast(BufferedReader, copy)


def _by_time(
    reader: LineReader,
    path: str,
    file: BufferedReader,
    survey: Survey,
    is_ordered: bool,
    wrong: set[int],
) -> Iterator[Line]:
    """Yield the lines of one file by event time, without those that are wrong."""
    lines = right_lines(reader, path, file, survey, wrong)
    if is_ordered:
        yield from lines
        return
    numbers, places = array("Q"), array("Q")

    def records() -> Iterator[tuple[float, bytes]]:
        for line in lines:
            numbers.append(line.number)
            places.append(line.place)
            yield line.event.t, to_msgpack(line.event)

    with sorting():
        for nth, record in by_key(records()):
            yield Line(event_from_msgpack(record), path, numbers[nth - 1], places[nth - 1])


def right_lines(
    reader: LineReader,
    path: str,
    file: BufferedReader,
    survey: Survey,
    wrong: set[int],
    set_aside: Counter[str] | None = None,
) -> Iterator[Line]:
    """Yield the lines of a file, in its order, without those whose stamps are wrong.

    survey: of all files of the recording.
    wrong: places of lines of this file, as `Survey.look` returns them; those of lonely lines come
        in addition.
    set_aside: has the number of these lines of each camera up to here.
    """
    lonely = survey.lonely_hours()
    for line in reader.lines(path, file):
        event = line.event
        # Or lonely, of a camera most of whose lines are elsewhere.
        if line.place in wrong or (
            lonely and event.t // HOUR in lonely and survey.cameras[event.camera] > 2 * len(lonely)
        ):
            wrong.add(line.place)
            if set_aside is not None:
                set_aside[event.camera] += 1
            reader.reject_event(
                "contradicted",
                f"{path}:{line.number}: t is {utc_text(event.t)}, which the lines of "
                f"{event.camera} around it contradict by more than a day: it is set aside",
            )
        else:
            yield line


def _once(reader: LineReader, lines: Iterator[Line], times: Times) -> Iterator[Line]:
    """Yield lines in order of time, each event once, and sum their times up."""
    # Times by what repeats share, for a moment of `SAME_SECONDS` and the one before.
    times_of: dict[tuple[object, ...] | None, float] = {}
    earlier_times_of = times_of
    until = -math.inf
    for line in lines:
        t = line.event.t
        if t >= until:
            earlier_times_of, times_of, until = times_of, {}, t + SAME_SECONDS
        key = _key(line.event)
        if key is not None:
            if t - times_of.get(key, earlier_times_of.get(key, -math.inf)) < SAME_SECONDS:
                reader.repeat(line)
                continue
            times_of[key] = t
        times.add(line.event)
        yield line


def once_by_number(reader: LineReader, lines: Iterable[Line]) -> Iterator[Line]:
    """Yield lines without events that have the boot and seq of an earlier one.

    The learner does the same by itself.
    """
    numbers: defaultdict[str, EventNumbers] = defaultdict(EventNumbers)
    for line in lines:
        boot, seq = line.event.boot, line.event.seq
        if boot is None or seq is None or numbers[line.event.camera].add(boot, seq):
            yield line
        else:
            reader.repeat(line)


def timed(events: Iterable[Event], times: Times) -> Iterator[Event]:
    """Yield the events of a recording, in any order, and take their times into account."""
    for event in events:
        times.add(event)
        yield event


def _key(event: Event) -> tuple[object, ...] | None:
    """Return the value that repeats of an event at its time share; None if there is none."""
    if event.track is not None:
        return event.camera, event.kind, event.track
    return None if event.x is None else (event.camera, event.kind, event.x, event.y)


def fault_of(times: Times) -> str | None:
    """Return a sentence if the times of a recording cannot be true; None if they may be."""
    count = len(times.stamps)
    if count < FAULT_EVENTS_MIN:
        return None
    moments = np.unique(times.stamps)
    if count >= 2 * len(moments) and not (moments % FAULT_STEP).any():
        return (
            f"{count} events have {len(moments)} different times, all of them rounded: a "
            "spreadsheet has shortened them (1.70E+09, or no seconds): save t with all its digits"
        )
    span = moments[-1] - moments[0]
    if count > FAULT_RATE * len(times.cameras) * span:
        return (
            f"{count} events lie within {span:.3g} s: t is in seconds; a spreadsheet counts days "
            "(45244.9): save t as seconds since 1970, or as text in ISO 8601"
        )
    return None


def cameras_in_words(names: Sequence[str]) -> str:
    """Return the names of cameras for a message, of many the first `CAMERAS_NAMED`."""
    return ", ".join([*names[:CAMERAS_NAMED], *["..."] * (len(names) > CAMERAS_NAMED)])


def foreign_cameras(path: str, topology: Topology, events: Counter[str]) -> int:
    """Say which cameras of the events the topology of ``path`` does not have, if there are any.

    events: number of events of each camera.

    Returns the exit status: `exits.FAILED` if hardly any event of a recording is of another one.
    """
    absent = sorted(events.keys() - {camera.id for camera in topology.cameras})
    count = sum(events[camera] for camera in absent)
    if absent:
        print(
            f"camtopod: {count} of {events.total()} events are of cameras that {path} does not "
            f"have ({cameras_in_words(absent)}): is it of another site, or older?",
            file=sys.stderr,
        )
    is_of_another_site = count > FOREIGN_SHARE_MAX * max(events.total(), FAULT_EVENTS_MIN)
    return exits.FAILED if is_of_another_site else exits.DONE
