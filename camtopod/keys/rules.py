"""Settings of the bus as data, for the daemon's session and for a separate router alike.

Each program that connects shows a certificate of the site's authority, whose common name decides
its rights. Everything that no rule allows is denied, in both directions: a camera's box
publishes and delivers its own events and receives the answers. The functions are pure:
they take names and return settings of zenoh.
"""

from __future__ import annotations

import json
from typing import Any, Literal

import msgspec
from msgspec import Struct

DAEMON = "daemon"
"""Name of the daemon's certificate, and of its folder."""
PREFIX = "camtopo"
"""First part of every key on the bus."""
FORMAT = "camtopod/access/1"
"""`Access.format` of the access lists that this program reads and writes."""
STATUS = "status/daemon"
"""Key, below the site's, of the daemon's status and newest version number."""
SOON_SECONDS = 60 * 86400.0
"""A warning is given for certificates that expire within this time."""
EVENT_BYTES_MAX = 16 * 1024
"""Largest event that the bus lets through, in bytes.

Larger ones are dropped; those too long for an event, but not for the bus, are counted as rejects.
"""
STATUS_BYTES_MAX = 1024 * 1024
"""Largest status that the bus lets through, in bytes."""
QUERY_BYTES_MAX = 320 * 1024
"""Largest content of a query, in bytes: more than a batch, or a hello of 1,000 boots, takes
(`camtopod.serve.requests`).
"""
RECEIVED_BYTES_MAX = 1024 * 1024
"""Largest message that the meeting point accepts, in bytes."""
RECONNECT_MILLISECONDS = (250, 1000)
"""First and largest wait of a box until it reconnects, so that it soon finds a restarted daemon."""

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
READABLE = (
    "topology",
    "topology/model",
    "topology/delta",
    "prediction/*",
    "predict/*",
    "match/*",
    "recent",
    "status/*",
)
"""Keys that a reader may subscribe to and query."""

_LIMITS = (
    ("put", "event/*", EVENT_BYTES_MAX),
    ("put", "status/*", STATUS_BYTES_MAX),
    ("query", "**", QUERY_BYTES_MAX),
)
"""Kind of message, key, and largest size in bytes."""
ANSWERS = "interactive_low"
"""Priority of readers' queries, and so of the answers."""


class Certificate(Struct, frozen=True, omit_defaults=True):
    """A certificate that was issued: its common name, role, and expiry (seconds since 1970)."""

    name: str
    role: Role
    expires: float
    camera: str = ""
    """The camera whose events it may publish."""
    cameras: list[str] = []
    """Instead of one camera: those of another program that publishes several."""
    sites: list[str] = []
    """The sites in which it has these rights; empty: that of the authority."""


class Access(Struct, frozen=True):
    """Contents of ``access.json``, written by `camtopod keys`: the valid certificates."""

    site: str
    certificates: list[Certificate]
    format: Literal["camtopod/access/1"] = FORMAT  # type: ignore[assignment]


def read_access(raw: bytes) -> Access:
    """Return the contents of an ``access.json``; raise `ValueError`."""
    return msgspec.json.decode(raw, type=Access)


def access_control(access: Access) -> Settings:
    """Return settings that allow each certificate's name its keys and deny everything else."""
    # Each certificate gets its own rules, and a policy that applies them to its name.
    all_rules: list[dict[str, Any]] = []
    policies = []
    for certificate in access.certificates:
        rules = _rules(access.site, certificate)
        all_rules += rules
        policies.append({"rules": [rule["id"] for rule in rules], "subjects": [certificate.name]})

    # The subject of a policy is the common name, over TLS only.
    subjects = [
        {"id": c.name, "cert_common_names": [c.name], "link_protocols": ["tls"]}
        for c in access.certificates
    ]
    return {
        "access_control": {
            "enabled": True,
            "default_permission": "deny",
            "rules": all_rules,
            "subjects": subjects,
            "policies": policies,
        }
    }


def mutual_tls(ca: str, certificate: str, private_key: str) -> Settings:
    """Return settings for TLS only, with certificates on both sides.

    A link is closed when its certificate expires.
    """
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


def size_limits(site: str) -> Settings:
    """Return settings that drop messages that are too large where they come in.

    Topologies only go out, so they are not limited here.
    """
    return {
        "low_pass_filter": [
            {
                "flows": ["ingress"],
                "messages": [message],
                "key_exprs": [_key(site, key)],
                "size_limit": size,
            }
            for message, key, size in _LIMITS
        ]
    }


