"""Draw README's animated picture: the demo's site is learned, then predicted.

    python -m bench animation [--out deploy/pictures/demo.svg] [--films FOLDER]

The demo's cameras are rendered and analysed by the grabbers' pipeline, and the learner receives
only its events. The picture is an SVG that repeats itself: first `LEARNED` seconds of the recording
with the links as they are published, then `SHOWN` seconds with predictions of the version learned
until then. ``--films`` keeps the films in FOLDER.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

import numpy as np

from bench.demo import START, recorded
from bench.support.parts import part_parser
from camtopod.arrays import Floats, Longs
from camtopod.cli.commands.demo import MINUTES, WALKERS_PER_SECOND
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.predict import Predictor
from camtopod.records import Event, Prediction, Topology
from camtopod.sim.floor import Plan, View, Walk, demo_plan, simulate_walks

OUT = Path("deploy/pictures/demo.svg")
LEARNED, SHOWN = 900.0, 42.0
"""Parts of the recording that are learned and predicted, seconds."""
FAST, SLOW, REST = 9.0, 14.0, 1.0
"""Seconds of the picture for the two parts, and for its end."""
LOOP = FAST + SLOW + REST
WIDTH, HEIGHT = 920, 540
CARD_WIDTH, CARD_HEIGHT = 180, 135
PLACES = {
    "entrance": (20, 126),
    "hall": (236, 126),
    "corridor": (504, 126),
    "garden": (720, 126),
    "cafe": (300, 326),
}
"""Left upper corner of each camera's card."""
BENDS = {("entrance", "garden"): -220.0, ("cafe", "corridor"): 20.0}
"""How far the middle of an edge is below the straight line, pixels."""
FLOORS = {"stone": "#c9c6c0", "grass": "#a9bf93", "wood": "#cdb491", "brick": "#c49a86"}
PULSE_SECONDS = 0.45
STYLE = """
.paper { fill: #ffffff; stroke: #d0d7de }
.ink { fill: #1f2328 }
.soft { fill: #59636e }
.line { fill: none; stroke-width: 5 }
.overlapped { stroke: #1f2328 }
.unseen_path { stroke: #9aa4ae }
.entry { fill: #1a7f37 }
.exit { fill: #cf222e }
.next { fill: #0969da }
.ring { fill: none; stroke: #0969da; stroke-width: 4 }
.person { stroke: #24292f; stroke-width: 7; stroke-linecap: round }
.way { fill: none; stroke: #fff; stroke-opacity: .35; stroke-width: 14; stroke-linejoin: round }
@media (prefers-color-scheme: dark) {
.paper { fill: #0d1117; stroke: #3d444d }
.ink { fill: #f0f6fc }
.soft { fill: #9198a1 }
.overlapped { stroke: #f0f6fc }
.unseen_path { stroke: #656c76 }
.next { fill: #4493f8 }
.ring { stroke: #4493f8 }
}
"""
TITLE = "Five cameras. No calibration, no floor plan, no re-identification."


def main(argv: list[str]) -> int:
    """Write the picture and return the exit status."""
    parser = part_parser(__name__, __doc__)
    parser.add_argument("--out", type=Path, default=OUT, help="SVG to write")
    parser.add_argument("--films", type=Path, metavar="FOLDER", help="folder to keep the films in")
    arguments = parser.parse_args(argv)

    # Record, learn the first part, and predict the second one.
    plan, seconds = demo_plan(), 60.0 * MINUTES
    walks = simulate_walks(plan, seconds, WALKERS_PER_SECOND, np.random.default_rng(1))
    with tempfile.TemporaryDirectory() as temporary:
        events = recorded(plan, walks, seconds, 1, arguments.films or Path(temporary))
    history = [event for event in events if event.t < START + LEARNED]
    replay = [event for event in events if 0 <= event.t - START - LEARNED < SHOWN]
    versions = versions_of(history)
    predictions = predictions_of(versions[-1], history, replay)

    dots, rings = aims(versions[-1], predictions)
    parts = [*frame(), *edges(versions), *dots, *cards(plan), *map(pulse, history[::3])]
    parts += [*people(plan, walks), *map(pulse, replay), *rings]
    parts += captions(history, versions, predictions)
    whole = tag(
        "svg",
        "\n".join(["", *parts, ""]),
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {WIDTH} {HEIGHT}",
        font_family="system-ui, sans-serif",
    )
    arguments.out.write_text(f"{whole}\n")
    size = arguments.out.stat().st_size
    print(f"{arguments.out}: {size / 1000:.0f} kB, {len(predictions)} predictions")
    return 0


