"""What the page is told after each change: verdict, template, uncertainty, residuals, and what is missing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from circlecal.api.calls import calibrate_annotation
from circlecal.config import Config
from circlecal.field import MEET, FieldTemplate
from circlecal.field.view import FieldView
from circlecal.formats.annotation import AnnotatedMarking, Annotation
from circlecal.geometry.projective import Array
from circlecal.observations import MarkingKey
from circlecal.overlay.page_view import describe_view, sigma_grid
from circlecal.overlay.quality import rate_sigma
from circlecal.overlay.template_lines import count_sigma_from_seen, pixels_near_picture
from circlecal.pipeline import field_of
from circlecal.refusals import explain
from circlecal.results import CameraFit, FrameCalibration

OFF_PX, OFF_SIGMAS, OFF_SHARE = 3.0, 5.0, 0.25
"""A named marking contradicts the rest where more than this share of its points lies further off: pixels at 1920 px
width, and standard deviations of its own. Fewer points were measured on a player who stands on the paint.
"""
FIT_PX, FIT_SIGMAS = 2.5, 2.0
"""A line without a name may be a marking that a camera puts so near to it: pixels at 1920 px width, and standard
deviations of the marking's place.
"""
FIT_WIDEST_PX = 25.0
"""But where its place is less certain than this, nothing is suggested, pixels at 1920 px width."""
ONE_LINE_PX, MOST_BEND = 3.0, 0.02
"""Lines are pieces of one where a parabola through both leaves no point further off, pixels at 1920 px width, and bends
by no larger share of its length: a strong broadcast lens (kappa 0.1) bends a line across the picture by 1.5 %, and the
penalty area's line seen behind the goal area's leaves more than 10 px.
"""
LIKELY_SHARE = 0.4
"""A marking is probably the one that the camera puts nearest if that lies no further off than this share of the next
one: without its line a touchline may be off by the uncertain width of the field, and the areas' lines are 13 m away.
"""
MARK_FITS_PX = 8.0
"""A point is probably another mark that the camera puts no further away, pixels at 1920 px width: marks are 9 m and
more apart, and clicks on one lie within three pixels.
"""
FIT_SAMPLES = 24
"""Points of a line that are compared."""
FEW_POINTS = 40
"""Markings of so few points show a residual beside each point; of others so many points are compared."""
STEP_M = 0.5
"""Distance of the places along a drawn marking, metres: a chord of the circle then leaves it by 3 mm."""

TAKE_AWAY = "Take that name away, or give it another one."
ONE_OF_THEM = "At least one name is wrong: each of the names that you gave is left out in turn, to find it."
LOOK_AT_NAMES = "Look at what is named: something has another marking's name, or its points lie beside its paint."
ONE_MORE = "Name one more marking: another line, an arc or a crossing of two lines."
ADVICE = {
    "no_circle": "Name the circle, or four straight markings, or three and an arc.",
    "no_circle_found": "Click the circle's paint, or name four straight markings, or three and an arc.",
    "circle_support_too_low": "If one of the dashed ellipses is a marking, click it and name it on the field.",
    "circle_off_marking": "If one of the dashed ellipses is a marking, click it and name it on the field.",
    "no_ellipse": "Mark more of the circle, or name another straight marking.",
    "rotation_free": "Name one straight marking: click it in the picture, then on the field.",
    "too_uncertain": "Name a marking far from what is named so far: a touchline, a penalty area.",
    "mark_contradicts_circle": "Look at the centre mark and the halfway line: take away what is not on its paint.",
    **dict.fromkeys(
        (
            "too_few_observations", "few_markings", "no_line_or_point", "arc_too_short", "circle_unconfirmed",
            "circle_open",
        ),
        ONE_MORE,
    ),
    **dict.fromkeys(
        (
            "observations_contradict", "residual_too_large", "implausible_camera", "no_camera", "mirrored",
            "circle_behind_camera", "field_behind_camera", "line_beyond_field", "markings_missing", "edges_contradict",
            "paint_unexplained", "picture_contradicts",
        ),
        LOOK_AT_NAMES,
    ),
}  # fmt: skip
"""What to click next, by the code of the refusal, where no name is marked as contradicting the others; what helps
elsewhere is the refusal's own help.
"""


@dataclass(frozen=True, slots=True)
class Answer:
    """A calibration of an annotation.

    Attributes
    ----------
    annotation : Annotation
        What it was made from.
    found : FrameCalibration
        The calibration.
    template : FieldTemplate
        The field.
    nameless : tuple of int
        Which markings of the annotation are the nameless lines that were given, in their order; none where they were
        left out.
    """

    annotation: Annotation
    found: FrameCalibration
    template: FieldTemplate
    nameless: tuple[int, ...]

    @property
    def is_calibrated(self) -> bool:
        """Whether the verdict accepts it."""
        return self.found.status == "calibrated"

    def recognise(self) -> dict[int, str]:
        """Names that the estimate gave to nameless lines, by index of the marking."""
        camera, seen = self.found.attempt.camera, self.found.attempt.observations
        if camera is None or seen is None or not self.nameless:
            return {}
        given = (k for k, line in enumerate(seen.lines) if line.line is None)
        numbers = zip(given, self.nameless, strict=True)
        return {index: camera.names_by_line[k] for k, index in numbers if k in camera.names_by_line}


def answer(annotation: Annotation, config: Config, *, nameless: bool, earlier: CameraFit | None = None) -> Answer:
    """Calibrate an annotation.

    Parameters
    ----------
    annotation, config : Annotation, Config
        As for :func:`circlecal.api.calls.calibrate_annotation`.
    nameless : bool
        Whether lines without a name are recognised too, which takes longer.
    earlier : CameraFit, optional
        Camera of nearly the same annotation.

    Raises
    ------
    ConfigError
        The annotation's settings contradict the configuration.
    """
    found = calibrate_annotation(annotation, config, nameless=nameless, earlier=earlier)
    given = [
        k
        for k, m in enumerate(annotation.markings)
        if nameless and m.used and m.kind == "line" and m.name is None and len(m.points_px) > 1
    ]
    return Answer(annotation, found, field_of(config)[0], tuple(given))


@dataclass(frozen=True, slots=True)
class WrongName:
    """A name that contradicts the rest of an annotation.

    Attributes
    ----------
    index : int
        Of the marking.
    name : str
        The wrong name.
    likely : str or None
        The one marking that the camera of the rest puts there; None where none or several fit.
    off_px : float or None
        Median distance of its points from where the camera puts the name, pixels; None where that is out of view.
    """

    index: int
    name: str
    likely: str | None
    off_px: float | None

    def describe(self) -> dict[str, Any]:
        """Ready for JSON: as a change of names, ``names``, with those before, ``instead``."""
        return {
            "names": {str(self.index): self.likely},
            "instead": {str(self.index): self.name},
            "told": self.tell(),
        }

    def tell(self) -> str:
        """A sentence for people."""
        if self.off_px is None:
            where = "the camera of everything else does not show it"
        else:
            where = f"its points lie {self.off_px:.0f} px beside where everything else puts it"
        mend = TAKE_AWAY if self.likely is None else f"It is probably {_words([self.likely])}."
        return f"The name {_words([self.name])} contradicts the rest: {where}. {mend}"


@dataclass(frozen=True, slots=True)
class SeenMarking:
    """A marking of the template before a camera: places along its centreline (N, 2), metres, and where they are seen,
    pixels (N, 2), nan far outside the picture.
    """

    places: Array
    pixels: Array


def see_markings(view: FieldView | None, template: FieldTemplate) -> dict[str, SeenMarking]:
    """The markings that a camera puts near its picture, by name."""
    if view is None:
        return {}
    drawn = [(name, view.grow(places, template)) for name, places in template.polylines(STEP_M).items()]
    ends = np.cumsum([len(places) for _, places in drawn])
    pixels = np.split(pixels_near_picture(view, np.concatenate([places for _, places in drawn])), ends[:-1])
    return {
        name: SeenMarking(places, seen)
        for (name, places), seen in zip(drawn, pixels, strict=True)
        if np.isfinite(seen).all(axis=1).sum() > 1
    }


def describe(told: Answer) -> dict[str, Any]:
    """An answer, ready for JSON; pixels are those of the picture, None is what is not known."""
    found, view = told.found, told.found.view
    drawn = see_markings(view, told.template)
    verdict, camera = found.verdict, found.attempt.camera
    recognised = told.recognise()
    markings = _markings(told, recognised, drawn)
    contradicting = [k for k, marking in enumerate(markings) if marking["contradicts"]]
    wrong = find_wrong_names(told, drawn, contradicting)
    return {
        "status": found.status,
        "code": verdict.code,
        "reason": verdict.reason,
        "missing": advise(told, wrong, contradicting),
        "wrong": [one.describe() for one in wrong],
        "sigma_px": None if camera is None else _finite(camera.max_sigma_px),
        "sigma_m": None if camera is None else _finite(camera.max_sigma_m),
        "rating": rate_sigma(None if camera is None else camera.max_sigma_px, told.annotation.width),
        "template": {name: runs for name, seen in drawn.items() if (runs := _runs(seen.pixels))},
        "markings": markings,
        "suggested": {str(k): name for k, name in suggest_names(told, drawn, contradicting).items()},
        "camera": None if view is None else describe_view(view),
        "sigma": None if view is None else sigma_grid(_count_from_seen(view, camera)),
        "footprint": [] if view is None else _footprint(view),
        "facts": list(_facts(told)),
        "milliseconds": round(sum(found.timings_ms.values()), 1),
    }


def _count_from_seen(view: FieldView, camera: CameraFit | None) -> FieldView:
    return view if camera is None else count_sigma_from_seen(view, camera.reference_by_growth)


def advise(told: Answer, wrong: Sequence[WrongName], contradicting: Sequence[int]) -> str | None:
    """What to do next, in a sentence: wrong names come first; None where there is none and the frame is calibrated.

    Parameters
    ----------
    told : Answer
        The calibration.
    wrong : sequence of WrongName
        From :func:`find_wrong_names`.
    contradicting : sequence of int
        Which markings contradict the rest.
    """
    if wrong:
        return " ".join(one.tell() for one in wrong)
    code = told.found.verdict.code
    if code is None:
        return None
    names = {told.annotation.markings[k].name or "" for k in contradicting}
    if len(names) == 1:
        return f"The name {_words(sorted(names))} contradicts the rest. {TAKE_AWAY}"
    if names:
        return ONE_OF_THEM
    return ADVICE.get(code) or explain(code, told.found.verdict.stage).help


def find_wrong_names(told: Answer, drawn: dict[str, SeenMarking], contradicting: Sequence[int]) -> list[WrongName]:
    """The name that contradicts the camera of a calibrated frame most, with the one that it probably should be: right
    names may contradict as long as that one counts. Of a refused frame none, since its camera may follow the wrong
    name. What was left out though it lies near its place has no wrong name.
    """
    if not told.is_calibrated:
        return []
    unit = told.annotation.width / 1920.0
    judged = [(judge_name(told, drawn, index), told.annotation.markings[index]) for index in contradicting]
    wrong = [one for one, m in judged if one.off_px is None or one.off_px > _farthest_px(m, unit)]
    return sorted(wrong, key=lambda one: -np.inf if one.off_px is None else -one.off_px)[:1]


def judge_name(told: Answer, drawn: dict[str, SeenMarking], index: int) -> WrongName:
    """What a calibrated camera says of the name of a marking that it was found without."""
    marking, view = told.annotation.markings[index], told.found.view
    name = marking.name or ""
    off = _residuals(marking, told, drawn.get(name), name)
    known = None if off is None or not np.isfinite(np.median(off)) else float(np.median(off))
    unit = told.annotation.width / 1920.0
    likely = None if view is None else _find_likely(marking, view, told.template, drawn, unit)
    return WrongName(index, name, likely, known)


def _find_likely(
    marking: AnnotatedMarking, view: FieldView, template: FieldTemplate, drawn: dict[str, SeenMarking], unit: float
) -> str | None:
    """The one other marking of its kind that the camera puts where a marking was seen; None where none or several."""
    if marking.kind == "point":
        pixels = {mark.name: view.project([mark.position])[0] for mark in template.marks if mark.name != marking.name}
        near = {name for name, px in pixels.items() if np.hypot(*(px - marking.points[0])) < MARK_FITS_PX * unit}
        return _only(near)
    kinds = template.line_by_name if marking.kind == "line" else {c.name for c in (*template.circles, *template.arcs)}
    others = {name: seen for name, seen in drawn.items() if name in kinds and name != marking.name}
    points = marking.points[:: max(1, len(marking.points) // FIT_SAMPLES)]
    off = {name: float(np.quantile(distance_to_polyline(points, seen.pixels), 0.9)) for name, seen in others.items()}
    nearest, second = sorted([*off, None, None], key=lambda name: np.inf if name is None else off[name])[:2]
    if nearest is None or (second is not None and off[nearest] > LIKELY_SHARE * off[second]):
        return None
    reach = FIT_WIDEST_PX * unit + FIT_SIGMAS * place_sigma(view, others[nearest])
    return nearest if off[nearest] < reach else None


def _runs(points: Array) -> list[list[list[float]]]:
    """Pieces of a polyline (N, 2) between the points that are nan."""
    finite = np.asarray(np.isfinite(points).all(axis=1))
    pieces = np.split(np.arange(len(points)), np.flatnonzero(np.diff(finite.astype(np.int8))) + 1)
    return [np.round(points[p], 1).tolist() for p in pieces if len(p) > 1 and finite[p[0]]]


def find_contradicting(told: Answer) -> list[int]:
    """Which markings of an annotation have a name that contradicts the rest."""
    judged = _markings(told, told.recognise(), see_markings(told.found.view, told.template))
    return [index for index, marking in enumerate(judged) if marking["contradicts"]]


def _markings(told: Answer, recognised: dict[int, str], drawn: dict[str, SeenMarking]) -> list[dict[str, Any]]:
    """Of each marking of the annotation: rms residual, residuals of few points, whether it contradicts the rest, and
    the name that it was recognised by.
    """
    camera = told.found.attempt.camera
    rejected = set() if camera is None else set(camera.left_out)
    found = []
    for index, marking in enumerate(told.annotation.markings):
        name = marking.name or recognised.get(index)
        off = None if name is None or not marking.used else _residuals(marking, told, drawn.get(name), name)
        own = MarkingKey(name or "", marking.edge if marking.kind == "curve" else None)
        is_off = off is not None and _is_off(off, marking, told.annotation.width / 1920.0)
        is_alone = sum(other.name == name and other.used for other in told.annotation.markings) == 1
        wrong = is_off or (own in rejected and (is_alone or off is None)) or _is_out_of_view(marking, told, off)
        found.append(
            {
                "rms_px": None if off is None else _finite(np.sqrt(np.mean(off**2))),
                "points_px": [_finite(v) for v in off] if off is not None and len(off) <= FEW_POINTS else None,
                "contradicts": wrong and marking.used and marking.name is not None,
                "recognised": recognised.get(index),
            }
        )
    return found


def _is_off(off_px: Array, marking: AnnotatedMarking, unit: float) -> bool:
    """Whether so many of a marking's residuals (N,) are so large that its name contradicts the rest."""
    return float(np.mean(off_px > _farthest_px(marking, unit))) > OFF_SHARE


