"""Variants of clips with ground truth: more of what real video there is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import cv2
import msgspec
import numpy as np

from bench.support.truth_clips import Clip, Picture, place_of
from bench.support.watched_clips import DIAGONALS
from camtopod.records import Event, Kind
from camtopod.vision.detect import Luma
from camtopod.vision.settings import VisionSettings

SLOWER = 1.5
"""Factor on the times of a slowed clip."""
DARKER = 0.5
"""Factor on the luma of a darkened clip."""
HAZE_LEVEL = 128
"""Grey level towards which haze takes each pixel by half."""
SHAKE_SHARE = 0.004
"""Standard deviation of a shaken picture's shift, as a share of its width."""
SHAKE_SHARE_MAX = 0.0125
"""Largest shift of a shaken picture, as a share of its width; this margin is cut off."""
CROP_SHARE_MAX, CROP_SHARE_MIN = 0.2, 0.03
"""Largest and least share of the picture that is cropped at a side."""
CROP_CLEAR_SHARE = 0.25
"""Share of the picture that remains between a cropped side and the nearest foot point."""
DETAIL_FACTOR = 2
"""Crops are taken from pictures of this many times the working width."""
LATER_SHARE = 1 / 3
"""Share of a clip that is left out of one that begins later."""
LATER_SECONDS_MIN = 10.0
"""Least length of what is left of it."""
LEAVES_SHARE = 0.35
"""Width and height of a bush, as shares of the picture."""
LEAF_PIXELS = 3
"""Size of its leaves, pixels of the working picture."""
GUST_PIXELS = 5.0
"""How far the strongest gusts move it at the top, pixels of the working picture."""
GUST_SECONDS = 12.0
"""Time between gusts."""


def mirrored(clip: Clip) -> Clip:
    """Return the clip with left and right exchanged."""

    def pictures(left_out: float, settings: VisionSettings) -> Iterator[Picture]:
        for picture in clip.pictures(left_out, settings):
            yield picture._replace(luma=np.ascontiguousarray(picture.luma[:, ::-1]))

    return _mapped(clip, "mirrored", pictures, x=(-1.0, 1.0))


def backwards(clip: Clip) -> Clip:
    """Return the clip reversed in time: entries become exits."""

    def pictures(left_out: float, settings: VisionSettings) -> Iterator[Picture]:
        for picture in reversed(list(clip.pictures(left_out, settings))):
            yield picture._replace(t=max(0.0, clip.seconds - picture.t))

    return _mapped(clip, "backwards", pictures, t=(-1.0, clip.seconds))


def darkened(clip: Clip) -> Clip:
    """Return the clip with less light, and so less contrast."""

    def pictures(left_out: float, settings: VisionSettings) -> Iterator[Picture]:
        for picture in clip.pictures(left_out, settings):
            yield picture._replace(luma=cv2.convertScaleAbs(picture.luma, alpha=DARKER))

    return _mapped(clip, "darkened", pictures)


def hazy(clip: Clip) -> Clip:
    """Return the clip with half of its contrast, at the same light."""

    def pictures(left_out: float, settings: VisionSettings) -> Iterator[Picture]:
        for picture in clip.pictures(left_out, settings):
            luma = cv2.convertScaleAbs(picture.luma, alpha=0.5, beta=HAZE_LEVEL / 2)
            yield picture._replace(luma=luma)

    return _mapped(clip, "hazy", pictures)


def shaken(clip: Clip) -> Clip:
    """Return the clip as of a camera that trembles: each picture has its own shift."""

    def pictures(left_out: float, settings: VisionSettings) -> Iterator[Picture]:
        rng = np.random.default_rng(1)
        detailed = _detailed(settings)
        for picture in clip.pictures(left_out, detailed):
            height, width = picture.luma.shape
            margin = max(1, round(SHAKE_SHARE_MAX * width))
            shift = np.clip(rng.normal(0.0, SHAKE_SHARE * width, 2), -margin, margin)
            x, y = (margin + shift.round().astype(np.int64)).tolist()
            luma = picture.luma[y : y + height - 2 * margin, x : x + width - 2 * margin]
            yield picture._replace(luma=np.ascontiguousarray(luma))

    return _mapped(clip, "shaken", pictures)


