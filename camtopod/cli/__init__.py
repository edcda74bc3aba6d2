"""The command line of camtopod: one module a command.

Read `main` first (command table, parser, `completion`), then `exits` (statuses), `common`
(configuration, logging and signals, shared by the commands) and `site_choice` (the site of a
program that reads), then any module of `commands`. Below them, `cameras` supervises one process per
camera, `events` reads event lines and other programs' formats, `terminal` draws progress and the
live view, and `generated` makes the example configuration and its JSON Schema.
"""

from camtopod.cli.main import console as console
