"""What each reason of a refusal means, and what can be done about it."""

from __future__ import annotations

from typing import NamedTuple


class Explanation(NamedTuple):
    """A reason in words for people, and the mend."""

    meaning: str
    mend: str


_REASONS = {
    "no_field": Explanation(
        "No playing field fills enough of the picture: a crowd shot, a close-up, a graphic.",
        "Nothing, if the frame shows no field. Otherwise give a mask, or the sport with --field.",
    ),
    "no_circle_found": Explanation(
        "The field is seen, but no circle of its markings.",
        "Nothing, if the circle is out of view. A faint or worn circle: give a mask (--mask) or keypoints.",
    ),
    "circle_support_too_low": Explanation(
        "The best ellipse has too little marking under it. A penalty arc, a logo or a short arc looks like this.",
        "Check the picture: if it is the circle, give a mask (--mask), which is believed.",
    ),
    "circle_off_marking": Explanation(
        "The best ellipse passes near marking that does not follow it: pieces of other lines, a logo, a penalty arc.",
        "Check the picture: if the circle is there, give a mask (--mask), which is believed.",
    ),
    "width_unlike_marking": Explanation(
        "The best ellipse is as wide near and far as at its sides: a ring drawn into the picture, not paint.",
        "Nothing for a graphic. If it is the circle, give a mask (--mask), which is believed.",
    ),
    "circle_unconfirmed": Explanation(
        "A likely circle, worn or short or mostly hidden, and nothing else of the field lies where its camera says.",
        "A mask (--mask) or one more line or keypoint; circlecal rig brings in other frames of the camera.",
    ),
    "line_beyond_field": Explanation(
        "The halfway line would be longer than the field: the circle is one of another sport or of smaller size, or "
        "something else was taken for the touchline.",
        "Give the sport that the circle belongs to (--field), or the field's own sizes (field.sizes), or a --mask.",
    ),
    "markings_missing": Explanation(
        "Where the camera puts the other markings of the field, the picture shows none: another circle or line was"
        " taken for the centre circle and the halfway line.",
        "Give the sport (--field), a mask (--mask) with the right circle, or a keypoint.",
    ),
    "no_mask": Explanation(
        "mask.source is file, and there is no mask for this frame.",
        "Put x.mask.png beside x.jpg, give --mask FOLDER, or set mask.source=auto.",
    ),
    "no_edges": Explanation(
        "The mask marks a circle, but the picture has no edges there.",
        "Check that mask and picture belong together; a blurred picture needs lower edges.* thresholds.",
    ),
    "no_band": Explanation(
        "No light band of the marking's width follows the circle.",
        "Check the mask, and the sport (--field): a dark marking on a light floor is another template.",
    ),
    "no_ellipse": Explanation(
        "The points along the circle fit no ellipse: too few, or a curve that does not close.",
        "Nothing for a sliver of the circle. Otherwise a better mask, or more annotated points.",
    ),
    "arc_too_short": Explanation(
        "Too little of the circle is seen to fix an ellipse.",
        "Frames that show more of it; circlecal rig or --camera-prior bring in what other frames of the camera know.",
    ),
    "rotation_free": Explanation(
        "The circle is there, but nothing fixes the rotation about its middle: no halfway line, and no other lines or "
        "arcs that can be only one marking each.",
        "circlecal rig brings in what other frames of the camera know; or annotate one more line or point.",
    ),
    "no_line_or_point": Explanation(
        "The circle is there, but no halfway line and no known point that would fix the rotation about its middle.",
        "circlecal rig brings in what other frames of the camera know; or annotate one more line or point.",
    ),
    "no_point": Explanation(
        "Case 2 was asked for, and no point of known field position is seen.",
        "Set correspondences.case=auto, or give keypoints.",
    ),
    "no_center": Explanation(
        "The imaged centre of the circle can be found neither from a mark or line nor from two edges of the marking.",
        "A sharper or larger picture shows two edges; a visible centre mark or halfway line does too.",
    ),
    "center_outside": Explanation(
        "The imaged centre would lie outside the circle, so line and circle do not belong together.",
        "Check whether the line is really the halfway line; give a mask with both classes.",
    ),
    "eigenvalue_gap_within_noise": Explanation(
        "The two edges of the marking are too alike to tell the imaged centre.",
        "Let a line or a point take part (correspondences.case=auto).",
    ),
    "degenerate": Explanation(
        "The points found leave the homography undetermined.", "Use a frame that shows more of the circle or a line."
    ),
    "ill_conditioned": Explanation(
        "The points found hardly determine the homography.", "Use a frame that shows more of the circle or a line."
    ),
    "no_homography": Explanation(
        "No homography could be estimated from what was seen.", "Look at the stages with circlecal debug."
    ),
    "no_circle": Explanation(
        "No points of the circle took part.", "Check the circle's name (field.circle) and the annotation's labels."
    ),
    "no_camera": Explanation(
        "No upright camera above the ground explains what was seen.",
        "The line is probably not the one it was taken for, or the field is another one (--field).",
    ),
    "circle_behind_camera": Explanation(
        "Part of the circle would lie behind the camera.",
        "The ellipse is probably no circle of the field; look at the frame.",
    ),
    "field_behind_camera": Explanation(
        "What is seen of the field would lie behind the camera.",
        "The lines or points were probably named wrongly; look at the frame and its annotation.",
    ),
    "observations_contradict": Explanation(
        "Too many of the lines, arcs and points contradict each other.",
        "Check the labels of the annotation or detections, and the field's size (--field, field.sizes).",
    ),
    "mirrored": Explanation(
        "The field would be seen mirrored.", "Check whether the picture is flipped, and the labels of given points."
    ),
    "residual_too_large": Explanation(
        "The projected circle or line leaves the marking by more than noise allows.",
        "Something else was taken for the marking, or the lens or the field's size is outside the priors (camera.*).",
    ),
    "edges_contradict": Explanation(
        "The two edges of the marking lie too far apart or too close for the circle's width.",
        "Another marking runs beside it, or the marking's width differs from the template (field.sizes.marking).",
    ),
    "mark_contradicts_circle": Explanation(
        "The centre mark is not where circle and line put it.",
        "A boot, a ball or a logo was taken for the mark, or the line for the halfway line.",
    ),
    "too_uncertain": Explanation(
        "A camera was found, but what is seen leaves the field around the circle uncertain.",
        "circlecal rig, a camera prior (--camera-prior) or more lines help most; verdict.max_sigma_px sets the limit.",
    ),
    "implausible_camera": Explanation(
        "The camera would stand where no camera stands, or have an absurd lens.",
        "Other sport or field size (--field)? Otherwise widen the limit that the check names (verdict.*).",
    ),
    "unreadable_input": Explanation(
        "The file could not be read as a picture.", "The reason names the mend: copy, convert or export it again."
    ),
    "worker_died": Explanation(
        "The process died on this frame: out of memory, or a damaged file.",
        "Run this frame alone with circlecal calibrate, or use fewer workers.",
    ),
    "internal_error": Explanation(
        "A defect of circlecal, not of the frame.", "Run it alone with circlecal debug and report the message."
    ),
}
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


def explain(code: str, stage: str | None) -> Explanation:
    """Meaning and mend of a reason; of its stage where the reason is not known here."""
    meaning = _STAGES.get(stage or "", "The frame was refused.")
    return _REASONS.get(code, Explanation(meaning, "Look at the stages with circlecal debug."))
