"""Why a frame is refused: one table of every code, in words for people, with what helps and what is tried again."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from circlecal.errors import EstimationError

_LOOK = "Look at the stages with circlecal debug."
_BELIEVED = "If it is the circle, name it (circlecal annotate) or give a mask (--mask): both are believed."
_COLOUR = "Other than white paint: say what it adds to the ground's blue, green and red (mask.paint_bgr)."
_OTHER_FRAMES = "circlecal rig or --camera-prior bring in what other frames of the camera know."
_SOLVER = "Another --solver needs less, and the default (no --solver) uses everything that is seen."


class Confidence(Enum):
    """How far a circle, a line or a name is believed."""

    ACCEPTED = "accepted"
    """Used as it stands."""
    TENTATIVE = "tentative"
    """Another marking must confirm it."""
    REJECTED = "rejected"
    """Not used."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """One reason for refusing a frame.

    Attributes
    ----------
    code : str
        For machines; never changes.
    words : str
        What is said where there is room for half a line.
    meaning : str
        What it means, for a person who does not know the method.
    help : str
        What helps.
    remeasure : bool
        Whether the circle is measured again, along the curve that the refused camera predicts.
    another_interpretation : bool
        Whether another circle or line of the picture is tried: this one may have been taken wrongly.
    """

    code: str
    words: str
    meaning: str
    help: str
    remeasure: bool = False
    another_interpretation: bool = False


def _by_code(refusals: Iterable[Refusal]) -> dict[str, Refusal]:
    return {refusal.code: refusal for refusal in refusals}


REFUSALS = _by_code(
    (
        # the picture and its mask
        Refusal(
            "no_field",
            "no playing field fills enough of the picture",
            "A crowd shot, a close-up or a graphic: hardly any playing surface is seen.",
            "Nothing, if the frame shows no field. Otherwise give a mask (--mask), or the sport (--field).",
        ),
        Refusal(
            "other_camera",
            "its annotation says that another camera took it",
            "A person said in the workbench that this frame is not of the camera that is calibrated.",
            "Nothing; take the flag away in circlecal annotate if it was set by mistake.",
        ),
        Refusal(
            "no_circle_found",
            "no circle is seen",
            "The field is seen, but no circle of its markings.",
            "Nothing, if the circle is out of view, or for a plan of a field or a view from straight above, which tell "
            f"nothing of a camera. A faint or worn circle: give a mask (--mask) or keypoints. {_COLOUR}",
        ),
        Refusal(
            "circle_support_too_low",
            "the best ellipse has too little marking under it to be the circle",
            "A penalty arc, a logo or a short arc looks like this.",
            f"Look at the picture. {_BELIEVED} {_COLOUR}",
        ),
        Refusal(
            "circle_off_marking",
            "the marking near the best ellipse does not follow an ellipse",
            "Pieces of other lines, a logo or a penalty arc were put together.",
            f"Look at the picture. {_BELIEVED}",
        ),
        Refusal(
            "width_unlike_marking",
            "the best ellipse is a ring drawn into the picture, not paint on the field",
            "Paint is narrower where it is further away; this ring is equally wide all round.",
            f"Nothing for a graphic. {_BELIEVED}",
        ),
        Refusal(
            "no_mask",
            "there is no mask for this frame",
            "The option mask.source is file, and no mask was given for this frame.",
            "Put x.mask.png beside x.jpg, give --mask FOLDER, or set mask.source=auto.",
        ),
        # the marking and its ellipse
        Refusal(
            "no_edges",
            "the picture has no edges where the marking should be",
            "The mask marks a circle, but the picture shows nothing there.",
            "Check that mask and picture belong together; a blurred picture needs lower edges.* thresholds.",
        ),
        Refusal(
            "no_band",
            "no band of the marking's width lies along the circle",
            "Nothing as light and as wide as paint follows the circle.",
            "Nothing but a lighter frame where the picture is so dark or noisy that its paint hardly shows. Otherwise "
            "check the mask and the sport (--field): dark paint on a light floor is another template.",
        ),
        Refusal(
            "no_ellipse",
            "the points along the circle fit no ellipse",
            "There are too few of them, or they follow a curve that does not close.",
            "Nothing for a sliver of the circle. Otherwise a better mask, or more annotated points.",
        ),
        Refusal(
            "arc_too_short",
            "too little of the circle is seen",
            "A short arc does not fix an ellipse, and a penalty arc looks the same.",
            f"Frames that show more of it; {_OTHER_FRAMES}",
        ),
        Refusal(
            "residual_too_large",
            "the circle or line that the best camera draws does not lie on the paint",
            "Something else was taken for the marking, or the lens or the size of the field is outside the priors.",
            "Check --field and field.sizes; a lens far from the usual needs wider camera.* priors; a mask is believed.",
            remeasure=True,
            another_interpretation=True,
        ),
        # what turns the circle
        Refusal(
            "few_markings",
            "too few straight markings are seen together to be sure which they are",
            "Without the circle the field is recognised by its lines, and these may be another part of it too.",
            f"Name the lines (circlecal annotate) or give keypoints; {_OTHER_FRAMES}",
        ),
        Refusal(
            "rotation_free",
            "nothing shows how the circle is turned: no halfway line, and no other marking that can be only one",
            "A circle looks the same however it is turned. One line or point that is known would fix it.",
            f"Name one more line or point (circlecal annotate); {_OTHER_FRAMES}",
            another_interpretation=True,
        ),
        Refusal(
            "no_line_or_point",
            "nothing shows how the circle is turned: no halfway line and no known point",
            "A circle looks the same however it is turned. One line or point that is known would fix it.",
            f"Name one more line or point (circlecal annotate); {_OTHER_FRAMES}",
        ),
        Refusal(
            "no_line",
            "no line through the circle's centre is seen, and case 1 needs one",
            "The option correspondences.case asks for case 1, which starts from the halfway line.",
            "Name the halfway line (circlecal annotate), or set correspondences.case=auto.",
        ),
        Refusal(
            "no_point",
            "no point of known field position is seen, and case 2 needs one",
            "The option correspondences.case asks for case 2, which starts from a point beside the centre.",
            "Give a point of the field beside the centre (--keypoints FILE), or set correspondences.case=auto.",
        ),
        Refusal(
            "no_center",
            "the circle's centre cannot be found in the picture",
            "Neither a mark or line nor two separate edges of the marking tell where it is.",
            "A sharper or larger picture shows two edges; a visible centre mark or halfway line does too.",
        ),
        Refusal(
            "center_outside",
            "the line does not belong to the circle: its centre would lie outside",
            "Line and circle together put the imaged centre outside the ellipse.",
            "Check whether the line is really the halfway line; give a mask with both classes.",
        ),
        Refusal(
            "eigenvalue_gap_within_noise",
            "the two edges of the marking are too alike to tell the circle's centre",
            "Case 3 finds the centre from the difference of both edges, which is within the noise here.",
            "Let a line or a point take part (correspondences.case=auto).",
        ),
        Refusal(
            "degenerate",
            "what was found leaves the homography open",
            "The points and lines do not determine how field and picture belong together.",
            "Use a frame that shows more of the circle or a line.",
        ),
        Refusal(
            "ill_conditioned",
            "what was found hardly determines the homography",
            "The points and lines determine it so weakly that noise decides.",
            "Use a frame that shows more of the circle or a line.",
        ),
        Refusal("no_homography", "no homography could be estimated", "What was seen is not enough.", _LOOK),
        # the camera
        Refusal(
            "no_circle",
            "no point of the circle took part, and the rest does not determine a camera",
            "None was found or given, and too few lines, arcs and points stand for it.",
            "Give more lines or points; check the circle's name (field.circle) and the labels of the annotation.",
        ),
        Refusal(
            "no_camera",
            "no upright camera above the ground explains what was seen",
            "The line is probably not the one it was taken for, or the field is another one.",
            "Check the sport (--field) and, in annotations, the names of the lines.",
            another_interpretation=True,
        ),
        Refusal(
            "circle_behind_camera",
            "part of the circle would lie behind the camera",
            "The ellipse is probably no circle of the field.",
            _LOOK,
            another_interpretation=True,
        ),
        Refusal(
            "field_behind_camera",
            "what is seen of the field would lie behind the camera",
            "The lines or points were probably named wrongly.",
            "Look at the frame and at the labels of its annotation.",
        ),
        Refusal(
            "mirrored",
            "the field would be seen mirrored",
            "The picture is flipped, or labels are swapped.",
            "Check whether the picture is flipped, and the labels of given points.",
            another_interpretation=True,
        ),
        Refusal(
            "implausible_camera",
            "the camera would stand where no camera stands",
            "Its height, distance, roll or focal length is outside what cameras have.",
            "Turn a picture that lies on its side upright, and take the distortion out of a fisheye's. Another sport "
            "or field size (--field)? Where the camera looks straight down, or the reason is its lens, "
            "state the focal length (camera.focal_px); over a robots' field take --config robocup-ceiling. Otherwise "
            "widen the limit that the reason names (verdict.*).",
            another_interpretation=True,
        ),
        # the verdict on a camera
        Refusal(
            "line_beyond_field",
            "the line runs further than this field is wide: it is another circle's, or another sport's",
            "The circle is one of another sport or a smaller one, something was taken for the touchline, or the "
            "picture is upside down.",
            "Turn the picture upright if it is upside down. Else give the sport (--field) or the field's own sizes "
            "(field.sizes), or a mask with the right circle.",
            another_interpretation=True,
        ),
        Refusal(
            "edges_contradict",
            "the marking is far wider or narrower than this camera would show it",
            "Another marking runs beside the circle, or the paint's width differs from the template.",
            "Check the sport (--field); else give the width of the paint (field.sizes.marking), or a mask without the "
            "other marking.",
            another_interpretation=True,
        ),
        Refusal(
            "markings_missing",
            "other markings that should be in view are not there",
            "Another circle or line was taken for the centre circle and the halfway line.",
            "Give the sport (--field), a mask (--mask) with the right circle, or a keypoint.",
            another_interpretation=True,
        ),
        Refusal(
            "circle_open",
            "what is seen may be another circle of the field about as well",
            "Two circles of the field, each with what lies around it, explain the picture alike.",
            "Name the circle (field.circle), or give a keypoint; both cameras are in the result, `alternatives`.",
        ),
        Refusal(
            "field_open",
            "several fields explain the picture about as well",
            "With --field auto: another sport's template fits too, or none fits well enough to be believed.",
            "Name the sport (--field); what was tried stands in the result under `fields`.",
        ),
        Refusal(
            "other_field",
            "the markings of another field are painted, not those of this one",
            "The picture shows the field of another league, or of another sport; the reason names it.",
            "Name the field that the reason names (--field), or let the picture tell it (--field auto).",
        ),
        Refusal(
            "paint_unexplained",
            "lines are painted on the field where this camera puts none",
            "The circle or the halfway line is another one, or the picture shows another sport's field.",
            "Give the sport (--field) or the field's own sizes (field.sizes), or a mask with the right circle.",
            another_interpretation=True,
        ),
        Refusal(
            "picture_contradicts",
            "the picture does not show a field where this camera puts it",
            "It is upside down, mirrored or put together from several pictures, or the circle is none of a field.",
            "Turn the picture upright. If it is, another sport or field size (--field, field.sizes) may explain it.",
            another_interpretation=True,
        ),
        Refusal(
            "mark_contradicts_circle",
            "the centre mark is not where circle and line put it",
            "A boot, a ball or a logo was taken for the mark, something else for the halfway line, or the picture was "
            "cut out of a larger one, or bent by a fisheye.",
            "Give a mask, or switch the mark off (cues.centre_mark=false); of a picture that was cut out, set "
            "camera.principal_point_sd_px=300; take the distortion out of a fisheye's.",
            another_interpretation=True,
        ),
        Refusal(
            "observations_contradict",
            "too many of the lines, arcs and points contradict each other",
            "Labels are wrong, or the field has another size.",
            "Check the labels of the annotation or detections, and the field's size (--field, field.sizes).",
        ),
        Refusal(
            "circle_unconfirmed",
            "too little of the circle is seen to be sure of it, and no other marking confirms it",
            "A worn, short or mostly hidden circle, and nothing else of the field lies where its camera says.",
            f"A mask (--mask), or one more line or point (circlecal annotate); {_OTHER_FRAMES}",
            remeasure=True,
        ),
        Refusal(
            "too_uncertain",
            "a camera was found, but too little is seen to know it well enough",
            "Zoom and distance can be traded against each other without changing what is seen.",
            "One more line or point helps most (the far touchline, the end of the halfway line), where the camera "
            f"stands (camera.position_m), or its focal length (camera.focal_px); "
            f"{_OTHER_FRAMES} verdict.max_sigma_px sets the limit.",
            remeasure=True,
        ),
        # published solvers, which the option --solver runs
        Refusal("no_line", "no line through the circle's centre is seen", "The solver needs one.", _SOLVER),
        Refusal("line_misses_circle", "the halfway line misses the circle", "Their crossings are needed.", _SOLVER),
        Refusal("no_point_on_line", "no known point of the halfway line is seen", "The solver needs one.", _SOLVER),
        Refusal("no_matches", "no matched points or lines are seen", "The solver needs poles or polars.", _SOLVER),
        Refusal("needs_two_edges", "the marking does not show two edges", "The solver needs both of them.", _SOLVER),
        Refusal("needs_two_circles", "only one circle is seen", "The solver needs two of them.", _SOLVER),
        Refusal("needs_two_markings", "only one marking is seen", "The solver needs two of them.", _SOLVER),
        Refusal("too_few_points", "too few points are seen", "The solver needs more of them.", _SOLVER),
        Refusal("too_few_keypoints", "too few keypoints are given", "The solver needs four of them.", _SOLVER),
        Refusal("collinear_keypoints", "all keypoints lie on one line", "They leave the homography open.", _SOLVER),
        Refusal("no_consensus", "the keypoints contradict each other", "No four of them agree.", _SOLVER),
        Refusal("no_real_center", "no centre lies inside the circle", "Noise of the two edges hides it.", _SOLVER),
        Refusal("no_vanishing_line", "no vanishing line fits the circles", "No common chord is a horizon.", _SOLVER),
        Refusal("underdetermined", "the matches leave the homography open", "One off the axis is missing.", _SOLVER),
        Refusal("no_convergence", "the solver found no camera in front of the field", "Every start failed.", _SOLVER),
        Refusal("not_finite", "a given point is not finite", "It is damaged.", "Mend the file that it comes from."),
        # frames of a clip
        Refusal(
            "no_tripod",
            "no camera of the clip is known",
            "Too few frames could be calibrated alone to tell where the camera stands.",
            "A longer part of the clip with the circle in view, or a venue (--venue) from another part of the match.",
        ),
        Refusal(
            "lost",
            "the picture's markings are not where any known camera would show them",
            "Another camera, a replay, a close-up, a graphic over the picture, or hardly any paint in view.",
            "Nothing, if another camera took it. Otherwise a venue (--venue) that knows this camera.",
        ),
        Refusal(
            "paint_missing",
            "too little paint is seen where the camera says it must be",
            "The camera was followed to here, but the picture does not confirm it: fog, a player before the lens, a "
            "graphic, or the way was lost.",
            "Nothing; frames beside it may be answered.",
        ),
        # files and the run
        Refusal(
            "unreadable_input",
            "the file cannot be read as a picture",
            "It is missing, cut off or damaged.",
            "The reason names the mend: copy, convert or export it again.",
        ),
        Refusal(
            "time_limit",
            "the frame took longer than its limit",
            "The picture is very large, or the machine very busy.",
            "Scale the picture down, or raise limits.frame_seconds.",
        ),
        Refusal(
            "out_of_memory",
            "the frame takes more memory than there is",
            "The picture is very large, or the workers are many.",
            "Scale the picture down, use fewer workers, or raise limits.memory_mb.",
        ),
        Refusal(
            "worker_died",
            "the process that worked on this frame died",
            "It ran out of memory, or the file makes a library crash.",
            "Run this frame alone with circlecal calibrate, or use fewer workers.",
        ),
        Refusal(
            "internal_error",
            "circlecal made a mistake on this frame",
            "A defect of circlecal, not of the frame.",
            "Run it alone with circlecal debug and report the message.",
        ),
    )
)
"""Every code with which a frame can be refused."""

_STAGES = {
    "input": "The frame could not be taken in.",
    "mask": "The markings could not be found in the picture.",
    "edges": "The edges of the marking could not be found.",
    "rays": "The marking could not be followed along the circle.",
    "ellipse": "No ellipse could be fitted.",
    "cues": "The line or mark that fixes the rotation could not be found.",
    "correspondences": "Points of the circle could not be named.",
    "homography": "No homography could be estimated.",
    "camera": "No camera could be estimated.",
    "verdict": "A calibration was found, but a check did not believe it.",
}


def explain(code: str, stage: str | None = None) -> Refusal:
    """What a code means and what helps; of its stage where the code is not known to this version."""
    words = _STAGES.get(stage or "", "The frame was refused.")
    return REFUSALS.get(code) or Refusal(code, words[0].lower() + words[1:-1], words, _LOOK)


def refuse(stage: str, code: str, detail: str = "") -> EstimationError:
    """The error by which a stage refuses a frame.

    Parameters
    ----------
    stage : str
        The stage that gives up.
    code : str
        One of :data:`REFUSALS`.
    detail : str
        What is particular to this frame, after the table's words.
    """
    words = REFUSALS[code].words
    return EstimationError(stage, code, f"{words}: {detail}" if detail else words)
