"""Simulated camera networks with ground truth: events for `camtopod simulate`, videos for the demo.

`simulation.simulate` makes events; it uses, in this order, `settings` (what can be simulated),
`layout` (zones and paths), `walkers` (passages of people) and `reports` (events and ground truth).
The demo uses `floor` (floor plan and walks), `rendering` (videos) and `picture` (the map it shows).
`truth` defines the ground truth, `scoring` compares a topology with it.
`AUDITORIUM` is a recording of real cameras, with identities.
"""

from pathlib import Path

AUDITORIUM = Path(__file__).parent / "auditorium"
"""Folder with ``events.jsonl`` and ``identities.csv``."""
