"""What the user has declared of the site: which cameras are neighbours, which are not (METHOD 7).

Declarations enter at three places, each by one factor for a pair of cameras
(`camtopod.topology.declared_odds`):

* as weights of the p-values of pairs of zones (`zone_weights`; Genovese, Roeder, Wasserman,
  Biometrika 93(3), 2006): their mean is 1 over all pairs that are tested, and they are fixed before
  the events are seen, so the false discovery rate stays what it says;
* as factors of the rates of candidates in the fits (`camtopod.topology.favours`), and of the odds
  that transitions are not spurious (`next_camera.spurious`);
* in predictions, where objects that are not found may be (`predict.anywhere`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from camtopod.arrays import Floats, Ints
from camtopod.learn.settings import TopologySettings
from camtopod.records import Declared
from camtopod.topology import declared_odds


def declared_by(
    settings: TopologySettings, names: Mapping[str, str], cameras: Sequence[str]
) -> Declared:
    """Return what the settings declare of ``cameras``, by their present names.

    names: old names of renamed cameras -> present ones; forgotten names -> "".

    If renaming has made one pair of two that contradict each other, they are neighbours.
    """
    camera_set = set(cameras)

    def present(pairs: Sequence[tuple[str, str]]) -> set[tuple[str, str]]:
        name_pairs = [(names.get(a, a), names.get(b, b)) for a, b in pairs]
        return {
            (min(pair), max(pair))
            for pair in name_pairs
            if camera_set.issuperset(pair) and pair[0] != pair[1]
        }

    neighbours = present(settings.neighbours)
    apart = present(settings.not_neighbours) - neighbours
    return Declared(sorted(neighbours), sorted(apart), settings.nobody_leaves)


def forgotten(names: Mapping[str, str], camera: str) -> dict[str, str]:
    """Return the names, as of `declared_by`, once a camera has been forgotten."""
    result = {old: "" if new == camera else new for old, new in names.items()}
    return result | {camera: ""}


def taken_back(names: Mapping[str, str], camera: str) -> dict[str, str]:
    """Return the names, as of `declared_by`, once a forgotten one may be a camera's again."""
    return {old: new for old, new in names.items() if old != camera}


def zone_weights(declarations: Declared, cameras: Sequence[str], camera: Ints) -> Floats | None:
    """Return the weight (zones, zones) of each pair of zones, with a mean of 1; None for 1.

    cameras: names of all cameras.
    camera (zones,): number of each zone's camera.
    """
    odds = declared_odds(declarations, cameras)
    if odds is None:
        return None
    of_zones: Floats = odds[camera[:, None], camera]
    of_zones /= of_zones.mean()
    return of_zones
