"""Learn a camera network's topology from anonymous events; predict where people are seen next.

An event is an entry into the view of a camera, or an exit. Of a recording:

    events = camtopod.load_events("events.csv")    # event lines, tables
    topology = camtopod.learn_topology(events)     # or camtopod.load_topology(path)
    camtopod.Predictor(topology).predict(exit)     # where the object appears next: a Prediction
    camtopod.CityPredictor(city).predict(exit)     # of a city that `camtopod merge` has made
    camtopod.score(topology, events, identities)   # how it fares; identities by camera and track
    camtopod.Gate(topology).affinity(exits, entries)  # which exit and entry are of one object

Of a running daemon, `connect` gives a `Site`; `Learner` learns from a stream. Each name is loaded
when it is first asked for, so programs that only predict do without SciPy.

The packages: `records` has the public data types, and `codec` reads and writes them. `learn` fits a
topology to events; `predict` says in which camera an object appears next; `serve` runs both as a
daemon on a message bus; `vision` makes events of video, `adapt` of other programs' output; `client`
is for programs that use the results. `city` joins many sites. `cli` holds the commands, `config`
the settings, `keys` the access rules, `web` the page and reports, `export` other formats, and `sim`
simulated sites.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from camtopod.cli.events.load import load_events
    from camtopod.client import Gate, Site, connect
    from camtopod.codec import load_topology
    from camtopod.export import export_topology
    from camtopod.learn.learner import Learner
    from camtopod.learn.recording import learn_topology
    from camtopod.predict import CityPredictor, Predictor
    from camtopod.records import Event, Prediction, Topology
    from camtopod.scoring import score
else:
    _HOMES = {
        "camtopod.cli.events.load": ("load_events",),
        "camtopod.client": ("Gate", "Site", "connect"),
        "camtopod.codec": ("load_topology",),
        "camtopod.export": ("export_topology",),
        "camtopod.learn.learner": ("Learner",),
        "camtopod.learn.recording": ("learn_topology",),
        "camtopod.predict": ("CityPredictor", "Predictor"),
        "camtopod.records": ("Event", "Prediction", "Topology"),
        "camtopod.scoring": ("score",),
    }

    def __getattr__(name):
        from importlib import import_module

        for module, names in _HOMES.items():
            if name in names:
                return getattr(import_module(module), name)
        raise AttributeError(f"module 'camtopod' has no attribute {name!r}")

    def __dir__():
        return sorted({*globals(), *__all__})


__version__ = "0.2.0"
__all__ = [
    "CityPredictor",
    "Event",
    "Gate",
    "Learner",
    "Prediction",
    "Predictor",
    "Site",
    "Topology",
    "connect",
    "export_topology",
    "learn_topology",
    "load_events",
    "load_topology",
    "score",
]