def versions_of(events: Sequence[Event]) -> list[Topology]:
    """Return the versions that the demo's daemon would publish."""
    learner = Learner(Settings(lateness_seconds=5.0, refit_share=0.03), site="demo", epoch="demo")
    versions = []
    for event in events:
        learner.receive(event)
        versions += learner.updates()
    learner.flush()
    return [*versions, *learner.updates()]


def predictions_of(
    topology: Topology, before: Sequence[Event], replay: Sequence[Event]
) -> list[Prediction]:
    """Return the predictions of the exits that are shown, all events being observed."""
    predictor = Predictor(topology)
    for event in before[-100:]:
        predictor.observe(event)
    predictions = []
    for event in replay:
        if event.kind == "exit":
            predictions.append(predictor.answer(event))
        predictor.observe(event)
    return predictions


def tag(name: str, inside: str = "", /, **attributes: object) -> str:
    """Return an element; in the names of attributes ``_`` stands for a hyphen."""
    words = [
        f'{key.removesuffix("_").replace("_", "-")}="{value:.5g}"'
        if isinstance(value, float)
        else f'{key.removesuffix("_").replace("_", "-")}="{value}"'
        for key, value in attributes.items()
    ]
    return f"<{' '.join([name, *words])}>{inside}</{name}>"


def frame() -> list[str]:
    """Return what does not change: paper, title and legend."""
    card = tag("rect", width=CARD_WIDTH, height=CARD_HEIGHT, rx=8)
    left, top = 560, 372
    legend = [
        tag("circle", class_="entry", cx=left, cy=top, r=7),
        tag("text", "entry", x=left + 16, y=top + 5),
        tag("circle", class_="exit", cx=left + 84, cy=top, r=7),
        tag("text", "exit", x=left + 100, y=top + 5),
        tag("circle", class_="next", cx=left, cy=top + 30, r=8),
        tag("text", "predicted: next camera, and when (frame)", x=left + 16, y=top + 35),
        tag("path", class_="line overlapped", d=f"M{left - 12} {top + 60}h24"),
        tag("text", "views overlap", x=left + 20, y=top + 65),
        tag("path", class_="line unseen_path", d=f"M{left + 140} {top + 60}h24"),
        tag("text", "unseen path", x=left + 172, y=top + 65),
    ]
    return [
        tag("style", STYLE),
        tag("clipPath", card, id="card"),
        tag("rect", class_="paper", x=0.5, y=0.5, width=WIDTH - 1, height=HEIGHT - 1, rx=12),
        tag("text", TITLE, class_="ink", x=24, y=40, font_size=21, font_weight=600),
        tag("g", "".join(legend), class_="soft", font_size=16),
    ]


def at(t: float) -> float:
    """Return when the picture shows the time ``t`` of an event, as a share of its loop."""
    seconds = t - START
    if seconds < LEARNED:
        return FAST * seconds / LEARNED / LOOP
    return min(FAST + SLOW * (seconds - LEARNED) / SHOWN, LOOP) / LOOP


def animate(attribute: str, moments: Iterable[tuple[float, str]]) -> str:
    """Return an animation over the whole loop from (share of the loop, value), in order."""
    times, values = zip(*moments, strict=True)
    return looped("animate", times, attributeName=attribute, values=";".join(values))


def looped(name: str, times: Iterable[float], **attributes: object) -> str:
    """Return an animation of any kind, at ``times`` (shares of the loop)."""
    ends = ";".join(f"{min(max(time, 0.0), 1.0):.4f}" for time in times)
    return tag(name, dur=f"{LOOP:g}s", repeatCount="indefinite", keyTimes=ends, **attributes)


def visible(begin: float, end: float, fade: float = 0.005, opacity: str = "1") -> str:
    """Return an animation that shows its element from ``begin`` to ``end``, shares of the loop."""
    begin = max(begin, 1e-4)
    last = min(end, 1.0 - 1e-4)
    moments = [(0.0, "0"), (begin, "0"), (min(begin + fade, last), opacity), (last, opacity)]
    return animate("opacity", [*moments, (min(last + fade, 1.0 - 5e-5), "0"), (1.0, "0")])


def on_card(camera: str, x: float, y: float) -> tuple[float, float]:
    """Return the place of a picture's position, fractions, in the whole."""
    left, top = PLACES[camera]
    return left + CARD_WIDTH * x, top + CARD_HEIGHT * y


def middle(camera: str) -> tuple[float, float]:
    """Return the middle of a card."""
    return on_card(camera, 0.5, 0.5)


