"""Learn a camera network's topology from anonymous events; predict where people are seen next.

An event is an entry into the view of a camera, or an exit. Start with `records`, the public data
types, and `codec`, which reads and writes them. `learn` fits a topology to events; `predict` says
in which camera an object appears next; `serve` runs both as a daemon on a message bus; `vision`
makes events of video, `adapt` of other programs' output; `client` is for programs that use the
results. `cli` holds the commands, `config` the settings, `keys` the access rules, `web` the page
and reports, `export` other formats, and `sim` simulated sites.
"""

__version__ = "0.2.0"
