"""Events from ONVIF scene descriptions (Profile M): XML of a metadata stream, or JSON by MQTT.

- XML: documents ``tt:MetadataStream``, one after another, as an RTSP metadata stream carries them.
  With or without lines.
- JSON: messages of ``PREFIX/onvif-mj/VideoAnalytics/PROFILE/MODULE``, whose keys are XML's names
  (attributes with ``@`` in front).

Fields, coordinates and topics are those of the ONVIF Analytics Service Specification (chapter
"Scene Description", with "Metadata in JSON over MQTT", since 22.06). Coordinates are -1 to 1,
x right and y up, after the transformations of frame and appearance: scale, then translate.

An object that ``ObjectTree/Delete`` names has left at once. Renames, splits and merges are
followed (`object_tree`), and an object that stands still (``Behaviour/Idle``) need not be listed.
Heads, faces, plates and whatever has a ``Parent`` are not counted beside their owner. The kind is
the likeliest of ``Type``, ``ClassCandidate`` and ``OtherTypes``. Modules of one camera (``Source``,
or the topic's last levels) number their objects independently and are kept apart.

XML comes from the network: a document with a DOCTYPE, thus with entities, is refused.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection
from typing import Any
from xml.etree.ElementTree import Element

from msgspec import Struct, field

from camtopod import codec
from camtopod.adapt.adapter import split_topic
from camtopod.adapt.camera_streams import (
    Box,
    CameraStream,
    Name,
    StreamAdapter,
    TrackedBox,
    seconds_of,
)
from camtopod.adapt.kinds import plain
from camtopod.adapt.object_tree import ObjectTree
from camtopod.codec import TRACK_CHARACTERS_MAX, Rejected
from camtopod.records import Event
from camtopod.untrusted_xml import all_of, parse_xml, tag_of

_NUMBERS = frozenset({"x", "y", "left", "top", "right", "bottom", "Likelihood"})
"""Attributes that are numbers."""
_SEVERAL = frozenset(
    {"Object", "Delete", "Type", "ClassCandidate", "OtherTypes", "Rename", "Split", "Merge"}
    | {"from", "to"}
)
"""Elements of which there may be several."""
_OTHER = "other"
"""Kind of an object of no other kind: any other one is likelier."""


class _Vector(Struct, frozen=True):
    x: float = field(name="@x", default=0.0)
    y: float = field(name="@y", default=0.0)


class _Transformation(Struct, frozen=True):
    """Point = scale * point + translate, by axis; without a scale it is 1."""

    translate: _Vector = field(name="Translate", default=_Vector())
    scale: _Vector = field(name="Scale", default=_Vector(1.0, 1.0))

    def apply(self, x: float, y: float) -> tuple[float, float]:
        """Return a point in the parent's coordinates."""
        return self.scale.x * x + self.translate.x, self.scale.y * y + self.translate.y


class _OnvifBox(Struct, frozen=True):
    left: float = field(name="@left")
    top: float = field(name="@top")
    right: float = field(name="@right")
    bottom: float = field(name="@bottom")


class _Shape(Struct, frozen=True):
    box: _OnvifBox | None = field(name="BoundingBox", default=None)


class _Type(Struct, frozen=True):
    text: str = field(name="#text", default="")
    likelihood: float | None = field(name="@Likelihood", default=None)


class _Candidate(Struct, frozen=True):
    """An older form of a kind."""

    types: list[_Type | str] | _Type | str = field(name="Type", default="")
    likelihood: _Type | str | float | None = field(name="Likelihood", default=None)


class _Extension(Struct, frozen=True):
    others: list[_Candidate] | _Candidate = field(name="OtherTypes", default_factory=list)


class _OnvifClass(Struct, frozen=True):
    types: list[_Type | str] | _Type | str = field(name="Type", default_factory=list)
    candidates: list[_Candidate] | _Candidate = field(name="ClassCandidate", default_factory=list)
    others: list[_Candidate] | _Candidate = field(name="OtherTypes", default_factory=list)
    extension: _Extension = field(name="Extension", default=_Extension())

    def likeliest(self) -> str:
        """Return the most probable kind; empty if there is none."""
        kinds = [
            (_text(kind), kind.likelihood or 0.0 if isinstance(kind, _Type) else 0.0)
            for kind in _many(self.types)
        ]
        older = (self.candidates, self.others, self.extension.others)
        kinds += [
            (_text(kind), _float(_text(candidate.likelihood)))
            for candidate in itertools.chain(*map(_many, older))
            for kind in _many(candidate.types)
        ]
        return max(kinds, key=lambda kind: (plain(kind[0]) != _OTHER, kind[1]), default=("", 0))[0]