def _farthest_px(marking: AnnotatedMarking, unit: float) -> float:
    """How far points of a marking may lie from its place, pixels."""
    return max(OFF_PX * unit, OFF_SIGMAS * float(np.median(marking.sigma)))


def _is_out_of_view(marking: AnnotatedMarking, told: Answer, off_px: Array | None) -> bool:
    """Whether a calibrated camera does not show the marking that a line or a curve was named."""
    known = (*told.template.lines, *told.template.circles, *told.template.arcs)
    is_marking = marking.kind != "point" and any(marking.name == element.name for element in known)
    return told.is_calibrated and off_px is None and is_marking


def _residuals(marking: AnnotatedMarking, told: Answer, seen: SeenMarking | None, name: str) -> Array | None:
    """Distances (N,) of the points, or of some of them where they are many, from where the camera puts the marking;
    None without a camera, and where that does not show the marking.
    """
    view, points = told.found.view, marking.points
    if view is None:
        return None
    if marking.kind == "point":
        place = place_of(name, told.template)
        return None if place is None else np.linalg.norm(points - view.project(place[None]), axis=1)
    if len(points) > FEW_POINTS:
        points = points[:: -(-len(points) // FEW_POINTS)]
    return None if seen is None else distance_to_polyline(points, seen.pixels)


def place_of(name: str, template: FieldTemplate) -> Array | None:
    """The field point (2,) of a mark, or of the meet of two lines; None for another name."""
    mark = template.mark_by_name.get(name)
    if mark is not None:
        return np.asarray(mark.position, dtype=np.float64)
    first, _, second = name.partition(MEET)
    return template.meet_lines(first, second)


def distance_to_polyline(points: Array, polyline: Array) -> Array:
    """Distances (N,) of points (N, 2) from a polyline (M, 2) with gaps of nan; inf where there is none of it."""
    start, end = polyline[:-1], polyline[1:]
    there = np.isfinite(start).all(axis=1) & np.isfinite(end).all(axis=1)
    if not there.any():
        return np.full(len(points), np.inf)
    start, span = start[there], end[there] - start[there]
    away = points[:, None] - start
    share = np.clip((away * span).sum(axis=-1) / np.maximum((span * span).sum(axis=-1), 1e-12), 0.0, 1.0)
    rest = away - share[..., None] * span
    return np.asarray(np.sqrt((rest * rest).sum(axis=-1).min(axis=1)))


def suggest_names(
    told: Answer, drawn: dict[str, SeenMarking], contradicting: Sequence[int] | None = None
) -> dict[int, str]:
    """Names of nameless lines, by index: of the one named line that a line continues, or else of the one marking that
    the camera puts there; none where several fit.

    Parameters
    ----------
    told : Answer
        The calibration.
    drawn : dict
        From :func:`see_markings`.
    contradicting : sequence of int, optional
        Which markings have a name that contradicts the rest, which no other line gets; looked for when None.
    """
    contradicting = find_contradicting(told) if contradicting is None else contradicting
    view, unit = told.found.view, told.annotation.width / 1920.0
    named, nameless = _split_lines(told, contradicting)
    if view is None or not told.is_calibrated or not nameless:
        return {}
    taken = {name for name, _ in named} | {told.annotation.markings[k].name for k in contradicting}
    free = {name: seen for name, seen in drawn.items() if name in told.template.line_by_name and name not in taken}
    tolerances_px = _tolerances_px(view, free, unit)
    found = {
        index: _find_continued(points, named, unit) or _find_fitting(points, free, tolerances_px)
        for index, points in nameless.items()
    }
    return {index: name for index, name in found.items() if name is not None}


def _split_lines(told: Answer, contradicting: Sequence[int]) -> tuple[list[tuple[str, Array]], dict[int, Array]]:
    """The used lines of an annotation: names and points (N, 2) of those that are lines of the template and do not
    contradict the rest, and the points (N, 2) of nameless ones by index.
    """
    lines = [(index, m) for index, m in enumerate(told.annotation.markings) if m.kind == "line" and m.used]
    known = told.template.line_by_name
    named = [(m.name, m.points) for k, m in lines if m.name is not None and m.name in known and k not in contradicting]
    return named, {index: m.points for index, m in lines if m.name is None}


def _find_continued(points: Array, named: Sequence[tuple[str, Array]], unit: float) -> str | None:
    """The one named line that a seen line (N, 2) continues; None where it continues none or several."""
    return _only({name for name, others in named if continues(points, others, unit)})


def _tolerances_px(view: FieldView, lines: dict[str, SeenMarking], unit: float) -> dict[str, float]:
    """How far a seen line may lie from where the camera puts a marking, by name, px; without markings whose place is
    too uncertain for a suggestion.
    """
    sigmas = {name: place_sigma(view, seen) for name, seen in lines.items()}
    return {name: FIT_PX * unit + FIT_SIGMAS * sigma for name, sigma in sigmas.items() if sigma < FIT_WIDEST_PX * unit}


def _find_fitting(points: Array, lines: dict[str, SeenMarking], tolerances_px: dict[str, float]) -> str | None:
    """The one marking that lies within its tolerance along nine tenths of a seen line (N, 2), or None."""
    some = points[:: max(1, len(points) // FIT_SAMPLES)]
    return _only(
        {
            name
            for name, tolerance in tolerances_px.items()
            if np.quantile(distance_to_polyline(some, lines[name].pixels), 0.9) < tolerance
        }
    )


def _only(names: set[str]) -> str | None:
    """The name where there is just one."""
    return next(iter(names)) if len(names) == 1 else None


def continues(points: Array, others: Array, unit: float) -> bool:
    """Whether two lines in a picture, points (N, 2) and (M, 2), are pieces of one, which the lens may bend a little.

    ``unit`` is in pixels per pixel at 1920 px width.
    """
    both = np.concatenate(
        [points[:: max(1, len(points) // FIT_SAMPLES)], others[:: max(1, len(others) // FIT_SAMPLES)]]
    )
    axes = np.linalg.svd(both - both.mean(axis=0), full_matrices=False)[2]
    along, across = ((both - both.mean(axis=0)) @ axes.T).T
    length = float(np.ptp(along))
    if length <= 0.0:
        return False
    bend = np.polynomial.Polynomial.fit(along, across, 2)
    sagitta = abs(float(bend.convert().coef[-1])) * (length / 2.0) ** 2 if len(bend.convert().coef) == 3 else 0.0
    return bool(np.abs(across - bend(along)).max() < ONE_LINE_PX * unit and sagitta < MOST_BEND * length)


def place_sigma(view: FieldView, seen: SeenMarking) -> float:
    """Median standard deviation of a marking's place in the picture, px; inf where it is not known."""
    inside = np.flatnonzero(view.shows(np.nan_to_num(seen.pixels, nan=-1.0)))
    if len(inside) == 0:
        return float("inf")
    some = seen.places[inside[:: max(1, len(inside) // FIT_SAMPLES)]]
    sigma = view.project(some, sigma=True).sigma
    return float("inf") if sigma is None else float(np.nanmedian(sigma))


def _footprint(view: FieldView) -> list[list[float]]:
    """The border of the picture on the field, where it shows the ground, metres."""
    width, height = view.camera.width - 1.0, view.camera.height - 1.0
    corners = np.array([[0.0, height], [0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])
    steps = np.linspace(0.0, 1.0, 24, endpoint=False)[:, None]
    border = np.concatenate([a + steps * (b - a) for a, b in pairwise(corners)])
    field = view.to_field(border)
    near = field[np.isfinite(field).all(axis=1) & (np.abs(np.nan_to_num(field)) < 400.0).all(axis=1)]
    return np.round(near, 2).tolist() if len(near) > 2 else []


def _facts(told: Answer) -> Iterator[tuple[str, str]]:
    camera = told.found.attempt.camera
    if camera is None:
        return
    x, y, z = camera.camera.position_m
    yield "camera", f"{x:z.1f}, {y:z.1f} m from the centre mark, {-z:.1f} m high"
    pan, tilt, roll = np.degrees(camera.camera.angles_rad)
    yield "pan, tilt, roll", f"{pan:z.2f}°, {tilt:z.2f}°, {roll:z.2f}°"
    yield "focal length", f"{camera.camera.focal_px[0]:.0f} px"
    yield "lens", f"kappa {camera.camera.kappa[0]:z.3f}"
    yield (
        "crown",
        f"{100 * camera.surface.crown_m:z.1f} cm at {camera.surface.reference_m:.2f} m ({camera.surface.shape})",
    )
    size = np.array([told.template.length_m, told.template.width_m]) + camera.view.growth_m
    yield "field", f"{size[0]:.1f} x {size[1]:.1f} m"
    yield "recognised", _words(sorted(set(told.recognise().values())))
    yield "left out", _words([str(key) for key in camera.left_out])


def _words(names: Sequence[str]) -> str:
    return ", ".join(name.replace("_", " ") for name in names) or "nothing"


def _finite(value: float) -> float | None:
    return round(float(value), 4) if np.isfinite(value) else None
