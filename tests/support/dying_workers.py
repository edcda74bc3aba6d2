"""Workers of a cluster whose fits kill them."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from distributed import Worker, WorkerPlugin
from dying_fits import learn_or_die

from camtopod.city import recordings


class Killing(WorkerPlugin):
    """Plugin of a cluster, by which workers learn as `learn_or_die`, those that are restarted too."""

    def __init__(self, folder: Path, district: str, kills: int) -> None:
        self._learn = partial(learn_or_die, folder, district, kills)

    def setup(self, worker: Worker) -> None:
        recordings.learn_in_order = self._learn  # type: ignore[assignment]
