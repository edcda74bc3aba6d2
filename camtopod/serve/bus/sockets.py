"""Socket options that zenoh does not set: a program that stops reading must not delay others.

Linux only, as the list of the process's sockets is needed; elsewhere nothing is changed.
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct
from collections.abc import Callable, Sequence

STALLED_SECONDS_MAX = 4.0
"""A program is disconnected when data has waited this many seconds for it; it may reconnect."""
_DESCRIPTORS = "/proc/self/fd"
_LISTENS = socket.SOL_SOCKET, socket.SO_ACCEPTCONN
_LINGERS = socket.SOL_SOCKET, socket.SO_LINGER
_NO_LINGER = struct.pack("ii", 0, 0)


def limit_waiting(endpoints: Sequence[str]) -> None:
    """Let the kernel end connections to ``endpoints`` whose data waits for `STALLED_SECONDS_MAX`.

    Zenoh itself ends the connection of a program that has stopped only when its lease is over,
    after ten seconds. Connections inherit this option from the listening socket.
    """
    ports = {
        int(port)
        for port in (endpoint.rpartition(":")[2] for endpoint in endpoints)
        if port.isdecimal()
    }

    def limit(one: socket.socket) -> None:
        if one.getsockopt(*_LISTENS) and one.getsockname()[1] in ports:
            one.setsockopt(
                socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(1000 * STALLED_SECONDS_MAX)
            )

    _with_each_socket(limit)


def close_without_waiting() -> None:
    """Turn SO_LINGER off on all connections, so that closing one returns at once.

    The kernel then sends the rest. Zenoh (1.10) sets SO_LINGER to ten seconds: when a program has
    stopped reading, closing its connection blocks a thread of the bus for that long, and no message
    is delivered meanwhile.
    """

    def turn_off(one: socket.socket) -> None:
        if one.getsockopt(*_LINGERS, len(_NO_LINGER)) != _NO_LINGER:
            one.setsockopt(*_LINGERS, _NO_LINGER)

    _with_each_socket(turn_off)


def _with_each_socket(act: Callable[[socket.socket], None]) -> None:
    """Call ``act`` with each network socket of this process."""
    for fd in map(int, os.listdir(_DESCRIPTORS) if os.path.isdir(_DESCRIPTORS) else []):
        with contextlib.suppress(OSError):  # another file, or closed meanwhile
            one = socket.socket(socket.AF_INET, socket.SOCK_STREAM, fileno=fd)
            try:
                if one.getsockopt(socket.SOL_SOCKET, socket.SO_DOMAIN) in (
                    socket.AF_INET,
                    socket.AF_INET6,
                ):
                    act(one)
            finally:
                one.detach()
