"""The bus's settings as data, for the daemon's own session and for a router of its own alike: one
source.

Whoever connects shows a certificate of the site's authority; its common name decides what it may
do. What no rule allows is denied, in both directions: a camera's box says its own events and hears
its own acks. Pure: names in, zenoh's settings out.
"""

from __future__ import annotations

import json
from typing import Any, Literal

import msgspec
from msgspec import Struct

PREFIX = "camtopo"
FORMAT = "camtopod/access/1"
STATUS = "status/daemon"
"""Below the site: how the daemon is, and which version is its newest."""
SOON_SECONDS = 60 * 86400.0
"""A certificate that expires within this time is warned of."""
EVENT_BYTES_MAX = 16 * 1024
"""A larger event is dropped by the bus; one that is too long for an event, but not for this, is
counted.
"""
STATUS_BYTES_MAX = 1024 * 1024
QUERY_BYTES_MAX = 4 * 1024
"""What a question may carry beside its parameters."""
SPOOLED_BYTES_MAX = 1536
"""More than a valid event takes in a spool's answer: ids of 64 and 128 characters of at most 4
bytes.
"""
RECEIVED_BYTES_MIN = 1024 * 1024
"""The meeting point takes messages of this size at least."""
RECONNECT_MILLISECONDS = (250, 1000)
"""How long a box waits before it dials again, first and at most: a daemon that restarts is soon
found.
"""

Role = Literal["daemon", "camera", "reader"]
Settings = dict[str, Any]
"""Path in zenoh's configuration -> value."""

_EVERYTHING = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "declare_liveliness_subscriber",
    "liveliness_query",
)
READABLE = ("topology", "topology/delta", "prediction/*", "predict/*", "status/*")
"""What a reader may hear and ask."""

_LIMITS = (
    ("put", "event/*", EVENT_BYTES_MAX),
    ("put", "status/*", STATUS_BYTES_MAX),
    ("query", "**", QUERY_BYTES_MAX),
)
"""Kind of message, key, and the most bytes that it may have."""
MARKS = {"background": _LIMITS[0], "data_low": _LIMITS[1], "data_high": _LIMITS[2]}
"""Priority -> the limit that a message with it is over; see `priorities`."""
ANSWERS = "interactive_low"
"""Priority of what readers ask, and so of the answers."""


class Certificate(Struct, frozen=True, omit_defaults=True):
    """A certificate given out: its common name, what it is for, and when it ends (seconds since
    1970).
    """

    name: str
    role: Role
    expires: float
    camera: str = ""
    """The camera whose events it may publish."""
    cameras: list[str] = []
    """Instead of one: those of another program that speaks for several."""


class Access(Struct, frozen=True):
    """``access.json``: the certificates that may do something. Written by `camtopod keys`."""

    site: str
    certificates: list[Certificate]
    format: Literal["camtopod/access/1"] = FORMAT  # type: ignore[assignment]


def read_access(raw: bytes) -> Access:
    """The contents of an ``access.json``. Raises `ValueError`."""
    return msgspec.json.decode(raw, type=Access)


def access_control(access: Access) -> Settings:
    """Default deny, and what each certificate's name allows."""
    allowed: list[dict[str, Any]] = []
    policies = []
    for certificate in access.certificates:
        mine = _rules(access.site, certificate)
        allowed += mine
        policies.append({"rules": [rule["id"] for rule in mine], "subjects": [certificate.name]})
    subjects = [
        {"id": c.name, "cert_common_names": [c.name], "link_protocols": ["tls"]}
        for c in access.certificates
    ]
    return {
        "access_control": {
            "enabled": True,
            "default_permission": "deny",
            "rules": allowed,
            "subjects": subjects,
            "policies": policies,
        }
    }


def mutual_tls(ca: str, certificate: str, private_key: str) -> Settings:
    """Nothing but TLS, both sides show a certificate, and one that ends closes its link."""
    tls: Settings = {
        "root_ca_certificate": ca,
        "listen_certificate": certificate,
        "listen_private_key": private_key,
        "connect_certificate": certificate,
        "connect_private_key": private_key,
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
    }
    return {"transport/link/protocols": ["tls"]} | {
        f"transport/link/tls/{key}": value for key, value in tls.items()
    }


def sizes(site: str, pull_events_max: int) -> Settings:
    """What is larger is dropped where it comes in. Topologies go out only, so they are not limited
    here.
    """
    limits = [*_LIMITS, ("reply", "spool/*", spool_bytes_max(pull_events_max))]
    return {
        "low_pass_filter": [
            {
                "flows": ["ingress"],
                "messages": [message],
                "key_exprs": [_key(site, key)],
                "size_limit": size,
            }
            for message, key, size in limits
        ]
    }


