"""Which field a picture shows, among several templates.

The first template is tried as if it had been named, and taken where its answer is beyond doubt: nothing else is looked
at then. Else the colour of the ground says which others may be seen, each of them is tried, and what is painted
decides: the length of markings that are where the template's camera puts them, and the share of the paint that these
markings explain. On ground of another colour the first template is tried by the likeliest circle alone, thoroughly only
where no other field was found. ``leagues`` leaves out fields of other sizes of a sport that is seen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from circlecal.config import Config, suit_config
from circlecal.field import FieldTemplate, Ground, load_field
from circlecal.observations import Observations
from circlecal.paint.brightness import brightness_of_paint
from circlecal.pipeline.attempts import refuse_as_open
from circlecal.pipeline.field_paint import look_for_paint, recall_evidence
from circlecal.pipeline.fields import field_of
from circlecal.pipeline.leagues import may_be_league
from circlecal.pipeline.likely_sport import Trial, shows_rink_paint, tell_sport
from circlecal.pipeline.placed_field import EXPLAINED_EVIDENCE as PLACED_EVIDENCE
from circlecal.pipeline.placed_field import EXPLAINED_SHARE as PLACED_SHARE
from circlecal.pipeline.run import run
from circlecal.pipeline.setting import Looks, Scene
from circlecal.placement import ViewEvidence, weigh_view
from circlecal.results import FieldCandidate, FrameCalibration
from circlecal.stages.mask import tell_grounds
from circlecal.stages.verdict_on_picture import FOUND_SURELY, is_beyond_doubt, needs_confirmation

LEAST_EVIDENCE = 0.3
"""Length of markings that lie where they should beyond break-even, picture widths, without which no answer is believed
among several fields; of 18 frames of other sports the right ones had 0.39 to 1.78.
"""
LEAST_EXPLAINED = 0.23
"""Share of what was found painted that a field must explain at least: right ones of 14 frames of other sports have 0.28
to 1, a handball court that was seen in a basketball court of another size 0.19.
"""
EXPLAINED_SHARE = 0.9
"""Share of what was found painted that a field must explain to be believed with less: a laboratory paints circle and
line of a robots' field and no more. Right answers on real frames have 0.41 to 1, those of other sports 0.3 to 0.86.
"""
SETTLED_MARKINGS = 6
"""Circles, arcs and lines that carry a camera, from which on another sport is no rival: circle, halfway line and border
may be those of several sports.
"""
EXPLAINED_ON_ICE = 0.5
"""Share of what was found painted that a field of a floor must explain on a ground that looks like ice: a basketball
court laid into a rink explained 0.36.
"""
STRANGE_GROUND = 0.5
"""What evidence counts for a field on ground of another colour than its own."""
RIVAL_RATIO = 1.35
"""By how much the weight of a field must exceed that of another sport's, which on two London frames of basketball is
at most half of it.
"""


def calibrate_unknown_field(
    image: NDArray[np.uint8],
    config: Config,
    *,
    mask: NDArray[np.uint8] | None = None,
    extra: Observations | None = None,
    frame_id: str,
    source: str | None = None,
) -> FrameCalibration:
    """Calibrate one frame under the template of ``config.field.among`` that it shows.

    Parameters
    ----------
    image, mask, extra, frame_id, source : optional
        As for :func:`circlecal.pipeline.run`. Observations name markings of the first template, so no other is tried
        where they are given.
    config : Config
        Options; those that a template asks for go under what was set.

    Returns
    -------
    FrameCalibration
        With ``fields``, what was tried, the one that was taken first.

    Raises
    ------
    ConfigError
        A template does not exist, or what was set contradicts it.
    InputError
        Where the mask is not of the picture's size.
    """
    names, looks = config.field.among, Looks()

    def calibrate(name: str, *, is_brief: bool = False) -> FrameCalibration:
        chosen = _leave_logos(suit_config(config, name), name)
        return run(
            image,
            chosen,
            mask=mask,
            extra=extra,
            frame_id=frame_id,
            source=source,
            looks=looks,
            is_brief=is_brief,
        )

    is_compared = config.mask.paint_bgr is not None  # by what speaks for it, with what all lines together say
    if extra is not None or (len(names) == 1 and not is_compared):
        return calibrate(names[0])
    grounds = tell_grounds(image)
    brightness = brightness_of_paint(image, config.mask.paint_bgr, config.mask.other_paint_bgr)
    scene = Scene(image, brightness, None, None, None, looks)
    is_at_home = _may_lie_on(load_field(names[0]), grounds)
    first = calibrate(names[0], is_brief=not is_at_home)
    is_told = _is_size_told(first)
    if is_told and _is_settled(first, grounds) and not is_compared:
        return replace(first, fields=(candidate_of(first),))
    others = names[1:] if is_told else _find_rivals(first, scene, config, grounds)
    answers = [replace(_weigh(scene, config, first), is_at_home=is_at_home)]
    _try_others(answers, others, scene, config, grounds, calibrate)
    if not is_at_home and not _is_seen(answers[1:]):
        answers[0] = replace(_weigh(scene, config, calibrate(names[0])), is_at_home=False)
    chosen = choose_answer(answers)
    if chosen.status == "calibrated":
        return chosen
    trials = [Trial(answer.found, answer.candidate) for answer in answers]
    return replace(chosen, sport=tell_sport(image, config, grounds, trials))


def _try_others(
    answers: list[Answer],
    others: Sequence[str],
    scene: Scene,
    config: Config,
    grounds: Sequence[Ground],
    calibrate: Callable[..., FrameCalibration],
) -> None:
    """Add the answers under other templates to that under the first.

    Those that suit the ground come first; after a group of which one has any weight no other is tried, no sport beside
    one that is settled, no league beside one that explains clearly more, and none of a floor where a rink is seen that
    does not calibrate. Beside a field of another sport that is painted only the likeliest circle is tried.
    """
    for group in _group_by_ground(others, grounds):
        if grounds[0] == "ice" and _is_rink(answers, scene, config):
            break
        for name in group:
            template = load_field(name)
            sport = template.sport_name
            if any(answer.is_settled and answer.candidate.sport != sport for answer in answers):
                continue
            leagues = [answer.found for answer in answers if answer.candidate.sport == sport]
            if not may_be_league(scene, config, leagues, template):
                continue
            is_brief = suit_config(config, name).field.any_circle if leagues else _is_seen(answers[1:])
            answer = _weigh(scene, config, calibrate(name, is_brief=is_brief))
            answer = replace(answer, is_scale_told=template.has_leagues or _tells_scale(answer.found))
            is_doubtful = grounds[0] == "ice" and template.ground != "ice"
            answers.append(replace(answer, least_explained=EXPLAINED_ON_ICE) if is_doubtful else answer)
        if any(answer.weight > 0.0 for answer in answers[1:]):
            break


def _tells_scale(found: FrameCalibration) -> bool:
    """Whether a camera was fitted to a line or an arc beside circle, halfway line and border, which a pitch of soccer
    and a smaller one at another scale share.

    With smaller pitches among the fields, two of 80 rendered pitches of soccer were taken for them by circle, halfway
    line, mark and touchlines; right cameras of eight smaller ones carry two lines of penalty areas at least.
    """
    camera, template = found.attempt.camera, found.template
    if camera is None or template is None:
        return False
    telling = {element.name for element in (*template.lines, *template.arcs)}
    telling -= {*template.border, template.halfway_line}
    return any(key.name in telling for key in camera.residuals_px)


def _is_seen(answers: Sequence[Answer]) -> bool:
    """Whether a field is painted where it was laid, or has an answer: what else is tried is tried by its likeliest
    circle alone. On a school yard with a court the looks for other circles, as of soccer and futsal, took 5 of 15 s.
    """
    return any(answer.is_painted or answer.weight > 0.0 for answer in answers)


def _is_rink(answers: Sequence[Answer], scene: Scene, config: Config) -> bool:
    """Whether a field of ice was laid over enough of its paint to be believed, which has a colour of rinks: what then
    does not calibrate is no light hall. A blurred rink was laid so and refused, and halls took 3 of its 6 s.
    """
    on_ice = [a for a in answers if a.found.template is not None and a.found.template.ground == "ice"]
    return any(answer.is_painted for answer in on_ice) and shows_rink_paint(scene.image, config)


def _leave_logos(config: Config, name: str) -> Config:
    """The options without a search for the rims of logos, which every court and rink may have: while fields are only
    compared, the rims of discs are looked for where the circle is one.
    """
    template, detector = load_field(name), config.mask.detector
    has_logo = template.circle_by_name[template.default_circle].fill not in ("none", "disc")
    if not has_logo or detector.rims is not None:
        return config
    plain = config.mask.model_copy(update={"detector": detector.model_copy(update={"rims": False})})
    return config.model_copy(update={"mask": plain})


def is_on_strange_ground(image: NDArray[np.uint8], config: Config) -> bool:
    """Whether the colour of the ground in a BGR picture (H, W, 3) is not that of the field of a configuration."""
    return not _may_lie_on(field_of(config)[0], tell_grounds(image))


def _may_lie_on(template: FieldTemplate, grounds: Sequence[Ground]) -> bool:
    return template.ground in (*grounds, "any")


def _group_by_ground(names: Sequence[str], grounds: Sequence[Ground]) -> list[list[str]]:
    """Templates by the ground that they are painted on, the likeliest first; those of any ground go with the floors, or
    come last.
    """
    of_ground = {name: load_field(name).ground for name in names}
    last = [name for name in names if of_ground[name] == "any"]
    groups = {ground: [name for name in names if of_ground[name] == ground] for ground in grounds}
    groups["floor"] = [*groups.pop("floor", []), *last]
    return list(groups.values())


def _is_settled(found: FrameCalibration, grounds: Sequence[Ground]) -> bool:
    """Whether a first answer needs no other template beside it, if its size is told: on its own ground it is not
    doubtful, on another one several further markings carry it.
    """
    if found.status != "calibrated" or found.template is None or needs_confirmation(found.verdict):
        return False
    if _may_lie_on(found.template, grounds):
        return True
    camera, cues = found.attempt.camera, found.attempt.cues
    return camera is not None and cues is not None and is_beyond_doubt(camera, cues, found.template)


def _is_size_told(found: FrameCalibration) -> bool:
    """Whether a calibrated field has its usual size, or markings to which the camera was not fitted are where that size
    has them: circle, halfway line and touchlines of another sport's field are those of a pitch of some size.

    Of 16 rendered fields on green and blue (futsal, handball, robots') twelve were taken for pitches 54 to 62 m wide.
    """
    camera, check = found.attempt.camera, found.verdict.check("found_share")
    is_usual = camera is None or camera.field_size is None or camera.field_size.is_usual
    return is_usual or (check is not None and check.value >= FOUND_SURELY)


def _find_rivals(first: FrameCalibration, scene: Scene, config: Config, grounds: Sequence[Ground]) -> list[str]:
    """The other templates that may be the field of a first answer whose size is not told: those that explain about as
    much of the paint where its camera has them. Of an answer that is not settled all are.
    """
    others = list(config.field.among[1:])
    if not _is_settled(first, grounds):
        return others
    return [name for name in others if may_be_league(scene, config, [first], load_field(name))]


@dataclass(frozen=True, slots=True)
class Answer:
    """A calibration under one template, what speaks for it, whether the ground is one of that field, the least share of
    the paint that it must explain, and whether it carries markings that a larger or smaller pitch does not have.
    """

    found: FrameCalibration
    candidate: FieldCandidate
    is_at_home: bool = True
    least_explained: float = LEAST_EXPLAINED
    is_scale_told: bool = True

    @property
    def is_painted(self) -> bool:
        """Whether enough of its markings is painted, and enough of what is painted is its markings."""
        evidence, share = self.candidate.evidence or 0.0, self.candidate.explained_share or 0.0
        return evidence >= LEAST_EVIDENCE and share >= self.least_explained

    @property
    def weight(self) -> float:
        """Evidence, picture widths, times the share of the paint that is explained; 0 where it is not believed."""
        evidence, share = self.candidate.evidence or 0.0, self.candidate.explained_share or 0.0
        least = 0.0 if share >= EXPLAINED_SHARE else PLACED_EVIDENCE
        is_believed = self.is_painted or (evidence > least and share >= PLACED_SHARE)
        if self.found.status != "calibrated" or not is_believed or not self.is_scale_told:
            return 0.0
        return self.candidate.explained_evidence * (1.0 if self.is_at_home else STRANGE_GROUND)

    @property
    def is_settled(self) -> bool:
        """Whether no other sport need be tried: it explains nearly all that is painted by more markings than two sports
        share.
        """
        share, camera = self.candidate.explained_share or 0.0, self.found.attempt.camera
        is_rich = camera is not None and len(camera.residuals_px) >= SETTLED_MARKINGS
        is_sure = self.weight > 0.0 and self.is_at_home and is_rich and share >= EXPLAINED_SHARE
        return is_sure and _is_size_told(self.found)


def choose_answer(answers: Sequence[Answer]) -> FrameCalibration:
    """The calibration for which what is painted speaks most, with all the others in its ``fields``.

    Parameters
    ----------
    answers : sequence of Answer
        Of at least one template, the one that is tried first at the head.

    Returns
    -------
    FrameCalibration
        The one of most weight, of those that weigh alike the first. Where another sport explains the picture about as
        well, it is refused as ``field_open``. Where none is believed, the first answer of all, refused on strange
        ground.
    """
    most = max(answer.weight for answer in answers)
    rivals = [answer for answer in answers if answer.weight * RIVAL_RATIO > most]
    taken = max(rivals, key=lambda answer: answer.weight) if rivals else answers[0]
    others = sorted((a for a in answers if a is not taken), key=lambda answer: -answer.weight)
    found = replace(taken.found, fields=(taken.candidate, *(answer.candidate for answer in others)))
    is_clear = len({answer.candidate.sport for answer in rivals}) == 1 or (not rivals and taken.is_at_home)
    if is_clear or found.status == "refused":
        return found
    return replace(found, attempt=refuse_as_open(found.attempt, "field_open"))


def candidate_of(found: FrameCalibration) -> FieldCandidate:
    """A calibration as one of the fields that a frame may show, before it is weighed."""
    template = found.template
    sport = found.field_name if template is None else template.sport_name
    camera = found.attempt.camera
    sigma = None if camera is None else camera.max_sigma_px
    return FieldCandidate(
        found.field_name,
        sport,
        found.status,
        found.verdict.code,
        max_sigma_px=sigma,
        H_image_field=found.H_image_field,
    )


def _weigh(scene: Scene, config: Config, found: FrameCalibration) -> Answer:
    candidate, template, view, mask = candidate_of(found), found.template, found.view, found.attempt.mask
    if found.status != "calibrated" or template is None or view is None or mask is None:
        laid = recall_evidence(scene, found.field_name)
        return Answer(found, candidate if laid is None else _with_evidence(candidate, laid))
    paint = look_for_paint(scene, mask, suit_config(config, found.field_name), template)
    if paint is None:
        return Answer(found, candidate)
    return Answer(found, _with_evidence(candidate, weigh_view(view, template, paint)))


def _with_evidence(candidate: FieldCandidate, weighed: ViewEvidence) -> FieldCandidate:
    return replace(
        candidate,
        evidence=weighed.evidence,
        found_share=weighed.found_share,
        explained_share=weighed.explained_share,
    )
