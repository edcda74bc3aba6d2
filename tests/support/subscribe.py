"""A subscriber's process: writes each version as one line until standard input ends."""

from __future__ import annotations

import sys
import threading
from pathlib import Path

from serving import small_config

from camtopod.codec import to_json
from camtopod.serve.bus.session import dial
from camtopod.serve.bus.topology_subscriber import TopologySubscriber

if __name__ == "__main__":
    stop = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), stop.set()), daemon=True).start()
    with dial(small_config(Path(), sys.argv[1])) as bus:
        view = TopologySubscriber(bus)
        while not stop.wait(0.05):
            if (new := view.update()) is not None:
                said = {
                    "epoch": new.epoch,
                    "version": new.version,
                    "digest": new.digest,
                    "events": new.events,
                }
                sys.stdout.write(to_json(said).decode() + "\n")
                sys.stdout.flush()
