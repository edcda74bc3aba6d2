"""Figures of a topology, with matplotlib: the extra ``[plot]``.

    from camtopod import plot

    axes = plot.times(topology, "lobby", "hall")  # of cameras, or of zones
    axes.figure.savefig("times.pdf")

Each function draws on the axes that it is given, or on a figure of its own, and returns the axes.
"""

from __future__ import annotations

import numpy as np

from camtopod.export import draw
from camtopod.records import Topology

try:
    from matplotlib import pyplot
    from matplotlib.axes import Axes
except ModuleNotFoundError as error:
    message = f"plots need the package {error.name}: pip install 'camtopod[plot]'"
    raise ModuleNotFoundError(message, name=error.name) from None

PIXELS = 96.0
"""Pixels of a drawing in an inch: text of 13 pixels is of 9.75 points."""
SHARE_WRITTEN_MIN = 0.005
"""Least share that is written in its cell of a matrix."""


def times(topology: Topology, from_: str, to: str, axes: Axes | None = None) -> Axes:
    """Draw the histogram of transit times of `Topology.link`, and their median.

    Raises KeyError if there is no such link.
    """
    axes = axes or pyplot.subplots()[1]
    link = topology.link(from_, to)
    edges, mass = link.times()
    axes.stairs(mass / np.diff(edges), edges, fill=True)
    axes.axvline(link.transit.q50, color="black", label=f"median {link.transit.q50:.1f} s")
    axes.set(xlabel="transit time (s)", ylabel="transitions per second of transit time")
    axes.legend(title=f"{link.from_} → {link.to}")
    return axes


def matrix(topology: Topology, axes: Axes | None = None) -> Axes:
    """Draw `Topology.matrix`; its last column is the probability of following no link."""
    axes = axes or pyplot.subplots(layout="constrained")[1]
    cameras, probability, unlinked = topology.matrix()
    shares = np.column_stack([np.reshape(probability, (len(cameras), -1)), unlinked])
    axes.imshow(shares, cmap="Greens", vmin=0.0, vmax=1.5)
    for row, column in np.argwhere(shares >= SHARE_WRITTEN_MIN):
        axes.text(column, row, f"{shares[row, column]:.2f}", ha="center", va="center", size=7)
    axes.set_xticks(range(len(cameras) + 1), [*cameras, "no link"], rotation=90)
    axes.set_yticks(range(len(cameras)), cameras)
    axes.set(xlabel="next camera", ylabel="camera that is left")
    return axes


def network(topology: Topology, axes: Axes | None = None) -> Axes:
    """Draw the map, as ``export --format svg`` does: black lines for overlaps, grey for paths."""
    points, lines, texts, low, high = draw(topology)
    if axes is None:
        figure = pyplot.figure(figsize=(high - low) / PIXELS)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    for line in lines:
        axes.plot(
            *zip(line.start, line.start + line.way, strict=True),
            color="black" if line.overlapped else "darkgrey",
            linestyle="dotted" if line.weak else "solid",
            linewidth=0.75 * line.width,
        )
    for point in points.values():
        axes.plot(*point, "o", color="#0f6b4f", markersize=16)
    for text, kind, x, y in texts:
        axes.text(x, y, text, size={"name": 9, "time": 8}[kind], ha="center", va="center")
    axes.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), aspect="equal")
    axes.axis("off")
    return axes
