"""Full-screen view of `camtopod watch`. Only this module uses rich, an extra (``[terminal]``).

Rows that do not fit are left out from the end of a table: cameras without problems, and the least
used links.
"""

from __future__ import annotations

import logging
import textwrap
import threading
from collections.abc import Callable, Sequence

from rich.console import Console, Group, RenderableType
from rich.layout import Layout
from rich.live import Live
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from camtopod.cli.terminal.site_state import (
    SiteView,
    alarm_line,
    busiest_links,
    daemon_line,
    newest_alarms,
    prediction_line,
    topology_lines,
    transit,
)
from camtopod.topology import waiting_for_links
from camtopod.visible import visible

DRAW_SECONDS = 0.25
"""Interval between two drawings."""
WIDE = 120
"""Columns from which the cameras stand beside the rest instead of above it."""
NARROW = 70
"""Columns below which each camera and link shows only the essential columns."""
GUTTER = 2
"""Columns between the cameras and the rest in a wide terminal."""
PART_ROWS_MIN = 5
"""Rows below which a part is left out."""
REASON_ROWS_MAX = 3
"""Most rows of a camera's reason."""
REASON_COLUMNS_MIN = 8
"""Columns below which the reason of a camera is left out."""
_COLOURS = {"running": "green", "ended": "dim", "no grabber": "dim", "gone": "dim"}
"""Style of a camera's state; other states are `_WRONG`."""
_WRONG = "bold yellow"
_CORNER = "dim"


class LastLogLine:
    """Stand-in for standard error while the screen is drawn; its last line is shown at the top."""

    def __init__(self) -> None:
        self.line = ""

    def write(self, text: str) -> int:
        """Keep the last line of ``text``."""
        self.line = text.strip().splitlines()[-1] if text.strip() else self.line
        return len(text)

    def flush(self) -> None:
        """Do nothing: there is no buffer."""


def show(look: Callable[[], SiteView], stop: threading.Event) -> bool:
    """Draw the views that ``look`` returns, four times a second, until ``stop``.

    Returns False if the terminal cannot do it.
    """

    # Redirect the log, which would disturb the screen.
    console = Console()
    if console.is_dumb_terminal:
        return False
    words = LastLogLine()
    streams = [
        handler
        for handler in logging.getLogger().handlers
        if isinstance(handler, logging.StreamHandler)
    ]
    before = [handler.setStream(words) for handler in streams]
    try:
        with Live(console=console, screen=True, auto_refresh=False) as live:
            while not stop.is_set():
                live.update(drawn(look(), *console.size, words.line), refresh=True)
                stop.wait(DRAW_SECONDS)
    finally:
        for handler, stream in zip(streams, before, strict=True):
            handler.setStream(stream)
    return True


