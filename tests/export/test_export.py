"""Exports are read back by other programs, or by simple parsers where these are missing."""

from __future__ import annotations

import io
import json
import re
import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import msgspec
import networkx as nx
import pytest
from synthetic_events import topology_of

from camtopod.cli.main import main
from camtopod.codec import to_json
from camtopod.export import FORMATS
from camtopod.export.aicity import camera_numbers
from camtopod.export.graph import edges
from camtopod.records import Camera, Topology
from camtopod.sim.simulation import SimSettings, simulate

TOPOLOGY = topology_of(simulate(SimSettings(cameras=7, hours=0.5, seed=2))[1])
PAIRS = {(pair.cameras, pair.relation == "overlapped") for pair in TOPOLOGY.pairs}
EMPTY = msgspec.structs.replace(TOPOLOGY, cameras=[], zones=[], links=[], pairs=[])


def related(graph: list[tuple[str, str, bool]]) -> set[tuple[tuple[str, str], bool]]:
    """Convert directed edges to pairs."""
    pairs: dict[tuple[str, str], bool] = {}
    for a, b, overlapped in graph:
        key = (min(a, b), max(a, b))
        pairs[key] = pairs.get(key, False) or overlapped
    return set(pairs.items())


def test_edges_are_the_pairs() -> None:
    found = edges(TOPOLOGY)
    assert related([(e.from_, e.to, e.overlapped) for e in found]) == PAIRS
    for edge in found:
        assert 0 < edge.probability <= 1
        assert edge.colour == ("black" if edge.overlapped else "gray60")


def test_graphml_is_read_by_networkx() -> None:
    graph = nx.read_graphml(io.StringIO(FORMATS["graphml"](TOPOLOGY)))
    assert set(graph.nodes) == {camera.id for camera in TOPOLOGY.cameras}
    assert (
        related([(a, b, d["relation"] == "overlapped") for a, b, d in graph.edges(data=True)])
        == PAIRS
    )
    for edge in edges(TOPOLOGY):
        data = graph.edges[edge.from_, edge.to]
        assert (data["weight"], data["q90"]) == (edge.transit.mode, edge.transit.q90)
        assert data["probability"] == edge.probability
    assert graph.nodes["cam01"]["zones"] == len(TOPOLOGY.cameras[0].zones)


def test_json_is_read_by_networkx() -> None:
    graph = nx.node_link_graph(json.loads(FORMATS["json"](TOPOLOGY)), edges="links")
    assert related([(a, b, d["colour"] == "black") for a, b, d in graph.edges(data=True)]) == PAIRS
    zones = sum(len(data["zones"]) for _, data in graph.nodes(data=True))
    assert zones == len(TOPOLOGY.zones)


def test_dot_has_every_camera_and_edge() -> None:
    text = FORMATS["dot"](TOPOLOGY)
    found = re.findall(
        r'^  "([^"]+)" -> "([^"]+)" \[color="(\w+)", label="(-?[\d.]+) s"', text, re.M
    )
    assert related([(a, b, colour == "black") for a, b, colour, _ in found]) == PAIRS
    assert len(re.findall(r'^  "[^"]+" \[label=', text, re.M)) == len(TOPOLOGY.cameras)
    assert text.count("{") == text.count("}") == 1


@pytest.mark.skipif(shutil.which("dot") is None, reason="graphviz is not installed")
def test_dot_is_read_by_graphviz() -> None:
    text = FORMATS["dot"](TOPOLOGY).encode()
    done = subprocess.run(
        ["dot", "-Tplain"], input=text, capture_output=True, check=True, timeout=30
    )
    lines = done.stdout.decode().splitlines()
    assert sum(line.startswith("edge ") for line in lines) == len(edges(TOPOLOGY))
    assert not done.stderr


