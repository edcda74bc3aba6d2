"""The page: a site's topology, predictions and health in a browser; `camtopod report` writes the
same as one file.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import names_from

if TYPE_CHECKING:
    from camtopod.web.report import gather
    from camtopod.web.single_file import page

__all__ = [
    "app",
    "gather",
    "page",
    "pictures",
]

__getattr__ = names_from(
    __name__,
    {
        "gather": "report",
        "page": "single_file",
    },
)
