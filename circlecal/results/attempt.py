"""The attempt that the stages add up to, and the calibration of a frame."""

from __future__ import annotations

from dataclasses import dataclass, field

from circlecal.field import FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.camera import PlaneCamera
from circlecal.geometry.projective import Array
from circlecal.geometry.short_repr import ShortRepr
from circlecal.observations import Observations
from circlecal.results.estimates import CameraFit, Correspondences, HomographyFit
from circlecal.results.seen import Cues, EdgePoints, EllipseFits, MarkingMask, RayPoints
from circlecal.results.verdict import Status, Verdict


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """What a picture's attempt holds once a camera was fitted to it: where looking at the picture again starts."""

    mask: MarkingMask
    edges: EdgePoints
    cues: Cues
    observations: Observations
    camera: CameraFit
    verdict: Verdict


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """Another way to see the picture: its circle taken for another one of the field.

    Attributes
    ----------
    circle_name : str
        What the circle is taken for.
    camera : CameraFit
        The camera that follows.
    evidence : float
        Length of markings that are painted where this camera puts them, beyond break-even, picture widths.
    """

    circle_name: str
    camera: CameraFit
    evidence: float


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Attempt(ShortRepr):
    """What the stages made of one frame with one circle: each stage's result, None where it was not reached.

    Attributes
    ----------
    mask, edges, rays, ellipses, cues, correspondences, homography, camera : stage results
        In the order of the stages.
    no_correspondences : str or None
        Why a circle that was measured gives no points and tangents, and what helps; the camera can do without them.
    observations : Observations or None
        What the camera is fitted to: everything that was measured, and what was given beside the picture.
    verdict : Verdict or None
        The answer of the last stage, or why an earlier one gave up.
    circle_name : str or None
        Circle of the template that the seen one was taken for, where it is another than the one looked for.
    rivals : tuple of Rival
        What else it may be, the likeliest first, where that was asked.
    is_placed : bool
        Whether all that is painted decided what the observations are: none was left out for straining the camera.
    """

    mask: MarkingMask | None = None
    edges: EdgePoints | None = None
    rays: RayPoints | None = None
    ellipses: EllipseFits | None = None
    cues: Cues | None = None
    observations: Observations | None = None
    correspondences: Correspondences | None = None
    no_correspondences: str | None = None
    homography: HomographyFit | None = None
    camera: CameraFit | None = None
    verdict: Verdict | None = None
    circle_name: str | None = None
    rivals: tuple[Rival, ...] = ()
    is_placed: bool = False

    @property
    def fitted(self) -> Fitted | None:
        """What was reached, where a picture led to a camera and a verdict; else None."""
        if self.mask is None or self.edges is None or self.cues is None:
            return None
        if self.observations is None or self.camera is None or self.verdict is None:
            return None
        return Fitted(
            mask=self.mask,
            edges=self.edges,
            cues=self.cues,
            observations=self.observations,
            camera=self.camera,
            verdict=self.verdict,
        )

    @property
    def is_calibrated(self) -> bool:
        """Whether the verdict accepts it."""
        return self.verdict is not None and self.verdict.status == "calibrated"

    @property
    def code(self) -> str | None:
        """Why the verdict refuses it, for machines; None where it does not."""
        return None if self.verdict is None else self.verdict.code


@dataclass(frozen=True, slots=True, eq=False)
class FieldCandidate:
    """What a frame looks like as one field among several that it may be.

    Attributes
    ----------
    template, sport : str
        Name of the field template, and the sport that it belongs to.
    status, code : str, str or None
        Verdict under this template.
    evidence : float or None
        Length of its markings that are painted where its camera puts them, beyond the length at which as much is
        missing as a wrong camera's would be, picture widths; of a refused frame that of the best camera under which
        the whole template was laid over the picture; None where there is no camera.
    found_share : float or None
        Share of its markings in view that are painted.
    explained_share : float or None
        Share of what was found painted that are its markings.
    max_sigma_px : float or None
        Largest predicted standard deviation, pixels.
    H_image_field : (3, 3) array or None
        Field to pixels, where it was calibrated.
    """

    template: str
    sport: str
    status: Status
    code: str | None
    evidence: float | None = None
    found_share: float | None = None
    explained_share: float | None = None
    max_sigma_px: float | None = None
    H_image_field: Array | None = None

    @property
    def explained_evidence(self) -> float:
        """Evidence, picture widths, times the share of the paint that is explained; 0 where either is unknown."""
        return (self.evidence or 0.0) * (self.explained_share or 0.0)


