"""A site's topology, live, for a program that waits: `Topology.connect`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

from camtopod.client.prediction_queue import WAITING_MAX, Inbox
from camtopod.client.site_view import Settings, View
from camtopod.records import Prediction
from camtopod.records import Topology as Version


class Topology(View):
    """What a site's daemon has learned, up to date while it is open.

        with Topology.connect("hq") as site:
            for version in site.versions():
                print(version.version, len(version.links))

    Its methods may be called from any thread.
    """

    @classmethod
    def connect(
        cls, site: str | None = None, connect: str | Sequence[str] = (), config: Settings = None
    ) -> Topology:
        """Join the bus of a site; returns when its topology is there, or it is sure that there is
        none yet.

        ``site``: its name, ``site`` where neither this nor the configuration says it. ``connect``:
        an endpoint or several (``tcp/192.168.1.5:7447``); else those of the configuration, else
        this machine. ``config``: a configuration's file or a `camtopod.config.settings.Config`, for
        what else there is to say: `[bus.tls]` with the certificate that `camtopod keys reader`
        makes, or `connect_seconds`.

        Raises `BusError`, an OSError, where nobody can be reached;
        `camtopod.config.settings.ConfigError`, OSError for a file that cannot be read; ValueError
        for a site or endpoint that is none. That there is no daemon behind a router, or nothing
        learned, is no error: see `stale_since` and `current`.
        """
        return cls(site, connect, config)

    def wait_for(self, version: int, seconds: float) -> Version:
        """The newest version as soon as it is at least ``version``. Raises TimeoutError after
        ``seconds``, or when it is closed meanwhile.
        """
        found = self._news.wait_for(lambda: self._at_least(version), seconds)
        if found is None:
            raise TimeoutError(self._not_there(version, seconds))
        return found

    def versions(self, seconds: float | None = None) -> Iterator[Version]:
        """The current version, if there is one, and each that comes after, until closed or none has
        come for ``seconds``. Who is slow gets the newest, and not those in between.
        """
        last = None
        while (last := self._news.wait_for(partial(self._newer, last), seconds)) is not None:
            yield last

    def predictions(
        self,
        camera: str | None = None,
        seconds: float | None = None,
        waiting_max: int = WAITING_MAX,
    ) -> Predictions:
        """The daemon's own predictions from now on (it takes a moment until the daemon knows), one
        for each exit at ``camera``, or anywhere; see `Predictions`. They use all that the daemon
        hears: more than `predict` knows.

        At most ``waiting_max`` wait to be read. Raises ValueError for a camera that cannot be one
        or a ``waiting_max`` below 1; `BusError` when it has been closed.
        """
        return self._opened(lambda bus: Predictions(bus, camera, seconds, waiting_max))

    def __enter__(self) -> Topology:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Predictions(Inbox):
    """The daemon's predictions in the order they come. Iterate over it: it ends when it or the
    topology is closed, or when none has come for ``seconds``, if that was given.

        with site.predictions("lobby") as predictions:
            for prediction in predictions:
                print(prediction.next_[:1])

    `dropped` says how many were lost to a reader that was too slow.
    """

    def get(self, seconds: float | None = None) -> Prediction | None:
        """The next one; None when none has come for ``seconds``, or when it is closed."""
        return self._news.wait_for(self._take, seconds)

    def __iter__(self) -> Iterator[Prediction]:
        while (prediction := self.get(self._seconds)) is not None:
            yield prediction

    def __enter__(self) -> Predictions:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
