"""Snapshots: the complete state of a learner as bytes, and back.

A restored learner makes the same versions as one that never stopped. The snapshot leaves out what
can be derived (sums of the window, keys, indices). It holds everything that affects later versions,
including events that wait for the watermark and predictions that wait for their outcome. Floats and
integers are preserved exactly.
"""

from __future__ import annotations

import zlib
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct

from camtopod.learn.association import FollowedSources
from camtopod.learn.changes import AlarmState, Move
from camtopod.learn.clocks import ClockState
from camtopod.learn.self_score import ScorerState
from camtopod.learn.settings import Settings
from camtopod.learn.window import ReorderBufferState, WindowState
from camtopod.learn.zones import ZoneMap, ZoneShape
from camtopod.publishers import Publisher
from camtopod.records import Topology

FORMAT = 1
"""Format of a snapshot; a higher number is refused. There is no lower one yet: a change that raises
it must migrate from this one.
"""
BYTES_MAX = 1 << 30
"""Largest size of an uncompressed snapshot, bytes. One that unpacks to more is damaged."""
_COMPRESSION = 1


class SnapshotError(ValueError):
    """The bytes are not a snapshot that this program can read; ``str()`` gives the reason."""


class NewerSnapshot(SnapshotError):
    """The snapshot was written by a newer program."""


class CameraState(Struct):
    """State of one camera's zones, see `Learner`."""

    zones: ZoneMap
    zoned: int
    """Positioned events of the camera when its zones were last learned."""
    gone: tuple[ZoneShape, ...]
    """Zones that have vanished, latest first."""
    looked: int
    """Positioned events of the camera when it was last tested for a move."""


class RetiredCamera(Struct):
    """State kept of a camera that was retired: its zones, and the next free zone number."""

    zones: tuple[ZoneShape, ...] = ()
    next_number: int = 1


class LearnerState(Struct):
    """Complete state of a `Learner`."""

    settings: Settings
    site: str
    epoch: str
    topology: Topology | None
    intake: ReorderBufferState
    window: WindowState
    clocks: ClockState
    alarms: AlarmState
    scorer: ScorerState
    cameras: list[CameraState]
    moved: list[tuple[int, float, Move]]
    done_us: int | None
    fitted_us: int | None
    learned: int
    since_fit: int
    followed: dict[int, FollowedSources] = {}
    publishers: dict[str, Publisher] = {}
    doubled: list[str] = []
    left: dict[str, RetiredCamera] = {}


class _Snapshot(Struct):
    format: int
    state: msgspec.Raw


def pack(state: LearnerState) -> bytes:
    """Return the state as compressed bytes."""
    raw = msgspec.Raw(_encoder.encode(state))
    return zlib.compress(_encoder.encode(_Snapshot(FORMAT, raw)), _COMPRESSION)


def unpack(blob: bytes) -> LearnerState:
    """Return the state from bytes.

    Raises `SnapshotError` if they are damaged, and `NewerSnapshot` if a newer program wrote them.
    """
    try:
        inflater = zlib.decompressobj()
        plain = inflater.decompress(blob, BYTES_MAX)
        if not inflater.eof:
            raise SnapshotError("the snapshot is cut short or too large")
        outer = msgspec.msgpack.decode(plain, type=_Snapshot)
        if outer.format != FORMAT:
            newer = outer.format > FORMAT
            raise (NewerSnapshot if newer else SnapshotError)(
                f"its format is {outer.format}, this program's {FORMAT}"
            )
        state: LearnerState = _decoder.decode(outer.state)
    except (zlib.error, msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise error if isinstance(error, SnapshotError) else SnapshotError(str(error)) from None
    return state


def _encode_array(array: object) -> tuple[str, tuple[int, ...], bytes]:
    if not isinstance(array, np.ndarray):
        raise NotImplementedError(f"{type(array)} cannot be stored in a snapshot")
    return array.dtype.str, array.shape, array.tobytes()


def _decode_array(kind: type, packed: Any) -> np.ndarray[Any, Any]:
    """Decode a field whose type msgspec does not know itself: always an array."""
    dtype, shape, data = msgspec.convert(packed, tuple[str, tuple[int, ...], bytes])
    try:
        return np.frombuffer(data, np.dtype(dtype)).reshape(shape).copy()
    except TypeError as error:
        raise SnapshotError(str(error)) from None


_encoder = msgspec.msgpack.Encoder(enc_hook=_encode_array)
_decoder = msgspec.msgpack.Decoder(LearnerState, dec_hook=_decode_array)