@dataclass(frozen=True, slots=True)
class LikelySport:
    """Which sport a frame looks like that no field calibrated.

    Attributes
    ----------
    name : str or None
        As the templates call it; None where nothing tells.
    probability : float
        How sure that is, 0 to 1; of None, that it is none of the sports that were tried.
    """

    name: str | None
    probability: float


@dataclass(frozen=True, slots=True, eq=False)
class FrameCalibration:
    """Everything known about one frame: which one it is, how it was run, and the attempt that was taken.

    The :class:`circlecal.Calibration` that users get is made from it.

    Attributes
    ----------
    id, source : str, str or None
        Name of the frame, and the file or address that it comes from.
    width, height : int
        Size of the picture, pixels.
    field_name, circle_name : str
        Field template, and the circle of it that was looked for.
    attempt : Attempt
        What every stage reached.
    seed, config_digest : int, str
        Seed of the random draws, and digest of the configuration.
    timings_ms : dict
        Time spent in each stage, over all attempts.
    template : FieldTemplate or None
        The field itself; None where the calibration was read from a file.
    fields : tuple of FieldCandidate
        Where the field was to be told by the picture: the templates that were tried, the one that was taken first.
    sport : LikelySport or None
        The sport that the picture looks like, where its field was to be told and it is refused.
    aspect : float
        Width of a pixel over its height, as it was assumed.
    paint_bgr : (float, float, float) or None
        What the circle's paint adds to blue, green and red of the surface, where a picture was calibrated under a
        template all of whose markings are in one paint.
    other_paints_bgr : tuple of (float, float, float)
        Of a picture that was calibrated by the lines of one colour: the same of the other colours on its floor.
    camera_name : str or None
        Name of the known camera that took it, where one is told by name.
    """

    id: str
    width: int
    height: int
    field_name: str
    circle_name: str
    attempt: Attempt
    seed: int
    config_digest: str
    timings_ms: dict[str, float] = field(default_factory=dict)
    source: str | None = None
    template: FieldTemplate | None = None
    fields: tuple[FieldCandidate, ...] = ()
    sport: LikelySport | None = None
    aspect: float = 1.0
    paint_bgr: tuple[float, float, float] | None = None
    other_paints_bgr: tuple[tuple[float, float, float], ...] = ()
    camera_name: str | None = None

    @property
    def verdict(self) -> Verdict:
        """Calibrated, or refused with a reason."""
        return self.attempt.verdict or Verdict("refused", "no_homography", "no stage was run", None)

    @property
    def status(self) -> Status:
        """``"calibrated"`` or ``"refused"``."""
        return self.verdict.status

    @property
    def view(self) -> FieldView | None:
        """Where the field is seen, through the camera or else the homography, also of a refused frame; None without."""
        camera, homography = self.attempt.camera, self.attempt.homography
        if camera is not None:
            return camera.view
        if homography is not None:
            return FieldView(PlaneCamera(self.width, self.height, homography.H_image_field))
        return None

    @property
    def H_image_field(self) -> Array | None:
        """Field (metres) to undistorted pixels: of the camera where there is one, else the DLT; None when refused."""
        if self.status != "calibrated":
            return None
        camera, homography = self.attempt.camera, self.attempt.homography
        if camera is not None:
            return camera.H_image_field
        return None if homography is None else homography.H_image_field
