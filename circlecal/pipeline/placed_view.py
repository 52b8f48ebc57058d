"""Every marking measured where a view of the field puts it, and the camera that follows from all of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from circlecal.errors import EstimationError
from circlecal.field import Circle, FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.conics import sampson_distance
from circlecal.observations import CirclePoints, LineEnd, MarkingKey, Observations
from circlecal.paint.local_energy import local_energy
from circlecal.paint.predicted_width import RESIDUAL_WIDTHS, mean_paint_width
from circlecal.paint.spots import measure_spots
from circlecal.pipeline.attempts import add_checks, estimate, has_one_paint, look_again, take_observations
from circlecal.pipeline.false_lines import leave_out_short_borders, leave_out_streaks
from circlecal.pipeline.logo_rims import measure_logo_rims
from circlecal.pipeline.refinements import Retry, is_less_uncertain
from circlecal.pipeline.setting import Scene, Setting, lighten_markings
from circlecal.pipeline.template_markings import measure_template
from circlecal.placement import PlacedField, mean_distance_px, share_on_surface
from circlecal.refusals import Confidence
from circlecal.results import Attempt, CameraFit, MarkingMask
from circlecal.stages.edges import detect_edges

PLACED_ROUNDS = 3
"""How often the markings of a placed field are measured: where the placement puts them, and where the camera does; the
last one takes in what the second camera put within reach.
"""
FEWEST_CARRYING = 3
"""Markings that carry a placed field at least: both circles of either end of a rink look alike, and were taken for
those of the other end. Right cameras of eight real rinks and an NBA court have 3 to 6.
"""
LARGEST_MOVE_WIDTHS = 0.05
"""Mean distance, picture widths, by which the camera may move the markings from where they were found: right ones moved
them by 0.001 to 0.038.
"""
LOST_WIDTHS = 0.12
"""Mean distance, picture widths, after any round from which a placement is given up: on seven frames of other sports
those that settled had moved by 0.061 at most.
"""
LARGEST_RESIDUAL_PX = 2.0
"""Root mean square distance of a marking from its place, pixels at 1920 px width, that few may exceed: of 15
right cameras of other sports the second largest was 1.6 at most, of a court 2 m shorter than its template 3.2.
"""
LEAST_LIMIT_PX = 1.0
"""The least such distance, pixels of the picture: in smaller ones paint is measured no better. A robot's camera of 640
px width was refused for two lines 0.68 and 0.76 px beside their places.
"""
ROUND = 72
"""Places round a circle at which a camera's circle is compared with the one that was seen, from which it may lie as far
as a marking: of a school yard that was taken for a longer court it lay 5.6 px beside it, pixels at 1920 px width, of a
rendered court 0.6.
"""
PAINTERS_SIGMAS = 2.0
"""Standard deviations of painters' errors that a residual may have beside that: spots of rendered rinks, 3 cm beside
their place, are 2 to 6 px off in right cameras, which their circles decide.
"""
STRAY_AMONG = 7
"""Among so many markings one may be the edge of a board, or half hidden: of a rendered court with 15 of them two are
off by 9 and 2 px, and its camera by 0.4.
"""
SURE_PX = 0.5
"""Largest standard deviation of a marking, pixels at 1920 px width, of a camera that needs no further markings: courts
that were rendered have 1.9 to 2.5 with a circle and a line or two, 0.1 to 0.5 with all that is painted.
"""
DROPPED_AMONG, FEWEST_LEFT = 4, 5
"""Among so many markings one that lies farther is left out of the fit, and so many markings stay: on rendered courts
the edges of painted keys and of boards moved right cameras by 2 to 5 px.
"""
STRAY_MEDIANS, LEAST_STRAY_PX = 5.0, 0.5
"""In medians of all residuals, and pixels at 1920 px width, what counts as farther: of two real rinks the worst
marking has 1.8 medians, the edge of a painted key on three rendered courts 5 to 20, and errors of 1.4 to 4 px fall
to 0.2 to 1.8 without it.
"""
FEWEST_MORE = 2
"""Markings that a camera which was refused must find beside those that it was fitted to."""
SURFACE_SHARE = 0.68
"""Least share of the markings in the picture that lie on the playing surface: of eight right cameras of rinks and
courts 0.77 to 1; of a rink that was laid into the stands 0.60, of three rendered courts whose other circle with its
line and one more marking were taken for the centre circle and its own 0.05 to 0.30.
"""


def follow_placement(setting: Setting, scene: Scene, mask: MarkingMask, placed: PlacedField) -> Attempt | None:
    """The calibrated attempt that a placement leads to; None where there is none, or it leads far away."""
    told = replace(setting, circle=placed.circle)
    mask = replace(mask, conic=placed.conic, halfway=None, confidence=Confidence.ACCEPTED, band_px=0.0)
    picture = lighten_markings(scene.marked, mask, placed.circle)
    attempt = Attempt(mask=mask, circle_name=placed.circle.name)
    try:
        with setting.clock("edges"):
            attempt = replace(attempt, edges=detect_edges(picture, mask, setting.config.edges))
    except EstimationError:
        return None
    settled = settle_view(told, scene, picture, attempt, placed.view)
    if settled is None or settled.camera is None:
        return None
    attempt = settled
    is_near = (
        mean_distance_px(placed.view, settled.camera.view, setting.template) <= LARGEST_MOVE_WIDTHS * setting.width
    )
    is_good = is_near and attempt.is_calibrated and _is_of_this_size(setting, attempt)
    return attempt if is_good and _draws_circle(setting, settled.camera, placed) else None


def _draws_circle(setting: Setting, camera: CameraFit, placed: PlacedField) -> bool:
    """Whether a camera was fitted to the circle about which the field was laid, or draws it where it was seen: one
    edge of its paint or the middle lies there.
    """
    if any(key.name == placed.circle.name for key in camera.residuals_px):
        return True
    angle = np.linspace(0.0, 2 * np.pi, ROUND, endpoint=False)
    drawn = [
        camera.view.project(camera.view.circle_points(placed.circle, edge, angle, setting.template))
        for edge in ("outer", "center", "inner")
    ]
    off_px = [np.abs(sampson_distance(placed.conic, curve[camera.view.shows(curve)])) for curve in drawn]
    nearest_px = min((float(np.sqrt(np.mean(off**2))) for off in off_px if len(off)), default=0.0)
    return nearest_px <= LARGEST_RESIDUAL_PX * setting.width / 1920.0


def settle_view(
    setting: Setting, scene: Scene, picture: NDArray[np.uint8], attempt: Attempt, view: FieldView
) -> Attempt | None:
    """The attempt with every marking measured where a view puts it, and again where the camera that follows does; None
    where there is no camera, or one that leads far away.
    """
    there, ends = view, _ends_of_halfway(attempt)
    for _ in range(PLACED_ROUNDS):
        attempt = _calibrate_view(setting, scene, picture, attempt, there, ends)
        if attempt.camera is None:
            return None
        there = attempt.camera.view
        if mean_distance_px(view, there, setting.template) > LOST_WIDTHS * setting.width:
            return None
    return attempt


def _ends_of_halfway(attempt: Attempt) -> tuple[LineEnd, ...]:
    """Where the paint of the halfway line was seen to end."""
    return () if attempt.cues is None or attempt.cues.halfway is None else attempt.cues.halfway.ends


def _calibrate_view(
    setting: Setting,
    scene: Scene,
    picture: NDArray[np.uint8],
    attempt: Attempt,
    view: FieldView,
    ends: Sequence[LineEnd] = (),
) -> Attempt:
    """The attempt with every marking measured where a view puts it, but for lines that are none of the field; ``ends``
    are those of the halfway line's paint.
    """
    mask, edges, template = attempt.mask, attempt.edges, setting.template
    if mask is None or edges is None:
        return attempt
    with setting.clock("rays"):
        follows = not setting.config.field.any_circle
        circles, lines = measure_template(
            picture,
            view,
            template,
            region=mask.field_region,
            noise=edges.noise,
            config=setting.config.rays,
            follows_curves=follows,
            plain=None if scene.relief is None else _see_lines(scene, template),
        )
        circles = (*circles, *_measure_rims(setting, scene, mask, view, circles))
        lines = leave_out_short_borders(view, template, view.center_of(setting.circle, template), lines, ends)
        # beside painted keys lines lie between two surfaces
        if has_one_paint(setting, scene, mask) and not setting.config.field.any_circle:
            lines = leave_out_streaks(scene.image, view, template, circles, lines, edges.blur_px)
        spots = measure_spots(picture, scene.image, view, template.lone_marks, edges.noise, template.placement_sd_m)
    observations = Observations(setting.width, setting.height, circles, lines, spots)
    seen = replace(attempt, verdict=None, camera=None, correspondences=None, homography=None)
    found = _calibrate_observations(setting, seen, observations)
    return _leave_out_stray_markings(setting, seen, _leave_out_mark(setting, seen, found))


def _measure_rims(
    setting: Setting, scene: Scene, mask: MarkingMask, view: FieldView, found: Sequence[CirclePoints]
) -> tuple[CirclePoints, ...]:
    """Circles that a logo fills up to their line, so that no band was found, by their rims where a view puts them."""
    if scene.relief is not None:  # edges are bands there anyway
        return ()
    known, template = {circle.circle for circle in found}, setting.template
    filled = [circle for circle in template.circles if circle.fill == "logo" and circle.name not in known]
    shown = [circle for circle in filled if view.shows(view.project(view.center_of(circle, template)[None]))[0]]
    if not shown:
        return ()
    return measure_logo_rims(scene.image, view, template, shown, mask.field_region, setting.config.rays)


def _see_lines(scene: Scene, template: FieldTemplate) -> NDArray[np.uint8] | None:
    """Brightness (H, W) in which the field's lines are light; None where they may be lighter or darker than the
    field.
    """
    if template.polarity == "any":
        return None
    return ~scene.gray if template.polarity == "dark" else scene.gray


def see_rims(scene: Scene) -> NDArray[np.uint8]:
    """The picture (H, W) in which edges are bands, too."""
    return scene.looks.once(("rims",), lambda: local_energy(scene.image))


def _calibrate_observations(setting: Setting, seen: Attempt, observations: Observations) -> Attempt:
    """The attempt with given observations. What they are was decided by all that is painted, so that none is left out
    for the few centimetres by which real circles and lines are painted off their places: without the second circle of
    two end zones of rinks cameras were wrong by 11 and 17 px, with it by 5 and 4 px.
    """
    return estimate(setting, take_observations(setting, seen, observations), is_strain_left_out=False)


def _leave_out_mark(setting: Setting, seen: Attempt, attempt: Attempt) -> Attempt:
    """The attempt without the circle's mark where the camera contradicts it and other markings than the circle and a
    line decide: spots are painted centimetres off, and skates are taken for them.
    """
    camera, cues, observations = attempt.camera, attempt.cues, attempt.observations
    if attempt.code != "mark_contradicts_circle" or camera is None or cues is None or observations is None:
        return attempt
    if cues.mark is None or count_carrying(attempt) < FEWEST_CARRYING:
        return attempt
    return _calibrate_observations(setting, seen, observations.without({MarkingKey(cues.mark.name)}))


def _leave_out_stray_markings(setting: Setting, seen: Attempt, attempt: Attempt) -> Attempt:
    """The attempt without the few markings that lie farthest from where its camera puts them, one after another: the
    edge of a board or of a painted key may have been followed in their place.
    """
    camera, observations, unit = attempt.camera, attempt.observations, setting.width / 1920.0
    left = 0 if camera is None else max(1, len(camera.residuals_px) // DROPPED_AMONG)
    while left > 0 and camera is not None and observations is not None and len(camera.residuals_px) > FEWEST_LEFT:
        usual = STRAY_MEDIANS * float(np.median(list(camera.residuals_px.values())))
        limit_px = float(np.clip(usual, LEAST_STRAY_PX * unit, LARGEST_RESIDUAL_PX * unit))
        wander_px = RESIDUAL_WIDTHS * mean_paint_width(camera.view, setting.circle, setting.template)
        limits = {
            key: _allow_painters(camera, key, limit_px + (wander_px if key.name == setting.circle.name else 0.0))
            for key in camera.residuals_px
        }
        beyond = {key: camera.residuals_px[key] / limit for key, limit in limits.items()}
        worst = max(beyond, key=lambda key: beyond[key])
        if beyond[worst] <= 1.0 and attempt.code != "residual_too_large":
            break
        observations = observations.without({worst})
        attempt = _calibrate_observations(setting, seen, observations)
        camera, left = attempt.camera, left - 1
    return attempt


def _is_of_this_size(setting: Setting, attempt: Attempt) -> bool:
    """Whether the markings lie where the camera puts them, but for one, or one of several, which may be a line of
    something else: on a field of another size more of them do not.
    """
    camera = attempt.camera
    if camera is None:
        return True
    limit_px = max(LARGEST_RESIDUAL_PX * setting.width / 1920.0, LEAST_LIMIT_PX)
    off = sum(rms > _allow_painters(camera, key, limit_px) for key, rms in camera.residuals_px.items())
    return off <= max(1, len(camera.residuals_px) // STRAY_AMONG)


def _allow_painters(camera: CameraFit, key: MarkingKey, limit_px: float) -> float:
    """Largest residual of a marking, pixels, where painters' errors come on top of a limit without them."""
    return float(np.hypot(limit_px, PAINTERS_SIGMAS * camera.painted_sigma_px.get(key, 0.0)))


