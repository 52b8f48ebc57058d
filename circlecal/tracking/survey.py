"""The cameras of a clip: frames here and there alone, then together on their tripods, then all that these find."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from circlecal.config import Config
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.least_squares import invert_normal
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface
from circlecal.pipeline import field_of
from circlecal.rig.positions import group_positions
from circlecal.rig.tripod import TripodEstimate, Venue
from circlecal.rig.venue import describe_changes
from circlecal.tracking.anchors import Anchor
from circlecal.tracking.closer_look import learn_closely
from circlecal.tracking.first_look import (
    Alone,
    FirstLook,
    PicturesAt,
    join_fields_of,
    learn_paint,
    look_through,
    suit_tracking,
)
from circlecal.tracking.frame_paint import PART_M, HeadedFrame
from circlecal.tracking.head_path import HeadPath
from circlecal.tracking.looking import LEAST_PLACES, Look, LookedAt, Place
from circlecal.tracking.markings import DrawnTemplate, template_curves
from circlecal.tracking.one_view import tripod_of_frame
from circlecal.tracking.other_cameras import times_of_others
from circlecal.tracking.paint_width import priors_of_frames
from circlecal.tracking.pitch import (
    SHAPES,
    WORST_RMS_PX,
    choose_pitch,
    choose_surface,
    may_be_hip,
    search_length,
    search_width,
)
from circlecal.tracking.seen_paint import MeasuredFrame
from circlecal.tracking.shared_pitch import KnownPitch, fit_before, size_variance, tell_pitch
from circlecal.tracking.survey_steps import UNTOLD, SurveySteps
from circlecal.tracking.tripod_fit import TripodFit, count_alike, fit_tripod, free_parameters, start_tripod

_log = logging.getLogger(__name__)

MOST_PICTURES, LEAST_STEP_S = 48, 0.2
"""Pictures that are looked at, and the least time between them: with 0.5 s a clip of 4 s gave too few to tell the
length of its pitch (48 % of its frames answered, with 0.2 s 93 %).
"""
SAME_PLACE_M = 0.8
"""How far apart single frames put one camera, beyond their own uncertainty: the lever arm moves the pupil so far."""
LEAST_PICTURES = 5
"""Pictures that a short clip is looked at in at least, where it has as many."""
LEAST_FRAMES, LEAST_OTHERS = 2, 3
"""Frames that make a tripod, but of a clip that shows one view, in which a second one that agrees confirms nothing; and
those that make a further one, of pictures that the found ones do not explain: more of these are falsely calibrated.
"""
WORTH_SHARE = 0.25
"""Share of the worth of the best proposal's first look below which another one is not looked at again."""
ROUNDS, LOOKS = 3, 3
"""In which the tripods find further frames and learn from them; and looks at a frame while its tripod changes."""
KNOWN_SD_PX, KNOWN_SD_ZOOM = 3.0, 0.004
"""Of a head that the paint of its own frame tells, while its tripod changes, pixels at 1920 px width and logarithm of
the focal length.
"""
STAYING_SHARE = 0.8
"""Share of its frames that a tripod must find again before the pitch of another one of its clip."""
AGREEING = 16.3
"""Chi-square of three degrees of freedom that one of a thousand exceeds."""
AGREEING_IN_ALL = 40.8
"""Chi-square that one of a thousand exceeds, of seventeen degrees of freedom, as many as a tripod has parameters that
frames tell: by how much more frames may cost beside what was known than before any tripod. Views of an ideal pitch cost
8 more with an axis 2.5 standard deviations beside its place, 49 with one six beside.
"""
SLACK = 9.0
"""How much more than its covariance says a tripod may change to meet a frame that looks elsewhere: the surface and the
lens have other shapes than their models.
"""

Grown = tuple[TripodEstimate, list[HeadedFrame]]
"""A tripod and its frames."""


