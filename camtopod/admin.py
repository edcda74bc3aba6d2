"""An operator's commands: changes of a site by hand, each in its place in the order of the events.

The daemon stores a command in its journal like an event, so that a learner that replays the journal
carries it out at the same point. Structs without logic, as in `camtopod.records`.
"""

from __future__ import annotations

from msgspec import Struct

from camtopod.records import CameraId


class Forget(Struct, frozen=True, tag="forget"):
    """Remove a camera and all that was learned of it; its name is refused from then on.

    until (Unix seconds): of the old name of a renamed camera, which the daemon forgets itself:
        earlier events still count for the camera.
    """

    camera: CameraId
    until: float | None = None


class TakeBack(Struct, frozen=True, tag="take-back"):
    """Accept the events of a forgotten name again."""

    camera: CameraId


class Rename(Struct, frozen=True, tag="rename"):
    """Rename the camera ``old`` to ``new``, and keep everything learned about it."""

    old: CameraId
    new: CameraId


class Reset(Struct, frozen=True, tag="reset"):
    """Begin the site anew: nothing is learned, no camera is known.

    t (Unix seconds): earlier events are not learned.
    before, epoch: the epoch that ends, and the one that begins.

    An operator's command has none of these: the daemon fills them in.
    """

    t: float = 0.0
    before: str = ""
    epoch: str = ""


class Rewind(Struct, frozen=True, tag="rewind"):
    """Drop what was learned after a time; the daemon's own, when its clock was set back.

    to (Unix seconds): everything later is dropped.
    before, epoch: the epoch that ends, and the one that begins.
    """

    to: float
    before: str
    epoch: str


Command = Forget | TakeBack | Rename | Reset | Rewind
