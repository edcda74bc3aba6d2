"""Live topology of a site for programs that use threads: `Site.connect`."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from functools import partial

from camtopod.client.answer_queue import AnswerQueue, AnswerT
from camtopod.client.site_view import Settings, SiteView
from camtopod.records import Between, Match, Prediction, Topology


class Site(SiteView, contextlib.AbstractContextManager["Site"]):
    """Live view of the topology that a site's daemon has learned.

        with Site.connect("hq") as site:
            for version in site.versions():
                print(version.version, len(version.links))

    All methods may be called from any thread.
    """

    @classmethod
    def connect(
        cls, site: str | None = None, connect: str | Sequence[str] = (), config: Settings = None
    ) -> Site:
        """Join the bus of a site and wait for its topology. `camtopod.connect` is the same.

            >>> import camtopod
            >>> with camtopod.connect() as site:  # the daemon on this machine
            ...     print(site.site, site.current.cameras[0].id)
            site a

        Returns when the topology has been received, or when it is certain that there is none yet. A
        missing daemon behind a router and an empty topology are not errors (see `stale_since` and
        `current`), unless the daemons of other sites are there: then the site's name is wrong.

        site: name of the site; without it the configuration's, else ``site`` or, if that has no
            daemon, the only one on the bus that has.
        connect: one or several endpoints (``tcp/192.168.1.5:7447``); without it those of the
            configuration, else this machine.
        config: configuration file or `camtopod.config.settings.Config` for all other settings, such
            as `[bus.tls]` with the certificate that `camtopod keys reader` makes, or
            `connect_seconds`.

        A forked child cannot use the bus: start processes by "spawn", and connect in each.

        Raises `BusError` (an OSError) if no endpoint can be reached, if other sites have a daemon
        and this one has none, and after a fork;
        `camtopod.config.settings.ConfigError` or OSError if the file cannot be read; ValueError for
        an invalid site or endpoint.
        """
        return cls(site, connect, config)

    def wait_for(self, version: int, seconds: float) -> Topology:
        """Return the newest version as soon as its number is at least ``version``.

        Raises TimeoutError after ``seconds``, or if closed meanwhile.
        """
        topology = self._news.wait_for(lambda: self._at_least(version), seconds)
        if topology is None:
            raise TimeoutError(self._not_there(version, seconds))
        return topology

    def versions(self, seconds: float | None = None) -> Iterator[Topology]:
        """Yield the current version, if there is one, and each later one.

        Ends when closed, or when no version has arrived for ``seconds``. A slow reader gets the
        newest version and skips those in between.
        """
        last = None
        while (last := self._news.wait_for(partial(self._newer, last), seconds)) is not None:
            yield last

    def predictions(
        self, camera: str | None = None, seconds: float | None = None
    ) -> Answers[Prediction]:
        """Subscribe to the daemon's own predictions, one for each exit at ``camera`` or anywhere.

        The daemon uses all events it receives, so its predictions know more than `predict` does. It
        takes a moment until the subscription reaches the daemon. Up to `WAITING_MAX` may wait to be
        read; beyond it the oldest are dropped.

        seconds: iteration ends when no prediction has arrived for this long (default: never).

        Raises ValueError for an invalid camera id; `BusError` if closed.
        """
        return self._opened(lambda bus: Answers(bus, Prediction, camera, seconds))

    def walks(self, camera: str | None = None, seconds: float | None = None) -> Answers[Match]:
        """Subscribe to the daemon's matches, one for each entry at ``camera`` or anywhere.

            for match in site.walks():
                print(match.walk, match.camera, match.t)

        Entries with the same ``walk`` are probably of one object. A match that later events change
        comes once more after ten seconds. Arguments and errors are those of `predictions`.
        """
        return self._opened(lambda bus: Answers(bus, Match, camera, seconds))

    def between(self) -> Between | None:
        """Ask the daemon how many objects are between cameras: by pair of cameras, and in all.

            if (between := site.between()) is not None:
                print(f"{between.number:.0f} objects, {between.low} to {between.high}")

        Returns None if no daemon answers within two seconds, and if it has not learned anything
        yet or matches no entries (``[site] walks = false``).

        Raises `BusError` if closed.
        """
        return self._between()

    def __exit__(self, *_: object) -> None:
        self.close()


connect = Site.connect
"""The front door's name of it."""


class Answers(AnswerQueue[AnswerT], contextlib.AbstractContextManager["Answers[AnswerT]"]):
    """The daemon's predictions, or matches, in order of arrival.

        with site.predictions("lobby") as predictions:
            for prediction in predictions:
                print(prediction.camera, "->", prediction)

    Iteration ends when this object or the topology is closed, or when no answer has arrived for
    ``seconds``, if given. `dropped` counts the answers lost because the reader was too slow.
    """

    def get(self, seconds: float | None = None) -> AnswerT | None:
        """Return the next answer; None if none arrives within ``seconds``, or when closed."""
        return self._news.wait_for(self._take, seconds)

    def __iter__(self) -> Iterator[AnswerT]:
        while (answer := self.get(self._seconds)) is not None:
            yield answer

    def __exit__(self, *_: object) -> None:
        self.close()
