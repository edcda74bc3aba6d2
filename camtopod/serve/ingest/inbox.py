"""Messages from the bus that have not been processed yet."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable, Container

from camtopod import codec
from camtopod.serve.requests import Answer

PUBLISHED_MAX = 1_000
"""Most publications of one camera that wait to be decoded, and most that wait to be released."""
UNKNOWN_REQUESTS_MAX = 100
"""Number of waiting requests beyond which none of an unknown camera is kept."""
BUSY = codec.to_msgpack(Answer({}, reason="busy", detail="other requests are waiting"))
"""Answer to a request that is not looked at."""

Reply = Callable[[bytes], None]
"""Sends the answer to a request."""
AskedFor = tuple[str, bytes, Reply]
"""A request: camera, content, and what answers it."""


class Inbox:
    """Requests, and publications, in the order of their arrival. Thread-safe; nothing blocks.

    Of requests there is one a camera: a newer one takes its place, and the older is answered
    ``busy``. Publications of a camera beyond `PUBLISHED_MAX` are dropped. As names can be invented,
    all unknown cameras share the room of one, and their requests wait only while there are few.

    cameras: the cameras that are known.
    """

    def __init__(self, cameras: Container[str]) -> None:
        self._cameras = cameras
        self._requests: dict[str, tuple[bytes, Reply]] = {}
        self._publications: deque[tuple[str, bytes, str]] = deque()
        """Camera, content, and whose room it takes."""
        self._counts: Counter[str] = Counter()  # number of publications by whose room they take
        self._mutex = threading.Lock()
        self._wakeup = threading.Event()
        self.dropped: Counter[str] = Counter()
        """Number of publications dropped for lack of room, by camera; "": of unknown ones."""

    def on_request(self, key: str, content: bytes, reply: Reply) -> None:
        """Receive a request on ``store/{camera}``."""
        camera = key.removeprefix("store/")
        with self._mutex:
            _, refuse = self._requests.get(camera, (b"", None))
            if camera in self._cameras or len(self._requests) < UNKNOWN_REQUESTS_MAX:
                self._requests[camera] = content, reply
                self._wakeup.set()
            else:
                refuse = reply
        if refuse is not None:
            refuse(BUSY)

    def on_event(self, key: str, content: bytes) -> None:
        """Receive a publication on ``event/{camera}``."""
        camera = key.removeprefix("event/")
        with self._mutex:
            room = camera if camera in self._cameras else ""
            if self._counts[room] >= PUBLISHED_MAX:
                self.dropped[room] += 1
                return
            self._counts[room] += 1
            self._publications.append((camera, content[: codec.EVENT_BYTES_MAX + 1], room))
            self._wakeup.set()

    def has_request(self, camera: str) -> bool:
        """Return True if a request of a camera is here."""
        return camera in self._requests

    def take_request(self) -> AskedFor | None:
        """Return the oldest request, which is then no longer here; None if there is none."""
        with self._mutex:
            camera = next(iter(self._requests), None)
            return None if camera is None else (camera, *self._requests.pop(camera))

    def take_published(self, limit: int) -> list[tuple[str, bytes]]:
        """Return up to ``limit`` publications (camera, content), which are then no longer here."""
        if not self._publications:
            return []
        with self._mutex:
            publications = [
                self._publications.popleft() for _ in range(min(limit, len(self._publications)))
            ]
            self._counts -= Counter(room for _, _, room in publications)
        return [(camera, content) for camera, content, _ in publications]

    @property
    def has_messages(self) -> bool:
        """True if a message is here."""
        return bool(self._requests or self._publications)

    @property
    def has_publications(self) -> bool:
        """True if a publication is here."""
        return bool(self._publications)

    def wait(self, seconds: float) -> None:
        """Wait until a message has come since the last call, at most ``seconds``."""
        self._wakeup.wait(seconds)
        self._wakeup.clear()
