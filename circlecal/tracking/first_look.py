"""The pictures with which a survey begins: some calibrated alone, all in the shapes that tracking needs, and seen along
the colour of the clip's paint where that tells it better than brightness does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from circlecal.config import Config
from circlecal.field import FieldTemplate
from circlecal.paint.shared_paint import Colour, agree_on_paint, is_coloured
from circlecal.pictures.interlacing import join_fields
from circlecal.pipeline import calibrate_image, field_of
from circlecal.results import CameraFit
from circlecal.stages.mask import suit_field, tell_paint
from circlecal.tracking.anchors import Anchor
from circlecal.tracking.looking import LookedAt
from circlecal.tracking.markings import DrawnTemplate, place_markings
from circlecal.tracking.seen_paint import MeasuredFrame, measure_markings

PicturesAt = Callable[[Sequence[float]], Iterator[NDArray[np.uint8] | None]]
"""Decodes, at some growing times, the first frame at or after each; None where there is none."""

ENOUGH_ALONE = 10
"""Frames that are calibrated alone; all others are found by the tripod that these determine."""
LEAST_OWN_PLACES = 30
"""Places with paint, 9 px apart at 1920 px width, of a frame that was calibrated alone and counts."""


@dataclass(frozen=True, slots=True)
class Alone:
    """A frame that was calibrated alone, with the paint of its markings."""

    name: str
    fit: CameraFit
    measured: MeasuredFrame
    is_named: bool = False
    """Whether a person named what is seen in it; then it needs no second frame that agrees."""


@dataclass(slots=True)
class FirstLook:
    """Pictures of a clip by their names, and those that were calibrated alone.

    Attributes
    ----------
    pictures : dict
        All pictures.
    alone : list of Alone
        Frames whose camera is known, with enough of their paint.
    paints : list of (float, float, float)
        What the paint adds to blue, green and red of its surface in each frame that was calibrated alone.
    tried : set of str
        Pictures that were to be calibrated alone, whether they could be or not.
    """

    pictures: dict[str, LookedAt] = field(default_factory=dict)
    alone: list[Alone] = field(default_factory=list)
    paints: list[Colour] = field(default_factory=list)
    tried: set[str] = field(default_factory=set)

    def with_one_surface(self) -> dict[str, LookedAt]:
        """The pictures with the playing surface that has the colour of those that were calibrated alone."""
        usual = self.surface_colour
        return {name: picture.take_surface(usual) for name, picture in self.pictures.items()}

    @property
    def surface_colour(self) -> NDArray[np.float64] | None:
        """Median a and b (2,) of the playing surface in CIE Lab, levels, over the frames that were calibrated alone."""
        colours = [colour for a in self.alone if (colour := self.pictures[a.name].colour) is not None]
        return np.asarray(np.median(colours, axis=0)) if colours else None


def suit_tracking(config: Config, paint_bgr: Colour | None) -> Config:
    """The options for following the markings of a clip: with what the field template says of them, and with the colour
    of their paint where it is known.
    """
    template, _ = field_of(config)
    return config.model_copy(update={"mask": suit_field(tell_paint(config.mask, paint_bgr), template)})


def learn_paint(look: FirstLook, config: Config) -> Colour | None:
    """What the paint of a clip adds to blue, green and red of its surface; None where brightness tells it as well, the
    frames that were calibrated alone do not agree, or it was said before.
    """
    if config.mask.paint_bgr is not None or not config.learning.enabled:
        return None
    agreed = agree_on_paint(look.paints, config.learning.least_frames)
    return agreed[0] if agreed is not None and is_coloured(agreed[0]) else None


def look_through(
    pictures_at: PicturesAt,
    times: Sequence[float],
    config: Config,
    drawn: DrawnTemplate,
    anchors: Sequence[Anchor] = (),
    *,
    is_known: bool = False,
) -> FirstLook:
    """Look at pictures of a clip, and calibrate the first ones alone.

    Parameters
    ----------
    pictures_at : callable
        Decodes pictures by their times.
    times : sequence of float
        When, seconds.
    config : Config
        Options, as :func:`suit_tracking` gives them.
    drawn : DrawnTemplate
        The markings.
    anchors : sequence of Anchor
        Frames that a person named.
    is_known : bool
        Whether the cameras are known, so that no frame need be calibrated alone.
    """
    template, _ = field_of(config)
    look = FirstLook()
    for anchor in anchors:
        _take(look, f"{anchor.time_s:.3f}", anchor.picture, anchor.fit, config, template, drawn, is_named=True)
    for time_s, picture in zip(times, pictures_at(times), strict=False):
        name = f"{time_s:.3f}"
        if picture is None or name in look.pictures:
            continue
        is_wanted = len(look.alone) < ENOUGH_ALONE and not is_known
        fit = _calibrate_alone(look, name, picture, config) if is_wanted else None
        _take(look, name, picture, fit, config, template, drawn)
    return look


def _calibrate_alone(look: FirstLook, name: str, picture: NDArray[np.uint8], config: Config) -> CameraFit | None:
    """The camera of a picture by itself, None where it is refused; its paint is noted."""
    look.tried.add(name)
    found = calibrate_image(picture, config, frame_id=name)
    if found.status == "refused" or found.attempt.camera is None:
        return None
    if found.paint_bgr is not None:
        look.paints.append(found.paint_bgr)
    return found.attempt.camera


def _take(
    look: FirstLook,
    name: str,
    picture: NDArray[np.uint8],
    fit: CameraFit | None,
    config: Config,
    template: FieldTemplate,
    drawn: DrawnTemplate,
    *,
    is_named: bool = False,
) -> None:
    """Keep a picture, and measure the paint of its markings where its camera is known."""
    look.pictures[name] = LookedAt.of(picture, config.mask)
    if fit is None:
        return
    look.pictures[name], measured = _measure_on_surface(look.pictures[name], fit, template, drawn)
    if is_named or len(measured.marking) >= LEAST_OWN_PLACES:
        look.alone.append(Alone(name, fit, measured, is_named))


def join_fields_of(pictures_at: PicturesAt) -> PicturesAt:
    """Decodes pictures of one moment each, also from interlaced frames."""

    def decode(times: Sequence[float]) -> Iterator[NDArray[np.uint8] | None]:
        for picture in pictures_at(times):
            yield None if picture is None else join_fields(picture)

    return decode


def _measure(picture: LookedAt, fit: CameraFit, template: FieldTemplate, drawn: DrawnTemplate) -> MeasuredFrame:
    places = place_markings(drawn, fit.theta, fit.model, template.marking_width_m)
    variance = ((places.by_theta @ fit.covariance) * places.by_theta).sum(axis=1)
    spread = np.sqrt(np.maximum(variance, 0.0))
    unit = fit.model.width / 1920.0
    return measure_markings(picture.gray, places, spread, unit, len(drawn.names), None, picture.grass)[0]


def _measure_on_surface(
    picture: LookedAt, fit: CameraFit, template: FieldTemplate, drawn: DrawnTemplate
) -> tuple[LookedAt, MeasuredFrame]:
    """The paint of a calibrated frame's markings, and the picture with the surface on which they lie."""
    measured = _measure(picture, fit, template, drawn)
    if len(measured.marking) >= LEAST_OWN_PLACES:
        return picture, measured
    other = picture.take_other_surface()
    beside = _measure(other, fit, template, drawn)
    return (other, beside) if len(beside.marking) > len(measured.marking) else (picture, measured)
