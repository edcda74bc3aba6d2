"""Exports are read back by other programs, or by simple parsers where these are missing."""

from __future__ import annotations

import io
import json
import math
import re
import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import msgspec
import networkx as nx
import numpy as np
import pytest
from model_rows import with_rows
from synthetic_topology import synthetic_topology

from camtopod.cli.main import main
from camtopod.codec import to_json
from camtopod.export import FORMATS, camera_numbers
from camtopod.export.graph import edges, seconds
from camtopod.records import Camera, Lacks

TOPOLOGY = synthetic_topology(7)
CAMERAS = [camera.id for camera in TOPOLOGY.cameras]
PAIRS = {(pair.cameras, pair.relation == "overlapped") for pair in TOPOLOGY.pairs}
EMPTY = msgspec.structs.replace(
    TOPOLOGY, cameras=[], zones=[], links=[], pairs=[], model=None, alarms=None
)
ZONES_OF_FIRST = [zone for zone in TOPOLOGY.zones if zone.camera == CAMERAS[0]]
SVG = {"s": "http://www.w3.org/2000/svg"}


def pairs_of(directed: list[tuple[str, str, bool]]) -> set[tuple[tuple[str, str], bool]]:
    """Return the pairs that directed edges join, and whether their views overlap."""
    pairs: dict[tuple[str, str], bool] = {}
    for a, b, overlapped in directed:
        key = (min(a, b), max(a, b))
        pairs[key] = pairs.get(key, False) or overlapped
    return set(pairs.items())


def test_graphml_is_read_by_networkx() -> None:
    graph = nx.read_graphml(io.StringIO(FORMATS["graphml"](TOPOLOGY)))

    found = [(a, b, edge["relation"] == "overlapped") for a, b, edge in graph.edges(data=True)]
    assert set(graph.nodes) == set(CAMERAS)
    assert pairs_of(found) == PAIRS
    assert graph.nodes[CAMERAS[0]]["zones"] == len(TOPOLOGY.cameras[0].zones)
    for edge in edges(TOPOLOGY):
        data = graph.edges[edge.from_, edge.to]
        assert (data["weight"], data["q90"]) == (max(edge.transit.mode, 0.1), edge.transit.q90)
        assert data["mode"] == edge.transit.mode
        assert data["probability"] == edge.probability


def test_json_is_read_by_networkx() -> None:
    graph = nx.node_link_graph(json.loads(FORMATS["json"](TOPOLOGY)), edges="edges")
    assert min(edge["weight"] for _, _, edge in graph.edges(data=True)) == 0.1  # it overlaps

    found = [(a, b, edge["colour"] == "black") for a, b, edge in graph.edges(data=True)]
    zones = sum(len(node["zones"]) for _, node in graph.nodes(data=True))
    assert pairs_of(found) == PAIRS
    assert zones == len(TOPOLOGY.zones)


def test_weak_links_are_drawn_dashed_if_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, *links = TOPOLOGY.links
    ends = {first.from_.split("/")[0], first.to.split("/")[0]}
    hidden = [one for one in links if {one.from_.split("/")[0], one.to.split("/")[0]} == ends]
    shown = [one for one in links if one not in hidden]
    weak = [
        msgspec.structs.replace(one, transitions=9.0, lacks=Lacks(passages, 60.0))
        for one, passages in ((first, 3.0), (shown[0], 3.0), (hidden[0], 10.0))
    ]
    topology = with_rows(msgspec.structs.replace(TOPOLOGY, links=shown), weak=weak)
    path = tmp_path / "topology.json"
    path.write_bytes(to_json(topology))

    drawn = {}
    for name in ("dot", "svg", "json", "graphml"):
        assert main(["export", str(path), "--format", name]) == 0
        without = capsys.readouterr().out
        assert main(["export", str(path), "--format", name, "--weak"]) == 0
        drawn[name] = capsys.readouterr().out
        assert len(drawn[name]) > len(without)
        assert "dash" not in without

    assert drawn["dot"].count('style="dashed"') == 1
    assert drawn["svg"].count("stroke-dasharray") == 2, "the line, and the legend's"
    graphs = [nx.node_link_graph(json.loads(drawn["json"]), edges="edges")]
    graphs.append(nx.read_graphml(io.StringIO(drawn["graphml"])))
    for graph in graphs:
        assert {frozenset((a, b)) for a, b, weak in graph.edges(data="weak") if weak} == {
            frozenset(ends)
        }


