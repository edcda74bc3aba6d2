"""A topology file is checked for consistency; then every command can read it."""

from __future__ import annotations

import base64
import copy
import json
import math
import random
import zlib
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgspec
import numpy as np
import pytest
from model_rows import rows_of

from bench.support.disturbances import with_wrong_clocks, without_positions, without_tracks
from camtopod.cli.main import main
from camtopod.codec import Rejected, decode_topology, to_json
from camtopod.columns import numbers, packed
from camtopod.export import FORMATS
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.predict.predictor import Predictor
from camtopod.records import Event, Topology
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.soundness import problems
from camtopod.web.report import gather
from camtopod.web.single_file import page


def learned(events: list[Event]) -> Topology:
    """Learn a simulated site in a few fits."""
    learner = Learner(Settings(refit_share=10.0))
    for event in events:
        learner.receive(event)
    learner.flush()
    assert learner.topology is not None
    return learner.topology


SITE = learned(simulate(SimSettings(cameras=4, hours=0.5, seed=3, overlap_share=0.9))[0])
PLAIN: dict[str, Any] = json.loads(to_json(SITE))
assert SITE.model is not None
OLDER = PLAIN | {"model": msgspec.to_builtins(rows_of(SITE))}
"""The site in the form of older files."""


def column(values: list[float], kind: type = np.float32) -> str:
    """Return a column as JSON has it."""
    return base64.b64encode(packed(values, kind)).decode()


LINK = next(k for k, link in enumerate(SITE.links) if link.relation != "visible")
NUMBERS = (0, -1, 1, 5, 1e-12, 1e15, -1e300, 10**30, 2**53, 0.5)
ODD = (*NUMBERS, None, "", "a b", "a\x1bb/1", [], [1, 2], {}, True)


def changed(path: str, value: Any, site: dict[str, Any] = PLAIN) -> bytes:
    """Return the site's JSON with one value replaced, for example ``zones.0.cov``."""
    content = copy.deepcopy(site)
    *before, last = path.split(".")
    place: Any = content
    for step in before:
        place = place[int(step) if step.isdigit() else step]
    place[int(last) if last.isdigit() else last] = value
    return json.dumps(content).encode()


def renamed(old: str, new: str) -> bytes:
    return json.dumps(PLAIN).replace(f'"{old}', json.dumps(new)[:-1]).encode()


FEW = msgspec.structs.replace(
    SITE,
    links=SITE.links[:3] + [link for link in SITE.links[3:] if link.relation != "visible"][:5],
)
"""The site with few links, each of which costs time to draw."""
FIRST = SITE.cameras[0].id
WRONG = {
    "a space in an id": renamed(FIRST, "a b"),
    "an escape in an id": renamed(FIRST, "a\x1b[2J"),
    "a long id": renamed(FIRST, "x" * 65),
    "a zone with a huge number": renamed(SITE.zones[0].id, f"{FIRST}/{'9' * 5000}"),
    "a zone without a number": renamed(SITE.zones[0].id, f"{FIRST}/one"),
    "far too many bins": changed("model.lag_step", 1e-12),
    "an empty range": changed("model.lag_max", PLAIN["model"]["lag_min"]),
    "a histogram far away": changed(f"links.{LINK}.histogram.first", 10**15),
    "a histogram before the bins": changed(f"links.{LINK}.histogram.first", -1000),
    "a negative count": changed(f"links.{LINK}.histogram.mass.0", -1),
    "a cov of another shape": changed("zones.0.cov", [[0.1, 0.0]]),
    "a cov that is none": changed("zones.0.cov", [[0.001, 0.5], [0.5, 0.001]]),
    "half a position": changed("zones.0.x", None),
    "a position outside": changed("zones.0.y", -3.0),
    **{
        f"twice the same in {place}": changed(place, [*PLAIN[place], PLAIN[place][0]])
        for place in ("cameras", "zones", "links", "pairs")
    },
    "a zone that has no camera": changed("zones.0.camera", "cellar"),
    "a camera's zone that is not there": changed("cameras.0.zones", ["cellar/1"]),
    "a link to nowhere": changed(f"links.{LINK}.to", "cellar/1"),
    "a pair with nobody": changed("pairs.0.cameras", [FIRST, "zzz"]),
    "an outcome nowhere": changed("model.onward.0.next_.0.to", "cellar/1", OLDER),
    "a column of one number too few": changed("model.arrival_rate", column([0.1])),
    "a column that is not there": changed("model.onward.to", ""),
    "a column that is not deflated": changed("model.arrival_rate", "AAAA"),
    "a column that is far too large": changed(
        "model.arrival_rate", base64.b64encode(zlib.compress(bytes((1 << 28) + 4))).decode()
    ),
    "no number": changed("model.event_share", column([math.nan] * len(SITE.cameras))),
    "a share of 3": changed("model.onward.leave", column([3.0] * len(SITE.zones))),
    "more outcomes than columns have": changed(
        "model.onward.number", column([10**9] * len(SITE.zones), np.int32)
    ),
    "a zone of no number": changed("model.pace.entry", column([len(SITE.zones)], np.int32)),
    "bins that are not there": changed(
        "model.onward.hazard.first",
        column([5000] * len(numbers(SITE.model.onward.to, np.int32, -1)), np.int16),
    ),
    "a pair of one": changed("pairs.0.cameras", [FIRST, FIRST]),
    "a zone of another camera": changed("zones.0.camera", SITE.cameras[1].id),
    "a probability of 3": changed(f"links.{LINK}.probability", 3.0),
    "a hundred quadrillion exits": changed("zones.0.exits", 10**17),
    "a version of many digits": changed("version", 10**4000),
    "deciles that fall": changed(
        "model.stay", column([float(k) for k in range(11 * len(SITE.zones), 0, -1)])
    ),
    "a correlation of 5": changed("model.pace.correlation", 5),
    "a way of no time": changed("model.pace.ways.0.stay", 0, OLDER),
    "a share below 0": changed("model.onward.0.next_.0.share", -0.5, OLDER),
    "a row without a field": changed("model.zones.0", {}, OLDER),
    "a model that is none": changed("model", True, OLDER),
    "rows that are none": changed("model.contexts", 7, OLDER),
    "a clock of a geological age": changed("cameras.0.clock_offset", 1e15),
}


