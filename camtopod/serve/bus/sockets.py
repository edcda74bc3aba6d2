"""A socket option that zenoh sets otherwise: a program that stops reading must not delay others.

Linux only, as the list of the process's sockets is needed; elsewhere nothing is changed.
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct

_DESCRIPTORS = "/proc/self/fd"
_NO_LINGER = struct.pack("ii", 0, 0)


def close_without_waiting() -> None:
    """Turn SO_LINGER off on all connections, so that closing one returns at once.

    The kernel then sends the rest. Zenoh (1.10) sets SO_LINGER to ten seconds: when a program has
    stopped reading, closing its connection blocks a thread of the bus for that long, and no message
    is delivered meanwhile.
    """
    for fd in map(int, os.listdir(_DESCRIPTORS) if os.path.isdir(_DESCRIPTORS) else []):
        with contextlib.suppress(OSError):  # another file, or closed meanwhile
            connection = socket.socket(socket.AF_INET, socket.SOCK_STREAM, fileno=fd)
            try:
                family = connection.getsockopt(socket.SOL_SOCKET, socket.SO_DOMAIN)
                if family in (socket.AF_INET, socket.AF_INET6):
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _NO_LINGER)
            finally:
                connection.detach()
