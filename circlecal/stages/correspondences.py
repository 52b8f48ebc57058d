"""Stage ``correspondences``: points and tangents of the field from the imaged circle (Magera et al. 2025, section 3).

Case 1 starts from a line of known direction, case 2 from a point, case 3 finds the imaged centre from the two edges
of the marking and goes on as one of the others.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.camera import camera_from_homography, image_center
from circlecal.geometry.circle_pose import pinhole_centers
from circlecal.geometry.concentric import imaged_center, vanishing_line
from circlecal.geometry.conics import line_conic_meet, normalise_conic, polar
from circlecal.geometry.homography import (
    Side,
    camera_side_of,
    compass_label,
    dlt,
    homography_from_circle,
    transfer_errors,
    turn_homography,
)
from circlecal.geometry.projective import (
    Array,
    apply_homography,
    dehomogenise,
    fit_line,
    join,
    lift,
    line_distance,
    meet,
    normalise_line,
)
from circlecal.observations import Observations
from circlecal.refusals import refuse
from circlecal.results import Correspondences, Cues, EllipseFits, KnownPoint, LineCorrespondence, PointCorrespondence

USUAL_ROLL_RAD = np.radians(5.0)
USUAL_DISTANCE_RADII = 7.0
USUAL_DISTANCE_LOG_SD = 0.6
"""Roll (standard deviation), and distance of broadcast cameras: 64 m from a circle of 9.15 m, half or twice as far at
little more than one standard deviation of its logarithm.
"""
ALIKE_SHARE = 1e-6
"""Of squared distances from what was seen: two homographies that differ by no more differ by rounding errors."""


class CorrespondencesConfig(BaseModel):
    """Options of the stage ``correspondences``."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    case: Literal["auto", 1, 2, 3] = Field(
        "auto",
        description="The paper's case, for its points and tangents: 1 from a line, 2 from a point, 3 from the two "
        "edges of the circle's paint; auto takes what is seen. The camera rests on everything that was seen, whatever "
        "the case.",
    )
    camera_side: Side = Field(
        "main",
        description="Which side of the field the camera stands on, since circle and halfway line look alike from both: "
        "main where y is positive, opposite where it is negative; behind a goal the halfway line runs across the "
        "picture.",
    )
    maximum_pair_split: float = Field(
        0.5,
        gt=0,
        description="Case 3: largest split of the double eigenvalue, as a share of the gap to the isolated one.",
    )


def derive_correspondences(
    ellipses: EllipseFits,
    cues: Cues,
    template: FieldTemplate,
    circle: Circle,
    observations: Observations,
    config: CorrespondencesConfig,
) -> Correspondences:
    """Derive eight points and eight tangents with their field coordinates, and put what was seen itself beside them.

    Parameters
    ----------
    ellipses : EllipseFits
        From the stage ``ellipse``.
    cues : Cues
        From the stage ``cues``.
    template : FieldTemplate
        The field.
    circle : Circle
        The circle that is seen.
    observations : Observations
        Everything that was seen: points of known field position for case 2, and what tells the field from the turned
        one; where nothing does, the prior on the camera's side chooses.
    config : CorrespondencesConfig
        Options.

    Raises
    ------
    EstimationError
        ``no_line_or_point`` where nothing fixes the rotation, ``no_center`` where the imaged centre cannot be found,
        ``eigenvalue_gap_within_noise`` (case 3), ``center_outside`` the ellipse.
    """
    fit = ellipses.primary
    radius = template.radius(circle, fit.edge)
    line = None if cues.halfway is None or template.halfway_line is None else cues.halfway
    point = next((k for k in observations.keypoints if np.linalg.norm(k.field_m - circle.center) > 1e-6), None)
    if line is None and point is None:
        raise refuse("correspondences", "no_line_or_point")
    if line is None and config.case == 1:
        raise refuse("correspondences", "no_line")
    center, source = _imaged_center(ellipses, cues, (observations.width, observations.height), config)
    o = np.asarray(circle.center)
    if line is not None and config.case != 2 and template.halfway_line is not None:
        start, end = template.line_ends(template.line_by_name[template.halfway_line])
        found = correspondences_from_line(
            fit.conic, center, line.line, o, radius, end - start, source=source, side=config.camera_side
        )
    elif point is not None:
        found = correspondences_from_point(fit.conic, center, point.point_px, point.field_m, o, radius)
        found = replace(found, center_source=source)
    else:
        raise refuse("correspondences", "no_point")
    if source == "two_edges":
        found = replace(found, case=3)
    by_points = dlt([p.field_m for p in found.points], [p.image_px for p in found.points])
    if by_points is not None:
        chosen = choose_turn(by_points.H, observations, template, o, config.camera_side)
        found = turn_correspondences(found, o) if is_turned(found, chosen, o) else found
    seen_points, seen_lines = known_points(observations, template), known_lines(observations, template)
    return replace(found, seen_points=tuple(seen_points), seen_lines=tuple(seen_lines))