class _Appearance(Struct, frozen=True):
    transformation: _Transformation = field(name="Transformation", default=_Transformation())
    shape: _Shape = field(name="Shape", default=_Shape())
    kind: _OnvifClass = field(name="Class", default=_OnvifClass())


class _Behaviour(Struct, frozen=True):
    idle: Any = field(name="Idle", default=False)
    """Anything but False if the object stands still, and is not listed until it moves."""


class _OnvifObject(Struct, frozen=True):
    id: int | str | None = field(name="@ObjectId", default=None)
    parent: int | str | None = field(name="@Parent", default=None)
    appearance: _Appearance = field(name="Appearance", default=_Appearance())
    behaviour: _Behaviour = field(name="Behaviour", default=_Behaviour())


class _Id(Struct, frozen=True):
    id: int | str | None = field(name="@ObjectId", default=None)


class _Change(Struct, frozen=True):
    """A rename, a split or a merge."""

    before: list[_Id] | _Id = field(name="from", default_factory=list)
    after: list[_Id] | _Id = field(name="to", default_factory=list)


class _Tree(Struct, frozen=True):
    renames: list[_Change] | _Change = field(name="Rename", default_factory=list)
    splits: list[_Change] | _Change = field(name="Split", default_factory=list)
    merges: list[_Change] | _Change = field(name="Merge", default_factory=list)
    delete: list[_Id] | _Id = field(name="Delete", default_factory=list)


class _OnvifFrame(Struct, frozen=True):
    time: str = field(name="@UtcTime")
    source: str = field(name="@Source", default="")
    transformation: _Transformation = field(name="Transformation", default=_Transformation())
    objects: list[_OnvifObject] | _OnvifObject = field(name="Object", default_factory=list)
    tree: _Tree = field(name="ObjectTree", default=_Tree())


class _OnvifMessage(Struct, frozen=True):
    frames: list[_OnvifFrame] | _OnvifFrame = field(name="Frame")


