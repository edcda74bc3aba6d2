"""Input of recorded and foreign events for `learn`, `predict`, `report` and `ingest`.

`event_lines` reads and checks event lines, `input_formats` selects the adapter for another
program's format, `broker_options` has the options of an MQTT broker, and `publish_outcome` counts
what the daemon did with published events.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import lazy_getattr

if TYPE_CHECKING:
    from camtopod.cli.events.event_lines import Line, LineReader, numbered, open_input
    from camtopod.cli.events.input_formats import add_options, events
    from camtopod.cli.events.publish_outcome import KNOWN_SECONDS, Outcome

__all__ = [
    "KNOWN_SECONDS",
    "Line",
    "LineReader",
    "Outcome",
    "add_options",
    "broker_options",
    "events",
    "numbered",
    "open_input",
]

__getattr__ = lazy_getattr(
    __name__,
    {
        "KNOWN_SECONDS": "publish_outcome",
        "Line": "event_lines",
        "LineReader": "event_lines",
        "Outcome": "publish_outcome",
        "add_options": "input_formats",
        "events": "input_formats",
        "numbered": "event_lines",
        "open_input": "event_lines",
    },
)
