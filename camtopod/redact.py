"""The one place where secrets are taken out of text: what a person or the bus sees goes through `redact`."""

from __future__ import annotations

import re
from urllib.parse import quote, unquote

HIDDEN = "***"
_SECRET_CHARACTERS_MIN = 4
"""A shorter password is hidden inside its URL only: hiding every 'a' would hide the message too."""

_USERINFO = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*://)\S*@")
"""To the last @ of the word: passwords may hold @, : and /. It may hide the host too, never too little."""
_PARAMETER = re.compile(r"(?i)(?<![a-z0-9])(user(?:name)?|pass(?:word|wd)?|pwd|token|secret|\w*private_key\w*)=[^&\s]+")
_KEY = re.compile(r"-----BEGIN ([A-Z ]*PRIVATE KEY)-----.*?(-----END \1-----|\Z)", re.DOTALL)
_known: set[str] = set()


def remember(source: str) -> None:
    """Learn a source's secret, so that it is hidden outside its URL too, whatever characters are in it."""
    match = re.match(r"[A-Za-z][A-Za-z0-9+.-]*://(.*)@", source, re.DOTALL)
    if match is None:
        return
    userinfo = match.group(1)
    _known.update({f"{userinfo}@", f"{unquote(userinfo)}@"})
    password = userinfo.partition(":")[2]
    for form in (password, unquote(password), quote(password, safe=""), quote(unquote(password), safe="")):
        if len(form) >= _SECRET_CHARACTERS_MIN:
            _known.add(form)


def redact(text: str) -> str:
    """``text`` without the user names and passwords of URLs, also as parameters, private keys, and remembered
    secrets.
    """
    text = _KEY.sub(HIDDEN, text)
    for secret in sorted(_known, key=len, reverse=True):
        text = text.replace(secret, f"{HIDDEN}@" if secret.endswith("@") else HIDDEN)
    text = _USERINFO.sub(rf"\g<1>{HIDDEN}@", text)
    return _PARAMETER.sub(rf"\g<1>={HIDDEN}", text)
