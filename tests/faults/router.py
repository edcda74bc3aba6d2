"""A router in a process of its own: `router.py ENDPOINT`; prints "ready" and runs until killed."""

from __future__ import annotations

import signal
import sys

from camtopod.config.settings import BusSettings, Config
from camtopod.serve.bus.session import open_daemon_session

if __name__ == "__main__":
    with open_daemon_session(Config(bus=BusSettings(listen=(sys.argv[1],)))):
        print("ready", flush=True)
        signal.pause()