def priorities(site: str) -> Settings:
    """Return settings for the priorities that the meeting point gives to others' messages.

    Queries of readers, and so the answers, get a priority of their own, which has its own queue on
    every link: in the queue of publications, an answer to a reader that has stopped reading would
    delay the publications to all others. Of these messages at most one waits.
    """
    return {
        "qos/network": [
            {
                "flows": ["ingress"],
                "messages": ["query"],
                "key_exprs": [_key(site, key) for key in READABLE],
                "overwrite": {"priority": ANSWERS, "congestion_control": "block_first"},
            }
        ]
    }


def session_settings(mode: str) -> Settings:
    """Return settings without discovery and shared memory, and with short waits to reconnect."""
    return {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,  # milliseconds; by default it waits half a second for discovery
        "transport/shared_memory/enabled": False,
        "connect/retry": {
            "period_init_ms": RECONNECT_MILLISECONDS[0],
            "period_max_ms": RECONNECT_MILLISECONDS[1],
        },
    }


def router_json5(access: Access, listen: list[str], message_bytes_max: int) -> str:
    """Return the configuration file of a separate router.

    It is started in a folder with the daemon's certificate and key.
    """
    # Collect the settings.
    settings = session_settings("router") | {"listen/endpoints": listen}
    settings |= mutual_tls("ca.pem", "certificate.pem", "private.key") | access_control(access)
    settings |= size_limits(access.site) | priorities(access.site)
    settings |= {"transport/link/rx/max_message_size": message_bytes_max}

    # Nest them by the parts of their paths.
    router_config: dict[str, Any] = {}
    for path, value in settings.items():
        *folders, name = path.split("/")
        place = router_config
        for folder in folders:
            place = place.setdefault(folder, {})
        place[name] = value
    return (
        f"// The bus of site {access.site}: who may do what. By `camtopod keys`;"
        f" start the router in this folder.\n" + json.dumps(router_config, indent=1) + "\n"
    )


def expiring_certificates(access: Access, now: float) -> list[tuple[Certificate, float]]:
    """Return the certificates that expire soon, each with the days left (negative: expired)."""
    soon = [
        certificate
        for certificate in access.certificates
        if certificate.expires - now < SOON_SECONDS
    ]
    return [(certificate, (certificate.expires - now) / 86400.0) for certificate in soon]


def _rules(site: str, certificate: Certificate) -> list[dict[str, Any]]:
    """Return the rules that a certificate's role allows."""

    def rule(
        purpose: str, flows: list[str], messages: tuple[str, ...], *keys: str
    ) -> dict[str, Any]:
        return {
            "id": f"{certificate.name} {purpose}",
            "permission": "allow",
            "flows": flows,
            "messages": list(messages),
            "key_exprs": [_key(site, key) for key in keys],
        }

    ingress = ["ingress"]
    egress = ["egress"]
    if certificate.role == "daemon":
        return [rule("everything", ingress + egress, _EVERYTHING, "**")]
    presence_rules = [
        rule(
            "watches",
            ingress,
            ("declare_liveliness_subscriber", "liveliness_query"),
            "alive/daemon/*",
        ),
        rule("sees", egress, ("liveliness_token",), "alive/daemon/*"),
    ]
    if certificate.role == "reader":
        return [
            rule("asks", ingress, ("declare_subscriber", "query"), *READABLE),
            rule("hears", egress, ("put", "reply"), *READABLE),
            *presence_rules,
        ]
    cameras = certificate.cameras or [certificate.camera]

    def of_each(*keys: str) -> list[str]:
        return [f"{key}/{camera}" for camera in cameras for key in keys]

    return [
        rule("publishes", ingress, ("put",), *of_each("event", "status")),
        rule("delivers", ingress, ("query",), *of_each("store")),
        rule("hears", egress, ("reply",), *of_each("store")),
        # A query for the status of all cameras reaches this one too, which answers with its own.
        rule("is asked", egress, ("query",), *of_each("status"), "status/*"),
        rule("answers", ingress, ("declare_queryable", "reply"), *of_each("status")),
        rule("is there", ingress, ("liveliness_token",), *of_each("alive/grabber")),
        *presence_rules,
    ]


def _key(site: str, key: str) -> str:
    return f"{PREFIX}/{site}/{key}"