def count_carrying(attempt: Attempt) -> int:
    """How many markings carry the camera of an attempt."""
    return 0 if attempt.camera is None else len(attempt.camera.residuals_px)


def lie_about_alike(camera: CameraFit, own: Circle, circles: Iterable[Circle]) -> Iterator[tuple[Circle, CameraFit]]:
    """Each other one of some circles that looks like the one that a camera lies about, with the camera as it stands
    where that is the one.
    """
    for other in circles:
        if other is own or (other.radius_m, other.color) != (own.radius_m, own.color):
            continue
        shift = np.append(np.subtract(other.center, own.center), 0.0)
        yield other, replace(camera, camera=replace(camera.camera, position_m=camera.camera.position_m + shift))


def _may_show_more_markings(setting: Setting, attempt: Attempt) -> bool:
    """Whether a circle with few lines carries a camera where the field has many more markings; one that was refused
    only where it cannot be another circle, since the whole field was laid over the picture else.
    """
    field, camera = setting.config.field, attempt.camera
    is_seen = attempt.mask is not None and attempt.mask.source == "detector" and attempt.edges is not None
    if not (field.all_markings and is_seen) or camera is None or attempt.circle_name is not None:
        return False
    is_unsure = camera.max_sigma_px > SURE_PX * setting.width / 1920.0
    return is_unsure if attempt.is_calibrated else not field.any_circle


