"""The subcommands, one module each, with `add_parser(add)` and `run(args) -> exit status`.

`camtopod.cli.main` imports only the module of the command that is run. `run`, `grab` and `learn`
are the core; `demo` and `simulate` need no cameras; `watch`, `web`, `report`, `export` and
`predict` show or use results; `ingest`, `bridge` and `schema` connect other programs; `forget`,
`rename` and `reset` change a site by hand; `init`, `check`, `keys` and `doctor` help with the
installation.
"""
