"""The last look of a survey: the paint of all frames is measured again from where their tripod has it, with that of
pictures between them, for one last fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from circlecal.camera.spike_and_slab import shares_of_all_sizes
from circlecal.config import Config
from circlecal.field import FieldTemplate
from circlecal.geometry.least_squares import StoppingRule
from circlecal.geometry.projective import Array
from circlecal.pipeline import field_of
from circlecal.rig.tripod import PLACE, TripodEstimate, Venue
from circlecal.tracking.clock import StageClock
from circlecal.tracking.entry import ClipFrame
from circlecal.tracking.first_look import PicturesAt
from circlecal.tracking.follower import Follower, KnownHead
from circlecal.tracking.frame_paint import PART_M, HeadedFrame
from circlecal.tracking.head_path import HeadPath
from circlecal.tracking.looking import Look, LookedAt, Place
from circlecal.tracking.markings import DrawnTemplate
from circlecal.tracking.motion import SHUTTER, move_of_middle
from circlecal.tracking.paint_width import priors_of_frames
from circlecal.tracking.pitch import (
    TOLD_SD_M,
    WORST_RMS_PX,
    hold_size,
    joint_frames,
    leave_out_false_line,
    loosen_size,
    mix_sizes,
    open_size,
    priors_of_sizes,
    untold_sizes,
)
from circlecal.tracking.shared_pitch import KnownPitch
from circlecal.tracking.tripod_fit import TripodFit, count_alike, fit_tripod
from circlecal.tracking.tripod_problem import RULE, VALLEY_RULE

WELL_KNOWN_M = 0.02
"""Standard deviation of the pitch's size from which on no further pictures are looked at. Before a penalty area 0.1 m
of length are 2 to 5 px at 1920 px width.
"""
WIDTH_MEASURED_SD_M, WIDTH_AGREES = 0.01, 2.5
"""A width of the paint that its blur tells better than this, metres, is estimated with the rest, unless that leads away
from it by more standard deviations: then it takes what lens and surface leave over (12 on a real clip). Over three
rendered clips its error falls from 4 to 2 mm, and that of the pitch's length in one of them from 0.13 to 0.01 m.
"""
MOST_FOLLOWED = 120
"""Longer gaps between frames of a tripod are followed frame by frame, at most so many frames in all, and all are
measured: a fast pan is what blurs pictures beyond finding, and what shows circle and penalty area together. Without
them two rendered clips leave the length of the pitch open by 0.07 and 0.19 m. With every second of them, and frames
beside a gap measured as if they were sharp, the lengths of three others, which are told to 0.04 to 0.11 m, are 0.086,
0.172 and 0.013 m off, with all of them as smeared as they are 0.076, 0.008 and 0.005: what the encoder makes of smeared
paint differs from frame to frame. A gap is entered as smeared as the frames before it say: looked for as if it were
sharp, the paint of its first frame did not confirm the head, and three of twelve rendered clips had no frame of a pan
of 13 to 28 degrees from the circle to a penalty area. The length of one was told to 0.09 m and 0.064 m off, and with
these frames to 0.026 and 0.018.
"""
WIDTH, LENGTH = PLACE["width"], PLACE["length"]


def measure_closely(
    tripod: TripodEstimate,
    members: Sequence[HeadedFrame],
    pictures: Mapping[str, LookedAt],
    template: FieldTemplate,
    period_s: float,
    path: HeadPath,
) -> list[HeadedFrame]:
    """The frames of a tripod, their paint measured again from where the tripod now puts the markings; those without a
    picture as they are. A path of heads, these frames' own and others', tells how far they are smeared.
    """
    place = Place.of(tripod, template)
    closely = []
    for frame in members:
        if frame.name not in pictures:
            closely.append(frame)
            continue
        time_s = float(frame.name)
        look = _look_closely(place, pictures[frame.name], frame.head, path.blur_px(time_s, tripod, period_s))
        closely.append(HeadedFrame(frame.name, look.fit.head, look.measured))
    return closely


def learn_closely(
    tripod: TripodEstimate,
    members: list[HeadedFrame],
    pictures: Mapping[str, LookedAt],
    pictures_at: PicturesAt,
    config: Config,
    drawn: DrawnTemplate,
    colour: Array | None = None,
    period_s: float = 0.0,
    pitch: KnownPitch | None = None,
) -> TripodEstimate:
    """The tripod by its frames, measured closely, and by pictures between them where the size of its pitch is known too
    little: where the circle is out of view, all places are as uncertain as the pitch is long.

    The frames are measured twice: a touchline that lies two pixels beside its place is not measured closely at first.
    And those at the end of a gap once more after it is followed, which tells how far they are smeared: in one that was
    measured as if it were sharp the penalty arc lay 0.4 px inside its place, and the pitch came out 0.02 m longer.
    Where no paint is measured the second time that of the first counts: a tripod that moved far takes focal lengths
    along, and no marking is near its place from where the head was before. A pitch that another tripod tells is known.
    """
    template, _ = field_of(config)
    members = _drop_bare(measure_closely(tripod, members, pictures, template, period_s, HeadPath.of(members)))
    if not members:
        return tripod
    fit = _fit_closely(tripod, members, [], config, template, drawn, parts_m=None, pitch=pitch)
    nearer = fit.estimate
    heads = dict(zip(nearer.used, fit.heads, strict=True))
    as_before = [replace(frame, head=heads[frame.name]) for frame in members if frame.name in heads]
    again = measure_closely(nearer, members, pictures, template, period_s, HeadPath.of(members))
    seen = {frame.name: frame for frame in (*as_before, *_drop_bare(again))}
    frames = [seen[frame.name] for frame in members if frame.name in seen]
    smeared: list[HeadedFrame] = []
    if max(tripod.sigma("length"), tripod.sigma("breadth")) >= WELL_KNOWN_M:
        place, path = Place.of(nearer, template), HeadPath.of(frames)
        if period_s > 0.0:
            smeared = _follow_gaps(place, path, pictures_at, config, colour, period_s)
        at_gaps = [frame for frame in frames if path.blur_px(float(frame.name), nearer, period_s) is None]
        whole = HeadPath.of([*frames, *smeared])
        again = _drop_bare(measure_closely(nearer, at_gaps, pictures, template, period_s, whole))
        seen = {frame.name: frame for frame in (*frames, *again)}
        frames = [seen[frame.name] for frame in frames]
        frames = frames + _look_between(place, path, pictures_at, config, colour, period_s)
    start = replace(tripod, mean=nearer.mean)
    return _fit_closely(start, frames, smeared, config, template, drawn, parts_m=PART_M, pitch=pitch).estimate


def _drop_bare(frames: Sequence[HeadedFrame]) -> list[HeadedFrame]:
    """The frames in which paint was measured."""
    return [frame for frame in frames if len(frame.measured.marking) > 0]


def _look_between(
    place: Place,
    path: HeadPath,
    pictures_at: PicturesAt,
    config: Config,
    colour: Array | None,
    period_s: float,
) -> list[HeadedFrame]:
    """Frames between those of a path that are near each other, in which the paint confirms the head."""
    frames, times = [], path.times_between(period_s)
    for time_s, picture in zip(times, pictures_at(times), strict=False):
        if picture is None:
            continue
        seen = LookedAt.of(picture, config.mask).take_surface(colour)
        look = _look_closely(place, seen, path.at(time_s), path.blur_px(time_s, place.tripod, period_s))
        if look.is_confirmed:
            frames.append(HeadedFrame(f"{time_s:.3f}", look.fit.head, look.measured))
    return frames


def _follow_gaps(
    place: Place,
    path: HeadPath,
    pictures_at: PicturesAt,
    config: Config,
    colour: Array | None,
    period_s: float,
) -> list[HeadedFrame]:
    """Frames of the longer gaps in a path, as the head was followed through these from frame to frame, from either
    side where it was lost between.
    """
    found: list[HeadedFrame] = []
    left = MOST_FOLLOWED
    for start, end in path.gaps():
        # the first frame that is not before a time is that of the time
        times = (np.arange(start, end + 0.5 * period_s, period_s) - 0.25 * period_s).clip(0.0).tolist()
        if len(times) > left:
            continue
        left -= len(times)
        shown = {k: picture for k, picture in enumerate(pictures_at(times)) if picture is not None}
        sides = ((0, start), (len(times) - 1, end))
        known = {k: KnownHead(path.at(t), path.blur_at_gap(t, place.tripod, period_s)) for k, t in sides}
        follower = Follower(Venue(place.template.name, (place.tripod,)), config, place.template, StageClock(), known)
        entries = [follower.follow(ClipFrame(k, times[k], picture)) for k, picture in shown.items()]
        for before, entry, after in zip(entries, entries[1:], entries[2:], strict=False):
            if not entry.is_confirmed or before.place is None or after.place is None or before.shot != after.shot:
                continue
            turn = SHUTTER * (after.head - before.head) / (after.index - before.index)
            blur = move_of_middle(turn, entry.head, place.tripod.model, place.tripod.mean)
            seen = LookedAt.of(shown[entry.index], config.mask).take_surface(colour)
            look = _look_closely(place, seen, entry.head, blur)
            if look.is_confirmed:
                name = f"{start + entry.index * period_s:.3f}"
                found.append(HeadedFrame(name, look.fit.head, look.measured))
    return found


def _fit_closely(
    tripod: TripodEstimate,
    sharp: list[HeadedFrame],
    smeared: list[HeadedFrame],
    config: Config,
    template: FieldTemplate,
    drawn: DrawnTemplate,
    *,
    parts_m: float | None,
    pitch: KnownPitch | None = None,
) -> TripodFit:
    """The fit of the tripod to closely measured frames, without those of a false camera; the width of the paint with
    the rest where its blur tells it. Whether a line is a false one, and what the models leave, the sharp frames tell.
    Where the models leave more than noise, a length that is not the usual one is that of the frames which show the
    middle of the field, some of them with an end, if they tell it. At last the size is told as uncertain as the paint
    leaves it.
    """
    unit = tripod.size[0] / 1920.0
    seen = [frame.measured for frame in sharp]
    any_mean, any_sd = priors_of_frames(config, template, tripod.size, seen, tripod.model.log_focal)
    mean, sd = hold_size(tripod, any_mean, any_sd) if pitch is None else pitch.tell(any_mean, any_sd)
    kept, (fit,) = leave_out_false_line(sharp, [tripod], mean, sd, drawn)
    alike = count_alike(fit)
    frames = [*kept, *(_leave_out_alike(frame, sharp, kept) for frame in smeared)]
    joint = joint_frames(frames, drawn) if pitch is None and alike > 1.0 and sd[LENGTH] > 0.0 else []
    if joint:
        told = fit_tripod(joint, tripod, mean, sd, drawn, alike=alike, parts_m=parts_m).estimate
        if told.sigma("length") < TOLD_SD_M:
            mean[LENGTH], sd[LENGTH] = told.mean[LENGTH], 0.0
    for _ in range(2):
        fit = fit_tripod(frames, tripod, mean, sd, drawn, alike=alike, parts_m=parts_m)
        heads_of = zip(frames, fit.heads, fit.clear_rms_px, strict=True)
        kept = [replace(frame, head=head) for frame, head, rms in heads_of if rms <= WORST_RMS_PX * unit]
        if len(kept) in (0, len(frames)):
            break
        frames = kept
    is_width_free = False
    if kept and sd[WIDTH] < WIDTH_MEASURED_SD_M:
        free = fit_tripod(kept, fit.estimate, mean, sd, drawn, is_width_free=True, alike=alike, parts_m=parts_m)
        is_width_free = abs(free.estimate.mean[WIDTH] - mean[WIDTH]) < WIDTH_AGREES * sd[WIDTH]
        fit = free if is_width_free else fit
    best = fit.estimate
    if kept and parts_m is not None:
        last = _LastFit(kept, drawn, is_width_free, alike)
        if pitch is not None:
            told = _open_pitch(last, best, pitch, (any_mean, any_sd))
            return replace(fit, estimate=replace(told, left_out=tripod.left_out))
        any_size = np.where(sd > 0.0, any_mean, mean), np.where(sd > 0.0, any_sd, 0.0)
        best = _tell_size(last, best, tripod, (mean, sd), any_size, config, template)
    return replace(fit, estimate=replace(best, left_out=tripod.left_out))


@dataclass(frozen=True, slots=True)
class _LastFit:
    """Fits to frames that differ by what is known of the size of the pitch; all else is as for :func:`fit_tripod`."""

    frames: list[HeadedFrame]
    drawn: DrawnTemplate
    is_width_free: bool
    alike: float

    def fit(
        self, start: TripodEstimate, mean: Array, sd: Array, parts_m: float, rule: StoppingRule = RULE
    ) -> TripodFit:
        """The fit from a start before pitches with these means and standard deviations (K,)."""
        free, alike = self.is_width_free, self.alike
        return fit_tripod(self.frames, start, mean, sd, self.drawn, None, free, alike, parts_m=parts_m, rule=rule)


def _tell_size(
    last: _LastFit,
    found: TripodEstimate,
    before: TripodEstimate,
    held: tuple[Array, Array],
    any_size: tuple[Array, Array],
    config: Config,
    template: FieldTemplate,
) -> TripodEstimate:
    """A tripod with the size of the pitch as its frames tell it.

    A size that they left open is the likeliest of what it may be, with what the others add to its variance; one that
    was settled is held, as uncertain as the paint leaves it. ``held`` and ``any_size`` are the priors, means and
    standard deviations (K,), that the tripod was found with and those before a pitch of any size.
    """
    mean, sd = held
    if untold_sizes(before, any_size[1]).any():
        shares = shares_of_all_sizes(config.camera.usual_size_share, config.camera.other_length_share)
        priors = priors_of_sizes(before, *any_size, shares)
        fits = [last.fit(found, *prior[:2], PART_M, VALLEY_RULE) for prior in priors]
        likeliest, found = mix_sizes(fits, priors)
        mean, sd, _ = priors[likeliest]
    loose_sd = loosen_size(sd, template)
    if not (loose_sd > sd).any():
        return found
    return open_size(found, last.fit(found, mean, loose_sd, np.inf).estimate, loose_sd > sd)


def _open_pitch(last: _LastFit, found: TripodEstimate, pitch: KnownPitch, prior: tuple[Array, Array]) -> TripodEstimate:
    """A tripod before a pitch that another one tells, with held sizes as uncertain as both leave them. The prior, means
    and standard deviations (K,), is that before a pitch of any size.
    """
    mean, sd = pitch.tell_loosely(*prior)
    is_held = pitch.is_held & (sd > 0.0)
    if not is_held.any():
        return found
    return open_size(found, last.fit(found, mean, sd, PART_M).estimate, is_held)


def _leave_out_alike(frame: HeadedFrame, before: Sequence[HeadedFrame], after: Sequence[HeadedFrame]) -> HeadedFrame:
    """A frame without the marking that others, as they were before and after it, do without."""
    seen_before, seen_after = ({int(k) for f in frames for k in f.measured.marking} for frames in (before, after))
    measured = frame.measured
    for marking in seen_before - seen_after:
        measured = measured.leave_out(marking)
    return replace(frame, measured=measured)


def _look_closely(place: Place, picture: LookedAt, head: Array, blur_px: Array | None = None) -> Look:
    """Look about where the head may be, again where the paint then says, and at last no further beside the markings
    than that leaves open: the dark run-off beyond a far touchline tilts the surface of a longer profile.
    """
    spread = place.proposal_covariance(head)
    look = place.look(picture, head, spread, None, blur_px)
    nearer = spread / 16.0
    look = place.look(picture, look.fit.head, nearer, look.fit.by_common, blur_px)
    nearest = np.asarray(np.linalg.inv(look.fit.information + np.linalg.inv(nearer)))
    look = place.look(picture, look.fit.head, nearest, look.fit.by_common, blur_px)
    return look if blur_px is None else replace(look, measured=look.measured.doubt_smear(blur_px))
