"""The subcommands, one module each, with `add_parser(add)` and `run(args) -> exit status`.

`camtopod.cli.main` imports only the module of the command that is run. `run`, `grab` and `learn`
are the core, `up` the parts of one machine together; `demo` and `simulate` need no cameras;
`watch`, `web`, `report`, `export` and `predict` show or use results; `ingest`, `bridge` and
`schema` connect other programs; `init`, `check`, `keys` and `doctor` help with the installation.
Those that change a site by hand are in `cli.operator`, those of a city in `cli.city`.
"""