def priorities(site: str) -> Settings:
    """Priorities that the meeting point gives to some messages, whatever those who send them ask
    for.

    What will be dropped by `sizes` gets another one for each limit: of that zenoh writes a line to
    its log that says which, while of a message that is dropped it says neither the key nor the
    reason. Answers cannot be marked so; one that is too large for a spool is too large for the
    meeting point to receive. Nor does an attachment count here, as it does there; of events it has
    some tens of bytes.

    What readers ask, and so the answers, gets a priority, which is a queue on every link, of its
    own: in that of the publications an answer to a reader that has stopped reading would hold up
    publications to all others. Nor does more than one of them wait.
    """
    marks = [
        {
            "flows": ["ingress"],
            "messages": [message],
            "key_exprs": [_key(site, key)],
            "payload_size": f"{size + 1}..",
            "overwrite": {"priority": priority},
        }
        for priority, (message, key, size) in MARKS.items()
    ]
    answers = {
        "flows": ["ingress"],
        "messages": ["query"],
        "key_exprs": [_key(site, key) for key in READABLE],
        "overwrite": {"priority": ANSWERS, "congestion_control": "block_first"},
    }
    return {"qos/network": [*marks, answers]}


def spool_bytes_max(pull_events_max: int) -> int:
    """The largest answer of a spool, which is the largest message that a meeting point has to take,
    but for the parts that shards tell.
    """
    return max(RECEIVED_BYTES_MIN, pull_events_max * SPOOLED_BYTES_MAX)


def quiet(mode: str) -> Settings:
    """Nobody is looked for or answered by multicast or gossip; no shared memory; lost links are
    soon dialled again.
    """
    return {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,  # milliseconds: by default half a second is waited for those whom nobody looks for
        "transport/shared_memory/enabled": False,
        "connect/retry": {
            "period_init_ms": RECONNECT_MILLISECONDS[0],
            "period_max_ms": RECONNECT_MILLISECONDS[1],
        },
    }


def router_json5(
    access: Access, listen: list[str], message_bytes_max: int, pull_events_max: int
) -> str:
    """The configuration of a router of its own, to be started beside the daemon's certificate and
    key.
    """
    settings = quiet("router") | {"listen/endpoints": listen}
    settings |= mutual_tls("ca.pem", "certificate.pem", "private.key") | access_control(access)
    settings |= sizes(access.site, pull_events_max) | priorities(access.site)
    settings |= {"transport/link/rx/max_message_size": message_bytes_max}
    nested: dict[str, Any] = {}
    for path, value in settings.items():
        *folders, name = path.split("/")
        place = nested
        for folder in folders:
            place = place.setdefault(folder, {})
        place[name] = value
    return (
        f"// The bus of site {access.site}: who may do what. By `camtopod keys`; start the router in this folder.\n"
        + json.dumps(nested, indent=1)
        + "\n"
    )


def expiring(access: Access, now: float) -> list[tuple[Certificate, float]]:
    """Certificates that have ended or will soon, with the days left (below 0: ended)."""
    left = [(certificate, certificate.expires - now) for certificate in access.certificates]
    return [
        (certificate, seconds / 86400.0) for certificate, seconds in left if seconds < SOON_SECONDS
    ]


def _rules(site: str, certificate: Certificate) -> list[dict[str, Any]]:
    def rule(what: str, flows: list[str], messages: tuple[str, ...], *keys: str) -> dict[str, Any]:
        return {
            "id": f"{certificate.name} {what}",
            "permission": "allow",
            "flows": flows,
            "messages": list(messages),
            "key_exprs": [_key(site, key) for key in keys],
        }

    come, go = ["ingress"], ["egress"]
    if certificate.role == "daemon":
        return [rule("everything", come + go, _EVERYTHING, "**")]
    if certificate.role == "reader":
        return [
            rule("asks", come, ("declare_subscriber", "query"), *READABLE),
            rule("hears", go, ("put", "reply"), *READABLE),
            rule(
                "watches",
                come,
                ("declare_liveliness_subscriber", "liveliness_query"),
                "alive/daemon/*",
            ),
            rule("sees", go, ("liveliness_token",), "alive/daemon/*"),
        ]
    cameras = certificate.cameras or [certificate.camera]

    def of_each(*keys: str) -> list[str]:
        return [f"{key}/{camera}" for camera in cameras for key in keys]

    return [
        rule("says", come, ("put",), *of_each("event", "status")),
        # Whoever asks all cameras for their status reaches this one, too, which answers with its
        # own.
        rule("is asked", go, ("query",), *of_each("spool", "status"), "status/*"),
        rule("answers", come, ("declare_queryable", "reply"), *of_each("spool", "status")),
        rule("listens", come, ("declare_subscriber",), *of_each("ack")),
        rule("hears", go, ("put",), *of_each("ack")),
        rule("is there", come, ("liveliness_token",), *of_each("alive/grabber")),
    ]


def _key(site: str, key: str) -> str:
    return f"{PREFIX}/{site}/{key}"
