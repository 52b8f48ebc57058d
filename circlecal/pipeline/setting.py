"""What all attempts at one frame share: options, field and random draws; and the picture as the stages see it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from circlecal.config import Config, aspect_of, config_digest
from circlecal.detection import Detection
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.projective import Mask
from circlecal.observations import Observations
from circlecal.paint.brightness import brightness_of_paint
from circlecal.pictures.graphics import cover_bands, fill_bands, find_bands, lie_clear
from circlecal.pictures.interlacing import measure_row_motion, remove_combs
from circlecal.pictures.window import cover_outside
from circlecal.results import Attempt, Cues, FrameCalibration, LineCue, MarkingMask, RayPoints
from circlecal.stages.mask import look_quickly, suit_field

T = TypeVar("T")

FEWEST_CLEAR, LEAST_CLEAR = 8, 0.5
"""Points, and share of its points, that graphics must leave of a straight marking: else it is their own edge."""


def frame_generator(seed: int) -> np.random.Generator:
    """Random generator of one frame, which every frame begins anew: neither its name, nor the order of frames, nor the
    number of workers changes an answer.
    """
    return np.random.default_rng(seed)


@dataclass(frozen=True, slots=True)
class Setting:
    """What stays the same over all attempts at one frame.

    Attributes
    ----------
    config, template, circle : Config, FieldTemplate, Circle
        Options, the field, and the circle of it that is looked for.
    width, height : int
        Size of the picture, pixels.
    rng : numpy.random.Generator
        For all random draws of the frame.
    timings_ms : dict
        Time spent in each stage so far.
    """

    config: Config
    template: FieldTemplate
    circle: Circle
    width: int
    height: int
    rng: np.random.Generator
    timings_ms: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def clock(self, stage: str) -> Iterator[None]:
        """Add the time that is spent here to that of a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            spent = (time.perf_counter() - start) * 1e3
            self.timings_ms[stage] = round(self.timings_ms.get(stage, 0.0) + spent, 3)

    def calibration(self, attempt: Attempt, frame_id: str, source: str | None) -> FrameCalibration:
        """The attempt that was taken, with the frame's identity."""
        return FrameCalibration(
            id=frame_id,
            width=self.width,
            height=self.height,
            field_name=self.template.name,
            circle_name=attempt.circle_name or self.circle.name,
            attempt=attempt,
            seed=self.config.seed,
            config_digest=config_digest(self.config),
            timings_ms=self.timings_ms,
            source=source,
            template=self.template,
            aspect=aspect_of(self.config),
        )


class Looks:
    """What was found in a picture, kept for further templates that ask for the same."""

    def __init__(self) -> None:
        self._found: dict[tuple[object, ...], object] = {}

    def once(self, key: tuple[object, ...], look: Callable[[], T]) -> T:
        """What a look finds, or found before under the same key."""
        if key not in self._found:
            self._found[key] = look()
        return cast("T", self._found[key])

    def keep(self, key: tuple[object, ...], found: object) -> None:
        """Keep what was found under a key, in the place of what was found before."""
        self._found[key] = found

    def recall(self, key: tuple[object, ...]) -> object | None:
        """What was found under a key; None where nothing was."""
        return self._found.get(key)


