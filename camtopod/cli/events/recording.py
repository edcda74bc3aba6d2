"""The events of a recording: in order of time, each once, without stamps that are wrong.

A recording is known to its end, so no event of it is late. What is wrong with its times as a whole
(`fault_of`) is seen by their span and their digits, not by their size: they may count from 0.
"""

from __future__ import annotations

import heapq
import math
import shutil
import tempfile
from array import array
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from io import BufferedReader
from typing import cast

from msgspec import Struct, field

from camtopod.cli.events.event_lines import Line, LineReader, messages, open_input
from camtopod.cli.events.time_order import by_key, sorting, sorting_failure
from camtopod.codec import event_from_msgpack, stamp_of, to_msgpack
from camtopod.event_numbers import EventNumbers
from camtopod.event_time import utc_text
from camtopod.records import Event

DAY = 86_400.0
"""Difference from the lines around it from which a stamp is wrong, in seconds."""
WRONG_IN_A_ROW_MAX = 3
"""Most wrong stamps of a camera in a row; more are another part of the recording."""
HOUR = 3_600.0
"""Difference of a camera's neighbouring lines from which it is a step of time, in seconds."""
DISORDER_MAX = 0.02
"""Largest share of a camera's lines with a step against the direction of the others.

Beyond that the lines are in no order, and those around a line say nothing about it.
"""
LONELY_MAX = 0.1
"""Largest share of lines with no other within a day, for those at either end to be wrong."""
SAME_SECONDS = 1e-6
"""Difference of two times below which they are the same: a time has microseconds."""
FAULT_EVENTS_MIN = 50
"""Least number of events whose times are judged together."""
FAULT_RATE = 5.0
"""Events per second and camera that no camera has over a whole recording."""
FAULT_STEP = 20.0
"""Whole minutes and hundreds of seconds are multiples of it, in seconds."""


class _Course(Struct):
    """The times of one camera's lines, in the order of a file."""

    last: float
    """Time of the last line, of those that are not in ``outliers``."""
    lines: int = 0
    rises: int = 0
    falls: int = 0
    """Number of steps of more than `HOUR` between lines that are right."""
    outliers: list[tuple[int, float]] = field(default_factory=list)
    """Number and time of the last lines, if they are more than a day from those before."""
    wrong: list[int] = field(default_factory=list)
    """Numbers of lines that those before and after them contradict."""

    def turn(self, number: int, t: float) -> None:
        """Take a line after a step, or after outliers."""
        if abs(t - self.last) <= DAY:
            self.wrong += [number for number, _ in self.outliers]
            self.outliers = []
            self._move(t)
        elif self.outliers and abs(t - self.outliers[-1][1]) > DAY:
            self._move(self.outliers[-1][1])
            self.outliers = [(number, t)]
        elif len(self.outliers) < WRONG_IN_A_ROW_MAX:
            self.outliers.append((number, t))
        else:
            self.outliers = []
            self._move(t)

    def is_ordered(self) -> bool:
        """Return True if the lines around a line tell something about its time."""
        return min(self.rises, self.falls) <= DISORDER_MAX * self.lines

    def _move(self, t: float) -> None:
        self.rises += t > self.last + HOUR
        self.falls += t < self.last - HOUR
        self.last = t


class _Survey:
    """What is to be known of files before their lines are used."""

    def __init__(self) -> None:
        self.cameras = Counter[str]()
        """Number of lines."""
        self._hours = Counter[float]()

    def look(self, path: str, file: BufferedReader) -> tuple[bool, set[int]]:
        """Read a file; return whether it is in order of time, and the numbers of wrong lines."""
        newest = -math.inf
        is_ordered = True
        courses: dict[str, _Course] = {}
        hour = math.nan
        hour_lines = 0
        for number, text in messages(path, file):
            stamp = stamp_of(text) if isinstance(text, bytes) else None
            if stamp is None:
                continue
            camera, t = stamp
            if t < newest:
                is_ordered = False
            newest = t
            if t // HOUR == hour:
                hour_lines += 1
            else:
                self._hours[hour] += hour_lines
                hour, hour_lines = t // HOUR, 1
            course = courses.get(camera)
            if course is None:
                course = courses[camera] = _Course(t)
            elif course.outliers or not -HOUR <= t - course.last <= HOUR:
                course.turn(number, t)
            else:
                course.last = t
            course.lines += 1
        self._hours[hour] += hour_lines
        wrong: set[int] = set()
        for camera, course in courses.items():
            self.cameras[camera] += course.lines
            if course.is_ordered():
                wrong.update(course.wrong)
        return is_ordered, wrong

    def lonely_hours(self) -> set[float]:
        """Return the hours at either end with one line, more than a day from all other lines."""
        lines = +self._hours
        hours = [-math.inf, *sorted(lines), math.inf]
        lonely = {
            hour
            for before, hour, after in zip(hours, hours[1:], hours[2:], strict=False)
            if lines[hour] == 1 and min(hour - before, after - hour) > DAY / HOUR
        }
        together = lines.keys() - lonely
        if not together or len(lonely) > LONELY_MAX * lines.total():
            return set()
        first, last = min(together), max(together)
        return {hour for hour in lonely if not first < hour < last}