def edge_path(a: str, b: str) -> tuple[str, float, float]:
    """Return the path from one card to another, and the place of its label."""
    (xa, ya), (xb, yb) = middle(a), middle(b)
    low, high = sorted((a, b))
    bend = BENDS.get((low, high), 0.0)
    x, y = (xa + xb) / 2, (ya + yb) / 2 + bend
    return f"M{xa:.0f} {ya:.0f}Q{x:.0f} {y:.0f} {xb:.0f} {yb:.0f}", x, y - bend / 2


def edges(versions: Sequence[Topology]) -> list[str]:
    """Return an edge for each camera pair of the last version, from when it was published."""
    last, parts = versions[-1], []
    for pair in last.pairs:
        first = next(v for v in versions if pair.cameras in [p.cameras for p in v.pairs])
        path, x, y = edge_path(*pair.cameras)
        since = visible(at(first.as_of), 1.0, 0.02)
        parts.append(tag("path", class_=f"line {pair.relation}", d=path))
        links = [
            link
            for link in last.links
            if {link.from_.split("/")[0], link.to.split("/")[0]} == {*pair.cameras}
        ]
        if pair.relation == "unseen_path" and links:
            seconds = max(links, key=lambda link: link.transitions).transit.mode
            parts[-1] += tag("rect", class_="paper", x=x - 25, y=y - 14, width=50, height=27, rx=13)
            parts[-1] += tag(
                "text",
                f"{seconds:.0f} s",
                class_="ink",
                x=x,
                y=y + 6,
                font_size=17,
                text_anchor="middle",
            )
        parts[-1] = tag("g", parts[-1] + since, opacity=0)
    return parts


def cards(plan: Plan) -> list[str]:
    """Return the cameras: the floor that each sees, and its name."""
    parts = []
    for view in plan.views:
        left, top = PLACES[view.camera]
        footprint = view.footprint()
        shapes = []
        for area in plan.areas:
            west, south, east, north = area.box
            corners = np.array([(west, south), (east, south), (east, north), (west, north)])
            shapes.append(shape(view, clipped(corners, footprint), FLOORS[area.floor]))
        for a, b in plan.ways:
            share = np.linspace(0, 1, 400)[:, None]
            way = np.array(plan.places[a]) * (1 - share) + np.array(plan.places[b]) * share
            feet = view.feet(way)
            near = (np.abs(feet[:, :2] - 0.5) < 0.65).all(axis=1) & (feet[:, 2] > 0)
            if near.any():
                line = " ".join(
                    f"{CARD_WIDTH * x:.0f},{CARD_HEIGHT * y:.0f}" for x, y, _ in feet[near][::4]
                )
                shapes.append(tag("polyline", class_="way", points=line))
        name = tag("text", view.camera, class_="soft", y=CARD_HEIGHT + 20, font_size=16)
        parts.append(
            placed(view.camera, shapes) + tag("g", name, transform=f"translate({left} {top})")
        )
    return parts


def placed(camera: str, shapes: Iterable[str]) -> str:
    """Return shapes on a camera's card."""
    left, top = PLACES[camera]
    inside = tag("g", "".join(shapes), clip_path="url(#card)")
    return tag("g", inside, transform=f"translate({left} {top})")


def clipped(corners: Floats, window: Floats) -> Floats:
    """Return the part of a convex polygon within another one, (n, 2), by Sutherland and Hodgman."""
    centre = window.mean(axis=0)
    points = list(corners)
    for a, b in zip(window, np.roll(window, -1, axis=0), strict=True):
        normal = np.array((a[1] - b[1], b[0] - a[0]))
        normal *= np.sign(normal @ (centre - a))
        vertices: list[Floats] = []
        for p, q in zip(points, points[1:] + points[:1], strict=True):
            inside, after = normal @ (p - a), normal @ (q - a)
            if inside >= 0:
                vertices.append(p)
            if (inside >= 0) != (after >= 0):
                vertices.append(p + (q - p) * inside / (inside - after))
        points = vertices
    return np.array(points).reshape(-1, 2)


def shape(view: View, floor: Floats, colour: str) -> str:
    """Return a polygon of the floor as the camera sees it."""
    if len(floor) < 3:
        return ""
    points = " ".join(f"{CARD_WIDTH * x:.0f},{CARD_HEIGHT * y:.0f}" for x, y, _ in view.feet(floor))
    return tag("polygon", points=points, fill=colour)