def test_dot_has_every_camera_and_edge() -> None:
    text = FORMATS["dot"](TOPOLOGY)

    edge = r'^  "([^"]+)" -> "([^"]+)" \[color="(\w+)", label="-?[\d.]+ s"'
    found = re.findall(edge, text, re.M)
    assert pairs_of([(a, b, colour == "black") for a, b, colour in found]) == PAIRS
    assert len(re.findall(r'^  "[^"]+" \[label=', text, re.M)) == len(CAMERAS)


@pytest.mark.skipif(shutil.which("dot") is None, reason="graphviz is not installed")
def test_dot_is_read_by_graphviz_whatever_the_names() -> None:
    names = ["a\\", 'a"b', 'a\\"b', "a\nb", "<b>&", "node"]
    odd = msgspec.structs.replace(EMPTY, site=names[2], cameras=[Camera(one, []) for one in names])

    for topology, nodes in ((TOPOLOGY, len(CAMERAS)), (odd, len(names))):
        text = FORMATS["dot"](topology).encode()
        drawn = subprocess.run(["dot", "-Tplain"], input=text, capture_output=True, timeout=30)
        kinds = [line.split(b" ")[0] for line in drawn.stdout.splitlines()]
        assert (drawn.returncode, drawn.stderr) == (0, b"")
        assert kinds.count(b"node") == nodes
        assert kinds.count(b"edge") == len(edges(topology))


def test_svg_is_xml_with_black_and_grey_edges() -> None:
    site = "a<b & c"
    root = ElementTree.fromstring(FORMATS["svg"](msgspec.structs.replace(TOPOLOGY, site=site)))

    left, top, width, height = map(float, root.attrib["viewBox"].split())
    assert (float(root.attrib["width"]), float(root.attrib["height"])) == (width, height)
    titled = [group for group in root.findall("s:g", SVG) if group.find("s:title", SVG) is not None]
    strokes = [line.attrib["stroke"] for group in titled for line in group.findall("s:line", SVG)]
    titles = {str(one.findtext("s:title", namespaces=SVG)).split(",")[0] for one in titled}
    assert strokes.count("#111513") == sum(overlapped for _, overlapped in PAIRS)
    assert strokes.count("#85908a") == sum(not overlapped for _, overlapped in PAIRS)
    assert set(CAMERAS) <= titles
    assert site in (root.findtext("s:title", namespaces=SVG) or "")
    for circle in root.findall("s:g/s:circle", SVG):
        assert 11 <= float(circle.attrib["cx"]) - left <= width - 11
        assert 11 <= float(circle.attrib["cy"]) - top <= height - 11


def test_svg_writes_names_and_times_where_they_hit_nothing() -> None:
    root = ElementTree.fromstring(FORMATS["svg"](synthetic_topology(60)))

    circles = [
        (float(one.attrib["cx"]), float(one.attrib["cy"]))
        for one in root.findall("s:g/s:circle", SVG)
    ]
    lines = [
        np.linspace(*(np.array([line.attrib[f"x{k}"], line.attrib[f"y{k}"]], float) for k in "12"))
        for line in root.findall("s:g/s:line", SVG)
    ]
    texts = [
        (float(one.attrib["x"]), float(one.attrib["y"]) - 4.5, len(str(one.text)) * 5.5)
        for one in root.findall("s:text", SVG)
        if one.attrib.get("text-anchor") == "middle"
    ]
    at_times = {float(one.attrib["x"]) for one in root.findall("s:text[@class='time']", SVG)}
    assert len(texts) > 1.5 * len(circles) == 90, "names, and times of paths"
    for k, (x, y, width) in enumerate(texts):
        assert all(abs(x - cx) > width / 2 or abs(y - cy) > 8 for cx, cy in circles)
        for line in lines if x in at_times else ():  # a name crosses a line if it must
            assert (abs(line - (x, y)) > (width / 2, 6)).any(axis=1).all()
        for other_x, other_y, other_width in texts[:k]:
            assert abs(x - other_x) > (width + other_width) / 2 or abs(y - other_y) > 12