def drawn(view: SiteView, width: int, height: int, words: str = "") -> RenderableType:
    """Return the screen for a terminal of ``width`` columns and ``height`` rows."""
    # Rows and columns that are available.
    head = _head(view, words, width)[: max(1, height // 3)]
    rows = max(1, height - len(head) - 1)
    wide = width >= WIDE
    room = width // 2 if wide else width

    # Stack predictions and links (each with a heading and an empty line).
    wanted = [
        len(view.predictions) + 2,
        len(busiest_links(view.topology)) + 2,
    ]
    others: list[Callable[[int], Table]] = [
        lambda n: _predictions(view, n),
        lambda n: _links(view, room, n),
    ]

    # Put the cameras beside or above them.
    if wide:
        body = Layout()
        cameras = Padding(_cameras(view, room - GUTTER, rows), (0, GUTTER, 0, 0))
        body.split_row(Layout(cameras), _stacked(rows, wanted, others))
    else:
        lines = len(view.cameras) + sum(camera.wrong for camera in view.cameras) + 2
        body = _stacked(rows, [lines, *wanted], [lambda n: _cameras(view, room, n), *others])
    whole = Layout()
    whole.split_column(Layout(Group(*head), size=len(head) + 1), body)
    return whole


def _stacked(rows: int, wanted: Sequence[int], parts: Sequence[Callable[[int], Table]]) -> Layout:
    """Stack ``parts`` in ``rows`` rows.

    Each part gets the rows it wants while there is room, else an equal share. Parts at the end are
    left out if shares would be smaller than `PART_ROWS_MIN`.
    """
    fitting = min(len(parts), max(1, rows // PART_ROWS_MIN))
    pieces = []
    for k in range(fitting):
        share = max(rows // (fitting - k), rows - sum(wanted[k + 1 : fitting]))
        share = min(wanted[k], share) if k < fitting - 1 else rows
        pieces.append(Layout(parts[k](share), size=share))
        rows -= share
    stack = Layout()
    stack.split_column(*pieces)
    return stack


def _head(view: SiteView, words: str, width: int) -> list[Text]:
    """Return the lines at the top: daemon, topology, last log line, alarms.

    The daemon's state and what is waited for are whole, the others cut to ``width`` columns.
    """
    style = "bold" if view.state == "running" else _WRONG
    daemon = [_text(line, style) for line in textwrap.wrap(daemon_line(view), max(width, 1))]
    waiting = "" if view.topology is None else waiting_for_links(view.topology)
    topology = [
        _text(piece)
        for line in topology_lines(view.topology)
        for piece in (textwrap.wrap(line, max(width, 1)) if line == waiting else [line])
    ]
    lines = [_text(words, _CORNER)] if words else []
    lines += [
        _text(f"! {alarm_line(alarm, view.now)}", "yellow")
        for alarm in newest_alarms(view.topology)
    ]
    return [*daemon, *topology, *lines]


def _text(text: str, style: str = "", whole: bool = False) -> Text:
    """Return text from others without control sequences; on one line unless ``whole``."""
    return Text(
        visible(text), style=style, no_wrap=not whole, overflow="fold" if whole else "ellipsis"
    )


def _table(*columns: str, flexible: str) -> Table:
    """Return a table without lines; numbers are right-aligned, the ``flexible`` column takes free
    space.
    """
    table = Table(box=None, expand=True, pad_edge=False, header_style="bold dim")
    for column in columns:
        right = column in ("EVENTS", "LAST", "SHARE")
        table.add_column(
            column,
            justify="right" if right else "left",
            no_wrap=True,
            overflow="ellipsis",
            ratio=1 if column == flexible else None,
        )
    return table


def _cameras(view: SiteView, width: int, rows: int) -> Table:
    """Return the table of cameras: those with problems first, then those with the newest events.

    The whole reason of a problem is shown if it fits.
    """
    # Choose the columns.
    cameras = sorted(
        view.cameras, key=lambda one: (not one.wrong, one.last is None, one.last or 0.0, one.name)
    )
    narrow = width < NARROW
    taken = max((len(camera.name) + len(camera.state) for camera in cameras), default=0)
    room = width - taken - (14 if narrow else 23)  # for the reason
    columns = ["CAMERA", "STATE", *(() if narrow else ("EVENTS",)), "LAST"]
    columns += ["REASON"] if room >= REASON_COLUMNS_MIN else []
    table = _table(*columns, flexible=columns[-1])

    # Fill the rows; three are the heading, the number of hidden cameras and an empty line.
    shown, left = 0, rows - 3
    while shown < len(cameras) and left > 0:
        camera = cameras[shown]
        needed = len(textwrap.wrap(camera.reason, max(room, 1)))
        whole = camera.wrong and 1 < needed <= min(left, REASON_ROWS_MAX)
        style = _COLOURS.get(camera.state, _WRONG)
        cells = {
            "CAMERA": _text(camera.name),
            "STATE": _text(f"{'!' if camera.wrong else ' '} {camera.state}", style),
            "EVENTS": _text(str(camera.events)),
            "LAST": _text("" if camera.last is None else f"{camera.last:.0f} s"),
            "REASON": _text(camera.reason, whole=whole),
        }
        table.add_row(*(cells[column] for column in columns))
        shown, left = shown + 1, left - (needed if whole else 1)

    if hidden := cameras[shown:]:
        wrong = sum(camera.wrong for camera in hidden)
        table.add_row(
            _text(f"and {len(hidden)} more", _CORNER),
            _text(f"{wrong} faulty" if wrong else "  ok", _CORNER),
        )
    return table


def _links(view: SiteView, width: int, rows: int) -> Table:
    narrow = width < NARROW
    table = _table(
        *("FROM", "TO", *(() if narrow else ("RELATION",)), "SHARE", "TRANSIT (q10 to q90)"),
        flexible="TO",
    )
    links = busiest_links(view.topology)
    shown = links if len(links) <= rows - 2 else links[: max(0, rows - 3)]
    for link in shown:
        relation = [] if narrow else [_text(link.relation)]
        table.add_row(
            _text(link.from_),
            _text(link.to),
            *relation,
            _text(f"{link.probability:.2f}"),
            _text(transit(link)),
        )
    if len(links) > len(shown):
        table.add_row(_text(f"and {len(links) - len(shown)} more", _CORNER))
    return table


def _predictions(view: SiteView, rows: int) -> Table:
    table = _table("LEFT", "SEEN NEXT", flexible="SEEN NEXT")
    for prediction in view.predictions[: max(0, rows - 2)]:
        ago = max(0.0, view.now - prediction.t)
        table.add_row(_text(f"{ago:.0f} s ago"), _text(prediction_line(prediction)))
    return table