class Times(Struct):
    """The times of a recording together."""

    first: float = math.inf
    last: float = -math.inf
    events: int = 0
    moments: int = 0
    """Number of different times."""
    cameras: set[str] = field(default_factory=set)
    are_coarse: bool = True
    """All are multiples of `FAULT_STEP`."""


def recorded(reader: LineReader, paths: Sequence[str], times: Times) -> Iterator[Line]:
    """Yield the lines of a recording, several files maybe, by event time; ``-`` is standard input.

    times: has the times in the end.

    Repeats are counted, and left out. A stamp that its camera's lines around it contradict by more
    than a day, while they agree with each other, is rejected. Raises `InputError` if a file cannot
    be read, and `CommandError` if the disk is full.
    """
    with ExitStack() as stack:
        survey = _Survey()
        files = [(path, stack.enter_context(_known_to_its_end(path))) for path in paths]
        reader.files = [file for _, file in files]
        streams = []
        for path, file in files:
            begin = file.tell()
            is_ordered, wrong = survey.look(path, file)
            file.seek(begin)
            streams.append(_by_time(reader, path, file, is_ordered, wrong))
        lines = heapq.merge(*streams, key=_time) if len(streams) > 1 else streams[0]
        yield from _once(reader, survey, lines, times)


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
    reader: LineReader, path: str, file: BufferedReader, is_ordered: bool, wrong: Collection[int]
) -> Iterator[Line]:
    """Yield the lines of one file by event time, without those that are wrong."""
    lines = reader.lines(path, file)
    if wrong:
        lines = (line for line in lines if not _set_aside(reader, line, wrong))
    if is_ordered:
        yield from lines
        return
    numbers = array("Q")

    def records() -> Iterator[tuple[float, bytes]]:
        for line in lines:
            numbers.append(line.number)
            yield line.event.t, to_msgpack(line.event)

    with sorting():
        for place, record in by_key(records()):
            yield Line(event_from_msgpack(record), path, numbers[place - 1])


def _set_aside(reader: LineReader, line: Line, wrong: Collection[int]) -> bool:
    """Reject a line if its number is one of those."""
    if line.number not in wrong:
        return False
    event = line.event
    reader.reject_event(
        "contradicted",
        f"{line.file}:{line.number}: t is {utc_text(event.t)}, which the lines of {event.camera} "
        "around it contradict by more than a day: it is set aside",
    )
    return True


def _time(line: Line) -> float:
    return line.event.t


def _once(
    reader: LineReader, survey: _Survey, lines: Iterator[Line], times: Times
) -> Iterator[Line]:
    """Yield lines in order of time, each event once, and sum their times up."""
    numbers: dict[str, EventNumbers] = {}
    first: Event | None = None  # of this moment
    keys: set[tuple[object, ...] | None] = set()  # of this moment, if it has several events
    until = -math.inf
    lonely = survey.lonely_hours()
    cameras = times.cameras
    for line in lines:
        event = line.event
        if event.t >= until:
            if lonely and event.t // HOUR in lonely and survey.cameras[event.camera] > 2:
                _set_aside(reader, line, (line.number,))
                continue
            if first is None:
                times.first = event.t
            first, until = event, event.t + SAME_SECONDS
            if keys:
                keys = set()
            times.moments += 1
            if times.are_coarse:
                times.are_coarse = event.t % FAULT_STEP == 0.0
        else:
            if not keys and first is not None:
                keys.add(_key(first))
            key = _key(event)
            if key is not None and key in keys:
                reader.repeat(line)
                continue
            keys.add(key)
        if event.boot is not None and event.seq is not None:
            of_camera = numbers.get(event.camera) or numbers.setdefault(
                event.camera, EventNumbers()
            )
            if not of_camera.add(event.boot, event.seq):
                reader.repeat(line)
                continue
        times.events += 1
        cameras.add(event.camera)
        yield line
    times.last = until - SAME_SECONDS


def _key(event: Event) -> tuple[object, ...] | None:
    """Return what a repeat of an event at the same time shares with it; None if nothing tells."""
    if event.track is not None:
        return event.camera, event.kind, event.track
    return None if event.x is None else (event.camera, event.kind, event.x, event.y)


def fault_of(times: Times) -> str | None:
    """Return a sentence if the times of a recording cannot be true; None if they may be."""
    span = times.last - times.first
    count = times.events
    if count < FAULT_EVENTS_MIN:
        return None
    if times.are_coarse and count >= 2 * times.moments:
        return (
            f"{count} events have {times.moments} different times, all of them rounded: a "
            "spreadsheet has shortened them (1.70E+09, or no seconds): save t with all its digits"
        )
    if count > FAULT_RATE * len(times.cameras) * span:
        return (
            f"{count} events lie within {span:.3g} s: t is in seconds; a spreadsheet counts days "
            "(45244.9): save t as seconds since 1970, or as text in ISO 8601"
        )
    return None
