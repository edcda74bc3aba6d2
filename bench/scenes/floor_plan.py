"""People on an open floor (metres), and cameras that each see a piece of it in perspective.

A piece is the part of the floor that is in the picture, near enough and not hidden: a convex
polygon. People walk from place to place along slightly curved lines. A passage is the time in which
the foot point is in the piece.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from bench.scenes.recording import GAP_SECONDS, Sightings, join
from camtopod.arrays import Bools, Floats, Longs
from camtopod.sim.floor import View

LEG_KNOTS = 8
"""Straight pieces of a leg of a walk."""
BEND_SD = 0.06
"""Spread of the bend of a leg, as a share of its length."""
WOBBLE_METRES, SWAY_METRES = 0.15, 0.2
"""Spread of people's distance from their line, and of their shifts while they wait, metres."""
WALKING_SPEED, SPEED_SD, LEG_SPEED_SD = 1.3, 0.25, 0.05
"""Median speed, m/s; its spread between people and between a person's legs (log scale)."""
CELL_METRES = 0.5
"""Grid on which a piece's share of the floor is measured, metres."""
VIEW_TRIES_MAX = 2000
"""Most views that are tried."""
PILLAR_SHARE = 0.4
"""Share of the cameras in whose picture an upper corner is hidden."""


@dataclass(frozen=True)
class Piece:
    """A camera's piece of the floor: the picture of ``view`` where a x + b y <= c for all ``cuts``
    (m, 3).
    """

    view: View
    cuts: Floats

    def look(self, floor: Floats) -> tuple[Floats, Bools]:
        """Project floor points (n, 2), metres, to picture fractions (n, 2); and tell which are in
        the piece.
        """
        feet = self.view.feet(floor)
        xy, depth = feet[:, :2], feet[:, 2]
        inside = (np.abs(xy - 0.5) <= 0.5).all(1) & (depth > 0.1)
        return xy, inside & (xy @ self.cuts[:, :2].T <= self.cuts[:, 2]).all(1)


@dataclass(frozen=True)
class Walks:
    """Everybody's places on each frame, person after person.

    person (n,): number of the person.
    t (n,), seconds: time of the frame.
    floor (n, 2), metres: place.
    frame, seconds: time between frames.
    """

    person: Longs
    t: Floats
    floor: Floats
    frame: float


def make_pieces(
    size: tuple[float, float],
    names: list[str],
    share: tuple[float, float],
    common: tuple[float, float],
    rng: np.random.Generator,
) -> list[Piece]:
    """Place cameras on the walls or ceiling over a floor of ``size`` metres.

    Each sees a share of the floor within ``share``; a share within ``common`` of that is also seen
    by earlier cameras. Raises ValueError if no such cameras are found.
    """
    cells = np.stack(
        np.meshgrid(*(np.arange(CELL_METRES / 2, side, CELL_METRES) for side in size)), -1
    ).reshape(-1, 2)

    # Try random views until there are enough.
    is_covered = np.zeros(len(cells), dtype=bool)
    pieces: list[Piece] = []
    for _ in range(VIEW_TRIES_MAX):
        if len(pieces) == len(names):
            return pieces
        piece = _piece(size, names[len(pieces)], rng)
        inside = piece.look(cells)[1] if piece is not None else is_covered
        if piece is None or not share[0] <= inside.mean() <= share[1]:
            continue
        if pieces and not common[0] <= is_covered[inside].mean() <= common[1]:
            continue
        pieces.append(piece)
        is_covered |= inside
    raise ValueError(f"no {len(names)} views of a floor of {size[0]:g} x {size[1]:g} m found")


def _piece(size: tuple[float, float], name: str, rng: np.random.Generator) -> Piece | None:
    """Return a camera that looks at a random place; None if it would hang far outside the floor."""
    target = rng.uniform((0.0, 0.0), size)
    heading, distance = rng.uniform(-math.pi, math.pi), rng.uniform(5.0, 14.0)
    position = target - distance * np.array((math.cos(heading), math.sin(heading)))
    if (position < -1.0).any() or (position > np.array(size) + 1.0).any():
        return None

    # View, cut off far away and maybe by a pillar.
    view = View(
        name,
        (float(target[0]), float(target[1])),
        heading,
        rng.uniform(3.5, 7.0),
        distance,
        rng.uniform(0.6, 1.0),
    )
    ahead = np.array((math.cos(heading), math.sin(heading)))
    far = float(view.feet((position + (distance + rng.uniform(4.0, 14.0)) * ahead)[None])[0, 1])
    cuts = [(0.0, -1.0, -far)]
    if rng.random() < PILLAR_SHARE:
        side = rng.choice((-1.0, 1.0))  # the upper left or right corner is hidden
        cuts.append((side, -1.0, 0.5 * side + 0.5 - rng.uniform(0.3, 0.6)))
    return Piece(view, np.array(cuts))


