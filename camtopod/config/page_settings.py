"""The settings of the page."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

Address = Annotated[
    str,
    Meta(
        pattern=r"^$|^https?://[^\s/@]+(/\S*)?$",
        description="an address that begins with http:// or https://, without a password",
    ),
]
PlaceOnPlan = Annotated[
    tuple[Annotated[float, Meta(ge=0, le=1)], ...],
    Meta(max_length=2, description="two numbers from 0 to 1, like [0.3, 0.7]"),
]


class WebSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[web]``: who may open the page of `camtopod web`."""

    password_file: str = ""
    """A file whose first line is the password that the page asks for, at least 8 characters; nobody
    else may be able to read it. A path as in [bus.tls]; empty: no password.
    """
    token_file: str = ""
    """A file whose first line is the token with which programs use the HTTP API, at least 20
    characters; needs password_file.
    """


class MapSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[map]``: the map of the page."""

    plan: str = ""
    """A picture (png, jpg or svg) of the floor plan to show beneath the map; a path as in
    [bus.tls]. Cameras with `at` are placed on it, the others below it.
    """
