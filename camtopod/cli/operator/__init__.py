"""The commands that change a site by hand, modules like those of `cli.commands`.

`forget` sends every such command to the daemon; `rename` and `reset` use it.
"""
