"""Remove secrets from text. All text that people or the bus get to see goes through `redact`."""

from __future__ import annotations

import re
from urllib.parse import quote, unquote

HIDDEN = "***"
"""Stands in the text where a secret was."""
_SECRET_CHARACTERS_MIN = 4
"""Shorter passwords are hidden in their URL only: to hide every 'a' would make messages unreadable.
"""

# Each pattern takes a few steps a character at most, as text of the bus is untrusted.
_USERINFO = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://(.*)@", re.DOTALL)
_WORD = re.compile(r"\S+")
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]{0,30}://")
_PARAMETER = re.compile(
    r"(?i)((?<![a-z0-9])(?:user(?:name)?|pass(?:word|wd)?|pwd|auth|token|secret|api_?key"
    r"|sig(?:nature)?)"
    r"|private_key\w{0,30})=[^&\s]+"
)
_PATH = re.compile(
    r"(?<![A-Za-z])(?!file:)([A-Za-z][A-Za-z0-9+.-]{0,30}://[^\s/?#\"'<>]*)([/?#][^\s\"'<>]*)"
)
"""Scheme and host of a URL, and the rest of it; not of ``file:`` URLs, whose path is no secret."""
_TOKEN = re.compile(
    r"""(?<![\w~%+-])
    (?=[A-Za-z_~%+-]*[0-9]) (?=[0-9_~%+-]*[A-Za-z])
    (?: [A-Za-z0-9]{16,} | [A-Fa-f0-9_~%+-]{20,} | (?=[0-9a-z_~%+-]*[A-Z])(?=[0-9A-Z_~%+-]*[a-z])
        [A-Za-z0-9_~%+-]{20,} )
    (?![\w~%+-])""",
    re.VERBOSE,
)
"""What may be a token in a path: a long run of letters and digits.

One with hyphens or the like must have capital and small letters, or hexadecimal digits only.
"""
_KEY = re.compile(r"-----BEGIN ([A-Z ]*PRIVATE KEY)-----.*?(-----END \1-----|\Z)", re.DOTALL)
_secrets: set[str] = set()
"""Secrets to hide wherever they appear."""


def remember(source: str) -> None:
    """Remember the secrets of a camera's source, so that they are hidden outside its URL too.

    They may hold any characters.
    """
    # Tokens in the path and in the query.
    for _, remainder in _PATH.findall(_with_userinfo("", source)):
        _secrets.update(_TOKEN.findall(remainder))

    # User name and password, as written and with percent-encoding undone or done.
    match = _USERINFO.match(source)
    if match is None:
        return
    userinfo = match[1]
    password = userinfo.partition(":")[2]
    plain = unquote(password)
    _secrets.update({f"{userinfo}@", f"{unquote(userinfo)}@"})
    forms = {password, plain, quote(password, safe=""), quote(plain, safe="")}
    _secrets.update(form for form in forms if len(form) >= _SECRET_CHARACTERS_MIN)


def redact(text: str) -> str:
    """Return ``text`` without secrets.

    These are user names and passwords of URLs and of parameters, tokens in the paths of URLs,
    private keys, and remembered secrets.
    """
    text = _KEY.sub(HIDDEN, text)
    for secret in sorted(_secrets, key=len, reverse=True):
        whole = re.escape(secret)
        if secret.isalpha():  # with the password "secret", "secrets" stays
            whole = rf"(?<![A-Za-z]){whole}(?![A-Za-z])"
        text = re.sub(whole, f"{HIDDEN}@" if secret.endswith("@") else HIDDEN, text)
    return _without(_with_userinfo(f"{HIDDEN}@", text))


def holds_secret(source: str) -> bool:
    """Return True if a source is a URL with a password or a token.

    A user name alone is no secret.
    """
    userinfo = _USERINFO.match(source)
    bare = _with_userinfo("", source)
    has_password = userinfo is not None and ":" in userinfo[1].partition("/")[0]
    return has_password or _without(bare) != bare


def _with_userinfo(instead: str, text: str) -> str:
    """Replace the user name and password of each URL by ``instead``.

    They reach up to the last @ of the word, as passwords may hold @, : and /. So the host may be
    replaced too, but never too little.
    """

    def replaced(word: re.Match[str]) -> str:
        at = word[0].rfind("@")
        scheme = _SCHEME.search(word[0], 0, max(at, 0))
        if scheme is None:
            return word[0]
        return f"{word[0][: scheme.end()]}{instead}{word[0][at + 1 :]}"

    return _WORD.sub(replaced, text)


def _without(text: str) -> str:
    """Remove tokens behind the host of URLs, and secret parameters."""
    text = _PATH.sub(lambda url: url[1] + _TOKEN.sub(HIDDEN, url[2]), text)
    return _PARAMETER.sub(rf"\g<1>={HIDDEN}", text)
