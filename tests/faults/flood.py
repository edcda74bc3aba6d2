"""A camera that floods: `flood.py ENDPOINT CAMERA PER_SECOND SECONDS`.

Publishes that many valid events a second and prints their number.
"""

from __future__ import annotations

import sys
import time

from camtopod.codec import to_msgpack
from camtopod.config.settings import BusSettings, Config
from camtopod.records import Event
from camtopod.serve.bus.session import dial

_STEP_SECONDS = 0.01


def flood(endpoint: str, camera: str, per_second: int, seconds: float) -> int:
    """Publish a flood and return the number of events."""
    began = time.monotonic()
    count = 0
    with dial(Config(bus=BusSettings(connect=(endpoint,)))) as bus:
        while (elapsed := time.monotonic() - began) < seconds:
            for count in range(count + 1, int(elapsed * per_second) + 1):  # noqa: B020
                event = Event(camera, "entry", time.time(), 0.5, 0.5, str(count), "wild", count)
                bus.publish_raw(f"event/{camera}", to_msgpack(event), "event")
            time.sleep(_STEP_SECONDS)
    return count


if __name__ == "__main__":
    where, which, rate, lasts = sys.argv[1:]
    print(flood(where, which, int(rate), float(lasts)), flush=True)