@pytest.mark.skipif(shutil.which("dot") is None, reason="graphviz is not installed")
@pytest.mark.parametrize("name", ["a\\", 'a"b', 'a\\"b', "a\nb", "<b>&", "node"])
def test_dot_survives_any_name(name: str) -> None:
    odd = msgspec.structs.replace(EMPTY, site=name, cameras=[Camera(name, []), Camera("other", [])])
    done = subprocess.run(
        ["dot", "-Tplain"], input=FORMATS["dot"](odd).encode(), capture_output=True, timeout=30
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert sum(line.startswith(b"node ") for line in done.stdout.splitlines()) == 2


SVG = {"s": "http://www.w3.org/2000/svg"}


def test_svg_is_xml_with_black_and_grey_edges() -> None:
    root = ElementTree.fromstring(FORMATS["svg"](TOPOLOGY))
    _, _, width, height = map(float, root.attrib["viewBox"].split())
    groups = [g for g in root.findall("s:g", SVG) if g.find("s:title", SVG) is not None]
    strokes = [line.attrib["stroke"] for g in groups for line in g.findall("s:line", SVG)]
    assert strokes.count("#111513") == sum(overlapped for _, overlapped in PAIRS)
    assert strokes.count("#85908a") == sum(not overlapped for _, overlapped in PAIRS)
    titles = {str(g.findtext("s:title", namespaces=SVG)).split(",")[0] for g in groups}
    assert {camera.id for camera in TOPOLOGY.cameras} <= titles
    for circle in root.findall("s:g/s:circle", SVG):
        assert 11 <= float(circle.attrib["cx"]) <= width - 11
        assert 11 <= float(circle.attrib["cy"]) <= height - 11


def test_svg_writes_names_and_times_where_they_hit_nothing() -> None:
    root = ElementTree.fromstring(FORMATS["svg"](TOPOLOGY))
    circles = [
        (float(c.attrib["cx"]), float(c.attrib["cy"])) for c in root.findall("s:g/s:circle", SVG)
    ]
    texts = [
        (float(t.attrib["x"]), float(t.attrib["y"]) - 4.5, len(str(t.text)) * 5.5)
        for t in root.findall("s:text", SVG)
        if t.attrib.get("class") != "title"
    ]
    assert len(texts) > len(TOPOLOGY.cameras), "names, and times of paths"
    for k, (x, y, width) in enumerate(texts):
        assert all(abs(x - cx) > width / 2 or abs(y - cy) > 8 for cx, cy in circles)
        for other, height, wide in texts[:k]:
            assert abs(x - other) > (width + wide) / 2 or abs(y - height) > 12


def test_mermaid_has_every_camera_and_edge() -> None:
    text = FORMATS["mermaid"](TOPOLOGY)
    name = dict(re.findall(r'^  (c\d+)\(\["([^"]+)"\]\)$', text, re.M))
    assert list(name.values()) == [camera.id for camera in TOPOLOGY.cameras]
    paths = re.findall(r'^  (c\d+) -->\|"[\d.]+ s"\| (c\d+)$', text, re.M)
    overlaps = re.findall(r"^  (c\d+) === (c\d+)$", text, re.M)
    assert len(name) + len(paths) + len(overlaps) + 1 == len(text.splitlines())
    found = [(name[a], name[b], False) for a, b in paths]
    assert related(found + [(name[a], name[b], True) for a, b in overlaps]) == PAIRS


@pytest.mark.parametrize("name", ['a"b', "a#b", "end", "a\nb", "<b>&"])
def test_mermaid_survives_any_name(name: str) -> None:
    odd = msgspec.structs.replace(EMPTY, cameras=[Camera(name, [])])
    _, node = FORMATS["mermaid"](odd).splitlines()
    shown = re.fullmatch(r'  c0\(\["([^"<]+)"\]\)', node)
    assert shown is not None
    unescaped = shown[1].replace("#quot;", '"').replace("#lt;", "<").replace("#35;", "#")
    assert unescaped == name.replace("\n", "\\n")


def test_svg_survives_a_site_with_markup_in_its_name() -> None:
    root = ElementTree.fromstring(FORMATS["svg"](msgspec.structs.replace(TOPOLOGY, site="a<b & c")))
    assert "a<b & c" in (root.findtext("{http://www.w3.org/2000/svg}title") or "")


def test_aicity_lines_are_read_as_the_challenge_code_reads_them() -> None:
    """The rules are those of UWIPL's camera_transition.py.

    Integers, lower camera first, zones in their zone lists.
    """
    numbers = camera_numbers(TOPOLOGY)
    names = {number: name for name, number in numbers.items()}
    windows = {}
    for line in FORMATS["aicity"](TOPOLOGY).splitlines():
        a, lists_a, b, lists_b, z_a, z_b, low, high = line.split(" ")
        assert int(a) < int(b)
        assert int(low) < int(high)
        for lists, zone in ((lists_a, z_a), (lists_b, z_b)):
            for passage in lists.split(";"):
                assert int(zone) in [int(part) for part in passage.split("-")]
        windows[names[int(a)], int(z_a), names[int(b)], int(z_b), int(high) > 1] = (
            int(low),
            int(high),
        )
    links = [link for link in TOPOLOGY.links if link.relation != "visible"]
    assert len(FORMATS["aicity"](TOPOLOGY).splitlines()) == len(links)
    link = next(x for x in links if x.relation == "unseen" and x.from_ > x.to)
    (camera, zone), (source, exit_) = link.to.split("/"), link.from_.split("/")
    low, high = windows[camera, int(zone), source, int(exit_), False]
    assert low <= -10 * link.transit.q90 < low + 1
    assert high - 2 < -10 * link.transit.q10 <= high


def test_camera_numbers_are_those_in_the_names_if_these_differ() -> None:
    def numbers(*names: str) -> dict[str, int]:
        cameras = [msgspec.structs.replace(TOPOLOGY.cameras[0], id=name) for name in names]
        return camera_numbers(msgspec.structs.replace(TOPOLOGY, cameras=cameras))

    assert numbers("c041", "c007") == {"c041": 41, "c007": 7}
    assert numbers("hall", "gate") == {"gate": 1, "hall": 2}
    assert numbers("a1", "b1") == {"a1": 1, "b1": 2}


@pytest.mark.parametrize("name", FORMATS)
def test_an_empty_topology_is_no_error(name: str) -> None:
    FORMATS[name](EMPTY)
    alone = msgspec.structs.replace(EMPTY, cameras=TOPOLOGY.cameras[:1], zones=TOPOLOGY.zones[:5])
    FORMATS[name](alone)


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "t.json", tmp_path / "o"
    path.write_bytes(to_json(TOPOLOGY))
    for name, export in FORMATS.items():
        assert main(["export", str(path), "--format", name]) == 0
        assert capsys.readouterr().out == export(TOPOLOGY)
        assert main(["export", str(path), "--format", name, "--out", str(out)]) == 0
        assert out.read_text() == export(TOPOLOGY)
        assert capsys.readouterr().out == ""


def test_command_says_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "t.json"
    assert main(["export", str(path), "--format", "dot"]) == 66
    path.write_text('{"schema":"camtopod/topology/9"}')
    assert main(["export", str(path), "--format", "dot"]) == 66
    path.write_bytes(to_json(TOPOLOGY))
    assert main(["export", str(path), "--format", "dot", "--out", str(tmp_path / "no" / "x")]) == 1
    assert capsys.readouterr().out == ""


def test_made_topology_is_one(tmp_path: Path) -> None:
    assert msgspec.json.decode(to_json(TOPOLOGY), type=Topology) == TOPOLOGY
