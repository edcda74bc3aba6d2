"""The page's drawings in a browser: edges, times and names on the map, line of versions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from chromium import Browser
from synthetic_topology import made_link, synthetic_topology

from camtopod.records import Camera, Pair, Topology, Zone
from camtopod.web import report
from camtopod.web.single_file import page

SITE = synthetic_topology(9)
BOXES = """
const boxes = (selector) => [...document.querySelectorAll(selector)].map((one) => one.getBoundingClientRect());
const upon = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
"""
CLASHES = f"""
{BOXES}
const all = boxes('.labels text');
const others = [...all, ...boxes('.node circle'), ...boxes('.overlay')];
return all.filter((a) => others.some((b) => a !== b && upon(a, b))).length
"""
STYLES = """
return Object.fromEntries([...document.querySelectorAll('.edge')].map((one) => {
  const { stroke, strokeDasharray, strokeWidth } = getComputedStyle(one);
  return [one.dataset.key, { stroke, dash: strokeDasharray, width: parseFloat(strokeWidth) }];
}))
"""
Shows = Callable[..., None]


@pytest.fixture
def show(browser: Browser, tmp_path: Path) -> Iterator[Shows]:
    """Open a report on the last of some versions, on a desktop or in another size, without complaints."""

    def open_report(
        *versions: Topology, width: int = 1280, height: int = 800, place: str = ""
    ) -> None:
        path = tmp_path / "report.html"
        path.write_text(page(report.gather(versions[-1], versions[:-1], None)), "utf-8")
        browser.size(width, height)
        browser.open(path.as_uri() + place)
        cameras = len(versions[-1].cameras)
        browser.wait(lambda: browser.count(".node") == cameras, "the map")
        browser.wait(lambda: browser.count(".labels .name") > 0 or bool(place), "it to be drawn")

    yield open_report
    assert browser.complaints() == []


def joined(*edges: tuple[str, str, float, float, float]) -> Topology:
    """Return cameras joined as given: from, to, seconds there, seconds back, transitions."""
    names = sorted({name for a, b, *_ in edges for name in (a, b)})
    links = [
        made_link(f"{one}/1", f"{other}/1", seconds, taken, overlapped=seconds < 0)
        for a, b, there, back, taken in edges
        for one, other, seconds in ((a, b, there), (b, a, back))
    ]
    pairs = [
        Pair((min(a, b), max(a, b)), "overlapped" if t < 0 else "unseen_path")
        for a, b, t, *_ in edges
    ]
    return msgspec.structs.replace(
        SITE,
        cameras=[Camera(name, [f"{name}/1"], 0.0, 0.1) for name in names],
        zones=[
            Zone(f"{name}/1", name, 100, 100, 0.5, 0.5, [[0.002, 0.0], [0.0, 0.002]])
            for name in names
        ],
        links=links,
        pairs=pairs,
        model=None,
        alarms=None,
        score=None,
    )


def times(browser: Browser) -> list[str]:
    """Return the times on the map."""
    found = browser.run(
        "return [...document.querySelectorAll('.labels .time')].map((one) => one.textContent)"
    )
    return [str(one) for one in found]


def test_an_edges_colour_dash_and_width_say_what_it_is(browser: Browser, show: Shows) -> None:
    show(
        joined(
            ("a", "b", -1.0, -1.0, 400.0),
            ("b", "c", 9.0, 9.0, 400.0),
            ("c", "d", 9.0, 9.0, 40.0),
            ("d", "e", 9.0, 9.0, 10.0),
        )
    )
    edges: dict[str, Any] = browser.run(STYLES)

    assert edges["a b"]["stroke"] != edges["b c"]["stroke"]
    level = {
        key: sum(int(part) for part in one["stroke"][4:-1].split(",")) / 3
        for key, one in edges.items()
    }
    assert level["a b"] < 40, "overlapping views are black"
    assert 100 < level["b c"] == level["c d"] == level["d e"] < 200, "unseen paths are grey"
    assert [edges[key]["dash"] == "none" for key in ("a b", "b c", "c d", "d e")] == [
        True,
        True,
        True,
        False,
    ]
    assert edges["b c"]["width"] > 1.5 * edges["c d"]["width"] > 0, "wider with traffic"
    assert edges["b c"]["width"] == edges["a b"]["width"]


def test_each_time_says_which_way_it_is_of_where_they_differ(browser: Browser, show: Shows) -> None:
    show(joined(("a", "b", 15.0, 27.0, 400.0), ("b", "c", 9.0, 9.2, 400.0)))
    browser.wait(lambda: len(times(browser)) == 2, "both times")
    a, b = browser.run(
        f"{BOXES} return ['a', 'b'].map((id) => boxes(`.node[data-id=${{id}}] circle`)[0]).map((one) => [one.x, one.y])"
    )

    assert abs(a[0] - b[0]) > 5 * abs(a[1] - b[1]), "they lie beside each other"
    there, back = ("→", "←") if a[0] < b[0] else ("←", "→")
    assert sorted(times(browser)) == sorted(["9.0 s", f"{there} 15 {back} 27 s"])


@pytest.mark.parametrize(
    ("cameras", "width", "height", "names", "share"),
    [
        (12, 1280, 800, 12, 1.0),
        (12, 390, 844, 12, 0.5),
        (200, 1280, 800, 100, 0),
        (200, 390, 844, 20, 0),
    ],
)
def test_names_and_times_are_where_there_is_room(
    browser: Browser,
    show: Shows,
    monkeypatch: pytest.MonkeyPatch,
    cameras: int,
    width: int,
    height: int,
    names: int,
    share: float,
) -> None:
    monkeypatch.setattr(report, "LINKS_MAX", 0)  # their details are not on the map
    topology = synthetic_topology(cameras)
    show(topology, width=width, height=height)

    browser.wait(lambda: len(times(browser)) >= share * len(topology.pairs), "the times")
    assert browser.count(".labels .name") >= names
    assert browser.run(CLASHES) == 0, "none upon another, a camera or what lies on the map"


def test_versions_are_on_a_time_line_before_there_is_a_score_and_all_can_be_listed(
    browser: Browser, show: Shows
) -> None:
    versions = [
        msgspec.structs.replace(SITE, version=k, as_of=SITE.as_of + 60.0 * k, score=None)
        for k in range(1, 46)
    ]
    changed = msgspec.structs.replace(versions[-1], pairs=SITE.pairs[1:])
    show(*versions[:-1], changed, place="#/versions")

    browser.wait(lambda: browser.count(".page .mark") == 45, "a mark each")
    places = browser.run(
        "return [...document.querySelectorAll('.page .mark')].map((one) => one.cx.baseVal.value)"
    )
    assert places == sorted(set(places)), "along the time"
    assert browser.count(".page .axis text") >= 3
    assert "needs two scored versions" in browser.text(".columns")

    assert "What changed from version 44 to 45" in browser.text(".columns")
    assert browser.text(".changes .gone b") == " – ".join(SITE.pairs[0].cameras)
    browser.go("#/versions/44")
    browser.wait(lambda: "No camera, pair, link or zone came" in browser.text(".columns"), "44")

    assert browser.count(".page tbody tr") == 40
    assert browser.text(".page .more") == "Show 5 more"
    browser.run("document.querySelector('.page .more').focus()")
    browser.press("ENTER")
    browser.wait(lambda: browser.count(".page tbody tr") == 45, "all of them")
    assert browser.count(".page .more") == 0


def test_a_name_that_is_wider_than_the_screen_makes_no_map_small(
    browser: Browser, show: Shows
) -> None:
    show(joined(("a", "b", 9.0, 9.0, 400.0), ("b", "c" * 64, 9.0, 9.0, 400.0)), width=390)
    middles = "return [...document.querySelectorAll('.node circle')].map((one) => one.getBoundingClientRect().y)"
    places = browser.run(middles)
    assert max(places) - min(places) > 200, "of the 800 pixels of the screen"
