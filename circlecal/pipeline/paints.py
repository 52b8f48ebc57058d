"""Lines of several colours on one floor: those of each colour by themselves, where all together are refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from circlecal.config import AUTO, Config, suit_config
from circlecal.field import load_field
from circlecal.geometry.projective import Array
from circlecal.observations import Observations
from circlecal.paint.brightness import brightness_of_paint
from circlecal.paint.colour import match_paint
from circlecal.pipeline.attempts import refuse_as_open
from circlecal.pipeline.field_choice import calibrate_unknown_field
from circlecal.pipeline.field_paint import LEAST_CIRCLE
from circlecal.pipeline.fields import field_of
from circlecal.pipeline.known_cameras import calibrate_by_cameras
from circlecal.pipeline.run import run
from circlecal.pipeline.setting import frame_generator
from circlecal.placement import mean_distance_px
from circlecal.results import FrameCalibration, LikelySport
from circlecal.stages.mask import MaskConfig, look_quickly, suit_field, tell_grounds, tell_paints

MOST_TRIED, MOST_OF_UNKNOWN_FIELD = 2, 1
"""Paints that are followed, those with the clearest circles: in rendered halls the right one is the first. Where the
field is not known each of them costs a look at every template, 20 s for a hall that stays refused.
"""
GREY, SAME_SIGN = 0.97, 0.3
"""Cosine from which on two colours are one, and from which on both are lighter, or darker, than the floor. Grey paint
that is alone with its sign is what the brightness shows, so nothing new is seen along its colour.
"""
LITTLE_EVIDENCE = 0.5
"""Evidence, picture widths, below which a field that nobody named is no reason to leave out the look at each colour: a
rendered NBA court that was taken for another league's had 0.43, right leagues of five London frames 0.86 to 1.42.
"""
MOST_EXPLAINED = 0.7
"""Share of the paint of all colours that such a field explains, from which on no other colour hides its lines: an NBA
court of which three arcs are seen has 0.75 and by its colour alone no other camera; halls with lines of several sports
have 0.54 to 0.62.
"""
ALIKE_WIDTHS = 0.02
"""Two cameras that put the markings within this share of the picture's width on average are one."""


def calibrate_image(
    image: NDArray[np.uint8],
    config: Config,
    *,
    mask: NDArray[np.uint8] | None = None,
    extra: Observations | None = None,
    frame_id: str,
    source: str | None = None,
) -> FrameCalibration:
    """Calibrate one frame, whose field is named or to be told, by all that is painted or by the lines of one colour.

    A mask says little of a field with several large circles or with discs: where it is refused, the picture is looked
    at as if there were none.

    Parameters
    ----------
    image, config, mask, extra, frame_id, source : optional
        As for :func:`circlecal.pipeline.run`.

    Raises
    ------
    ConfigError
        For an unknown field template or circle.
    InputError
        Where the mask is not of the picture's size.
    """
    is_unknown = config.field.template == AUTO
    calibrate = calibrate_unknown_field if is_unknown else run

    def calibrate_with(given: NDArray[np.uint8] | None) -> FrameCalibration:
        def answer(chosen: Config) -> FrameCalibration:
            return calibrate(image, chosen, mask=given, extra=extra, frame_id=frame_id, source=source)

        return calibrate_by_cameras(config, lambda chosen: calibrate_by_paint(image, chosen, answer(chosen), answer))

    found = calibrate_with(mask)
    is_open = mask is not None and found.status != "calibrated" and config.mask.source == "auto"
    if not is_open or not (is_unknown or _is_more_than_a_circle(config)):
        return found
    seen = calibrate_with(None)
    is_more = not is_unknown or _is_more_than_a_circle(suit_config(config, seen.field_name))
    is_telling = seen.status == "calibrated" or seen.verdict.code == "circle_open"
    return seen if is_telling and is_more else found


def _is_more_than_a_circle(config: Config) -> bool:
    """Whether the detector sees more of a field than a mask tells: any of several circles, or a disc or logo."""
    return config.field.any_circle or field_of(config)[1].fill != "none"


def calibrate_by_paint(
    image: NDArray[np.uint8], config: Config, first: FrameCalibration, calibrate: Callable[[Config], FrameCalibration]
) -> FrameCalibration:
    """The answer of all lines together, or, where that is refused or little speaks for it, of the lines of one colour.

    Every paint on the floor is looked at along its own colour, in which the others show least, and counts only where
    the circle that is found has that colour. Where two paints lead to two cameras the frame stays refused.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR picture.
    config : Config
        Options.
    first : FrameCalibration
        The answer of all lines together.
    calibrate : callable
        Calibrates the picture under another configuration.
    """
    if not (_is_open(first) and _may_have_paints(image, first, config)):
        return first
    answers = []
    for paint, told in _find_likely_paints(image, first, config):
        found = calibrate(_keep_sport(config, first).model_copy(update={"mask": told}))
        added = found.paint_bgr
        if found.status == "calibrated" and added is not None and match_paint(np.array(added), paint):
            others = told.other_paint_bgr
            answers.append(replace(found, other_paints_bgr=others, config_digest=first.config_digest))
    found = _choose(answers, first)
    return found if first.status != "calibrated" or _weigh(found) > _weigh(first) else first


