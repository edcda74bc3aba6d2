"""The mechanisms of camtopod that `bench ablation` leaves out, and constants that it scales."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any
from unittest.mock import patch

import numpy as np
from msgspec import Struct

from camtopod.learn.prediction_model import missed_shares
from camtopod.learn.traffic.speed import NO_PERSISTENCE
from camtopod.topology import LagBins


class Mechanism(Struct, frozen=True):
    """A mechanism that can be left out.

    ``replaced`` maps names (``module:name``, below `camtopod`) to their replacements.
    """

    name: str
    replaced: dict[str, Any]


def _without_levels(*levels: int) -> Callable[..., Any]:
    """Return a replacement of `Contexts._contexts` in which some levels are always unknown."""
    method = import_module("camtopod.learn.next_camera.contexts").Contexts._contexts

    def contexts_of(self: Any, *arguments: Any) -> Any:
        contexts = method(self, *arguments)
        return [(c, weight * (k not in levels)) for k, (c, weight) in enumerate(contexts)]

    return contexts_of


def _no_tone_shift(self: Any, *arguments: Any) -> Any:
    """Stand in for `Background._tone_shift`: the light is always that of the model."""
    return np.zeros(256, np.float32)


MECHANISMS = [
    Mechanism(
        "context: entry and block",
        {"learn.next_camera.contexts:Contexts._contexts": _without_levels(0)},
    ),
    Mechanism(
        "context: camera before",
        {"learn.next_camera.contexts:Contexts._contexts": _without_levels(1)},
    ),
    Mechanism(
        "contexts, all", {"learn.next_camera.contexts:Contexts._contexts": _without_levels(0, 1)}
    ),
    Mechanism(
        "speed", {"learn.association.em:estimate_persistence": lambda *arguments: NO_PERSISTENCE}
    ),
    Mechanism("prior: paths are two-way", {"learn.next_camera.prior:RETURNING": 0.0}),
    Mechanism("faint transitions", {"learn.next_camera.fit:FAINT_TRANSITIONS": 0.0}),
    Mechanism(
        "spurious transitions",
        {
            "learn.next_camera.fit:spurious_shares": lambda pair, weight, evidence, *arguments: (
                np.zeros(len(evidence))
            )
        },
    ),
    Mechanism("entry kernels", {"learn.next_camera.entry_kernels:ENTRY_PAIRS_MAX": (0, 0)}),
    Mechanism("overlapping views", {"learn.refit:find_overlapping": lambda *arguments: []}),
    Mechanism(
        "test of overlap",
        {
            "learn.next_camera.fit:negative_without_overlap": lambda problem, c, *arguments: (
                np.zeros(len(c.lag), np.bool_)
            )
        },
    ),
    Mechanism(
        "missed detections, prediction",
        {
            "learn.prediction_model:missed_shares": lambda posterior, scene, bins, shares: (
                missed_shares(posterior, scene, bins, None)
            )
        },
    ),
    Mechanism(
        "missed detections, links",
        {"learn.links.publishing:own_transitions": lambda table, shares: table.transit.total},
    ),
    Mechanism(
        "range of lags is found",
        {"learn.refit:find_lag_bins": lambda *arguments: LagBins(-120.0, 180.0)},
    ),
    Mechanism(
        "labels", {"learn.association.em:estimate_label_persistence": lambda *arguments: 0.0}
    ),
    Mechanism("ways through zones", {"learn.zones.partition:way_contrast": lambda *a: math.inf}),
    Mechanism(
        "rhythm", {"learn.traffic.labelled_events:rhythm_rates": lambda t, zone, even, n: even}
    ),
    Mechanism(
        "activity of the site",
        {
            f"learn.{module}:activity_rates": lambda t, zone, camera, rate: rate
            for module in ("links.cross_validation", "paths.camera_lags")
        },
    ),
    Mechanism(
        "past of a zone by age",
        {"learn.traffic.rhythm:_past_by_age": lambda t, zone, zones: np.zeros((0, len(t)))},
    ),
    Mechanism(
        "common cycle",
        {"learn.refit:without_cycle": lambda problem, fit: (fit, np.full(len(fit.counts), np.nan))},
    ),
    Mechanism(
        "one occasion tells little",
        {
            f"learn.links.{module}:repeated": lambda nats: nats.sum(axis=-1)
            for module in ("significance", "cross_validation")
        },
    ),
    Mechanism("changes", {"learn.refit:find_changes": lambda *arguments: []}),
    Mechanism("over-relaxed EM", {"learn.association.em:STRIDE": 1.0}),
    Mechanism("sparse prior", {"learn.association.joint_fit:SPARSITY": 0.0}),
    Mechanism("second opinion", {"learn.refit:is_wanted": lambda *arguments: False}),
    Mechanism(
        "second opinion between zones", {"learn.paths.opinion:_has_platoons": lambda scene: False}
    ),
    Mechanism(
        "second opinion on links",
        {"learn.refit:with_second_opinion": lambda table, *arguments: table},
    ),
    Mechanism("anywhere", {"predict.anywhere:surplus": lambda *arguments: 0.0}),
    Mechanism("long paths", {"learn.long_paths:find_long_paths": lambda *arguments: []}),
    Mechanism(
        "usual dwell times",
        {"learn.refit:with_usual_dwell_times": lambda departures, through: departures},
    ),
    Mechanism(
        "silent cameras",
        {"predict.predictor_memory:Reporting.is_alive": lambda self: np.ones(len(self._cameras))},
    ),
    Mechanism(
        "seen before the exit",
        {"predict.hazards:Hazards.seen_before": lambda self, zone: np.zeros(self._zones, np.bool_)},
    ),
]
"""The mechanisms that are left out in turn."""

VISION = [
    Mechanism("filter of noise", {"vision.detect.motion:NOISE_TO_FILTER": math.inf}),
    Mechanism("alignment with the scene", {"vision.detect.motion:SHAKE_PIXELS": math.inf}),
    Mechanism("damping of the alignment", {"vision.detect.shake:_DAMPING": 0.0}),
    Mechanism("tone curve", {"vision.detect.background:Background._tone_shift": _no_tone_shift}),
    Mechanism("light makes no edges", {"vision.detect.motion:EDGE_MIN": 0.0}),
    Mechanism("contrast of objects", {"vision.detect.object_contrast:ObjectContrast.share": 1.0}),
    Mechanism(
        "swaying background",
        {"vision.detect.swaying:Swaying.without": lambda self, differs, *arguments: differs},
    ),
    Mechanism(
        "blank areas", {"vision.detect.motion:blank_pixels": lambda frames: frames[0] * np.uint8(0)}
    ),
    Mechanism(
        "sudden change", {"vision.detect.motion:MotionDetector._has_changed": lambda *a: False}
    ),
    Mechanism("adoption", {"vision.detect.motion:ADOPT_SECONDS": math.inf}),
    Mechanism("ghosts", {"vision.detect.motion:MotionDetector.is_ghost": lambda *a: False}),
    Mechanism("dense part", {"vision.detect.blobs:SPARSE_SHARE_MAX": 0.0}),
    Mechanism("small fragments", {"vision.detect.blobs:NEAR": -math.inf}),
    Mechanism("blindness", {"vision.pipeline:Blindness.step": lambda *a: None}),
    Mechanism("learned doors", {"vision.track.doors:DOOR_EVENTS_MIN": math.inf}),
    Mechanism("stature", {"vision.track.stature:Stature.height": lambda self, row: None}),
    Mechanism("farther of head and foot", {"vision.track.assignment:NEARER_SHARE": 1.0}),
    Mechanism("movement confirms", {"vision.track.tracker:CONFIRM_HEIGHTS": 0.0}),
]
"""The mechanisms of vision that are left out in turn, on clips."""

CONSTANTS = (
    ("BACK_OFF_DEPARTURES", ("learn.next_camera.contexts", "predict.contexts")),
    ("RETURNING", ("learn.next_camera.prior",)),
    ("FAINT_TRANSITIONS", ("learn.next_camera.fit",)),
    ("SPREAD", ("learn.next_camera.spurious",)),
    ("CHANCE_PRIOR", ("learn.next_camera.spurious",)),
    ("DEPARTURES_TO_TELL", ("learn.next_camera.spurious",)),
    ("CLEAR_NOISE_SD", ("learn.next_camera.fit", "learn.next_camera.overlapping_views")),
    ("SPARSITY", ("learn.association.joint_fit", "learn.links.cross_validation")),
    ("OUTSIDE_LEAST", ("learn.links.cross_validation", "learn.paths.path_fit")),
    ("OCCASION_SHARE_MAX", ("learn.links.significance",)),
    ("PEAK_NATS", ("learn.links.common_cycle",)),
    ("ACTIVITY_SECONDS", ("learn.traffic.rhythm",)),
    ("CONTRAST_MIN", ("learn.lag_range",)),
    ("SPARE", ("learn.lag_range",)),
    ("WAY_CONTRAST", ("learn.zones.partition",)),
    ("DEPARTURES_PER_ZONE", ("learn.paths.opinion",)),
    ("PLATOON_NATS", ("learn.paths.opinion",)),
)
"""Constants that are halved and doubled: name, and the modules that hold it."""
FACTORS = (0.5, 2.0)
"""Factors by which each constant is scaled."""


def times(name: str, factor: float) -> str:
    """Return the name of a constant with a factor."""
    return f"{name} x {factor:g}"


SCALED = [
    Mechanism(
        times(name, factor),
        {
            f"{module}:{name}": factor * getattr(import_module(f"camtopod.{module}"), name)
            for module in modules
        },
    )
    for name, modules in CONSTANTS
    for factor in FACTORS
]
"""The constants with each factor, in the form of mechanisms."""


@contextlib.contextmanager
def without(mechanism: str) -> Iterator[None]:
    """Replace a mechanism ("": none) while the block runs."""
    replacements: dict[str, Any] = {}
    for candidate in (*MECHANISMS, *VISION, *SCALED):
        if candidate.name == mechanism:
            replacements |= candidate.replaced
    with contextlib.ExitStack() as stack:
        for name, stand_in in replacements.items():
            module, _, path = name.partition(":")
            *owners, attribute = path.split(".")
            owner: Any = import_module(f"camtopod.{module}")
            for part in owners:
                owner = getattr(owner, part)
            stack.enter_context(patch.object(owner, attribute, stand_in))
        yield