@pytest.mark.parametrize("why", WRONG)
def test_what_cannot_be_is_refused(why: str) -> None:
    with pytest.raises(Rejected, match=" - at `"):
        decode_topology(WRONG[why])


def test_an_older_form_is_converted_to_the_same_columns() -> None:
    """But the order of contexts of one zone, and weak links, which older rows have apart."""
    again = decode_topology(json.dumps(OLDER).encode())
    assert again.model is not None
    assert SITE.model is not None
    assert rows_of(again) == rows_of(SITE)


def test_every_command_says_that_it_is_no_topology(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, events = tmp_path / "topology.json", tmp_path / "events.jsonl"
    source.write_bytes(WRONG["an escape in an id"])
    events.write_bytes(to_json(Event(FIRST, "exit", 1_700_000_000.0, 0.5, 0.5)) + b"\n")

    for command in (
        ["report", str(source), "--out", str(tmp_path / "out")],
        ["predict", str(source), str(events)],
        *(["export", str(source), "--format", form] for form in FORMATS),
    ):
        assert main(command) == 66, command

        out, err = capsys.readouterr()
        assert out == ""
        assert err.startswith(f"camtopod: {source} is not a topology: ")
        assert len(err.splitlines()) == 1
        assert err[:-1].isprintable()


def test_what_the_learner_makes_is_sound() -> None:
    network = SimSettings(cameras=5, hours=0.2, seed=1)
    recording = simulate(network)
    bare = without_positions(without_tracks(recording, network), network)

    for events, _ in (bare, with_wrong_clocks(recording, network)):
        topology = learned(events)
        assert list(problems(topology)) == []
        assert decode_topology(to_json(topology)) == topology
        use(topology)


# --- whatever is believed can be used ------------------------------------------------------------


def places(content: Any, path: str = "") -> list[str]:
    """Return the places where a value can be replaced."""
    if isinstance(content, dict):
        return [
            one
            for key, inner in content.items()
            for one in [f"{path}{key}", *places(inner, f"{path}{key}.")]
        ]
    if isinstance(content, list):
        few = range(min(len(content), 3))
        return [one for k in few for one in [f"{path}{k}", *places(content[k], f"{path}{k}.")]]
    return []


def use(topology: Topology) -> None:
    """Do everything with it that commands do."""
    assert page(gather(topology, [topology], None))
    for form, exported in FORMATS.items():
        text = exported(topology)
        if form in ("svg", "graphml"):
            ElementTree.fromstring(text)
    predictor = Predictor(topology)
    for zone in topology.zones:
        t = topology.as_of
        for kind, later in (("entry", 0.0), ("exit", 4.0), ("entry", 30.0), ("exit", 31.0)):
            event = Event(zone.camera, kind, t + later, zone.x, zone.y, "7")  # type: ignore[arg-type]
            if kind == "exit":
                for now in (None, event.t + 5.0):
                    prediction = predictor.predict(event, now)
                    assert (
                        abs(prediction.leave + sum(one.probability for one in prediction.next) - 1)
                        < 1e-6
                    )
                    assert b"null" not in to_json(prediction.next), "a figure that is none"
            predictor.observe(event)


def test_what_is_believed_can_be_used() -> None:
    use(SITE)
    plain: dict[str, Any] = json.loads(to_json(FEW))
    chance, sites, believed = random.Random(4), places(plain), 0

    assert sites == places(PLAIN), "nothing is left out"
    for _ in range(40):
        raw = changed(chance.choice(sites), chance.choice(ODD), plain)
        try:
            topology = decode_topology(raw)
        except Rejected:
            continue
        believed += 1
        try:
            use(topology)
        except Exception as error:  # noqa: BLE001
            pytest.fail(f"{type(error).__name__}: {error}")
    assert believed > 2, "not everything is refused"


@pytest.mark.parametrize("odd", ["\x1b[2J", "\x00", "\ufffe", "\u202e", "\ud800", "<&\"'>"])
def test_pictures_of_any_site_are_well_formed(odd: str) -> None:
    named = msgspec.structs.replace(SITE, site=odd)

    for form in ("svg", "graphml"):
        assert len(ElementTree.fromstring(FORMATS[form](named))) > 0