def _is_open(first: FrameCalibration) -> bool:
    """Whether an answer is refused, or little is painted of a field in one paint that nobody named; where all lines
    together show another field, those of one colour alone say less.
    """
    if first.verdict.code == "other_field":
        return False
    if first.status != "calibrated" or first.template is None:
        return True
    seen = first.fields[0] if first.fields else None
    if seen is None or seen.evidence is None or not first.template.is_in_one_paint:
        return False
    return seen.evidence < LITTLE_EVIDENCE and (seen.explained_share or 0.0) < MOST_EXPLAINED


def _keep_sport(config: Config, first: FrameCalibration) -> Config:
    """The options with the fields of one sport alone, the one that was found first, where nobody named the field and
    all lines together calibrate: those of one colour may tell another league, or another place of the camera.
    """
    if config.field.template != AUTO or first.status != "calibrated" or first.template is None:
        return config
    fields = {name: load_field(name) for name in config.field.among}
    leagues = [name for name, field in fields.items() if field.sport_name == first.template.sport_name]
    among = tuple(sorted(leagues, key=lambda name: fields[name].name != first.field_name))
    return config.model_copy(update={"field": config.field.model_copy(update={"among": among})})


def _weigh(found: FrameCalibration) -> float:
    """Evidence for a calibrated field that nobody named, picture widths, times the share of the paint it explains."""
    if found.status != "calibrated" or not found.fields:
        return 0.0
    return found.fields[0].explained_evidence


def _find_likely_paints(
    image: NDArray[np.uint8], first: FrameCalibration, config: Config
) -> list[tuple[Array, MaskConfig]]:
    """The paints with the best ellipses at a quick look, each with the options that show it alone, the best first."""
    paints, likely = tell_paints(image, config.mask), []
    if len(paints) < 2 or first.template is None:
        return []
    for index, paint in enumerate(paints):
        if _shows_in_brightness(paint, [other for k, other in enumerate(paints) if k != index]):
            continue
        others = tuple(_as_numbers(other) for k, other in enumerate(paints) if k != index)
        told = config.mask.model_copy(update={"paint_bgr": _as_numbers(paint), "other_paint_bgr": others})
        brightness = brightness_of_paint(image, told.paint_bgr, others)
        options = suit_field(told, first.template)
        look = look_quickly(image, None, options, frame_generator(config.seed), brightness)
        if look is not None and look.candidates and look.candidates[0].score >= LEAST_CIRCLE:
            likely.append((look.candidates[0].score, index, paint, told))
    ranked = sorted(likely, key=lambda item: (-item[0], item[1]))
    most = MOST_OF_UNKNOWN_FIELD if config.field.template == AUTO else MOST_TRIED
    return [(paint, told) for _, _, paint, told in ranked[:most]]


def _shows_in_brightness(paint: Array, others: list[Array]) -> bool:
    """Whether what a paint adds to blue, green and red (3,) is grey, and no other paint is as light or as dark."""
    grey = np.ones(3)
    is_alone = all(_cosine(paint, other) < SAME_SIGN for other in others)
    return abs(_cosine(paint, grey)) > GREY and is_alone


def _cosine(one: Array, other: Array) -> float:
    return float(one @ other / max(float(np.linalg.norm(one) * np.linalg.norm(other)), 1e-9))


def _may_have_paints(image: NDArray[np.uint8], first: FrameCalibration, config: Config) -> bool:
    """Whether a floor may have lines of several colours of which the field has one, and nobody told which."""
    mask, template = first.attempt.mask, first.template
    if not config.mask.tell_paints or config.mask.paint_bgr is not None or mask is None or mask.source != "detector":
        return False
    if config.field.template == AUTO:
        return "floor" in tell_grounds(image) and _is_in_one_paint(first.sport, config)
    return template is not None and template.is_in_one_paint and template.ground in ("floor", "any")


def _is_in_one_paint(sport: LikelySport | None, config: Config) -> bool:
    """Whether the sport that a picture looks like, or any where it looks like none, has its lines in one colour."""
    if sport is None or sport.name is None:
        return True
    fields = [load_field(name) for name in config.field.among]
    return any(field.is_in_one_paint for field in fields if field.sport == sport.name)


def _choose(answers: list[FrameCalibration], first: FrameCalibration) -> FrameCalibration:
    """The surest answer, where all say the same; the first one where there is none."""
    if not answers:
        return first
    taken = min(answers, key=_sigma_px)
    for other in answers:
        view, template = other.view, taken.template
        if other is taken or taken.view is None or view is None or template is None:
            continue
        is_same_field = other.field_name == taken.field_name
        if not is_same_field or mean_distance_px(taken.view, view, template) > ALIKE_WIDTHS * taken.width:
            code = "circle_open" if is_same_field else "field_open"
            return replace(taken, attempt=refuse_as_open(taken.attempt, code))
    return taken


def _sigma_px(found: FrameCalibration) -> float:
    return np.inf if found.attempt.camera is None else found.attempt.camera.max_sigma_px


def _as_numbers(colour: Array) -> tuple[float, float, float]:
    blue, green, red = np.round(colour, 1).tolist()
    return blue, green, red
