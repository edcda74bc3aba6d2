"""Events from ONVIF scene descriptions (Profile M): XML of a metadata stream, or JSON by MQTT.

- XML: documents ``tt:MetadataStream``, one after another, as an RTSP metadata stream carries them.
  With or without lines.
- JSON: messages of ``PREFIX/onvif-mj/VideoAnalytics/PROFILE/MODULE``, whose keys are XML's names
  (attributes with ``@`` in front).

Fields, coordinates and topics are those of the ONVIF Analytics Service Specification (chapter
"Scene Description", with "Metadata in JSON over MQTT", since 22.06). Coordinates are -1 to 1,
x right and y up, after the transformations of frame and appearance: scale, then translate.

An object that ``ObjectTree/Delete`` names has left at once. Renames, splits and merges are not
followed; heads, faces and plates are not counted beside their owner. Modules of one camera
(``Source``) number their objects independently and are kept apart.

XML comes from the network: a document with a DOCTYPE, thus with entities, is refused.
"""

from __future__ import annotations

from typing import Any
from xml.etree.ElementTree import Element

from msgspec import Struct, field

from camtopod import codec
from camtopod.adapt.adapter import split_topic
from camtopod.adapt.camera_streams import Box, Name, StreamAdapter, TrackedBox, seconds_of
from camtopod.codec import TRACK_CHARACTERS_MAX, Rejected
from camtopod.records import Event
from camtopod.untrusted_xml import all_of, parse_xml, tag_of

_NUMBERS = frozenset({"x", "y", "left", "top", "right", "bottom", "Likelihood"})
"""Attributes that are numbers."""
_SEVERAL = frozenset({"Object", "Delete", "Type"})
"""Elements of which there may be several."""


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


class _OnvifClass(Struct, frozen=True):
    types: list[_Type] | _Type = field(name="Type", default_factory=list)

    def likeliest(self) -> str:
        """Return the most probable kind; empty if there is none."""
        return max(_many(self.types), key=lambda kind: kind.likelihood or 0.0, default=_Type()).text


class _Appearance(Struct, frozen=True):
    transformation: _Transformation = field(name="Transformation", default=_Transformation())
    shape: _Shape = field(name="Shape", default=_Shape())
    kind: _OnvifClass = field(name="Class", default=_OnvifClass())


class _OnvifObject(Struct, frozen=True):
    id: int | str | None = field(name="@ObjectId", default=None)
    appearance: _Appearance = field(name="Appearance", default=_Appearance())


class _ObjectTree(Struct, frozen=True):
    delete: list[_OnvifObject] | _OnvifObject = field(name="Delete", default_factory=list)


class _OnvifFrame(Struct, frozen=True):
    time: str = field(name="@UtcTime")
    source: str = field(name="@Source", default="")
    transformation: _Transformation = field(name="Transformation", default=_Transformation())
    objects: list[_OnvifObject] | _OnvifObject = field(name="Object", default_factory=list)
    tree: _ObjectTree = field(name="ObjectTree", default=_ObjectTree())


class _OnvifMessage(Struct, frozen=True):
    frames: list[_OnvifFrame] | _OnvifFrame = field(name="Frame")


class Onvif(StreamAdapter):
    """Adapter for scene descriptions, XML or JSON (its topic may be in front).

    camera: the camera's id; None to take it from the topic's level before ``onvif-mj``.
    labels: kinds of objects (``Human``, ``Vehicle``) that count; empty for all.
    """

    begins = b"<{"
    box_form = "fractions of the picture, behind the Transformation"
    outside_cause = "the camera sends no Transformation, or a wrong one, from its units to -1 to 1"

    def receive(self, line: bytes) -> list[Event]:
        """Return the events that a document or a message makes certain. Raises `Rejected`."""
        if line.startswith(b"<"):
            return self._read(self.cameras.id_of(""), _frames_of(line))

        # JSON by MQTT.
        levels, message = split_topic(line, "*/onvif-mj/VideoAnalytics/*")
        name = ""
        if levels:
            name = levels[levels.index("onvif-mj") - 1]
        return self._read(
            self.cameras.id_of(name), _many(codec.read(_OnvifMessage, message).frames)
        )

    def _read(self, camera: str, frames: list[_OnvifFrame]) -> list[Event]:
        """Return the events that frames make certain. Raises `Rejected`."""
        events = []
        for frame in frames:
            module = frame.source[: TRACK_CHARACTERS_MAX // 2]

            # Boxes, and the objects that are gone.
            tracked_boxes = []
            for detection in _many(frame.objects):
                if (box := detection.appearance.shape.box) is not None:
                    sides = _fractions(
                        box, detection.appearance.transformation, frame.transformation
                    )
                    kind = detection.appearance.kind.likeliest()
                    tracked_boxes.append(TrackedBox(_name(module, detection.id), sides, kind))
            ended_names = [_name(module, track.id) for track in _many(frame.tree.delete)]

            stream = self._stream(camera, module=module)
            events += stream.update(tracked_boxes, ended_names, seconds_of(frame.time))
        return events


def _many(value: Any) -> Any:
    """Return a list of what may be one item or several."""
    return value if isinstance(value, list) else [value]


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