def survey_clip(
    pictures_at: PicturesAt,
    duration_s: float,
    config: Config,
    known: Venue | None = None,
    anchors: Sequence[Anchor] = (),
    period_s: float = 0.0,
    steps: SurveySteps = UNTOLD,
) -> Venue:
    """Find the cameras of a clip.

    Parameters
    ----------
    pictures_at : callable
        Decodes pictures by their times.
    duration_s : float
        Length of the clip.
    config : Config
        Options.
    known : Venue, optional
        Cameras from earlier; they are taken over, learnt further where the clip shows them, and no others are looked
        for.
    anchors : sequence of Anchor
        Frames that a person named, by times like those of the pictures; one alone makes a camera.
    period_s : float
        Time between two frames of the video: how far a turning head smears their paint. 0 where it is not known.
    steps : SurveySteps
        Told how far it is.

    Returns
    -------
    Venue
        Without tripods where no camera could be determined.
    """
    template, circle = field_of(config)
    drawn = template_curves(template)
    pictures_at = join_fields_of(pictures_at) if config.mask.deinterlace else pictures_at
    times = _choose_times(duration_s, period_s)
    is_known = known is not None and len(known.tripods) > 0
    paint = None if known is None else known.paint_bgr
    config = suit_tracking(config, paint)
    at_first, between = (steps.decode(stage, pictures_at) for stage in ("looking at frames", "looking between frames"))
    look = look_through(at_first, times, config, drawn, anchors, is_known=is_known)
    learnt_paint = learn_paint(look, config)
    if learnt_paint is not None:
        paint, config = learnt_paint, suit_tracking(config, learnt_paint)
        look = look_through(at_first, times, config, drawn, anchors)
    looked = LookedThrough.of(look, between, config, template, drawn, period_s, steps)
    if known is not None and is_known:
        return Venue(template.name, tuple(_learn_known(tripod, looked) for tripod in known.tripods), paint)
    if looked.is_one_view:
        return Venue(template.name, _tripods_of_one_view(look.alone, looked), paint)
    grown = _grow(_tripods(look.alone, circle, looked), looked, {})
    looked, others = _look_for_others(look.tried, grown, circle, looked)
    grown = _grow(others, looked, grown)
    distinct = _keep_distinct([tripod for tripod, _ in grown.values()])
    _note_hips([grown[tripod.name] for tripod in distinct], looked)
    learnt = _keep_distinct([_learn_closely(tripod, grown[tripod.name][1], looked) for tripod in distinct])
    return Venue(template.name, tuple(_share_pitch(learnt, grown, looked)), paint)


def _choose_times(duration_s: float, period_s: float) -> list[float]:
    """When pictures of a clip are looked at, seconds; of a short one as many frames as it has, up to a few."""
    least = min(LEAST_STEP_S, max(period_s, duration_s / LEAST_PICTURES)) if period_s > 0.0 else LEAST_STEP_S
    step = max(least, duration_s / MOST_PICTURES)
    return np.arange(0.0, max(duration_s - 0.5 * step, 0.01), step).tolist()


@dataclass(frozen=True, slots=True)
class LookedThrough:
    """A clip whose pictures were looked at, as tripods are found in it.

    Attributes
    ----------
    pictures : dict
        Those that were looked at, by their names.
    pictures_at : callable
        Decodes further ones.
    colour : (2,) array or None
        Of the playing surface.
    config, template, drawn : Config, FieldTemplate, DrawnTemplate
        Options, and the field.
    period_s : float
        Time between two frames of the video, 0 where it is not known.
    is_one_view : bool
        Whether its pictures lie so near to each other that they show one view.
    steps : SurveySteps
        Told how far it is.
    """

    pictures: dict[str, LookedAt]
    pictures_at: PicturesAt
    colour: Array | None
    config: Config
    template: FieldTemplate
    drawn: DrawnTemplate
    period_s: float = 0.0
    is_one_view: bool = False
    steps: SurveySteps = UNTOLD

    @classmethod
    def of(
        cls, look: FirstLook, pictures_at: PicturesAt, config: Config, template: FieldTemplate, drawn: DrawnTemplate,
        period_s: float, steps: SurveySteps,
    ) -> LookedThrough:  # fmt: skip
        """After the first look at a clip."""
        times = [float(name) for name in look.pictures]
        is_one_view = len(times) > 0 and max(times) - min(times) < LEAST_STEP_S
        return cls(
            look.with_one_surface(), pictures_at, look.surface_colour, config, template, drawn, period_s, is_one_view,
            steps,
        )  # fmt: skip

    def prior_of(self, tripod: TripodEstimate, measured: Sequence[MeasuredFrame]) -> tuple[Array, Array]:
        """Means and standard deviations (K,) of what all frames of a tripod share, with how broad their paint looks."""
        return priors_of_frames(self.config, self.template, tripod.size, measured, tripod.model.log_focal)