def walk(
    stops: list[Floats], waits: list[float], speed: float, begin: float, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return the knots of a walk, (k,) seconds and (k, 2) metres, from stop to stop.

    There is a wait at each stop (0: walks on).
    """
    t, times, places = begin, [np.array([begin])], [stops[0][None]]
    for (a, b), wait in zip(pairwise(stops), waits[1:], strict=True):
        ahead = b - a
        length = float(np.linalg.norm(ahead))
        share = np.linspace(0, 1, LEG_KNOTS + 1)[1:]
        aside = BEND_SD * rng.standard_normal() * np.sin(np.pi * share)
        line = a + share[:, None] * ahead + aside[:, None] * np.array((-ahead[1], ahead[0]))
        line[:-1] += WOBBLE_METRES * rng.standard_normal((LEG_KNOTS - 1, 2))
        seconds = length / (speed * math.exp(LEG_SPEED_SD * rng.standard_normal()))
        times.append(t + share * seconds)
        places.append(line)
        t += seconds
        if wait > 0:
            shifts = 1 + int(wait / 10.0)
            times.append(t + wait * np.arange(1, shifts + 1) / shifts)
            places.append(b + SWAY_METRES * rng.standard_normal((shifts, 2)))
            t += wait
    return np.concatenate(times), np.concatenate(places)


def sampled(
    knots: list[tuple[Floats, Floats]], size: tuple[float, float], frame: float, seconds: float
) -> Walks:
    """Return everybody's place on each frame of a recording.

    ``frame`` is the time between frames and ``seconds`` the length of the recording, in seconds.
    """
    persons, t, floor = [np.zeros(0, dtype=np.int64)], [np.zeros(0)], [np.zeros((0, 2))]
    for person, (times, places) in enumerate(knots):
        first, last = (
            max(0, math.ceil(times[0] / frame)),
            math.floor(min(times[-1], seconds) / frame),
        )
        frames = np.arange(first, last + 1) * frame
        if len(frames):
            persons.append(np.full(len(frames), person))
            t.append(frames)
            floor.append(np.column_stack([np.interp(frames, times, column) for column in places.T]))
    everywhere = np.clip(np.concatenate(floor), 0.0, size)
    return Walks(np.concatenate(persons), np.concatenate(t), everywhere, frame)


def sightings(
    pieces: list[Piece], walks: Walks, broken_every: float, rng: np.random.Generator
) -> Sightings:
    """Return the passages of foot points through the pieces.

    A tracker loses a person once in ``broken_every`` seconds on average (inf: never).
    """
    parts = []
    for camera, piece in enumerate(pieces):
        at, inside = piece.look(walks.floor)
        if math.isfinite(broken_every):
            inside = _interrupted(walks, inside, broken_every, rng)

        # First and last frame of each passage.
        stays = inside[1:] & inside[:-1] & (walks.person[1:] == walks.person[:-1])
        begins, ends = inside.copy(), inside.copy()
        begins[1:] &= ~stays
        ends[:-1] &= ~stays
        first, last = np.flatnonzero(begins), np.flatnonzero(ends)
        no_zone = np.full(len(first), -1)
        owner = np.full(len(first), camera)
        parts.append(
            Sightings(
                walks.person[first],
                owner,
                walks.t[first],
                walks.t[last],
                at[first],
                at[last],
                no_zone,
                no_zone,
            )
        )
    return join(parts)


def _interrupted(
    walks: Walks, inside: Bools, mean_seconds: float, rng: np.random.Generator
) -> Bools:
    """Return ``inside`` without the gaps in which a tracker has lost a person."""
    losses = np.flatnonzero(inside & (rng.random(len(inside)) < walks.frame / mean_seconds))
    gap = np.ceil(rng.uniform(*GAP_SECONDS, len(losses)) / walks.frame).astype(np.int64)
    result = inside.copy()
    for k in range(int(gap.max(initial=0))):
        at = np.minimum(losses + k, len(inside) - 1)
        result[at[(k < gap) & (walks.person[at] == walks.person[losses])]] = False
    return result
