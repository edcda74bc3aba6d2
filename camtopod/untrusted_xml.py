"""Read XML that comes from the network: with a limit, without entities and namespaces."""

from __future__ import annotations

from collections.abc import Iterator
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from camtopod.codec import Rejected

DOCUMENT_BYTES_MAX = 1024 * 1024
"""Longest document that is read, in bytes."""


def parse_xml(document: bytes) -> Element:
    """Return the root of a document.

    Raises `Rejected` if it is too long, not UTF-8, malformed, or has a DOCTYPE, which may hold
    entities.
    """
    if len(document) > DOCUMENT_BYTES_MAX:
        raise Rejected("too-long", f"a document of more than {DOCUMENT_BYTES_MAX} bytes")
    try:
        text = document.decode("utf-8")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:  # as in UTF-16, which the parser would recognise by itself
        raise Rejected("malformed", "XML that is not UTF-8")
    if "<!DOCTYPE" in text.upper() or "<!ENTITY" in text.upper():
        raise Rejected("doctype", "a document with a DOCTYPE, which may hold entities")

    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise Rejected("malformed", f"is no XML: {error}") from None


def tag_of(element: Element) -> str:
    """Return the name of an element without its namespace."""
    return element.tag.rpartition("}")[2]


def all_of(element: Element, tag: str) -> Iterator[Element]:
    """Yield the elements of a name, an element itself and those below it."""
    return (node for node in element.iter() if tag_of(node) == tag)


def text_of(element: Element, tag: str) -> str:
    """Return the text of the first element of a name; "" if there is none."""
    return next(((node.text or "").strip() for node in all_of(element, tag)), "")
