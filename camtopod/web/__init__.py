"""Web page of a site: topology, predictions and health; `camtopod report` writes it as one file.

Reading order: `app` is the HTTP server, `api` its part for programs, and `feed` follows the bus for
both. `map_data` makes the map of a version (`camtopod.export` places the cameras), `explanations`
the details of a camera, pair or link, `versions` the time line and what each version changed.
`outbox` queues messages for open pages and `pictures` finds camera pictures. `connections`,
`guards` and `login` decide who is answered; `configured` is what the configuration says about the
page. `report` gathers the data of a report, `single_file` makes one HTML file of it. The page
itself is in ``static/``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import lazy_getattr

if TYPE_CHECKING:
    from camtopod.web.configured import Configured
    from camtopod.web.login import Login
    from camtopod.web.report import gather
    from camtopod.web.single_file import page

__all__ = [
    "Configured",
    "Login",
    "app",
    "gather",
    "page",
    "pictures",
]

__getattr__ = lazy_getattr(
    __name__,
    {
        "Configured": "configured",
        "Login": "login",
        "gather": "report",
        "page": "single_file",
    },
)