def pulse(event: Event) -> str:
    """Return the entry or exit as a disc that fades."""
    assert event.x is not None
    assert event.y is not None
    x, y = on_card(event.camera, event.x, event.y)
    begin = at(event.t)
    slow = event.t >= START + LEARNED
    radius, seconds = (8, 2 * PULSE_SECONDS) if slow else (5, PULSE_SECONDS)
    moments = [(0.0, "0"), (begin, "0"), (begin + 0.0005, ".9"), (begin + seconds / LOOP, "0")]
    fade = animate("opacity", [*moments, (1.0, "0")])
    return tag("circle", fade, class_=event.kind, cx=round(x), cy=round(y), r=radius, opacity=0)


def people(plan: Plan, walks: Sequence[Walk]) -> list[str]:
    """Return the people of the second part, where a camera sees them."""
    parts = []
    for view in plan.views:
        passages: list[str] = []
        for walk in walks:
            in_view = view.sees(walk.floor) & (walk.t >= LEARNED) & (walk.t < LEARNED + SHOWN)
            samples = np.flatnonzero(in_view)
            runs = np.split(samples, np.flatnonzero(np.diff(samples) > 1) + 1)
            passages += [person(view, walk, run) for run in runs if len(run) > 3]
        parts.append(placed(view.camera, passages))
    return parts


def person(view: View, walk: Walk, run: Longs) -> str:
    """Return one passage of a person; ``run``: the samples in view."""
    samples = run[:: max(len(run) // 8, 1)]
    times = [at(START + t) for t in walk.t[samples]]
    spots = view.feet(walk.floor[samples])[:, :2] * (CARD_WIDTH, CARD_HEIGHT)
    points = [f"{x:.0f} {y:.0f}" for x, y in spots]
    movement = looped(
        "animateTransform",
        [0.0, *times, 1.0],
        attributeName="transform",
        type="translate",
        values=";".join([points[0], *points, points[-1]]),
    )
    body = tag("path", movement, class_="person", d="M0 -3v-11")
    return tag("g", body + visible(times[0], times[-1], 0.001), opacity=0)


def aims(topology: Topology, predictions: Sequence[Prediction]) -> tuple[list[str], list[str]]:
    """Return a dot along the edge for each prediction of an unseen path, and a ring at its end."""
    pairs = {frozenset(pair.cameras) for pair in topology.pairs if pair.relation == "unseen_path"}
    dots, rings = [], []
    for prediction in predictions:
        if not prediction.next:
            continue
        aim = prediction.next[0]
        begin, first, last = (at(prediction.t + s) for s in (0.0, aim.q10, aim.q90))
        if aim.probability < 0.3 or frozenset((prediction.camera, aim.camera)) not in pairs:
            continue
        path, _, _ = edge_path(prediction.camera, aim.camera)
        arrival = min((first + last) / 2, 0.999)
        times = [0.0, begin, arrival, 1.0]
        movement = looped("animateMotion", times, path=path, keyPoints="0;0;1;1", calcMode="linear")
        dots.append(
            tag("circle", movement + visible(begin, arrival), class_="next", r=9, opacity=0)
        )
        left, top = PLACES[aim.camera]
        ring = tag(
            "rect",
            visible(first, last, opacity=f"{aim.probability:.2f}"),
            class_="ring",
            x=left - 4,
            y=top - 4,
            width=CARD_WIDTH + 8,
            height=CARD_HEIGHT + 8,
            rx=11,
            opacity=0,
        )
        rings.append(ring)
    return dots, rings


def captions(
    history: Sequence[Event], versions: Sequence[Topology], predictions: Sequence[Prediction]
) -> list[str]:
    """Return the line that says what is going on, and the last prediction in words."""
    sentences = []
    for minute in range(0, round(LEARNED / 60), 2):
        until = START + 60 * minute
        count = sum(event.t < until for event in history)
        pairs = next((len(v.pairs) for v in reversed(versions) if v.as_of <= until), 0)
        sentence = f"minute {minute}: {count} anonymous entries and exits"
        if pairs:
            sentence += f", {pairs} of 6 pairs of cameras found"
        sentences.append((at(until), sentence))
    sentences.append((at(START + LEARNED), "each exit is predicted:"))
    sentences += [
        (at(prediction.t), f"{prediction.camera} → {str(prediction).split('; ')[0]}")
        for prediction in predictions
        if prediction.next
    ]
    ends = [*(begin for begin, _ in sentences[1:]), 1.0]
    return [
        tag(
            "text",
            escape(text) + visible(begin, end, 1e-4),
            class_="ink",
            x=24,
            y=HEIGHT - 20,
            font_size=19,
            opacity=0,
        )
        for (begin, text), end in zip(sentences, ends, strict=True)
    ]
