"""Configuration files: TOML to typed settings, with the line of every mistake.

`settings` holds the tables, their defaults, and `load`. It is built on `toml_tables`, which makes
structs of tables, `polygons`, which reads areas of the picture, and `toml_lines`, which finds the
lines of keys. `secret_files` reads and writes files that hold secrets.
"""

from __future__ import annotations

from camtopod.config import polygons, secret_files, settings, toml_lines
from camtopod.config.settings import (
    RESERVED,
    TABLES,
    BusSettings,
    CameraSettings,
    Config,
    HealthSettings,
    KeepSettings,
    Limits,
    SiteSettings,
    StateSettings,
    detector_line,
    without_source,
)
from camtopod.config.toml_tables import DEFAULT_ENDPOINT, FLOAT_MAX, is_endpoint

__all__ = [
    "DEFAULT_ENDPOINT",
    "FLOAT_MAX",
    "RESERVED",
    "TABLES",
    "BusSettings",
    "CameraSettings",
    "Config",
    "HealthSettings",
    "KeepSettings",
    "Limits",
    "SiteSettings",
    "StateSettings",
    "detector_line",
    "is_endpoint",
    "polygons",
    "secret_files",
    "settings",
    "toml_lines",
    "without_source",
]