def _tripods_of_one_view(alone: Sequence[Alone], clip: LookedThrough) -> tuple[TripodEstimate, ...]:
    """The tripod of a clip that shows one view: that of the frame which knows best where it is, or was named."""
    if not alone:
        return ()
    surest = min(alone, key=lambda frame: (not frame.is_named, float(np.trace(frame.fit.covariance[4:7, 4:7]))))
    size = surest.fit.model.width, surest.fit.model.height
    given = clip.config, clip.template, size, [surest.measured], float(surest.fit.theta[0])
    return (tripod_of_frame("camera-1", surest.name, surest.fit, *priors_of_frames(*given)),)


def _learn_known(known: TripodEstimate, clip: LookedThrough) -> TripodEstimate:
    """A tripod that was known before, with what a clip tells of it."""
    extended, members = _extend(known, [], clip, known)
    if len(members) >= LEAST_FRAMES:
        own = _learn_closely(extended, members, clip)
        prior = clip.prior_of(known, [frame.measured for frame in members])
        extended = _learn_from(known, extended, own, members, prior, clip.drawn)
    _note_changes(known, extended)
    return extended


def _learn_closely(
    tripod: TripodEstimate, members: list[HeadedFrame], clip: LookedThrough, pitch: KnownPitch | None = None
) -> TripodEstimate:
    """A tripod by its frames and by others between them, all measured closely."""
    clip.steps.begin(f"{tripod.name}: measuring closely")
    given = clip.pictures, clip.pictures_at, clip.config, clip.drawn, clip.colour, clip.period_s
    return learn_closely(tripod, members, *given, pitch)


def _share_pitch(
    learnt: Sequence[TripodEstimate],
    grown: Mapping[str, Grown],
    clip: LookedThrough,
) -> list[TripodEstimate]:
    """The tripods of a clip before one pitch: that of the surest of them is that of the others. Where it leaves a size
    open, the next one adds what it tells, and at last those before it follow.

    One that finds far fewer of its frames before this pitch stands before another one, and keeps what it told.
    """
    if len(learnt) < 2:
        return list(learnt)
    first, *others = sorted(learnt, key=size_variance)
    pitch = KnownPitch.of(first)
    shared, apart = [first], []
    for own in others:
        tripod, members = grown[own.name]
        tripod, found = _extend(*_move_to(pitch, tripod, members, clip), clip, pitch=pitch)
        if len(found) < STAYING_SHARE * len(members):
            _log.warning("%s: its pitch does not seem to be that of %s", own.name, first.name)
            apart.append(own)
            continue
        shared.append(_learn_closely(tripod, found, clip, pitch))
        pitch = pitch if pitch.is_settled.all() else KnownPitch.of(shared[-1], pitch.is_settled)
    if not pitch.is_settled.all():
        shared = [*(tell_pitch(tripod, shared[-1]) for tripod in shared[:-1]), shared[-1]]
    return _keep_distinct([*shared, *apart])


def _move_to(pitch: KnownPitch, tripod: TripodEstimate, members: list[HeadedFrame], clip: LookedThrough) -> Grown:
    """A tripod and its frames before a pitch that is known: place and zoom make up for another size."""
    mean, sd = pitch.tell(*clip.prior_of(tripod, [frame.measured for frame in members]))
    fit = fit_tripod(members, pitch.take(tripod), mean, sd, clip.drawn)
    heads = zip(members, fit.heads, strict=True)
    return fit.estimate, [replace(frame, head=head) for frame, head in heads]


