"""What is true of a synthetic frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from circlecal.field import FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array, apply_homography
from circlecal.geometry.surface import Surface
from circlecal.synthetic.cameras import halfway_length_px, inside_frame, other_lengths_px, visible_circle_deg
from circlecal.synthetic.paint import CIRCLE_CLASS, HALFWAY_CLASS, PaintLayer, class_mask
from circlecal.synthetic.scene import Scene

MarkState = Literal["visible", "hidden", "not_painted", "outside"]
Expectation = Literal["calibrate", "refuse"]

_HIDDEN_ALPHA = 0.5
_VISIBLE_MARK_SHARE = 0.7
_SHORTEST_ARC_DEG = 60.0
_SHORTEST_LINE_SHARE = 0.08
_FEWEST_OTHERS = 2


@dataclass(frozen=True, slots=True)
class Truth:
    """Truth of one frame.

    Attributes
    ----------
    camera : Camera
        With its lens.
    template : FieldTemplate
        The field as it is meant to be.
    painted : FieldTemplate
        The field with its markings where the painters' errors put them; the template where there are none.
    surface : Surface
        With its crown.
    marking_width_m : float
        Width of the paint.
    imaged_center_px : (2,) array
        Where the circle's centre appears in the stored (distorted) picture; may lie outside it.
    imaged_center_undistorted_px : (2,) array
        Where it appears in undistorted pixels.
    center_mark : str
        ``"visible"``, ``"hidden"`` (behind a player), ``"not_painted"`` or ``"outside"`` the frame.
    kind : str
        What is shown, where the profile alone does not say it, e.g. ``"crowd"``.
    picture_box_px : (4,) tuple
        First and last column and row of the picture inside its bars: ``(x0, y0, x1, y1)``, pixel centres.
    visible_circle_deg, halfway_px : float
        Degrees of the outer edge, and length of the halfway line, inside the frame.
    others_px : tuple of float
        Length of every other line or arc inside the frame, longest first.
    classes : (H, W) uint8
        SoccerNet class ids of the paint that is seen: 7 circle, 18 halfway line; players excluded.
    """

    camera: Camera
    template: FieldTemplate
    painted: FieldTemplate
    surface: Surface
    marking_width_m: float
    imaged_center_px: Array
    imaged_center_undistorted_px: Array
    center_mark: MarkState
    kind: str
    picture_box_px: tuple[float, float, float, float]
    visible_circle_deg: float
    halfway_px: float
    others_px: tuple[float, ...]
    classes: NDArray[np.uint8]

    @property
    def field_name(self) -> str:
        """Name of the field template."""
        return self.template.name

    @property
    def view(self) -> FieldView:
        """Where the field is seen."""
        return FieldView(self.camera, self.surface)

    @property
    def H_image_field(self) -> Array:
        """Of the plane z = 0 (3, 3), tangent to the surface at the centre mark, to undistorted pixels."""
        return self.camera.homography

    @property
    def expect(self) -> Expectation:
        """Whether enough to calibrate is in view: 60 degrees of the circle, and a halfway line or two other markings of
        8 % of the width each.

        One line beside the circle would leave it open which of several it is, and how far away the camera stands.
        """
        least = _SHORTEST_LINE_SHARE * (self.picture_box_px[2] - self.picture_box_px[0] + 1)
        others = sum(length >= least for length in self.others_px)
        turned = self.halfway_px >= least or others >= _FEWEST_OTHERS
        return "calibrate" if self.visible_circle_deg >= _SHORTEST_ARC_DEG and turned else "refuse"

    def to_json(self) -> dict[str, Any]:
        """JSON-ready mapping without the mask; the camera has SoccerNet's keys and the lens in half-widths."""
        return {
            "width": self.camera.width,
            "height": self.camera.height,
            "field": self.field_name,
            "field_sizes": self.template.sizes,
            "expect": self.expect,
            "camera": {**self.camera.soccernet(), "kappa": [float(k) for k in self.camera.kappa]},
            "H_image_field": self.H_image_field.tolist(),
            "crown_m": self.surface.crown_m,
            "crown_shape": self.surface.shape,
            "crown_reference_m": self.surface.reference_m,
            "marking_width_m": self.marking_width_m,
            "imaged_center_px": self.imaged_center_px.tolist(),
            "imaged_center_undistorted_px": self.imaged_center_undistorted_px.tolist(),
            "center_mark": self.center_mark,
            "kind": self.kind,
            "picture_box_px": list(self.picture_box_px),
            "pixel_aspect": float(self.camera.focal_px[1] / self.camera.focal_px[0]),
            "visible_circle_deg": self.visible_circle_deg,
            "halfway_px": self.halfway_px,
            "others_px": list(self.others_px),
            "circle_pixels": int(np.sum(self.classes == CIRCLE_CLASS)),
            "halfway_pixels": int(np.sum(self.classes == HALFWAY_CLASS)),
        }


def truth_of(scene: Scene, layers: list[PaintLayer], hidden: NDArray[np.float32]) -> Truth:
    """Truth of a scene from its paint and from what the figures hide (H, W), 0..1."""
    camera, surface, template = scene.camera, scene.surface, scene.template
    circle = template.circle_by_name[template.default_circle]
    center = np.asarray(circle.center, dtype=np.float64)
    classes = class_mask(layers, camera.width, camera.height)
    classes[hidden > _HIDDEN_ALPHA] = 0
    return Truth(
        camera=camera,
        template=template,
        painted=scene.painted or template,
        surface=surface,
        marking_width_m=scene.config.marking_width_m,
        imaged_center_px=FieldView(camera, surface).project(center),
        imaged_center_undistorted_px=np.asarray(apply_homography(camera.homography, center)),
        center_mark=_mark_state(scene, layers, hidden),
        kind=scene.kind,
        picture_box_px=(0.0, 0.0, camera.width - 1.0, camera.height - 1.0),
        visible_circle_deg=visible_circle_deg(camera, template, surface) if scene.field_painted else 0.0,
        halfway_px=halfway_length_px(camera, template, surface) if scene.field_painted else 0.0,
        others_px=other_lengths_px(camera, template, surface) if scene.field_painted else (),
        classes=classes,
    )


def center_mark_name(template: FieldTemplate) -> str | None:
    """Name of the spot in the middle of the default circle, if the template has one."""
    center = np.asarray(template.circle_by_name[template.default_circle].center)
    return next((m.name for m in template.marks if np.linalg.norm(np.asarray(m.position) - center) < 1e-6), None)


def _mark_state(scene: Scene, layers: list[PaintLayer], hidden: NDArray[np.float32]) -> MarkState:
    name = center_mark_name(scene.template)
    if name is None or not (scene.center_mark_painted and scene.field_painted):
        return "not_painted"
    pixel = scene.camera.project(scene.surface.lift(scene.template.mark_by_name[name].position))
    if not inside_frame(pixel, scene.camera.width, scene.camera.height):
        return "outside"
    layer = next(item for item in layers if item.name == name)
    seen = float(np.sum(layer.coverage * (1.0 - hidden[layer.rows, layer.columns])) / np.sum(layer.coverage))
    return "visible" if seen >= _VISIBLE_MARK_SHARE else "hidden"
