"""README's animated picture: what it is made of, and its geometry."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
from paths import DEPLOY

from bench import animation
from camtopod.records import Event

PICTURE = DEPLOY / "pictures" / "demo.svg"
BYTES_MAX = 1_500_000


def test_the_picture_shows_every_camera_and_loads_nothing() -> None:
    content = PICTURE.read_bytes()
    assert len(content) < BYTES_MAX
    root = ET.fromstring(content)
    words = {element.text for element in root.iter() if element.text}
    assert words >= {*animation.PLACES, animation.TITLE}
    assert b"href" not in content
    assert b"url(http" not in content
    lengths = {element.get("dur") for element in root.iter() if element.get("dur")}
    assert lengths == {f"{animation.LOOP:g}s"}, "else the parts would drift apart"


def test_the_moments_of_an_animation_rise() -> None:
    for t in (0.0, 1.0, animation.LEARNED, animation.LEARNED + animation.SHOWN):
        event = Event("hall", "entry", animation.START + t, 0.5, 0.5)
        [disc] = ET.fromstring(animation.pulse(event))
        times = [float(time) for time in disc.attrib["keyTimes"].split(";")]
        assert times == sorted(times)
        assert (times[0], times[-1]) == (0.0, 1.0)
        assert len(times) == len(disc.attrib["values"].split(";"))


def test_a_floor_is_cut_at_the_edge_of_the_picture() -> None:
    square = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)])
    cut = animation.clipped(square + 1.0, square)
    assert sorted(map(tuple, cut.tolist())) == [(1.0, 1.0), (1.0, 2.0), (2.0, 1.0), (2.0, 2.0)]
    assert len(animation.clipped(square + 5.0, square)) == 0