def known_points(observations: Observations, template: FieldTemplate) -> list[KnownPoint]:
    """Marks and keypoints."""
    marks = [
        KnownPoint(np.asarray(template.mark_by_name[m.mark].position, dtype=np.float64), m.point_px, m.sigma_px)
        for m in observations.marks
        if m.mark in template.mark_by_name
    ]
    return marks + [KnownPoint(k.field_m, k.point_px, k.sigma_px) for k in observations.keypoints]


def known_lines(observations: Observations, template: FieldTemplate) -> list[LineCorrespondence]:
    """Straight markings that have a name and at least two points."""
    lines = template.line_by_name
    return [
        LineCorrespondence(
            seen.line, template.line_coordinates(lines[seen.line]), fit_line(seen.points_px, 1.0 / seen.sigma_px**2)
        )
        for seen in observations.lines
        if seen.line is not None and seen.line in lines and len(seen.points_px) >= 2
    ]


def choose_turn(
    H: Array, observations: Observations, template: FieldTemplate, circle_center: Array, side: str
) -> Array:
    """A homography (3, 3), or that of the field turned by 180 degrees about the circle's centre.

    Parameters
    ----------
    H : (3, 3) array
        One of the two.
    observations : Observations
        What was seen: of the two the one is taken that explains named lines, marks and keypoints better.
    template : FieldTemplate
        Says where these are on the field.
    circle_center : (2,) array
        Centre of the circle on the field.
    side : str
        Of :data:`circlecal.geometry.homography.SIDES`: where the camera stands, if both explain all as well.
    """
    turned = turn_homography(H, circle_center)
    kept, other = (_misfit_px2(each, observations, template) for each in (H, turned))
    if abs(kept - other) > ALIKE_SHARE * (kept + other):
        return H if kept < other else turned
    return turned if camera_side_of(H, side, circle_center) < 0 else H


def _misfit_px2(H: Array, observations: Observations, template: FieldTemplate) -> float:
    """Sum of squared distances, square pixels, of lines, marks and keypoints from where a homography puts them."""
    lines = template.line_by_name
    total = 0.0
    for seen in observations.lines:
        if seen.line in lines:
            start, end = lift(template.line_ends(lines[seen.line])) @ H.T
            total += float((line_distance(join(start, end), seen.points_px) ** 2).sum())
    places = known_points(observations, template)
    if places:
        field, image = np.array([p.field_m for p in places]), np.array([p.image_px for p in places])
        total += float((transfer_errors(H, field, image) ** 2).sum())
    return total


