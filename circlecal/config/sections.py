"""The options themselves: a model for every section, :class:`Config` over all of them, and which of them name files."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, get_args

from pydantic import BaseModel, ConfigDict, Field

from circlecal.camera.options import CameraConfig
from circlecal.camera.rig_options import RigConfig
from circlecal.detection.keypoints import KeypointsConfig
from circlecal.formats.meaning import SourcesConfig
from circlecal.paint.along_curve import RaysConfig
from circlecal.pictures.limits import DEFAULT_LIMITS, LimitsConfig
from circlecal.stages.correspondences import CorrespondencesConfig
from circlecal.stages.cues import CuesConfig
from circlecal.stages.edges import EdgesConfig
from circlecal.stages.ellipse import EllipseConfig
from circlecal.stages.homography import HomographyConfig
from circlecal.stages.mask import MaskConfig
from circlecal.stages.verdict import VerdictConfig

AUTO = "auto"
"""Stands for a field template that the picture tells."""
TOLD_APART = (
    "soccer",
    "soccer-7",
    "soccer-9",
    "robocup",
    "robocup-kid",
    "robocup-adult",
    "robocup-msl",
    "ice-hockey-nhl",
    "ice-hockey",
    "basketball",
    "basketball-nba",
    "basketball-ncaa",
    "futsal",
    "handball",
)
"""Templates of which real pictures were seen, and those that differ from them in their sizes."""
TEMPLATE_KEYS = (("field", "template"), ("field", "among"))
"""The keys that name templates, which are files of the user where they are not built in."""
MODEL_KEYS = (("mask", "model"), ("keypoints", "model"), ("keypoints", "lines_model"))
"""The keys that name networks, which are files of the user."""

_STRICT = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class FieldConfig(BaseModel):
    """Which field is seen, and which of its circles."""

    model_config = _STRICT

    template: str = Field(
        "soccer",
        description="Name of a field template (`circlecal fields` lists them), a YAML file of your own, or auto: the"
        " one that a picture shows.",
    )
    among: tuple[str, ...] = Field(
        TOLD_APART,
        min_length=1,
        description="Templates that auto chooses from, by name or as YAML files of your own; the first one is taken"
        " where its answer is beyond doubt.",
    )
    circle: str | None = Field(
        None, description="Circle of the template that is seen; null: the template's default circle."
    )
    any_circle: bool = Field(
        False,
        description="Whether every circle of the template may be the one that is seen, told by all other markings,"
        " where none is named above and the default circle with its line does not calibrate.",
    )
    all_markings: bool = Field(
        False,
        description="Whether every marking of the template is measured where a camera from circle and halfway line puts"
        " it, and those that agree are taken in.",
    )
    sizes: dict[str, float] = Field(
        {}, description="Sizes in metres over those of the template, e.g. {length: 100, marking: 0.1}."
    )
    length_sd_m: float | None = Field(
        None,
        ge=0,
        description="How far the field's length may be from the template's or the given one, metres; null: mostly very "
        "near, or anywhere that the rules allow.",
    )
    width_sd_m: float | None = Field(
        None, ge=0, description="How far its width may be, metres; null as for the length."
    )


class LearningConfig(BaseModel):
    """What the frames of a run that were calibrated alone tell those that were refused."""

    model_config = _STRICT

    enabled: bool = Field(
        True,
        description="Whether frames of a batch that are refused are calibrated again, told what the others of their"
        " folder or video agree on: the colour of the paint, and with the field `auto` the field; and whether a clip is"
        " tracked along the colour of the paint on which its first frames agree.",
    )
    least_frames: int = Field(3, ge=2, le=1000, description="Fewer frames that agree tell nothing.")


class OutputConfig(BaseModel):
    """What is written beside the result; nothing here changes an answer."""

    model_config = _STRICT

    overlay: bool = Field(True, description="Write the frame with the projected field template, `<id>.overlay.jpg`.")
    radar: bool = Field(False, description="Write the frame warped to the field plane, `<id>.radar.jpg`.")
    radar_px_per_m: float = Field(10.0, ge=1.0, le=100.0, description="Scale of the radar picture, pixels per metre.")
    debug: bool = Field(
        False, description="Write one picture per stage and a contact sheet, in the folder `<id>.debug`."
    )
    jpeg_quality: int = Field(90, ge=1, le=100, description="JPEG quality of the written pictures.")


class Config(BaseModel):
    """Everything that can be set."""

    model_config = _STRICT

    seed: int = Field(0, ge=0, le=2**32 - 1, description="Seed of all random draws; every frame begins with it anew.")
    solver: str | None = Field(
        None,
        description="One of the published solvers instead of the closed forms and the camera stage; null for none.",
    )
    field: FieldConfig = Field(FieldConfig(), description="Field: the template and the circle that is seen.")
    mask: MaskConfig = Field(MaskConfig(), description="Mask: where the markings are, read or detected.")
    keypoints: KeypointsConfig = Field(
        KeypointsConfig(), description="Keypoints: a network that finds points of the field, for pictures."
    )
    edges: EdgesConfig = Field(EdgesConfig(), description="Edges: sub-pixel Canny points on the markings.")
    rays: RaysConfig = Field(RaysConfig(), description="Rays: outer edge, inner edge and centreline of the circle.")
    ellipse: EllipseConfig = Field(EllipseConfig(), description="Ellipse: the conic of each edge.")
    cues: CuesConfig = Field(CuesConfig(), description="Cues: halfway line, centre mark, further straight markings.")
    correspondences: CorrespondencesConfig = Field(
        CorrespondencesConfig(), description="Correspondences: points and tangents with their field coordinates."
    )
    homography: HomographyConfig = Field(HomographyConfig(), description="Homography: DLT on points and lines.")
    camera: CameraConfig = Field(CameraConfig(), description="Camera: everything that was seen, with priors.")
    verdict: VerdictConfig = Field(VerdictConfig(), description="Verdict: when a calibration is refused.")
    sources: SourcesConfig = Field(
        default_factory=SourcesConfig,
        description="Sources: how far annotations and detections from files are trusted.",
    )
    learning: LearningConfig = Field(
        LearningConfig(),
        description="Learning: what frames of one run (`circlecal batch`, `track`) tell each other.",
    )
    rig: RigConfig = Field(RigConfig(), description="Rig: what many frames of one camera share (`circlecal rig`).")
    output: OutputConfig = Field(OutputConfig(), description="Output: what is written beside the result.")
    limits: LimitsConfig = Field(
        DEFAULT_LIMITS, description="Limits: how much of a file, a picture, time and memory a frame may take."
    )


def find_nested_model(model: type[BaseModel], name: str) -> type[BaseModel] | None:
    """The section that an option is, also where it may be null; None where it is a value or there is no such option."""
    if name not in model.model_fields:
        return None
    annotation = model.model_fields[name].annotation
    for candidate in (annotation, *get_args(annotation)):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return candidate
    return None


def is_own_template(named: str) -> bool:
    """Whether a template is named by a YAML file of the user, not by the name of one that is built in."""
    return named.endswith((".yaml", ".yml"))


def change_files(content: dict[str, Any], change: Callable[[str], str]) -> None:
    """Write what ``change`` makes of its name for every file of the user that the content of a configuration names."""
    for name, key in (*TEMPLATE_KEYS, *MODEL_KEYS):
        section = content.get(name)
        if not isinstance(section, dict) or key not in section:
            continue
        is_file = is_own_template if (name, key) in TEMPLATE_KEYS else bool
        named = section[key]
        many = list(named) if isinstance(named, list | tuple) else [named]
        many = [change(entry) if isinstance(entry, str) and is_file(entry) else entry for entry in many]
        section[key] = type(named)(many) if isinstance(named, list | tuple) else many[0]
