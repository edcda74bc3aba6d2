"""Read XML that comes from the network, without namespaces and with limits."""

from __future__ import annotations

from collections.abc import Iterator
from xml.etree import ElementTree

DOCUMENT_BYTES_MAX = 1_000_000
"""Longest document that is read, in bytes."""


class SoapError(Exception):
    """A document or an answer cannot be used; ``str()`` says why."""


def parsed(document: bytes) -> ElementTree.Element:
    """Return the root of a document.

    Raises `SoapError` if it is too long, malformed, or has a DOCTYPE, which may hold entities.
    """
    if len(document) > DOCUMENT_BYTES_MAX:
        raise SoapError(f"the answer has more than {DOCUMENT_BYTES_MAX} bytes")
    if b"<!" in document:
        raise SoapError("the answer has a DOCTYPE")
    try:  # the encoding is fixed, so that no other one hides a DOCTYPE
        return ElementTree.fromstring(document, ElementTree.XMLParser(encoding="utf-8"))
    except (ElementTree.ParseError, ValueError):
        raise SoapError("the answer is no XML") from None


def all_of(element: ElementTree.Element, name: str) -> Iterator[ElementTree.Element]:
    """Yield the elements below one that have a name, in any namespace."""
    return (one for one in element.iter() if one.tag.rpartition("}")[2] == name)


def text_of(element: ElementTree.Element, name: str) -> str:
    """Return the text of the first element below one that has a name; "" if there is none."""
    return next(((one.text or "").strip() for one in all_of(element, name)), "")
