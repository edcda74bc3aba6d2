"""Check that the columns of a model are as long as they should be, and their numbers possible."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camtopod.columns import numbers
from camtopod.records import LAG_BINS_MAX, Camera, Histograms, Model, Zone

Range = tuple[float, float]
COUNT: Range = (0, 2**31 - 1)
SHARE: Range = (0.0, 1.001)
NUMBER: Range = (0.0, 1e15)
SECONDS: Range = (-1e11, 1e11)
DURATION: Range = (0.0, 1e11)
"""Ranges of numbers, as in `camtopod.records`."""
DECILES = 11
FIGURES = 14
"""Widths of `Model.stay` and `WeakLinks.figures`."""
OPTIONAL_FIGURES = (8, 9, 12, 13)
"""Columns of `WeakLinks.figures` that may be nan."""


def problems(
    model: Model,
    zones: Sequence[Zone],
    cameras: Sequence[Camera],
    bins: tuple[int, int],
    offsets: tuple[int, int],
) -> Iterator[str]:
    """Yield a phrase for the first problem, with its place in the JSON.

    bins, offsets: the first bin of the model's lags, and of the offsets of two passages, and the
        one after the last.
    """
    zone, camera = (0, len(zones) - 1), (0, len(cameras) - 1)
    try:
        _of_zones_and_cameras(model, len(zones), len(cameras))
        _next_zones(model, len(zones), zone, bins)
        _contexts(model, len(zones), zone, camera)
        _few(model, len(zones), zone, camera, offsets)
    except ValueError as error:
        yield str(error)


def _column(
    table: Any,
    name: str,
    shape: tuple[int, ...],
    limits: Range | None,
    kind: type[np.generic] = np.float32,
    optional: bool = False,
) -> NDArray[Any]:
    """Return a column of a table; raise ValueError if it is not of this shape, and within limits.

    optional: it may be empty, for zeros.
    """
    raw = getattr(table, name)
    place = f"{type(table).__name__} - at `$.model.{name}`"
    if not raw and not optional and -1 not in shape and np.prod(shape):
        raise ValueError(f"no numbers, which there should be in {place}")
    try:
        column = numbers(raw, kind, *shape)
    except ValueError:
        raise ValueError(f"more or fewer numbers than there should be in {place}") from None
    if limits and column.size and not (limits[0] <= column.min() and column.max() <= limits[1]):
        raise ValueError(f"a number out of its range in {place}")
    return column


def _hazards(histograms: Histograms, rows: int, bins: tuple[int, int]) -> None:
    """Check histograms, one for each row, which are on the given bins."""
    length = _column(histograms, "bins", (rows,), (0, LAG_BINS_MAX), np.int16)
    first = _column(histograms, "first", (rows,), (-(2**15), 2**15), np.int16)
    _column(histograms, "unit", (rows,), NUMBER)
    _column(histograms, "steps", (int(length.sum()),), (0, 255), np.uint8)
    end = first.astype(int) + length
    if ((length > 0) & ((first < bins[0]) | (end > bins[1]))).any():
        raise ValueError("a histogram is not on the lag bins - at `$.model.hazard`")


def _of_zones_and_cameras(model: Model, zones: int, cameras: int) -> None:
    _column(model, "departures", (zones,), COUNT, np.int32, optional=True)
    _column(model, "arrival_rate", (zones,), NUMBER, optional=True)
    stay = _column(model, "stay", (zones, DECILES), DURATION, optional=True)
    if (np.diff(stay, axis=1) < 0.0).any():
        raise ValueError("deciles are not in ascending order - at `$.model.stay`")
    _column(model, "event_share", (cameras,), SHARE, optional=True)
    _column(model, "last_event", (cameras,), SECONDS, np.float64, optional=True)


def _next_zones(model: Model, zones: int, zone: Range, bins: tuple[int, int]) -> None:
    if (onward := model.onward) is not None:
        number = _column(onward, "number", (zones,), COUNT, np.int32)
        rows = int(number.sum())
        _column(onward, "leave", (zones,), SHARE)
        _column(onward, "to", (rows,), zone, np.int32)
        _column(onward, "share", (rows,), NUMBER)
        _column(onward, "doubt", (rows,), SHARE)
        _column(onward, "delay", (rows,), DURATION)
        _column(onward, "missed", (rows,), (0, 1), np.uint8)
        _hazards(onward.hazard, rows, bins)
    if (kernels := model.entered) is not None:
        rows = len(_column(kernels, "zone", (-1,), zone, np.int32))
        _column(kernels, "to", (rows,), zone, np.int32)
        _hazards(kernels.hazard, rows, bins)


def _contexts(model: Model, zones: int, zone: Range, camera: Range) -> None:
    if (contexts := model.contexts) is not None:
        rows = int(_column(contexts, "number", (zones,), COUNT, np.int32).sum())
        _column(contexts, "entry", (rows,), (-1, zone[1]), np.int32)
        _column(contexts, "block", (rows,), (-1, COUNT[1]), np.int32)
        _column(contexts, "previous", (rows,), (-1, camera[1]), np.int32)
        _column(contexts, "departures", (rows,), NUMBER)
        counts = _column(contexts, "followed", (rows,), (0, 2**15), np.int16)
        _column(contexts, "to", (int(counts.sum()),), zone, np.int32)
        _column(contexts, "transitions", (int(counts.sum()),), NUMBER)


def _few(model: Model, zones: int, zone: Range, camera: Range, offsets: tuple[int, int]) -> None:
    """Check the tables that have few rows."""
    if (pace := model.pace) is not None:
        rows = len(_column(pace, "entry", (-1,), zone, np.int32))
        _column(pace, "exit", (rows,), zone, np.int32)
        _column(pace, "stay", (rows,), (1e-6, DURATION[1]))
    if (overlaps := model.overlaps) is not None:
        rows = len(_column(overlaps, "camera", (-1,), camera, np.int32))
        _column(overlaps, "to", (rows,), camera, np.int32)
        _column(overlaps, "share", (rows,), NUMBER)
        _hazards(overlaps.same, rows, offsets)
        _hazards(overlaps.others, rows, offsets)
    if (paths := model.paths) is not None:
        end = zone if paths.of_zones else camera
        rows = len(_column(paths, "from_", (-1,), end, np.int32))
        _column(paths, "to", (rows,), end, np.int32)
        _column(paths, "share", (rows,), SHARE)
        _column(paths, "place", (rows,), SECONDS)
        _column(paths, "width", (rows,), DURATION)
    if (labels := model.labels) is not None:
        _column(labels, "shares", (zones, len(labels.names)), SHARE)
    if (weak := model.weak_links) is not None:
        rows = len(_column(weak, "from_", (-1,), zone, np.int32))
        _column(weak, "to", (rows,), zone, np.int32)
        _column(weak, "overlapped", (rows,), (0, 1), np.uint8)
        figures = _column(weak, "figures", (rows, FIGURES), None)
        basics = np.delete(figures, OPTIONAL_FIGURES, axis=1)
        possible = figures[:, (0, 1, 10, 11)]
        if not np.isfinite(basics).all() or np.isinf(figures).any() or (possible < 0.0).any():
            raise ValueError("a number out of its range in WeakLinks - at `$.model.figures`")
        if len(weak.provisional) not in (0, rows):
            raise ValueError("more or fewer texts than links - at `$.model.provisional`")
