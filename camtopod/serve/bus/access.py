"""Access to the bus: zenoh's security settings and the access list.

The rules are those of `camtopod.keys.rules`. The daemon enforces them if it listens itself; with a
separate router, the router does.
"""

from __future__ import annotations

import ipaddress
import logging
import socket
import ssl
from pathlib import Path
from urllib.parse import urlsplit

from camtopod.config import Config
from camtopod.keys import rules
from camtopod.serve.runtime import Clock

log = logging.getLogger(__name__)

HANDSHAKE_SECONDS = 2.0
"""Longest time to look at the certificate of a daemon."""
_EXPIRED = 10
"""OpenSSL's X509_V_ERR_CERT_HAS_EXPIRED."""


class BusError(OSError):
    """The bus cannot be reached or opened; ``str()`` says where or why, and what to do."""


def settings(config: Config, mode: str, access: rules.Access | None = None) -> rules.Settings:
    """Return the settings of a zenoh session, without its endpoints.

    mode: "router" for the daemon that listens, otherwise "client".
    access: the access list to enforce, in a router only.
    """
    values = rules.session_settings(mode)
    tls = config.bus.tls
    if tls.ca:
        values |= rules.mutual_tls(tls.ca, tls.certificate, tls.private_key)
    largest = config.bus.message_bytes_max
    if mode == "router":
        # It receives no topology: nothing large.
        largest = min(largest, rules.RECEIVED_BYTES_MAX)
        values |= rules.size_limits(config.site.name) | rules.priorities(config.site.name)
        if access is not None:
            values |= rules.access_control(access)
    values["transport/link/rx/max_message_size"] = largest
    return values


def read_access(config: Config, clock: Clock) -> rules.Access | None:
    """Return the access list, or None without authentication, where everything is allowed.

    Logs a warning for each certificate that has expired or expires soon. Raises `BusError`.
    """
    path = config.bus.tls.access
    if not config.bus.tls.ca:
        return None
    try:
        access = rules.read_access(Path(path).read_bytes())
    except OSError as error:
        raise BusError(f"cannot read the access list {path}: {error.strerror}") from None
    except ValueError as error:
        raise BusError(f"{path} is no access list of `camtopod keys`: {error}") from None
    if access.site != config.site.name:
        raise BusError(f"{path} is for site {access.site}, but this is site {config.site.name}")

    # Warn of certificates that end.
    for certificate, days in rules.expiring_certificates(access, clock()):
        remark = f"expires in {days:.0f} days" if days > 0 else f"expired {-days:.0f} days ago"
        log.warning(
            "the certificate of %s %s: make another with `camtopod keys`", certificate.name, remark
        )
    return access


def check_files(config: Config) -> None:
    """Raise `BusError` if a file of [bus.tls] cannot be read, with its path."""
    tls = config.bus.tls
    if not tls.ca:
        return
    for path in (tls.ca, tls.certificate, tls.private_key):
        try:
            Path(path).open("rb").close()
        except OSError as error:
            raise BusError(f"cannot read {path}: {error.strerror}; see [bus.tls]") from None


def ended_certificate(config: Config) -> str:
    """Return ", " and that the certificate of the daemon has ended; "" if not, or if none is there.

    It may take `HANDSHAKE_SECONDS` for each endpoint; zenoh does not tell the reason.
    """
    tls = config.bus.tls
    for endpoint in config.dials if tls.ca else ():
        try:
            place = urlsplit(f"//{endpoint.removeprefix('tls/')}")
            host = place.hostname or ""
            context = ssl.create_default_context(cafile=tls.ca)
            with (
                socket.create_connection((host, place.port or 0), HANDSHAKE_SECONDS) as link,
                context.wrap_socket(link, server_hostname=host),
            ):
                pass
        except ssl.SSLCertVerificationError as error:
            if error.verify_code == _EXPIRED:
                return (
                    f", as the certificate of the daemon at {endpoint} has ended: make another with"
                    " `camtopod keys`"
                )
        except (OSError, ValueError):  # or zenoh cannot read the endpoint either
            continue
    return ""


def openness_warning(config: Config) -> str | None:
    """Return who has access without authentication, and how to restrict it; None with it."""
    if config.bus.tls.ca:
        return None
    if config.listens and all(map(is_local, config.listens)):
        return (
            "no authentication: every program of this machine can read and write everything; "
            "`camtopod keys init` and [bus.tls] close it"
        )
    public = f"any program that reaches the bus at {', '.join(config.dials)}"
    if config.listens:
        public = f"ANYBODY ON THE NETWORK who reaches {', '.join(config.listens)}"
    return (
        f"no authentication: {public} can write events, read everything learned and answer in the"
        " daemon's place; `camtopod keys init` and [bus.tls] close it"
    )


def is_local(endpoint: str) -> bool:
    """Return True if an endpoint can be reached from this machine only."""
    protocol, _, address = endpoint.partition("/")
    if protocol in ("unixsock-stream", "vsock", "serial"):
        return True
    host = address.split("#")[0].split("?")[0].rpartition(":")[0].strip("[]")
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