def test_svg_gives_each_time_an_arrow_in_its_direction() -> None:
    root = ElementTree.fromstring(FORMATS["svg"](TOPOLOGY))
    at = {
        str(group.findtext("s:title", namespaces=SVG)).split(",")[0]: [
            float(circle.attrib[name]) for name in ("cx", "cy")
        ]
        for group in root.findall("s:g", SVG)
        if (circle := group.find("s:circle", SVG)) is not None
    }
    said = "".join(str(one.text) for one in root.findall("s:text[@class='time']", SVG))
    arrows = {}
    for edge in edges(TOPOLOGY):
        x, y = (b - a for a, b in zip(at[edge.from_], at[edge.to], strict=True))
        arrow = "→↘↓↙←↖↑↗"[round(math.atan2(y, x) / (math.pi / 4)) % 8]
        if not edge.overlapped:
            arrows[f"{arrow} {seconds(edge.transit.mode)}"] = edge
    assert len(arrows) > 2
    assert all(text in said for text in arrows)


def test_aicity_lines_are_read_as_the_challenge_code_reads_them() -> None:
    """The rules are those of UWIPL's camera_transition.py.

    Integers, lower camera first, zones in their zone lists.
    """
    lines = FORMATS["aicity"](TOPOLOGY).splitlines()

    # Every line is as the reader wants it.
    names = {number: name for name, number in camera_numbers(TOPOLOGY).items()}
    windows = {}
    for line in lines:
        a, lists_a, b, lists_b, zone_a, zone_b, low, high = line.split(" ")
        assert int(a) < int(b)
        assert int(low) < int(high)
        for lists, zone in ((lists_a, zone_a), (lists_b, zone_b)):
            for passage in lists.split(";"):
                assert int(zone) in [int(part) for part in passage.split("-")]
        ends = (f"{names[int(a)]}/{zone_a}", f"{names[int(b)]}/{zone_b}", int(high) > 1)
        windows[ends] = (int(low), int(high))
    assert len(lines) == sum(link.relation != "visible" for link in TOPOLOGY.links)

    # A link from the higher number to the lower has negative times.
    link = next(x for x in TOPOLOGY.links if x.relation == "unseen" and x.from_ > x.to)
    low_frames, high_frames = windows[link.to, link.from_, False]
    assert low_frames <= -10 * link.transit.q90 < low_frames + 1
    assert high_frames - 2 < -10 * link.transit.q10 <= high_frames


@pytest.mark.parametrize(
    "numbers", [{"c041": 41, "c007": 7}, {"gate": 1, "hall": 2}, {"a1": 1, "b1": 2}]
)
def test_camera_numbers_are_those_in_the_names_if_these_differ(numbers: dict[str, int]) -> None:
    cameras = [Camera(name, []) for name in reversed(numbers)]
    assert camera_numbers(msgspec.structs.replace(EMPTY, cameras=cameras)) == numbers


@pytest.mark.parametrize("name", FORMATS)
def test_the_command_writes_every_format_of_any_topology(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "topology.json"
    out = tmp_path / "out"
    alone = msgspec.structs.replace(EMPTY, cameras=TOPOLOGY.cameras[:1], zones=ZONES_OF_FIRST)

    for topology in (EMPTY, alone, TOPOLOGY):
        path.write_bytes(to_json(topology))
        assert main(["export", str(path), "--format", name]) == 0
        assert capsys.readouterr().out == FORMATS[name](topology)

    assert main(["export", str(path), "--format", name, "--out", str(out)]) == 0
    assert out.read_text() == FORMATS[name](TOPOLOGY)
    assert capsys.readouterr().out == ""


def test_the_command_says_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "topology.json"
    command = ["export", str(path), "--format", "dot"]

    assert main(command) == 66
    path.write_text('{"schema":"camtopod/topology/9"}')
    assert main(command) == 66
    path.write_bytes(to_json(TOPOLOGY))
    assert main([*command, "--out", str(tmp_path / "no" / "x")]) == 1
    assert capsys.readouterr().out == ""
