"""Digests and deltas: equal topologies have equal digests; a delta gives the next version."""

from __future__ import annotations

import zlib

import msgspec
import numpy as np
import pytest
from delta_receiver import apply_delta
from hypothesis import given, settings, strategies as st
from msgspec.structs import replace

from camtopod.codec import read, to_json, to_msgpack
from camtopod.columns import packed
from camtopod.records import (
    DELTA_SCHEMA,
    TOPOLOGY_SCHEMA,
    Camera,
    Delta,
    Histogram,
    LabelModel,
    Link,
    Model,
    Pair,
    Topology,
    Transit,
    VersionModel,
    Zone,
)
from camtopod.topology.versions import digest_of, make_delta, map_of, version_model, with_digest

NUMBERS = st.floats(-1e3, 1e3)
SHARES = st.floats(0, 1)
NAMES = st.sampled_from(["a", "b", "c", "d"])
TRANSITS = st.builds(Transit, NUMBERS, NUMBERS, SHARES, NUMBERS, NUMBERS, NUMBERS)
CAMERAS = st.builds(Camera, NAMES, st.lists(NAMES, max_size=2), NUMBERS)
HISTOGRAMS = st.builds(Histogram, st.integers(-20, 20), st.lists(SHARES, max_size=3))
LINKS = st.builds(
    Link,
    NAMES,
    NAMES,
    st.sampled_from(["visible", "overlapped", "unseen"]),
    SHARES,
    SHARES,
    TRANSITS,
    SHARES,
    SHARES,
    st.none() | HISTOGRAMS,
)
COV = st.just([[0.1, 0.0], [0.0, 0.1]])
ZONE_IDS = st.sampled_from(["a/1", "b/1", "c/1", "d/1"])
ZONES = st.builds(Zone, ZONE_IDS, NAMES, st.integers(0, 99), st.integers(0, 99)) | st.builds(
    Zone, ZONE_IDS, NAMES, st.integers(0, 99), st.integers(0, 99), SHARES, SHARES, COV
)
PAIRS = st.builds(Pair, st.tuples(NAMES, NAMES), st.sampled_from(["overlapped", "unseen_path"]))
COLUMNS = st.lists(st.floats(0, 1, width=32), max_size=3).map(lambda row: packed(row, np.float32))
MODELS = st.builds(
    Model,
    st.floats(0.1, 9.0),
    st.floats(0.1, 9.0),
    NUMBERS,
    NUMBERS,
    COLUMNS,
    COLUMNS,
    labels=st.none() | st.builds(LabelModel, st.just(["car"]), SHARES, COLUMNS),
)


def by_key(item: Camera | Zone | Link | Pair) -> object:
    if isinstance(item, Link):
        return item.from_, item.to, item.relation
    return item.cameras if isinstance(item, Pair) else item.id


def some(items: st.SearchStrategy[object]) -> st.SearchStrategy[list[object]]:
    """Draw the contents of a topology: each key once, in order."""
    return st.lists(items, max_size=3, unique_by=by_key).map(
        lambda found: sorted(found, key=by_key)
    )  # type: ignore[arg-type]


@st.composite
def topologies(draw: st.DrawFn, version: int = 1) -> Topology:
    return with_digest(
        Topology(
            TOPOLOGY_SCHEMA,
            "hq",
            "01J",
            version,
            draw(NUMBERS),
            draw(st.integers(0, 99)),
            "",
            draw(some(CAMERAS)),
            draw(some(ZONES)),
            draw(some(LINKS)),
            draw(some(PAIRS)),
            draw(st.none() | MODELS),
        )
    )  # type: ignore[arg-type]


@settings(max_examples=20)
@given(topologies(4), topologies(5))
def test_old_and_delta_are_new(old: Topology, new: Topology) -> None:
    delta = make_delta(old, new)
    old, new = map_of(old), map_of(new)

    assert apply_delta(old, delta) == new
    for pack, encode in ((False, to_json), (True, to_msgpack)):  # and after a way over the bus
        received = read(Delta, encode(delta), pack)
        assert received == delta
        assert apply_delta(read(Topology, encode(old), pack), received) == new


@settings(max_examples=20)
@given(topologies(4))
def test_digest_is_of_the_content_alone(topology: Topology) -> None:
    assert topology.digest == digest_of(topology) == digest_of(replace(topology, digest=""))
    elsewhere = replace(topology, site="other", epoch="02", version=9)

    assert digest_of(elsewhere) == topology.digest
    assert digest_of(read(Topology, to_json(topology))) == topology.digest
    assert digest_of(replace(topology, events=topology.events + 1)) != topology.digest
    assert digest_of(replace(topology, as_of=topology.as_of + 1)) != topology.digest
    more = [*topology.pairs, Pair(("x", "y"), "overlapped")]
    assert digest_of(replace(topology, pairs=more)) != topology.digest


@settings(max_examples=20)
@given(topologies(4))
def test_a_map_and_its_model_are_the_version(topology: Topology) -> None:
    """After a way over the bus; the digest is of the numbers, however they are deflated."""
    held = read(Topology, to_msgpack(map_of(topology)), pack=True)
    assert held.model is None
    model = version_model(topology)
    if model is not None:
        assert read(VersionModel, to_msgpack(model), pack=True) == model
        held = replace(held, model=model.model)
        assert digest_of(replace(held, model=stored_anew(model.model))) == topology.digest
    assert held == topology


def stored_anew(model: Model) -> Model:
    """Return a model with a column that is not deflated, but has the same numbers."""
    if not model.departures:
        return model
    return replace(model, departures=zlib.compress(zlib.decompress(model.departures), 0))


EMPTY = with_digest(Topology(TOPOLOGY_SCHEMA, "hq", "01J", 1, 0.0, 0, "", [], [], [], []))


@pytest.mark.parametrize("other", [{"version": 3}, {"version": 1}, {"epoch": "02", "version": 2}])
def test_only_the_next_version_follows(other: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="does not follow"):
        make_delta(EMPTY, replace(EMPTY, **other))


def test_the_digest_of_a_delta_tells_damage() -> None:
    delta = make_delta(EMPTY, with_digest(replace(EMPTY, version=2, events=5)))

    assert delta.schema == DELTA_SCHEMA
    assert digest_of(apply_delta(EMPTY, delta)) == delta.digest
    assert digest_of(apply_delta(EMPTY, replace(delta, events=6))) != delta.digest


def test_a_foreign_schema_is_refused() -> None:
    with pytest.raises(ValueError, match="this program reads"):
        replace(EMPTY, schema="camtopod/topology/2")
    raw = msgspec.json.encode(msgspec.to_builtins(EMPTY) | {"schema": "x", "more": 1})
    with pytest.raises(ValueError, match="schema is 'x'"):
        read(Topology, raw)

    assert read(Topology, raw.replace(b'"x"', b'"camtopod/topology/1"')) == EMPTY