def _note_changes(known: TripodEstimate, found: TripodEstimate) -> None:
    """Say so where a clip has a camera other than it was told: the camera was moved, or somebody changed a value that
    others in the file go with.
    """
    changes = describe_changes(known, found)
    if changes:
        mend = "if you changed a value by hand, delete correlation there"
        _log.warning("%s: is not as the venue says: %s of its standard deviations; %s", found.name, changes, mend)


def _learn_from(
    known: TripodEstimate,
    extended: TripodEstimate,
    own: TripodEstimate,
    members: list[HeadedFrame],
    prior: tuple[Array, Array],
    drawn: DrawnTemplate,
) -> TripodEstimate:
    """What becomes of a known tripod after its frames have extended it and, closely measured, tell one of their own:
    the own one where this is the surer and lies elsewhere, since then the camera was moved; else what was known and
    what the frames tell together. The prior, means and standard deviations (K,), is that of any tripod.
    """
    if _choose_surer(extended, own) is own and not _agree(known, own):
        return own
    return _choose_surer(_keep_known(known, extended, members, prior, drawn), own)


def _keep_known(
    known: TripodEstimate,
    extended: TripodEstimate,
    members: list[HeadedFrame],
    prior: tuple[Array, Array],
    drawn: DrawnTemplate,
) -> TripodEstimate:
    """The tripod as its frames have it together with what was known of it, as surely as that was told, where that costs
    these little more than any tripod, so that it is known no less than before; else as the frames extended it, for
    which what was known counts as loosely as a camera may have been moved.

    What the models leave of the paint beyond its noise makes it that much less certain here, so that frames which tell
    less than what was known hardly move it.
    """
    free = fit_tripod(members, extended, *prior, drawn)
    free = fit_tripod(members, free.estimate, *prior, drawn, alike=count_alike(free), parts_m=PART_M)
    alike = count_alike(free) * max(free.spread, 1.0)
    free = fit_tripod(members, free.estimate, *prior, drawn, alike=alike)
    sd, start = np.sqrt(np.diag(known.covariance)), replace(extended, painters=known.painters)
    precision = _precision(known, sd, 1.0)
    kept = fit_tripod(members, start, known.mean, sd, drawn, precision, alike=alike, parts_m=PART_M)
    agrees = kept.cost - free.cost < AGREEING_IN_ALL
    return replace(kept.estimate, left_out=extended.left_out) if agrees else extended


def _choose_surer(known: TripodEstimate, own: TripodEstimate) -> TripodEstimate:
    """What a clip tells of its camera by itself, where that agrees with it and what was known of it from elsewhere
    together and tells its place surer; else the two together.
    """
    surer = np.diag(own.whole_covariance)[:3] < np.diag(known.whole_covariance)[:3]
    return own if _agree(known, own) and surer.all() else known


def _agree(known: TripodEstimate, own: TripodEstimate, slack_m: float = 0.0) -> bool:
    """Whether two tripods stand in one place, as far as that is known of either, and each to so many metres."""
    spread = known.whole_covariance[:3, :3] + own.whole_covariance[:3, :3] + slack_m**2 * np.eye(3)
    away = own.mean[:3] - known.mean[:3]
    return bool(away @ np.linalg.solve(spread, away) <= AGREEING)


def _note_hips(found: Sequence[Grown], clip: LookedThrough) -> None:
    """Say so where a pitch seems to be a hipped roof: those who read a roof's records do not know that shape, so it is
    only taken where it is asked for.
    """
    if clip.config.camera.crown_shape != "auto":
        return
    for tripod, members in found:
        mean, sd = clip.prior_of(tripod, [frame.measured for frame in members])
        if members and may_be_hip(members, tripod, mean, sd, clip.drawn):
            _log.warning(
                "%s: its pitch falls to the goal lines too: camera.crown_shape=hip fits it better", tripod.name
            )


