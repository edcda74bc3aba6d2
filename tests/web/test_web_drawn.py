"""The page's drawings in a browser: edges, times and names on the map, line of versions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import msgspec
import pytest
from chromium import Browser
from page_fixture import Shown, opened
from synthetic_topology import made_link, synthetic_topology

from camtopod.records import Camera, Pair, SelfScore, Topology, Zone
from camtopod.web import report
from camtopod.web.single_file import page

SITE = synthetic_topology(9)
SCORE = SelfScore(200, 1, 1.1, 0.75, 0.91, 1.6, 0.55)
BOXES = """
const boxes = (selector) => [...document.querySelectorAll(selector)].map((one) => one.getBoundingClientRect());
const upon = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
"""
CLASHES = f"""
{BOXES}
const all = boxes('.labels text');
return all.filter((a) => all.some((b) => a !== b && upon(a, b))).length
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
        weak_links=None,
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


def test_overlapping_views_have_no_negative_time(browser: Browser, show: Shows) -> None:
    """The object appears in the second view before it leaves the first."""
    show(joined(("a", "b", -4.5, -4.5, 400.0), ("b", "c", 9.0, 9.0, 400.0)))
    browser.wait(lambda: sorted(times(browser)) == ["9.0 s", "overlap"], "what is on the edges")
    browser.go("#/link/a%2F1/b%2F1/overlapped")
    browser.wait(lambda: "they appear at b/1 4.5 s before" in browser.text(".lead"), "the headline")
    assert "−" not in browser.text(".lead")
    browser.go("#/links")
    browser.wait(lambda: "4.5 s before" in browser.text(".page table"), "the table")
    browser.go("#/camera/a")
    browser.wait(lambda: "overlap" in browser.text(".panel .links"), "the camera's list")


def test_zones_at_the_border_of_the_picture_are_whole(browser: Browser, show: Shows) -> None:
    corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.5, 1.0)]
    site = joined(("a", "b", 9.0, 9.0, 400.0))
    zones = [
        msgspec.structs.replace(site.zones[0], id=f"a/{k}", x=x, y=y)
        for k, (x, y) in enumerate(corners, 1)
    ]
    cameras = [Camera("a", [zone.id for zone in zones]), site.cameras[1]]
    show(msgspec.structs.replace(site, cameras=cameras, zones=[*zones, site.zones[1]]))
    browser.go("#/camera/a")
    browser.wait(lambda: browser.count(".scene .zone") == len(corners), "the zones")
    outside = (
        "const [panel] = boxes('.panel'); const frame = boxes('.scene svg')[0];"
        "return boxes('.scene .zone text').filter((one) => one.left < frame.left || one.right > frame.right"
        " || one.top < frame.top || one.bottom > frame.bottom).length"
        " + boxes('.scene .zone').filter((one) => one.left < panel.left || one.right > panel.right).length"
    )
    assert browser.run(f"{BOXES} {outside}") == 0
    assert (
        browser.run("return getComputedStyle(document.querySelector('.scene svg')).overflow")
        == "visible"
    )


def test_published_and_busy_edges_have_their_times_before_others(
    browser: Browser, show: Shows
) -> None:
    """A wheel has more spokes than there is room for; the first by name are the least busy."""
    spokes = [f"c{k:02d}" for k in range(60)]
    rare, busy = spokes[:40], spokes[40:]
    topology = joined(
        *((one, "hub", 11.0, 11.0, 8.0) for one in rare),
        *((one, "hub", 22.0, 22.0, 500.0) for one in busy),
    )
    show(topology)
    browser.wait(lambda: len(times(browser)) > 5, "times")
    assert times(browser).count("22 s") == len(busy)
    assert times(browser).count("11 s") < len(rare)


@pytest.mark.parametrize(("width", "height", "share"), [(1280, 800, 1.0), (390, 844, 0.5)])
def test_a_dozen_cameras_have_room_for_their_times(
    browser: Browser, show: Shows, width: int, height: int, share: float
) -> None:
    topology = synthetic_topology(12)
    show(topology, width=width, height=height)

    browser.wait(lambda: len(times(browser)) >= share * len(topology.pairs), "the times")
    assert browser.count(".labels .name") == 12
    assert browser.run(CLASHES) == 0, "none upon another"


def test_in_a_wide_font_names_and_times_are_not_upon_another(browser: Browser, show: Shows) -> None:
    spaced = "document.documentElement.style.letterSpacing = '4px'"
    with browser.running_first(
        f"document.addEventListener('readystatechange', () => {{{spaced}}})"
    ):
        show(synthetic_topology(30))
    assert browser.run(CLASHES) == 0
    assert browser.count(".labels text") > 20


def test_a_wide_map_is_turned_on_a_high_screen(browser: Browser, show: Shows) -> None:
    show(joined(*((f"c{k}", f"c{k + 1}", 9.0, 9.0, 90.0) for k in range(5))))
    sizes = (
        "const all = boxes('.node circle'); const range = (side) =>"
        " Math.max(...all.map((one) => one[side])) - Math.min(...all.map((one) => one[side]));"
        "return [range('x'), range('y')];"
    )
    width, height = browser.run(f"{BOXES} {sizes}")
    assert width > 3 * height
    browser.size(390, 844)
    browser.wait(lambda: browser.run(f"{BOXES} {sizes}")[1] > 3 * height + 200, "it to be turned")
    width, height = browser.run(f"{BOXES} {sizes}")
    assert height > 3 * width


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


def test_versions_with_a_score_are_as_high_as_it_and_those_without_are_there(
    browser: Browser, show: Shows
) -> None:
    scores = [None, None, SCORE, SCORE, msgspec.structs.replace(SCORE, top1=0.5)]
    versions = [
        msgspec.structs.replace(SITE, version=k, as_of=SITE.as_of + 86400.0 * k, score=score)
        for k, score in enumerate(scores, 1)
    ]
    show(*versions, place="#/versions")

    browser.wait(lambda: browser.count(".page .mark") == 5, "a mark each")
    height = (
        "return [...document.querySelectorAll('.page .mark')].map((one) => one.cy.baseVal.value)"
    )
    days = (
        "return [...document.querySelectorAll('.chart .axis text')].map((one) => one.textContent)"
    )
    y = browser.run(height)
    assert y[0] == y[1] > y[4] > y[2] == y[3]
    assert browser.count(".page .mark.unscored") == 2, "not as if they had been wrong each time"
    assert len(set(browser.run(days)) & {f"{day} Nov" for day in range(14, 22)}) == 3


def test_an_address_of_a_link_without_its_relation_opens_the_only_one(browser: Browser) -> None:
    shown = Shown(SITE)
    path = next(link for link in SITE.links if link.relation == "unseen")
    inside = next(link for link in SITE.links if link.relation == "visible")
    with shown.serving():
        for link in (path, inside):
            opened(browser, shown, f"#/link/{quote(link.from_, safe='')}/{quote(link.to, safe='')}")
            browser.wait(lambda: browser.count(".panel .chart .count") > 1, "its chart")
            assert browser.text(".panel h2") == f"{link.from_} → {link.to}"
        assert "drawn anew from the fitted curve" in browser.text(".panel .legend")
        browser.go(f"#/link/{quote(path.from_, safe='')}/{quote(path.from_, safe='')}")
        browser.wait(
            lambda: f"No link leads from {path.from_} to" in browser.text(".panel"),
            "that there is none",
        )