@dataclass(frozen=True, slots=True)
class Scene:
    """One picture as the stages see it.

    Attributes
    ----------
    image : (H, W, 3) uint8
        BGR picture, with both halves of an interlaced frame joined.
    gray : (H, W) uint8
        Its brightness.
    relief : (H, W) uint8 or None
        In its place for all that is painted: lines and edges as light bands, where a disc's rim is looked for.
    covered : (H, W) bool or None
        What graphics cover; None where there are none.
    outside : (H, W) bool or None
        What lies outside the picture's window; None where the camera took all of it.
    given : (H, W) uint8 or None
        The user's marking mask.
    extra : Observations or None
        What was given beside the picture.
    first_look : Detection or None
        What the quick passes of the built-in detector found; None where the marking comes from elsewhere.
    looks : Looks
        What was found in the picture so far.
    """

    image: NDArray[np.uint8]
    gray: NDArray[np.uint8]
    given: NDArray[np.uint8] | None
    extra: Observations | None
    first_look: Detection | None
    looks: Looks = field(default_factory=Looks)
    relief: NDArray[np.uint8] | None = None
    covered: Mask | None = None
    outside: Mask | None = None

    @property
    def unseen(self) -> Mask | None:
        """Where (H, W) the camera's picture is not seen: what graphics cover, and what lies outside its window."""
        if self.covered is None or self.outside is None:
            return self.outside if self.covered is None else self.covered
        return self.covered | self.outside

    @property
    def marked(self) -> NDArray[np.uint8]:
        """The picture (H, W) in which markings are measured."""
        return self.gray if self.relief is None else self.relief

    def clear_rays(self, rays: RayPoints) -> RayPoints:
        """What was seen of the circle where no graphics cover or touch it."""
        if self.covered is None:
            return rays
        outer, inner, middle = (
            lie_clear(points, self.covered) for points in (rays.outer_px, rays.inner_px, rays.center_line_px)
        )
        both = outer & inner
        return replace(
            rays,
            outer_px=rays.outer_px[both],
            outer_sigma_px=rays.outer_sigma_px[both],
            inner_px=rays.inner_px[both],
            inner_sigma_px=rays.inner_sigma_px[both],
            center_line_px=rays.center_line_px[middle],
            center_line_sigma_px=rays.center_line_sigma_px[middle],
        )

    def clear_line(self, line: LineCue) -> LineCue | None:
        """A straight marking where no graphics cover or touch it; None where too little of it is left."""
        is_clear = lie_clear(line.points_px, self.covered)
        if is_clear.all():
            return line
        if np.count_nonzero(is_clear) < max(FEWEST_CLEAR, LEAST_CLEAR * len(is_clear)):
            return None
        return replace(line, points_px=line.points_px[is_clear], sigma_px=line.sigma_px[is_clear])

    def clear_cues(self, cues: Cues) -> Cues:
        """The cues without what graphics cover or touch of straight markings."""
        halfway = None if cues.halfway is None else self.clear_line(cues.halfway)
        return replace(cues, halfway=halfway, lines=self.clear_lines(cues.lines))

    def clear_lines(self, lines: Iterable[LineCue]) -> tuple[LineCue, ...]:
        """Straight markings without those of which graphics leave too little."""
        return tuple(clear for line in lines if (clear := self.clear_line(line)) is not None)


def prepare_scene(
    setting: Setting,
    image: NDArray[np.uint8],
    given: NDArray[np.uint8] | None,
    extra: Observations | None,
    looks: Looks | None = None,
) -> Scene:
    """A picture with its brightness and a first look for its circle; both halves of an interlaced frame are joined.

    What was found in the same picture under another template serves this one, too.
    """
    looks = looks or Looks()
    with setting.clock("mask"):
        told = setting.config.mask
        gray = brightness_of_paint(image, told.paint_bgr, told.other_paint_bgr)
        motion = measure_row_motion(gray) if setting.config.mask.deinterlace else None
        if motion is not None:
            image = remove_combs(image, motion)
        bands = looks.once(("bands",), lambda: find_bands(image)) if told.leave_out_graphics else ()
        covered = cover_bands(image.shape, bands) if bands else None
        if motion is not None or bands:
            image = fill_bands(image, bands)
            gray = brightness_of_paint(image, told.paint_bgr, told.other_paint_bgr)
        options = suit_field(setting.config.mask, setting.template)
        key = ("first look", options.model_dump_json())
        first_look = looks.once(key, lambda: look_quickly(image, given, options, setting.rng, gray, covered))
    window = setting.config.camera.window_px
    outside = None if window is None else cover_outside(image.shape, window)
    return Scene(image, gray, given, extra, first_look, looks, covered=covered, outside=outside)


def lighten_markings(gray: NDArray[np.uint8], mask: MarkingMask, circle: Circle) -> NDArray[np.uint8]:
    """Brightness, inverted where the markings are darker than the surface, as it was seen or as the template says."""
    dark = circle.color == "dark" if mask.polarity is None else mask.polarity < 0
    return ~gray if dark else gray