def _keep_distinct(tripods: Sequence[TripodEstimate]) -> list[TripodEstimate]:
    """The tripods that stand apart: of those in one place the one with the most frames."""
    kept: list[TripodEstimate] = []
    for tripod in sorted(tripods, key=lambda t: len(t.used), reverse=True):
        apart = [float(np.linalg.norm(tripod.mean[:3] - other.mean[:3])) > SAME_PLACE_M for other in kept]
        if all(apart):
            kept.append(tripod)
    return kept


def _look_for_others(
    tried: set[str], grown: Mapping[str, Grown], circle: Circle, clip: LookedThrough
) -> tuple[LookedThrough, list[Grown]]:
    """Further tripods, of frames that those which were found do not explain and that were not tried alone; with the
    clip and the pictures that were looked at for them.

    A false calibration makes no camera: several have to agree, and more than for the first ones, which a clip was
    taken by.
    """
    explained = tried.union(*(tripod.used for tripod, _ in grown.values()))
    left = {name: picture.shows_surface and name not in explained for name, picture in clip.pictures.items()}
    period_s = clip.period_s or LEAST_STEP_S
    further = look_through(clip.pictures_at, times_of_others(left, period_s), clip.config, clip.drawn)
    pictures = {name: picture.take_surface(clip.colour) for name, picture in further.pictures.items()}
    # what was looked at within a period of a further picture, and is nobody's, may be that picture
    shown = np.array([float(name) for name in pictures])
    kept = {n: p for n, p in clip.pictures.items() if not left[n] or (np.abs(shown - float(n)) >= period_s).all()}
    clip = replace(clip, pictures={**pictures, **kept})
    others = _tripods(further.alone, circle, clip, LEAST_OTHERS)
    known = [tripod for tripod, _ in grown.values()]
    return clip, [other for other in others if not any(_agree(tripod, other[0], SAME_PLACE_M) for tripod in known)]


def _grow(starts: Sequence[Grown], clip: LookedThrough, before: Mapping[str, Grown]) -> dict[str, Grown]:
    """Tripods by their names, after those from before the further ones, each with all frames that it finds."""
    grown = dict(before)
    for start, members in starts:
        if not any(set(start.used) <= set(tripod.used) for tripod, _ in grown.values()):
            name = f"camera-{len(grown) + 1}"
            grown[name] = _extend_and_measure(replace(start, name=name), members, clip)
    return grown


def _tripods(alone: Sequence[Alone], circle: Circle, clip: LookedThrough, least: int = LEAST_FRAMES) -> list[Grown]:
    """Tripods of frames that were calibrated alone, so many at least, the one with the most frames first, and these
    frames.
    """
    fewest = _least_frames(alone, least)
    if len(alone) < fewest:
        return []
    theta = np.array([a.fit.theta for a in alone])
    covariance = np.array([a.fit.covariance for a in alone])[:, 4:7, 4:7]
    groups, turned = group_positions(theta[:, 4:7], covariance + SAME_PLACE_M**2 * np.eye(3), fewest)
    found = []
    for number in range(groups.max() + 1):
        members = [alone[int(k)] for k in np.flatnonzero((groups == number) & ~turned)]
        fit = _fit_alone(members, circle, clip, least)
        if fit is not None:
            measured = {member.name: member.measured for member in members}
            named = zip(fit.estimate.used, fit.heads, strict=True)
            found.append((fit.estimate, [HeadedFrame(name, head, measured[name]) for name, head in named]))
    return found


def _least_frames(frames: Sequence[Alone], least: int) -> int:
    """Frames that make a tripod: one where a person named what is seen in it."""
    return 1 if any(frame.is_named for frame in frames) else least


