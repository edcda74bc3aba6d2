"""Snapshots: the complete state of a learner as bytes (`pack`), and back (`unpack`).

A restored learner makes the same versions as one that never stopped. So the state (`LearnerState`)
has everything that affects later versions, including events that wait for the watermark and
predictions that wait for their outcome. It leaves out values that can be computed from others (keys
and indices). Floats and integers are preserved exactly.
"""

from __future__ import annotations

import zlib
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct, field

from camtopod.learn.association import FollowedSources
from camtopod.learn.changes import AlarmState, Move
from camtopod.learn.clocks import ClockState
from camtopod.learn.self_score import ScorerState
from camtopod.learn.settings import Settings
from camtopod.learn.window import ReorderBufferState, WindowState
from camtopod.learn.zones import ZoneMap, ZoneShape
from camtopod.publishers import CameraBoots
from camtopod.records import Topology

FORMAT = 8
"""Format of the snapshots that this program reads and writes. Snapshots of another format are
refused; the state is learned again from the journal.
"""
BYTES_MAX = 1 << 30
"""Largest size of an uncompressed snapshot in bytes; a snapshot that unpacks to more is damaged."""


class SnapshotError(ValueError):
    """The bytes are not a snapshot that this program can read; ``str()`` gives the reason."""


class NewerSnapshot(SnapshotError):
    """The snapshot was written by a newer program."""


class LearnedCamera(Struct):
    """State that a `Learner` has of one camera: its zones, and when they were updated."""

    zones: ZoneMap
    """The camera's zones."""
    zoned_at: int
    """Number of the camera's positioned events so far when its zones were last learned."""
    vanished: tuple[ZoneShape, ...]
    """Zones that have vanished, latest first."""
    tested_at: int
    """Number of its positioned events so far when it was last tested for having been turned."""


class RetiredCamera(Struct):
    """State that is kept of a retired camera: its zones, and the next free zone number."""

    zones: tuple[ZoneShape, ...] = ()
    next_number: int = 1


class LearnerState(Struct):
    """Complete state of a `Learner`."""

    settings: Settings
    site: str
    epoch: str
    topology: Topology | None = None
    """The newest version; None before the first one of the epoch."""
    intake: ReorderBufferState = field(default_factory=ReorderBufferState)
    window: WindowState = field(default_factory=WindowState)
    clocks: ClockState = field(default_factory=ClockState)
    alarms: AlarmState = field(default_factory=AlarmState)
    scorer: ScorerState = field(default_factory=ScorerState)
    cameras: list[LearnedCamera] = []
    """State of each camera, by index in the window."""
    moved: list[tuple[int, float, Move]] = []
    """Cameras turned since the last version: index, time in seconds, move."""
    done_us: int | None = None
    """Last processed tick, microseconds."""
    fitted_us: int | None = None
    """Tick of the newest version, microseconds."""
    learned: int = 0
    """Number of events learned so far."""
    since_fit: int = 0
    """Number of events learned since the newest version."""
    followed: dict[int, FollowedSources] = {}
    """Zones of departure that screening follows, by `place` of the zone of arrival."""
    publishers: dict[str, CameraBoots] = {}
    """Programs that publish each camera."""
    doubled: list[str] = []
    """Cameras found to have two publishers since the last version."""
    retired: dict[str, RetiredCamera] = {}
    """Retired cameras, the one retired last at the end."""
    names: dict[str, str] | None = None
    """Old names of renamed cameras -> present ones, and forgotten names -> "", by which
    declarations are read; None: an older program, which had none.
    """


class _Snapshot(Struct):
    """The outer layer of a snapshot, which can be read whatever the format of the state is."""

    format: int
    state: msgspec.Raw


def pack(state: LearnerState) -> bytes:
    """Return a learner's state as compressed bytes."""
    raw = msgspec.Raw(_encoder.encode(state))
    return zlib.compress(_encoder.encode(_Snapshot(FORMAT, raw)), zlib.Z_BEST_SPEED)


def unpack(blob: bytes) -> LearnerState:
    """Return a learner's state from bytes made by `pack`.

    Raise `SnapshotError` if the bytes are damaged, `NewerSnapshot` if a newer program wrote them.
    """
    try:
        inflater = zlib.decompressobj()
        plain = inflater.decompress(blob, BYTES_MAX)
        if not inflater.eof:
            raise SnapshotError("the snapshot is cut short or too large")
        outer = msgspec.msgpack.decode(plain, type=_Snapshot)
        formats = f"its format is {outer.format}, this program's {FORMAT}"
        if outer.format > FORMAT:
            raise NewerSnapshot(formats)
        if outer.format < FORMAT:
            raise SnapshotError(formats)
        state: LearnerState = _decoder.decode(outer.state)
    except SnapshotError:
        raise
    except (zlib.error, msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise SnapshotError(str(error)) from None
    return state


def _encode_array(array: object) -> tuple[str, tuple[int, ...], bytes]:
    """Encode a value that msgspec does not know as type, shape and bytes: always an array."""
    if not isinstance(array, np.ndarray):
        raise NotImplementedError(f"{type(array)} cannot be stored in a snapshot")
    return array.dtype.str, array.shape, array.tobytes()


def _decode_array(kind: type, fields: Any) -> np.ndarray[Any, Any]:
    """Decode a field whose type msgspec does not know: always an array."""
    dtype, shape, data = msgspec.convert(fields, tuple[str, tuple[int, ...], bytes])
    try:
        return np.frombuffer(data, np.dtype(dtype)).reshape(shape).copy()
    except TypeError as error:
        raise SnapshotError(str(error)) from None


_encoder = msgspec.msgpack.Encoder(enc_hook=_encode_array)
_decoder = msgspec.msgpack.Decoder(LearnerState, dec_hook=_decode_array)