def take_in_markings(setting: Setting, scene: Scene, attempt: Attempt) -> Iterator[Attempt]:
    """The attempt with every marking that lies where its camera puts it, and with the checks that it passed, or those
    of a new look at the picture where it had been refused.
    """
    if attempt.mask is None or attempt.camera is None or attempt.verdict is None:
        return
    picture = lighten_markings(scene.marked, attempt.mask, setting.circle)
    fuller = settle_view(setting, scene, picture, attempt, attempt.camera.view)
    if fuller is None or not lies_on_surface(setting, fuller):
        return
    if not attempt.is_calibrated:
        yield look_again(setting, scene, fuller)
        return
    told = set() if fuller.verdict is None else {check.name for check in fuller.verdict.checks}
    yield add_checks(fuller, *(check for check in attempt.verdict.checks if check.name not in told))


def lies_on_surface(setting: Setting, attempt: Attempt) -> bool:
    """Whether a camera leaves the markings in the picture on the playing surface: a circle and a line of the field, or
    one marking more that fits by chance, make a wrong camera look sure, but it lays the rest of the field into the
    stands.
    """
    region = None if attempt.mask is None else attempt.mask.field_region
    if region is None or attempt.camera is None:
        return True
    return share_on_surface(attempt.camera.view, setting.template, region) >= SURFACE_SHARE


def _is_fuller(setting: Setting, attempt: Attempt, fuller: Attempt) -> bool:
    """Whether more markings agree with a camera that is surer than one that was accepted, and that stays within what
    the first one said of itself.
    """
    if attempt.camera is None or fuller.camera is None or not fuller.is_calibrated:
        return False
    if attempt.is_calibrated and not is_less_uncertain(setting, attempt, fuller):
        return False
    moved = mean_distance_px(attempt.camera.view, fuller.camera.view, setting.template)
    more = len(fuller.camera.residuals_px) - len(attempt.camera.residuals_px)
    is_more = more >= (1 if attempt.is_calibrated else FEWEST_MORE)
    return is_more and moved <= LARGEST_MOVE_WIDTHS * setting.width and _is_of_this_size(setting, fuller)


ALL_MARKINGS = Retry(_may_show_more_markings, take_in_markings, _is_fuller)
"""Tried where few of the markings carry a camera."""