def _fit_alone(members: Sequence[Alone], circle: Circle, clip: LookedThrough, least: int) -> TripodFit | None:
    """The tripod of frames, without those of a false calibration; None where too few are left."""
    if len(members) < _least_frames(members, least):
        return None
    config, template, drawn = clip.config, clip.template, clip.drawn
    size = members[0].fit.model.width, members[0].fit.model.height
    unit = size[0] / 1920.0
    log_focal = float(np.median([member.fit.theta[0] for member in members]))
    mean, sd = priors_of_frames(config, template, size, [member.measured for member in members], log_focal)
    kept = list(members)
    left_out: list[str] = []
    while len(kept) >= _least_frames(kept, least):
        best = None
        for shape in SHAPES if config.camera.crown_shape == "auto" else (config.camera.crown_shape,):
            theta = np.array([a.fit.theta for a in kept])
            start = start_tripod("", theta, size, Surface(shape, circle.radius_m, 1.0), mean, sd)
            heads = start.model.own_of(theta, start.mean)[:, :3]
            frames = [HeadedFrame(a.name, head, a.measured) for a, head in zip(kept, heads, strict=True)]
            fit = fit_tripod(frames, start, mean, sd, drawn)
            best = fit if best is None else choose_surface(best, fit)
        if best is None:
            return None
        worst = int(np.argmax(best.clear_rms_px))
        if best.clear_rms_px[worst] <= WORST_RMS_PX * unit:
            return replace(best, estimate=replace(best.estimate, left_out=tuple(left_out)))
        left_out.append(kept[worst].name)
        del kept[worst]
    return None


def _extend(
    tripod: TripodEstimate,
    members: list[HeadedFrame],
    clip: LookedThrough,
    known: TripodEstimate | None = None,
    pitch: KnownPitch | None = None,
) -> Grown:
    """The tripod after it has found its other frames among the pictures, and learnt from them; what is known of it from
    elsewhere stays known. And these frames.
    """
    template = clip.template
    mean, sd = clip.prior_of(tripod, [])
    sizes = {n: p for n, p in clip.pictures.items() if p.size == tripod.size and p.shows_surface}
    for _ in range(ROUNDS):
        place = Place.of(tripod, template)
        frames = []
        before, path = {frame.name: frame for frame in members}, HeadPath.of(members)
        for name, picture in clip.steps.count(f"{tripod.name}: finding its frames", sizes.items(), len(sizes)):
            seen = before.get(name)
            look = (
                _find_beyond(place, picture, mean, sd)
                if seen is None
                else _look_again(place, picture, seen, path.blur_px(float(name), tripod, clip.period_s))
            )
            is_painted = look is not None and len(look.measured.marking) > 0
            if look is not None and is_painted and (look.is_confirmed or seen is not None):
                frames.append(HeadedFrame(name, look.fit.head, look.measured))
        mean, sd = clip.prior_of(tripod, [frame.measured for frame in frames])
        clip.steps.begin(f"{tripod.name}: fitting")
        fit = _fit_members(frames, tripod, mean, sd, clip, known, pitch)
        if fit is None:
            return tripod, members
        is_settled = set(fit.estimate.used) == set(tripod.used)
        left_out = (*tripod.left_out, *(f.name for f in frames if f.name not in fit.estimate.used))
        tripod = replace(fit.estimate, left_out=tuple(dict.fromkeys(left_out)))
        heads = dict(zip(fit.estimate.used, fit.heads, strict=True))
        members = [replace(f, head=heads[f.name]) for f in frames if f.name in heads]
        if is_settled:
            break
    return tripod, members


def _look_again(place: Place, picture: LookedAt, frame: HeadedFrame, blur_px: Array | None) -> Look:
    """Look where a frame's head was found by its paint, which it follows as the tripod changes: a touchline of a pitch
    of unknown width, which it does not show, leaves nothing else open. The way (2,) of the picture while the shutter
    was open is that between its neighbours.
    """
    spread = place.proposal_covariance(place.tripod.head_low, KNOWN_SD_PX, KNOWN_SD_ZOOM)
    return place.look(picture, frame.head, spread, place.follow_paint(frame.head, frame.measured), blur_px)


