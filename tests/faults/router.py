"""A router in a process of its own: `router.py ENDPOINT`; prints "ready" and runs until killed."""

from __future__ import annotations

import signal
import sys

from camtopod.config.settings import BusSettings, Config
from camtopod.serve.bus.session import meet

if __name__ == "__main__":
    with meet(Config(bus=BusSettings(listen=(sys.argv[1],)))):
        print("ready", flush=True)
        signal.pause()