def cropped(clip: Clip) -> Clip | None:
    """Return the clip without the margins that no event is near to; None if there is hardly any.

    Where nobody enters or leaves, passages remain as they are. Somebody may still walk through a
    margin in between, who is then cut.
    """
    if not clip.truth:
        return None
    at = np.array([place_of(event) for event in clip.truth])
    room = np.concatenate([at.min(axis=0), 1.0 - at.max(axis=0)]) - CROP_CLEAR_SHARE
    cut = np.where(room < CROP_SHARE_MIN, 0.0, np.minimum(room, CROP_SHARE_MAX))
    left, top, right, bottom = cut.tolist()
    return part_of(clip, "cropped", (left, top, 1 - right, 1 - bottom)) if cut.any() else None


def part_of(clip: Clip, variant: str, box: tuple[float, float, float, float]) -> Clip:
    """Return the part of the picture in a box (left, top, right, bottom; fractions).

    The truth is that of the clip: it fits if nobody enters or leaves at the cuts.
    """
    left, top, right, bottom = box

    def cut(image: Luma) -> Luma:
        height, width = image.shape[:2]
        rows = slice(round(top * height), round(bottom * height))
        return np.ascontiguousarray(image[rows, round(left * width) : round(right * width)])

    def pictures(left_out: float, settings: VisionSettings) -> Iterator[Picture]:
        for t, luma, image in clip.pictures(left_out, _detailed(settings)):
            yield Picture(t, cut(luma), None if image is None else cut(image))

    wide, high = right - left, bottom - top
    x, y = (1 / wide, -left / wide), (1 / high, -top / high)
    return replace(_mapped(clip, variant, pictures, x, y), aspect=clip.aspect * wide / high)


def slowed(clip: Clip) -> Clip:
    """Return the clip played more slowly; pictures are taken as often as before."""

    def pictures(left_out: float, settings: VisionSettings) -> Iterator[Picture]:
        # The same pictures as of the clip itself at a higher rate.
        faster = msgspec.structs.replace(settings, analysed_fps=SLOWER * settings.analysed_fps)
        for picture in clip.pictures(left_out / SLOWER, faster):
            yield picture._replace(t=SLOWER * picture.t)

    return replace(
        _mapped(clip, "slowed", pictures, t=(SLOWER, 0.0)), seconds=SLOWER * clip.seconds
    )


def begun_later(clip: Clip) -> Clip | None:
    """Return the clip without its first part; None if it is short.

    People who are in view at the beginning have no entry, and may become part of the scene.
    """
    begin = LATER_SHARE * clip.seconds
    if clip.seconds - begin < LATER_SECONDS_MIN:
        return None

    def pictures(left_out: float, settings: VisionSettings) -> Iterator[Picture]:
        for picture in clip.pictures(left_out, settings):
            if picture.t >= begin:
                yield picture._replace(t=picture.t - begin)

    shorter = replace(clip, truth=tuple(event for event in clip.truth if event.t > begin))
    later = _mapped(shorter, "begun later", pictures, t=(1.0, -begin))
    return replace(later, seconds=clip.seconds - begin)


