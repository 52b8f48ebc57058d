"""A frame as an annotation file shows it: labelled shapes in pixels, before anybody asks what they mean.

Every annotation format is read to, and written from, these; :mod:`circlecal.formats.meaning` gives them their meaning
on the field. Pixels are the package's: (0, 0) is the centre of the top-left pixel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from circlecal.errors import InputError
from circlecal.geometry.projective import Array
from circlecal.observations import Observations

ShapeKind = Literal["points", "line", "ellipse"]
ELLIPSE_SAMPLES = 48
ROUNDING_PX = 2.0
"""A resized picture has whole pixels: its height may differ from the one that its width asks for by so many pixels of
the smaller picture. 4:3 and 16:10 differ from 16:9 by 120 and 40 rows at 640 px width.
"""


@dataclass(frozen=True, slots=True)
class Shape:
    """One labelled shape.

    Attributes
    ----------
    label : str
        As written in the file.
    kind : {"points", "line", "ellipse"}
        Single points, a polyline or polygon, or an ellipse.
    points_px : (N, 2) array
        The points; of an ellipse its centre and one end of each semi-axis.
    confidence : tuple of float, optional
        One per point, 0 to 1, where the file has them.
    sigma_px : float, optional
        Standard deviation of a single point, pixels, where the file has it.
    """

    label: str
    kind: ShapeKind
    points_px: Array
    confidence: tuple[float, ...] | None = None
    sigma_px: float | None = None

    def sample(self) -> Array:
        """Points (N, 2) on the shape: its own, or samples of the ellipse."""
        if self.kind != "ellipse":
            return self.points_px
        center, first, second = self.points_px
        angle = np.linspace(0.0, 2.0 * np.pi, ELLIPSE_SAMPLES, endpoint=False)[:, None]
        return np.asarray(center + np.cos(angle) * (first - center) + np.sin(angle) * (second - center))


@dataclass(frozen=True, slots=True)
class AnnotatedFrame:
    """Everything that a file says about one frame of ``width`` x ``height`` pixels.

    Attributes
    ----------
    id : str
        Name of the frame.
    width, height : int
        Size of the picture, from the file, the picture or the user.
    shapes : tuple of Shape
        What is marked.
    image : str or None
        The picture's name, where the file has one.
    warnings : tuple of str
        What was left out, one line each, naming file and field.
    original : mapping or None
        The file's own content, where a writer hands on what it does not change.
    observations : Observations or None
        Curves and lines with a standard deviation for each point, where the file has them: they count instead of the
        shapes, which then only draw them.
    field : str
        Template, or its file, whose markings the labels name.
    on_paint : bool
        Whether the file says that its points lie on the middle of the paint; what says nothing is left to the user.
    """

    id: str
    width: int
    height: int
    shapes: tuple[Shape, ...]
    image: str | None = None
    warnings: tuple[str, ...] = ()
    original: Mapping[str, Any] | None = None
    observations: Observations | None = None
    field: str = "soccer"
    on_paint: bool = False

    def resize(self, width: int, height: int) -> AnnotatedFrame:
        """The frame on a picture of another size; the corners of the picture stay its corners.

        Raises
        ------
        InputError
            The other picture has another aspect, so that it is another part of the scene or distorted.
        """
        if (width, height) == (self.width, self.height):
            return self
        factor = scale_between(self.id, (self.width, self.height), (width, height))
        shapes = tuple(
            replace(
                shape,
                points_px=(shape.points_px + 0.5) * factor - 0.5,
                sigma_px=None if shape.sigma_px is None else float(factor[0]) * shape.sigma_px,
            )
            for shape in self.shapes
        )
        seen = None if self.observations is None else self.observations.resize(width, height)
        return replace(self, width=width, height=height, shapes=shapes, observations=seen)


def scale_between(frame_id: str, annotated: tuple[int, int], picture: tuple[int, int]) -> Array:
    """Factors (2,) from the size of an annotation to that of its picture, width and height each.

    Raises
    ------
    InputError
        They have another aspect.
    """
    (own_width, own_height), (width, height) = annotated, picture
    if abs(own_width * height - width * own_height) / max(own_width, width) > ROUNDING_PX:
        sizes = f"{own_width}x{own_height}, the picture {width}x{height}"
        raise InputError(f"{frame_id}: the annotation is of {sizes}, which has another aspect")
    return np.array([width / own_width, height / own_height])


@dataclass(frozen=True, slots=True)
class ObservedFrame:
    """One frame of an annotation file as observations of the field, ready to be calibrated."""

    id: str
    width: int
    height: int
    observations: Observations
    image: str | None = None
    warnings: tuple[str, ...] = ()
    original: Mapping[str, Any] | None = None
    on_paint: bool = False