def _imaged_center(
    ellipses: EllipseFits, cues: Cues, size: tuple[int, int], config: CorrespondencesConfig
) -> tuple[Array, str]:
    if config.case != 3 and cues.mark is not None:
        return lift(cues.mark.point_px), "centre_mark"
    if config.case != 3 and cues.halfway is not None:
        center = pinhole_center(ellipses.primary.conic, cues.halfway.line, size)
        if center is not None:
            return center, "pinhole"
    if ellipses.outer is None or ellipses.inner is None:
        raise refuse("correspondences", "no_center", "the marking does not show two separate edges")
    found = imaged_center(ellipses.outer.conic, ellipses.inner.conic)
    if found is None:
        raise refuse("correspondences", "no_center", "the two edges of the marking have none in common")
    if found.pair_split > config.maximum_pair_split * found.gap:
        detail = f"the double eigenvalue is split by {found.pair_split:.2g}, the gap is only {found.gap:.2g}"
        raise refuse("correspondences", "eigenvalue_gap_within_noise", detail)
    return found.center, "two_edges"


def pinhole_center(conic: Array, line: Array, size: tuple[int, int]) -> Array | None:
    """Imaged centre (3,) on the halfway line that an ordinary camera allows; of several the most usual camera's.

    Usual means little roll and a distance of some radii of the circle, both only to choose between separate roots.
    """
    width, height = size
    best: tuple[float, Array] | None = None
    for candidate in pinhole_centers(conic, line, image_center(width, height), width):
        H = homography_from_circle(conic, candidate, line, np.zeros(2), 1.0, np.array([0.0, 1.0]))
        camera = None if H is None else camera_from_homography(H, width, height)
        if camera is None or camera.depth(np.zeros(2)) <= 0:
            continue
        roll = float(camera.angles_rad[2]) / USUAL_ROLL_RAD
        distance = np.log(np.linalg.norm(camera.position_m) / USUAL_DISTANCE_RADII) / USUAL_DISTANCE_LOG_SD
        chi_square = roll**2 + distance**2
        if best is None or chi_square < best[0]:
            best = chi_square, candidate
    return None if best is None or best[0] > 16 else best[1]


def correspondences_from_line(
    conic: Array,
    center: Array,
    image_line: Array,
    field_center: Array,
    radius: float,
    direction: Array,
    *,
    case: int = 1,
    source: str = "centre_mark",
    side: Side = "main",
    toward: Array | None = None,
) -> Correspondences:
    """The paper's construction from a line of known direction (which need not pass through the centre).

    Parameters
    ----------
    conic : (3, 3) array
        Image of the circle.
    center : (3,) array
        Imaged centre, inside the ellipse.
    image_line : (3,) array
        Image of the line.
    field_center : (2,) array
        Centre of the circle on the field.
    radius : float
        Its radius, metres.
    direction : (2,) array
        Direction of the line on the field.
    case, source : int, str
        Recorded in the result.
    side : str
        Prior on the camera's side that chooses between the two solutions.
    toward : (2,) array, optional
        A pixel on the positive side of ``direction``; overrules ``side``.

    Raises
    ------
    EstimationError
        ``center_outside`` where the centre does not lie inside the ellipse.
    """
    e = normalise_conic(conic)
    c = np.asarray(center, dtype=np.float64)
    c = c / c[2]
    if not c @ e @ c < 0:
        raise refuse("correspondences", "center_outside")
    u = np.asarray(direction, dtype=np.float64) / np.linalg.norm(direction)
    H = homography_from_circle(e, c, image_line, field_center, radius, u)
    if H is None:
        raise refuse("correspondences", "center_outside")
    if _is_turned(H, field_center, u, side, toward, c):
        H = turn_homography(H, field_center)
    n = np.array([-u[1], u[0]])
    horizon = vanishing_line(e, c)  # eq. 4
    v = meet(image_line, horizon)  # eq. 5
    l2 = join(v, c)  # eq. 6, and 10 of case 2
    l3 = polar(e, v)  # eq. 7
    # on l2 and on l3, which is across it, and where the diagonals of the tangents' trapezoid meet the ellipse
    a, b = _order_near(e, l2, H, field_center + radius * u)
    d, f = _order_near(e, l3, H, field_center + radius * n)
    corner = {(i, j): meet(polar(e, p), polar(e, q)) for i, p in ((1, a), (-1, b)) for j, q in ((1, d), (-1, f))}
    diagonal = u + n
    g, h = _order_near(e, join(corner[1, 1], corner[-1, -1]), H, field_center + radius * diagonal / np.sqrt(2))
    antidiagonal = u - n
    k, m = _order_near(e, join(corner[1, -1], corner[-1, 1]), H, field_center + radius * antidiagonal / np.sqrt(2))
    found = ((a, u), (b, -u), (d, n), (f, -n), (g, diagonal), (h, -diagonal), (k, antidiagonal), (m, -antidiagonal))
    points, tangents = [], []
    for image, outward in found:
        outward = outward / np.linalg.norm(outward)
        label = compass_label(outward)
        points.append(PointCorrespondence(label, field_center + radius * outward, dehomogenise(image)))
        field_line = np.array([outward[0], outward[1], -outward @ field_center - radius])
        tangents.append(LineCorrespondence(label, field_line, normalise_line(polar(e, image))))
    return Correspondences(
        case=case,
        conic=e,
        radius_m=float(radius),
        imaged_center=c,
        center_source=source,
        vanishing_line=normalise_line(horizon),
        points=tuple(points),
        tangents=tuple(tangents),
    )