class Onvif(StreamAdapter):
    """Adapter for scene descriptions, XML or JSON (its topic may be in front).

    camera: the camera's id; None to take it from the topic's level before ``onvif-mj``.
    labels: kinds of objects (``Human``, ``Vehicle``) that count; empty for all.
    """

    begins = b"<{"
    box_form = "left, top, right, bottom in fractions of the picture, after Transformation"
    outside_cause = "the camera sends no Transformation, or a wrong one, from its units to -1 to 1"

    def __init__(self, camera: str | None = None, labels: Collection[str] = ()) -> None:
        super().__init__(camera, labels)
        self._trees: dict[CameraStream, ObjectTree] = {}
        self._modules: dict[str, str] = {}
        """The first module of each camera that only its topic names."""

    def receive(self, line: bytes) -> list[Event]:
        """Return the events that a document or a message makes certain. Raises `Rejected`."""
        if line.startswith(b"<"):
            return self._read(self.cameras.id_of(""), "", _frames_of(line))

        # JSON by MQTT.
        levels, message = split_topic(line, "*/onvif-mj/VideoAnalytics/*")
        name = module = origin = ""
        if levels:
            place = levels.index("onvif-mj")
            name, module = levels[place - 1], "/".join(levels[place + 2 :])
            origin = "/".join(levels[: place - 1])
        camera = self.cameras.id_of(name, origin=origin)
        if self._modules.setdefault(camera, module) == module:
            module = ""
        return self._read(camera, module, _many(codec.read(_OnvifMessage, message).frames))

    def _read(self, camera: str, topic: str, frames: list[_OnvifFrame]) -> list[Event]:
        """Return the events that frames make certain. Raises `Rejected`.

        topic: name of the module for frames that name none.
        """
        events = []
        for frame in frames:
            t = seconds_of(frame.time)
            module = (frame.source or topic)[: TRACK_CHARACTERS_MAX // 2]
            stream = self._stream(camera, module=module)
            stream.require_newer(t)
            tree = self._trees.setdefault(stream, ObjectTree(stream.tracks))
            if t != tree.t:  # else it has come again
                tree.t = t
                _follow(frame.tree, tree, module)

            # Boxes, and the objects that are gone, or stand still.
            tracked_boxes, parents, idle_names = self._boxes(frame, module, stream, tree)
            ended_names = [
                name for number in _ids(module, frame.tree.delete) for name in tree.end(number)
            ]
            events += stream.update(tree.places(tracked_boxes, parents), ended_names, t)
            for name in idle_names:
                for held_name in tree.along(name):
                    stream.tracks.hold(held_name)
        return events

    def _boxes(
        self, frame: _OnvifFrame, module: str, stream: CameraStream, tree: ObjectTree
    ) -> tuple[list[TrackedBox], dict[str, str], list[Name]]:
        """Return boxes, names of tracks by those of their parts, and names of those that stand."""
        tracked_boxes = []
        parents = {}
        idle_names = []
        for detection in _many(frame.objects):
            name = tree.name(_name(module, detection.id))
            if detection.parent is not None:
                if not (self._labels or stream.tracks.follows(name)):
                    continue
                parents[str(name)] = str(tree.name(_name(module, detection.parent)))
            if detection.behaviour.idle is not False:
                idle_names.append(name)
            appearance = detection.appearance
            if (box := appearance.shape.box) is not None:
                sides = _fractions(box, appearance.transformation, frame.transformation)
                tracked_boxes.append(TrackedBox(name, sides, appearance.kind.likeliest()))
        return tracked_boxes, parents, idle_names


def _follow(changes: _Tree, tree: ObjectTree, module: str) -> None:
    """Follow the objects of a frame that have other ids than before."""
    for change in _many(changes.renames):
        tree.rename(_ids(module, change.before)[0], _ids(module, change.after)[0])
    for change in _many(changes.merges):
        tree.merge(_ids(module, change.before), _ids(module, change.after)[0])
    for change in _many(changes.splits):
        tree.split(_ids(module, change.before)[0], _ids(module, change.after))


def _many(value: Any) -> Any:
    """Return a list of what may be one item or several."""
    return value if isinstance(value, list) else [value]


def _ids(module: str, items: list[_Id] | _Id) -> list[Name]:
    """Return the names of several ids; None, if there is none."""
    return [_name(module, item.id) for item in _many(items)] or [None]


def _text(value: _Type | str | float | None) -> str:
    """Return the text of an element, or of a value of JSON."""
    return value.text if isinstance(value, _Type) else str(value or "")


def _float(text: str) -> float:
    """Return a likelihood; 0 for none."""
    try:
        return float(text)
    except ValueError:
        return 0.0


def _name(module: str, number: int | str | None) -> Name:
    """Return the name of a track: ids are unique within a module only."""
    if number is None or not module:
        return number
    return f"{module}-{number}"


def _fractions(box: _OnvifBox, inner: _Transformation, outer: _Transformation) -> Box:
    """Return a box in fractions of the picture, y down."""
    left, top = outer.apply(*inner.apply(box.left, box.top))
    right, bottom = outer.apply(*inner.apply(box.right, box.bottom))
    return (left + 1) / 2, (1 - max(top, bottom)) / 2, (right + 1) / 2, (1 - min(top, bottom)) / 2


def _frames_of(document: bytes) -> list[_OnvifFrame]:
    """Return the frames of an XML document. Raises `Rejected`."""
    root = parse_xml(document)
    frames = [_plain(element) for element in all_of(root, "Frame")]
    return codec.read(_OnvifMessage, codec.to_json({"Frame": frames})).frames  # type: ignore[return-value]


def _plain(element: Element, levels: int = 6) -> dict[str, Any]:
    """Return an element in the form of the JSON messages, with this number of levels below it.

    Raises `Rejected`.
    """
    plain: dict[str, Any] = {"#text": (element.text or "").strip()}
    for name, value in element.items():
        plain[f"@{name}"] = _number(value) if name in _NUMBERS else value
    for child in element if levels else ():
        tag = tag_of(child)
        if tag in _SEVERAL:
            plain.setdefault(tag, []).append(_plain(child, levels - 1))
        else:
            plain[tag] = _plain(child, levels - 1)
    return plain


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise Rejected("malformed", "an attribute is no number") from None