def _extend_and_measure(tripod: TripodEstimate, members: list[HeadedFrame], clip: LookedThrough) -> Grown:
    """The tripod with all its frames, before a pitch whose size was searched for where these do not tell it.

    The width is searched for once more at the end: a frame that is found with the length may have the touchline taken
    for a false one. So a pitch 57 m wide was held near 68 m, where the foot of the boards was taken for its touchline.
    """
    tripod, members = _extend(tripod, members, clip)
    searched = tripod
    for search in (search_length, search_width):
        searched = search(searched, members, clip.pictures, clip.template) or searched
    if searched is tripod:
        return tripod, members
    tripod, members = _extend(searched, members, clip)
    return search_width(tripod, members, clip.pictures, clip.template) or tripod, members


def _find_beyond(place: Place, picture: LookedAt, mean: Array, sd: Array) -> Look | None:
    """Search for the head where the tripod is known too little: it may change to meet the paint, as far as it may."""
    best: Look | None = None
    precision = _precision(place.tripod, sd)
    looks = [place.look(picture, head, place.proposal_covariance(head)) for head in place.propose(picture)]
    least_worth = WORTH_SHARE * max(look.worth for look in looks)
    for look in sorted(looks, key=lambda look: -look.worth):
        now, spread = place, place.proposal_covariance(look.fit.head)
        for _ in range(LOOKS - 1):
            if len(look.measured.marking) < LEAST_PLACES or look.worth < least_worth:
                break
            frame = HeadedFrame("", look.fit.head, look.measured)
            fit = fit_tripod([frame], now.tripod, place.tripod.mean, sd, place.drawn, precision)
            now = replace(now, tripod=replace(fit.estimate, covariance=place.tripod.covariance))
            spread = spread / 4.0
            look = now.look(picture, fit.heads[0], spread)
        if look.is_found and (best is None or look.is_better(best)):
            best = look
            if look.is_sure:
                break
    return best


def _fit_members(
    frames: list[HeadedFrame],
    tripod: TripodEstimate,
    mean: Array,
    sd: Array,
    clip: LookedThrough,
    known: TripodEstimate | None = None,
    pitch: KnownPitch | None = None,
) -> TripodFit | None:
    """The tripod of found frames, without those that do not fit the others; with the better shape of the surface, where
    it is not known from elsewhere.
    """
    kept, drawn = list(frames), clip.drawn
    limit = WORST_RMS_PX * tripod.size[0] / 1920.0
    is_hipped = clip.config.camera.crown_shape == "hip"
    while len(kept) >= LEAST_FRAMES:
        if known is not None:
            fit = _learn_beside(known, kept, tripod, drawn)
        elif pitch is not None:
            fit = fit_before(pitch, kept, tripod, mean, sd, drawn)
        else:
            fit = choose_pitch(kept, tripod, mean, sd, drawn, limit, is_hipped=is_hipped)
        worst = int(np.argmax(fit.clear_rms_px))
        if fit.clear_rms_px[worst] <= limit:
            return fit
        del kept[worst]
    return None


def _precision(tripod: TripodEstimate, sd: Array, slack: float = SLACK) -> Array:
    """Information (K, K) of a tripod's free parameters where its variances are so many times what it says."""
    free = free_parameters(sd)
    precision = np.zeros((len(sd), len(sd)))
    precision[np.ix_(free, free)] = invert_normal(slack * tripod.covariance[np.ix_(free, free)])
    return precision


def _learn_beside(
    known: TripodEstimate, frames: list[HeadedFrame], start: TripodEstimate, drawn: DrawnTemplate
) -> TripodFit:
    """The tripod from frames and from what is known of it from elsewhere, told as uncertain as frames that repeat one
    error of the models leave it.
    """
    sd = np.sqrt(np.diag(known.covariance))
    precision = _precision(known, sd)
    alike = count_alike(fit_tripod(frames, start, known.mean, sd, drawn, precision))
    # the prior follows painters' errors as the known tripod does
    start = replace(start, painters=known.painters)
    return fit_tripod(frames, start, known.mean, sd, drawn, precision, alike=alike, parts_m=PART_M)
