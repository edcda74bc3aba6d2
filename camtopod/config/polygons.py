"""Read areas of the picture: lists of [x, y] points, or texts with the coordinates in a row."""

from __future__ import annotations

from typing import Any

from msgspec.structs import FieldInfo

from camtopod.vision.settings import Polygon

_AREA = "[[x, y], [x, y], [x, y]]"
"""How a polygon is written."""


def points_min(field: FieldInfo) -> int:
    """Return how many points a polygon of the field has at least; 0 if it holds no polygons."""
    metas = getattr(field.type, "__metadata__", ())
    return next((meta.extra["points_min"] for meta in metas if meta.extra), 0)


def parse(value: Any, points_min: int) -> tuple[tuple[Polygon, ...], dict[int | None, str]]:
    """Return the polygons in ``value``, and the mistakes by the index of the polygon.

    value: a list, as tomllib reads it, or one text. An element is a list of points [x, y], a text
        such as "0.1,0.2,0.3,0.4,0.5,0.6" (x and y in turn, as Frigate writes a motion mask), or, if
        ``points_min`` is 1, a single point.
    points_min: 3 for areas, 1 if single points are allowed; two points are neither.

    The index None stands for the whole value.
    """
    if isinstance(value, str):
        value = [value]
    if not isinstance(value, list):
        return (), {None: f"expected a list of polygons, such as [{_AREA}]"}
    found: list[Polygon] = []
    wrong: dict[int | None, str] = {}
    for index, element in enumerate(value):
        try:
            found.append(_polygon(element, points_min))
        except ValueError as error:
            wrong[index] = str(error)
    return tuple(found), wrong


def _polygon(element: Any, points_min: int) -> Polygon:
    """Return one element as a polygon. Raises `ValueError` that names the mistake."""
    if isinstance(element, str):
        points = _pairs(element)
    elif isinstance(element, list) and element and all(map(_is_number, element)):
        points = [element]
    elif isinstance(element, list):
        points = element
    else:
        raise ValueError(f"expected a polygon, {_AREA}")
    if len(points) == 1 and points_min > 1:
        raise ValueError(f"a polygon has three points or more: write [{_AREA}]")
    if len(points) < points_min or len(points) in (0, 2):
        raise ValueError(f"a polygon has three points or more, not {len(points)}")
    return tuple(map(_point, points))


def _pairs(text: str) -> list[list[float]]:
    """Return the points of a text with x and y in turn."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise ValueError(f'{text!r} is not a list of numbers with commas, "x,y,x,y,..."') from None
    if len(numbers) % 2:
        raise ValueError(f"{len(numbers)} numbers are not pairs of x and y")
    return [numbers[at : at + 2] for at in range(0, len(numbers), 2)]


def _point(point: Any) -> tuple[float, float]:
    """Return a point, checked."""
    if not isinstance(point, list) or len(point) != 2 or not all(map(_is_number, point)):
        raise ValueError(f"a point is [x, y], not {point!r}")
    for number in point:
        if not 0 <= number <= 1:
            raise ValueError(
                f"{number:g} is not between 0 and 1; divide pixels by the picture's width or height"
            )
    return float(point[0]), float(point[1])


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
