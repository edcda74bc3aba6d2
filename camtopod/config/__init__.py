"""Configuration files: TOML to typed settings, with the line of every mistake.

`settings` holds the tables and their defaults, `config_file` reads a file. It is built on
`toml_tables`, which makes structs of tables, and finds the lines of keys. `districts_file` is the
file of a city's districts. `secret_files` reads and writes files that hold secrets.
"""

from camtopod.config import (
    config_file as config_file,
    districts_file as districts_file,
    secret_files as secret_files,
)
from camtopod.config.config_file import (
    detector_line as detector_line,
    without_source as without_source,
)
from camtopod.config.districts_file import (
    District as District,
    Districts as Districts,
    owners_of as owners_of,
    with_borders as with_borders,
)
from camtopod.config.settings import (
    ADDRESS_PATTERN as ADDRESS_PATTERN,
    DEFAULT_ENDPOINT as DEFAULT_ENDPOINT,
    SITES_MAX as SITES_MAX,
    TABLES as TABLES,
    BusSettings as BusSettings,
    CameraSettings as CameraSettings,
    Config as Config,
    ConfigError as ConfigError,
    HealthSettings as HealthSettings,
    KeepSettings as KeepSettings,
    Limits as Limits,
    OtherSite as OtherSite,
    SiteSettings as SiteSettings,
    StateSettings as StateSettings,
    WebSettings as WebSettings,
)
from camtopod.config.toml_tables import fields as fields, key_lines as key_lines