def side_by_side(left: Clip, right: Clip) -> Clip:
    """Return two clips as one wide picture, as long as the shorter of them.

    Both halves are as large as they are alone. Nothing is scored near the seam, where people
    vanish in mid-view.
    """
    total = left.aspect + right.aspect
    seam = left.aspect / total
    seconds = min(left.seconds, right.seconds)
    # The halves have the height of the first, so the second one's width follows from its shape.
    width = round(left.settings.working_width / seam)

    def pictures(left_out: float, settings: VisionSettings) -> Iterator[Picture]:
        single = msgspec.structs.replace(settings, working_width=left.settings.working_width)
        right_pictures = right.pictures(left_out, single)
        right_picture = next(right_pictures, None)
        next_picture = next(right_pictures, None)
        for picture in left.pictures(left_out, single):
            # The other clip's newest picture.
            while next_picture is not None and next_picture.t <= picture.t:
                right_picture, next_picture = next_picture, next(right_pictures, None)
            if right_picture is None or picture.t > seconds:
                return
            height = len(picture.luma)
            size = (round(right.aspect * height), height)
            beside = cv2.resize(right_picture.luma, size, interpolation=cv2.INTER_AREA)
            yield picture._replace(luma=np.hstack([picture.luma, beside]))

    # The truth of both halves.
    a = _mapped(left, "", pictures, x=(seam, 0.0))
    b = _mapped(right, "", pictures, x=(1.0 - seam, seam))
    reach = DIAGONALS * float(np.hypot(total, 1.0)) / total
    truth = sorted((event for event in a.truth + b.truth if event.t <= seconds), key=_time)
    near = [event for event in truth if abs(place_of(event)[0] - seam) <= reach]
    return Clip(
        f"{left.name} + {right.name}",
        "side by side",
        tuple(event for event in truth if event not in near),
        total,
        seconds,
        msgspec.structs.replace(left.settings, working_width=width),
        pictures,
        (*a.maybe, *b.maybe, *near),
        (*a.skip, *b.skip, (seam - reach, 0.0, seam + reach, 1.0)),
        (max(a.span[0], b.span[0]), min(a.span[1], b.span[1])),
    )


def with_leaves(clip: Clip) -> Clip:
    """Return the clip with a bush in the wind in front of the corner where least happens."""
    at = np.array([place_of(event) for event in clip.truth]).reshape(-1, 2)
    corners = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
    distances = np.linalg.norm(at[None, :, :] - corners[:, None, :], axis=2)
    x, y = corners[int(distances.min(axis=1, initial=2.0).argmax())].tolist()

    def pictures(left_out: float, settings: VisionSettings) -> Iterator[Picture]:
        bush: Bush | None = None
        for picture in clip.pictures(left_out, settings):
            luma = picture.luma.copy()
            height, width = luma.shape
            bush = bush or Bush(round(LEAVES_SHARE * width), round(LEAVES_SHARE * height))
            left, top = round(x * (width - bush.width)), round(y * (height - bush.height))
            bush.draw(luma[top : top + bush.height, left : left + bush.width], picture.t)
            yield picture._replace(luma=luma)

    return _mapped(clip, "with leaves", pictures)


