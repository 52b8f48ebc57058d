"""What is checked before an answer is believed: one table of all checks, what each measures, and what it refuses as."""

from __future__ import annotations

from dataclasses import dataclass

from circlecal.refusals import REFUSALS


@dataclass(frozen=True, slots=True)
class Gate:
    """What one check asks.

    Attributes
    ----------
    code : str
        The refusal that follows where it fails.
    measures : str
        What its value is, with the unit.
    at_least : bool
        Whether the value must be at least the limit; otherwise at most.
    option : str
        Options that set its limit; empty where the limit is fixed.
    words : str
        What is said of a frame that it refuses, where the refusal's own words are too general.
    """

    code: str
    measures: str
    at_least: bool = False
    option: str = ""
    words: str = ""


CHECKS: dict[str, Gate] = {
    "marking_rms_px": Gate(
        "circle_off_marking", "rms distance of the circle's paint from the ellipse that was found, px"
    ),
    "band_width": Gate(
        "width_unlike_marking",
        "width of the paint where the circle is far away, over what perspective lets it be",
        at_least=True,
    ),
    "painted_share": Gate(
        "circle_support_too_low",
        "share of the marking in view that is painted",
        at_least=True,
        option="mask.detector.acceptance",
    ),
    "whole_share": Gate(
        "arc_too_short",
        "share of the whole ellipse that is in view and painted",
        at_least=True,
        option="mask.detector.acceptance",
    ),
    "arc_deg": Gate(
        "arc_too_short",
        "how much of the circle is measured, as the camera puts it on the field, degrees",
        at_least=True,
        option="ellipse.minimum_arc_deg",
    ),
    "circle_in_front": Gate(
        "circle_behind_camera",
        "1 where the whole circle lies before the camera, 0 where some of it lies behind",
        at_least=True,
    ),
    "field_in_front": Gate(
        "field_behind_camera", "how far before the camera the middle of what was seen lies, m", at_least=True
    ),
    "not_mirrored": Gate(
        "mirrored",
        "determinant of the homography, negative where the field is seen mirrored or from below",
        at_least=True,
    ),
    "circle_residual_px": Gate(
        "residual_too_large",
        "rms distance of the circle's points from the camera's circle, px",
        option="verdict.max_circle_residual_px",
        words="the circle that the best camera draws does not lie on the paint",
    ),
    "structured_residual_px": Gate(
        "residual_too_large",
        "part of that which repeats itself along the arc, px",
        option="verdict.max_structured_residual_px",
        words="the circle that the best camera draws leaves the paint in a regular way, as another shape would",
    ),
    "line_residual_px": Gate(
        "residual_too_large",
        "rms distance of the halfway line's points from the camera's line, px",
        option="verdict.max_line_residual_px",
        words="the halfway line that the best camera draws does not lie on the paint",
    ),
    "arc_residual_px": Gate(
        "residual_too_large",
        "rms distance of another arc's points from where the camera draws it, px",
        option="verdict.max_circle_residual_px",
        words="an arc of the field does not lie where the best camera draws it",
    ),
    "end_residual_px": Gate(
        "residual_too_large",
        "distance of the end of the halfway line from the marking at its end, px",
        option="verdict.max_line_residual_px",
        words="what was taken for the end of the halfway line does not lie on the marking at its end",
    ),
    "marking_residual_px": Gate(
        "residual_too_large",
        "rms distance of the worst line, arc or point from where the camera puts it, px",
        option="verdict.max_line_residual_px",
        words="{marking} does not lie where the other lines and points put it",
    ),
    "widest_edge_gap": Gate(
        "edges_contradict",
        "gap between the circle's two edges over the camera's, which blur may widen",
        option="verdict.edge_gap_ratio",
        words="the marking is far wider than this camera would show it",
    ),
    "narrowest_edge_gap": Gate(
        "edges_contradict",
        "gap between the circle's two edges over the camera's",
        at_least=True,
        option="verdict.edge_gap_ratio",
        words="the marking is far narrower than this camera would show it",
    ),
    "line_reach": Gate(
        "line_beyond_field",
        "how far the halfway line is seen to run from the middle, half widths of the field",
        option="verdict.max_line_reach",
    ),
    "other_end_reach": Gate(
        "line_beyond_field",
        "how far it runs on the side of the end that was not used, half widths of the field",
        option="verdict.max_line_reach",
        words="the halfway line runs past the far side of the field: what was taken for its end is not its end",
    ),
    "crossed_end_beyond": Gate(
        "line_beyond_field",
        "how far beyond its end it still crosses another line, half widths of the field",
        words="the halfway line crosses another line well beyond what was taken for the field's border",
    ),
    "beyond_end_widths": Gate(
        "line_beyond_field",
        "length over which a straight marking is seen beyond its end, picture widths",
        words="a straight marking runs on beyond the end that it has on this field: it is another one",
    ),
    "found_share": Gate(
        "markings_missing", "share of the markings that should be in view that are painted", at_least=True
    ),
    "unexplained_widths": Gate(
        "paint_unexplained", "length of paint on the field where the camera puts no marking, picture widths"
    ),
    "painted_share_of_carriers": Gate(
        "markings_missing",
        "share of the markings to which the camera was fitted that is painted",
        at_least=True,
        words="much of the circle and the halfway line is not painted where the camera puts them",
    ),
    "bare_widths": Gate(
        "markings_missing",
        "how much too early the halfway line's paint ends, picture widths",
        words="the halfway line breaks off where the camera says that it goes on, and nothing hides it",
    ),
    "bare_ends": Gate(
        "markings_missing",
        "how many ends of the halfway line lie on bare ground in full view",
        words="the halfway line ends on bare ground, where a pitch has its touchlines",
    ),
    "crown_m": Gate(
        "picture_contradicts",
        "how much higher the ground is in the circle's middle than at its rim, m",
        at_least=True,
        words="the ground would be hollow, as a crowned pitch is that is seen upside down",
    ),
    "reversal": Gate(
        "picture_contradicts",
        "how much better the widths of the paint fit a camera with near and far exchanged (half a chi-square)",
        words="the paint grows wider where the camera says that it is further away",
    ),
    "rough_share": Gate(
        "picture_contradicts",
        "share of the field in view that looks like a crowd or boards",
        words="a crowd or boards are seen where the camera puts the field",
    ),
    "above_share": Gate(
        "picture_contradicts",
        "share of the picture that is playing surface above the horizon",
        words="playing surface is seen above the camera's horizon",
    ),
    "beyond_share": Gate(
        "picture_contradicts",
        "share of the picture that is playing surface far beyond the field's border",
        words="the playing surface goes on far beyond where the camera puts its border",
    ),
    "near_share": Gate(
        "picture_contradicts",
        "share of the picture that lies before the field and is no ground",
        words="much of what lies before the field, on the camera's side, is no ground",
    ),
    "seam_share": Gate(
        "picture_contradicts",
        "share of the picture's width or height along which a straight step runs",
        words="a straight step runs across the picture: it is put together from several",
    ),
    "contradictions": Gate(
        "picture_contradicts",
        "how near to their limits the checks of paint and ground are together (root of the sum of squared shares)",
        words="several things speak against the camera, each a little less than would refuse it alone: paint that is "
        "missing or too much, and ground that looks like none",
    ),
    "noise_scale": Gate(
        "residual_too_large",
        "how many times the picture's noise circle and lines scatter about the camera",
        words="circle and lines leave many times the noise that the picture has: the camera or a marking is "
        "another one",
    ),
    "chord_radii": Gate(
        "paint_unexplained",
        "length of a straight marking inside the circle that is not the halfway line, radii",
        words="a straight marking runs through the circle, and is not the halfway line: it is an arc of a penalty area",
    ),
    "named_markings": Gate("few_markings", "straight markings and arcs that were recognised", at_least=True),
    "rejected_share": Gate(
        "observations_contradict",
        "share of the lines, arcs and points that contradict the others",
        option="verdict.max_rejected_share",
    ),
    "mark_distance_px": Gate(
        "mark_contradicts_circle",
        "distance of the centre mark from where the camera puts it, px",
        option="verdict.max_mark_distance_px",
    ),
    "noise_beside_mark": Gate(
        "mark_contradicts_circle", "how many times the expected noise circle and line need to contradict the mark"
    ),
    "likely_residual_px": Gate(
        "circle_unconfirmed",
        "the circle's rms distance from the camera's, where little of it is seen, px",
        words="too little of the circle is seen to be sure of it, and the best camera's circle does not lie exactly "
        "on it",
    ),
    "confirmations": Gate(
        "circle_unconfirmed", "other markings, or an exact circle, that confirm a doubtful circle", at_least=True
    ),
    "sigma_px": Gate(
        "too_uncertain", "largest predicted standard deviation near what was seen, px", option="verdict.max_sigma_px"
    ),
    "mean_sigma_px": Gate("too_uncertain", "mean of it there, px", option="verdict.max_mean_sigma_px"),
    "sigma_m": Gate(
        "too_uncertain", "largest predicted standard deviation on the ground there, m", option="verdict.max_sigma_m"
    ),
    "assumed_place": Gate(
        "too_uncertain",
        "of points without a picture that are too few by themselves: how far the camera that they show lies from where "
        "main cameras stand, which is assumed then, standard deviations",
    ),
    "other_size_share": Gate(
        "too_uncertain",
        "how likely a field of another size is, which would be another answer",
        option="verdict.max_other_size_share",
        words="what is seen speaks for a field of another size than the one that the camera rests on",
    ),
    "beyond_rules_m": Gate(
        "line_beyond_field",
        "how surely the field is smaller or larger than the rules allow, m beyond three sigma; negative inside",
        option="field.sizes",
        words="the field would be smaller or larger than the rules of its sport allow",
    ),
    "height_m": Gate(
        "implausible_camera",
        "height of the camera, m",
        option="verdict.height_m",
        words="the camera would hang higher than cameras do",
    ),
    "lowest_height_m": Gate(
        "implausible_camera",
        "height of the camera, m",
        at_least=True,
        option="verdict.height_m",
        words="the camera would stand lower than cameras do",
    ),
    "distance_radii": Gate(
        "implausible_camera",
        "distance of the camera from the circle, radii of the circle",
        option="verdict.distance_radii, verdict.stands_m",
        words="the camera would stand further away than cameras do",
    ),
    "nearest_radii": Gate(
        "implausible_camera",
        "distance of the camera from the circle, radii of the circle",
        at_least=True,
        option="verdict.distance_radii",
        words="the camera would stand closer than cameras do",
    ),
    "roll_deg": Gate(
        "implausible_camera",
        "roll of the camera, degrees",
        option="verdict.max_roll_deg",
        words="the camera would lean to its side further than cameras do",
    ),
    "focal_widths": Gate(
        "implausible_camera",
        "focal length, picture widths",
        option="verdict.focal_widths",
        words="the lens would be longer than lenses are",
    ),
    "shortest_focal_widths": Gate(
        "implausible_camera",
        "focal length, picture widths",
        at_least=True,
        option="verdict.focal_widths",
        words="the lens would be shorter than lenses are",
    ),
    "circle_told": Gate("circle_open", "1 where the paint tells which of the field's circles is seen", at_least=True),
    "rival_ratio": Gate(
        "circle_open", "how many times more speaks for this circle of the field than for the next one", at_least=True
    ),
    "paint_of_view": Gate(
        "circle_unconfirmed",
        "of a circle and a line or two that may be any of the field's: length of the markings in view that are painted,"
        " beyond the length at which as much is bare, picture widths",
        at_least=True,
    ),
    "lines_found_share": Gate(
        "markings_missing",
        "share of the straight markings beside a painted disc that are there",
        at_least=True,
        words="the lines beside the disc are not where the camera puts them: it may be seen from the other side",
    ),
    "least_line_share": Gate(
        "markings_missing",
        "least share of one of them, if it is long in view, that is there",
        at_least=True,
        words="a line beside the disc is not where the camera puts it: it may be seen from the other side",
    ),
    "surface_share": Gate(
        "picture_contradicts",
        "share of the markings in the picture that lie on the playing surface",
        at_least=True,
        words="much of the field that the camera puts into the picture lies beside the playing surface",
    ),
    "painted_width_m": Gate(
        "other_field",
        "greatest width that the paint of circle and lines may have on a floor, m",
        at_least=True,
        words="the lines would be thinner than lines on floors are painted: it is a larger field of another sport",
    ),
    "other_field_ratio": Gate(
        "other_field", "how many times more speaks for the likeliest other league's or sport's field than for this one"
    ),
    "other_field_agreement": Gate(
        "other_field",
        "how many times more markings, the nearer the more, lie where another field has them that covers about as "
        "much of the paint",
    ),
    "missing_markings": Gate(
        "paint_missing", "of a tracked frame: markings that should be in view and are not painted"
    ),
    "frames_to_confirmed": Gate("paint_missing", "of a tracked frame: frames since paint last confirmed the camera"),
}
"""Every check by its name: of a circle that may be found, of the verdict, and of a tracked frame."""


def words_of_check(name: str, marking: str = "") -> str:
    """What is said of a frame that a check of the verdict refuses; the check itself holds the numbers."""
    gate = CHECKS[name]
    return (gate.words or REFUSALS[gate.code].words).format(marking=marking)


def words_of_value(name: str, value: float, limit: float) -> str:
    """What a check measured, what it must be, and which options set that."""
    gate = CHECKS[name]
    setter = f", set by {gate.option}" if gate.option else ""
    return f"{gate.measures}: {value:.3g}, must be {words_of_limit(name, f'{limit:.3g}')}{setter}"


def words_of_limit(name: str, limit: str) -> str:
    """The limit of a check, with whether its value must be at most or at least that; the limit alone of a check that
    this version does not know.
    """
    gate = CHECKS.get(name)
    return limit if gate is None else f"{'at least' if gate.at_least else 'at most'} {limit}"
