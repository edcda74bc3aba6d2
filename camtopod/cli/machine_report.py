"""The machine part of `camtopod doctor`: versions, memory, clock; no person or place in it."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

from camtopod import __version__

PACKAGES = (
    "eclipse-zenoh",
    "opencv-python-headless",
    "numpy",
    "scipy",
    "msgspec",
    "cryptography",
    "paho-mqtt",
    "rich",
    "starlette",
    "uvicorn",
    "prometheus-client",
)
"""Packages whose versions are reported: required ones and those of the extras."""
CLOCK_COMMANDS = (
    ("chronyc", "-n", "tracking"),
    ("timedatectl", "show", "--property=NTP", "--property=NTPSynchronized"),
)
"""Programs that know whether the clock is synchronised."""
_ASK_SECONDS = 5.0
"""Time limit for each of them."""
_ABOUT_THE_PROGRAM = ("CAMTOPOD_", "OPENCV_", "OMP_", "OPENBLAS_", "MKL_", "RUST_", "ZENOH_")
"""Prefixes of environment variables whose names are reported (never their values)."""
_DIRECTORIES = (
    "STATE_DIRECTORY",
    "XDG_STATE_HOME",
    "CREDENTIALS_DIRECTORY",
    "NOTIFY_SOCKET",
    "WATCHDOG_USEC",
)
"""Further environment variables whose names are reported."""


def versions() -> list[str]:
    """Return the versions of camtopod, Python and the packages, a line each."""
    lines = [
        f"camtopod {__version__}",
        f"Python {sys.version.split()[0]} ({platform.python_implementation()})",
    ]
    for package in PACKAGES:
        try:
            lines.append(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            lines.append(f"{package}: not installed")
    return lines


def machine() -> list[str]:
    """Return lines about operating system, cores, memory and the names of environment variables."""
    memory = dict(line.split(":", 1) for line in _text(Path("/proc/meminfo")).splitlines())
    release = dict(
        line.split("=", 1) for line in _text(Path("/etc/os-release")).splitlines() if "=" in line
    )
    load = " ".join(f"{one:.1f}" for one in os.getloadavg())
    named = sorted(
        name for name in os.environ if name.startswith(_ABOUT_THE_PROGRAM) or name in _DIRECTORIES
    )
    return [
        f"{release.get('PRETTY_NAME', 'unknown').strip(chr(34))}, "
        f"{platform.system()} {platform.release()}",
        f"{platform.machine()}, {os.cpu_count()} cores, "
        f"{len(os.sched_getaffinity(0))} for this program, load {load}",
        f"memory: {memory.get('MemTotal', '?').strip()}, "
        f"available {memory.get('MemAvailable', '?').strip()}",
        f"memory limit of the control group: "
        f"{_text(Path('/sys/fs/cgroup/memory.max')).strip() or 'unknown'}",
        f"environment variables that are set: {', '.join(named) or 'none'}",
    ]


def clock(wall: float) -> list[str]:
    """Return lines on whether the machine's clock is synchronised; ``wall``: now, seconds since the
    epoch.
    """
    lines = [f"now: {wall:.3f}"]
    for command in CLOCK_COMMANDS:
        if shutil.which(command[0]) is None:
            continue
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=_ASK_SECONDS, check=False
            )
        except (OSError, subprocess.TimeoutExpired):
            continue
        if done.returncode == 0:
            lines += [f"{command[0]}: {line}" for line in done.stdout.splitlines()]
    return (
        lines
        if len(lines) > 1
        else [*lines, "synchronisation unknown: neither chronyc nor timedatectl answers"]
    )


def _text(path: Path) -> str:
    """Return the content of a system file; "" if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""