class Bush:
    """Leaves of ``width`` x ``height`` pixels that the wind moves, more at the top, in gusts.

    gust (pixels): how far the strongest gusts move it at the top.
    """

    def __init__(self, width: int, height: int, gust: float = GUST_PIXELS) -> None:
        self.width, self.height, self._gust = width, height, gust
        rng = np.random.default_rng(1)
        rows, columns = np.mgrid[0:height, 0:width].astype(np.float32)
        self._rows, self._columns = rows, columns

        # Leaves: noise in two sizes; outline: an uneven oval.
        fine, coarse, outline = (
            cv2.resize(
                rng.normal(0.0, 1.0, (height // size + 2, width // size + 2)).astype(np.float32),
                (width, height),
                interpolation=cv2.INTER_CUBIC,
            )
            for size in (LEAF_PIXELS, 4 * LEAF_PIXELS, 10 * LEAF_PIXELS)
        )
        self._leaves = np.clip(110.0 + 35.0 * fine + 25.0 * coarse, 0.0, 255.0)
        oval = (2 * columns / width - 1) ** 2 + (2 * rows / height - 1) ** 2
        self._mark_occluded = (oval + 0.15 * outline < 0.9).astype(np.float32)

        # Four waves, each with its frequency and its phases.
        self._hertz = rng.uniform(0.3, 1.2, 4)
        self._phases = [
            cv2.resize(
                rng.uniform(0.0, 2 * np.pi, (5, 5)).astype(np.float32),
                (width, height),
                interpolation=cv2.INTER_CUBIC,
            )
            for _ in range(4)
        ]

    def draw(self, canvas: Luma, t: float) -> None:
        """Draw it over ``canvas`` (H, W) as it is at ``t`` seconds."""
        gust = self._gust * (0.35 + 0.65 * max(0.0, np.sin(2 * np.pi * t / GUST_SECONDS)))
        bend = gust * (1.0 - self._rows / self.height)
        waves = [
            np.sin(2 * np.pi * hertz * t + phase)
            for hertz, phase in zip(self._hertz, self._phases, strict=True)
        ]
        columns = (self._columns + bend * (waves[0] + waves[1] / 2)).astype(np.float32)
        rows = (self._rows + bend / 2 * (waves[2] + waves[3] / 2)).astype(np.float32)

        leaves = cv2.remap(
            self._leaves, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT
        )
        cover = cv2.remap(self._mark_occluded, columns, rows, cv2.INTER_LINEAR)
        canvas[:] = (canvas * (1 - cover) + leaves * cover).round().astype(np.uint8)


VARIANTS: dict[str, Callable[[Clip], Clip | None]] = {
    "mirrored": mirrored,
    "backwards": backwards,
    "cropped": cropped,
    "darkened": darkened,
    "hazy": hazy,
    "shaken": shaken,
    "slowed": slowed,
    "begun later": begun_later,
    "with leaves": with_leaves,
}
"""Variants of a single clip by name; None where a clip has none."""
SIDE_BY_SIDE = "side by side"
"""Name of the variant of two clips."""


def with_variants(clips: list[Clip]) -> list[Clip]:
    """Return the clips, then their variants, and each clip beside the next one."""
    result = list(clips)
    for variant in VARIANTS.values():
        result += [new_clip for clip in clips if (new_clip := variant(clip)) is not None]
    if len(clips) > 1:
        result += [side_by_side(a, b) for a, b in zip(clips, clips[1:] + clips[:1], strict=True)]
    return result


def _detailed(settings: VisionSettings) -> VisionSettings:
    """Return settings of pictures with more detail than is analysed, to cut from."""
    return msgspec.structs.replace(settings, working_width=DETAIL_FACTOR * settings.working_width)


def _mapped(
    clip: Clip,
    variant: str,
    pictures: Callable[[float, VisionSettings], Iterator[Picture]],
    x: tuple[float, float] = (1.0, 0.0),
    y: tuple[float, float] = (1.0, 0.0),
    t: tuple[float, float] = (1.0, 0.0),
) -> Clip:
    """Return a variant whose places and times are those of the clip, times a factor, plus a shift.

    Entries become exits where time runs backwards.
    """

    def mapped(event: Event) -> Event:
        column, row = place_of(event)
        turned: Kind = "exit" if event.kind == "entry" else "entry"
        return msgspec.structs.replace(
            event,
            kind=turned if t[0] < 0 else event.kind,
            t=max(0.0, t[0] * event.t + t[1]),
            x=x[0] * column + x[1],
            y=y[0] * row + y[1],
        )

    def box(area: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
        left, right = sorted(x[0] * side + x[1] for side in area[::2])
        top, bottom = sorted(y[0] * side + y[1] for side in area[1::2])
        return left, top, right, bottom

    begin, end = sorted(t[0] * moment + t[1] for moment in clip.span)
    return replace(
        clip,
        variant=variant,
        pictures=pictures,
        truth=tuple(sorted(map(mapped, clip.truth), key=_time)),
        maybe=tuple(map(mapped, clip.maybe)),
        skip=tuple(map(box, clip.skip)),
        span=(begin, end),
    )


def _time(event: Event) -> float:
    return event.t