def correspondences_from_point(
    conic: Array, center: Array, image_point: Array, field_point: Array, field_center: Array, radius: float
) -> Correspondences:
    """Case 2: from a point (2,) of known field position; no prior on the camera's side is needed.

    The paper prints the vanishing point of the tangents as ``v = E l1`` (eq. 9); a point is the pole of a line,
    ``v = E^-1 l1``, which is what the construction from the line through the centre and the point comes to.
    """
    direction = np.asarray(field_point, dtype=np.float64) - field_center
    line = join(lift(image_point), center)  # eq. 8
    return correspondences_from_line(
        conic, center, line, field_center, radius, direction, case=2, toward=np.asarray(image_point, dtype=np.float64)
    )


def is_turned(found: Correspondences, H_image_field: Array, field_center: Array) -> bool:
    """Whether points fit a homography better when the field is turned by 180 degrees about ``field_center`` (2,)."""
    field, image = np.array([p.field_m for p in found.points]), np.array([p.image_px for p in found.points])
    as_named, turned = (apply_homography(H_image_field, places) for places in (field, 2 * field_center - field))
    return float(np.sum((turned - image) ** 2)) < float(np.sum((as_named - image) ** 2))


def turn_correspondences(found: Correspondences, field_center: Array) -> Correspondences:
    """The field turned by 180 degrees about ``field_center`` (2,): opposite points and tangents change their images."""
    field = np.array([p.field_m for p in found.points])
    opposite = np.linalg.norm(2 * field_center - field[:, None] - field, axis=-1).argmin(axis=1).tolist()
    points = (
        replace(p, image_px=found.points[k].image_px, sigma_px=found.points[k].sigma_px)
        for p, k in zip(found.points, opposite, strict=True)
    )
    tangents = (
        replace(t, image_line=found.tangents[k].image_line) for t, k in zip(found.tangents, opposite, strict=True)
    )
    return replace(found, points=tuple(points), tangents=tuple(tangents))


def _order_near(conic: Array, line: Array, H: Array, field_point: Array) -> Array:
    """Both points (2, 3) of a line on the conic, the one nearer to the image of a field point first."""
    both = line_conic_meet(conic, line)
    if both is None:
        raise refuse("correspondences", "center_outside", "a line through it misses the ellipse")
    expected = dehomogenise(H @ lift(field_point))
    distance = np.linalg.norm(dehomogenise(both) - expected, axis=-1)
    return both if distance[0] <= distance[1] else both[::-1]


def _is_turned(
    H: Array, field_center: Array, direction: Array, side: Side, toward: Array | None, center: Array
) -> bool:
    if toward is not None:
        ahead = dehomogenise(H @ lift(field_center + 1e-3 * direction)) - dehomogenise(center)
        return bool(ahead @ (toward - dehomogenise(center)) < 0)
    return camera_side_of(H, side, field_center) < 0
