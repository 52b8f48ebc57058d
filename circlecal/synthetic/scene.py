"""What a synthetic frame shows and how it looks: nothing here draws."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from circlecal.field import Circle, FieldTemplate, Line, Mark
from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface
from circlecal.synthetic.decals import Decal

Channel = Annotated[float, Field(ge=0, le=255)]
Color = tuple[Channel, Channel, Channel]


Alteration = Literal["", "upside_down", "mirrored", "shuffled", "drawn"]


class Graphics(BaseModel):
    """What is laid over the picture besides the score."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    rings: int = Field(default=0, ge=0, le=20, description="Rings that an analyst drew around players.")
    drawn_lines: int = Field(default=0, ge=0, le=20, description="Lines and arrows that an analyst drew.")
    logo: bool = Field(default=False, description="Sign of the channel in a corner.")
    lower_third: bool = Field(default=False, description="Caption in the lower part.")
    ticker: bool = Field(default=False, description="Band of news along the lower edge.")
    watermark: bool = Field(default=False, description="Half transparent words.")
    wipe: float = Field(default=0.0, ge=0, le=1, description="Share of the width that a wipe covers.")
    board: bool = Field(default=False, description="Full screen of names over the picture.")
    banners: int = Field(default=0, ge=0, le=10, description="Bands across the picture, at any height.")


class RenderConfig(BaseModel):
    """Look of a frame: paint, turf, stadium, light and the camera's picture quality."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    marking_width_m: float = Field(default=0.12, gt=0, le=0.3, description="Width of the painted lines, metres.")
    paint_bgr: Color = Field(default=(222, 232, 230), description="Colour of light paint.")
    paint_opacity: float = Field(default=0.92, ge=0, le=1, description="How much of the turf fresh paint hides.")
    wear: float = Field(default=0.0, ge=0, le=1, description="Share of the paint that is gone where it is worn most.")
    wear_scale_m: float = Field(default=0.5, gt=0, description="Size of the worn patches, metres.")
    ground: Literal["turf", "ice", "wood"] = Field(default="turf", description="What is played on.")
    turf_bgr: Color = Field(default=(42, 118, 72), description="Mean colour of the turf, the ice or the floor.")
    gloss: float = Field(default=0.0, ge=0, le=1, description="How brightly ice and varnish mirror the lamps.")
    roof_m: float = Field(default=12.0, gt=0, description="Height of the lamps of a hall, metres.")
    line_gaps: float = Field(
        default=0.0, ge=0, le=0.8, description="Share of the markings' length where no paint is left."
    )
    stripe_width_m: float = Field(default=5.5, gt=0, description="Width of the mown stripes, metres.")
    stripe_rad: float = Field(default=0.0, description="Direction across the stripes, from x towards y.")
    mown_rings: bool = Field(default=False, description="Mown in rings around the centre mark instead of stripes.")
    stripe_contrast: float = Field(
        default=0.06, ge=0, le=0.5, description="Half the relative difference between stripes."
    )
    cross_stripes: bool = Field(default=False, description="Mown in squares instead of stripes.")
    texture: float = Field(
        default=0.035, ge=0, le=0.5, description="Relative standard deviation of the blades of grass."
    )
    patchiness: float = Field(
        default=0.04, ge=0, le=0.5, description="Relative standard deviation of bare and dry patches."
    )
    shade: float = Field(
        default=0.0, ge=0, le=0.9, description="How much darker the shade of the stand is; 0 for none."
    )
    shade_edge_m: float = Field(default=-10.0, description="The shade ends at this y on the halfway line, metres.")
    shade_tilt: float = Field(default=0.1, ge=-2, le=2, description="Slope of the end of the shade, dy/dx.")
    shade_depth_m: float = Field(
        default=400.0, gt=0, description="Extent of the shade from its end towards the far side, metres."
    )
    shade_soft_m: float = Field(default=0.4, gt=0, description="Width of the half-shade at the ends, metres.")
    sun_patches: float = Field(
        default=0.0, ge=0, le=1, description="Share of the shade broken by light through the stands."
    )
    exposure: float = Field(default=1.0, gt=0, le=4, description="Gain of the picture; what passes white is cut off.")
    cast_bgr: tuple[float, float, float] = Field(
        default=(1.0, 1.0, 1.0), description="Colour of the light: gains of the three channels."
    )
    light_pools: float = Field(
        default=0.0, ge=0, le=0.9, description="How uneven few or weak floodlights light the field."
    )
    vignette: float = Field(default=0.08, ge=0, le=0.6, description="Relative loss of light in the corners.")
    haze: float = Field(default=0.0, ge=0, le=0.6, description="Share of grey over the far end of the field.")
    veil: float = Field(
        default=0.0, ge=0, le=0.9, description="Share of grey over the whole picture: mist, stray light."
    )
    precipitation: float = Field(default=0.0, ge=0, le=1, description="Rain or snow in the air.")
    board_distance_m: float = Field(
        default=4.0, gt=0, description="From the touchline to the advertising boards, metres."
    )
    board_height_m: float = Field(default=0.95, gt=0, description="Height of the advertising boards, metres.")
    round_logos: bool = Field(default=False, description="Round logos on the boards.")
    glass: float = Field(
        default=0.0, ge=0, le=1, description="How much the stanchions of glass on the near side hide; 0: no glass."
    )
    corner_m: float = Field(default=0.0, ge=0, description="Radius of the corners of the boards; 0 for square ones.")
    stand_height_m: float = Field(default=21.0, ge=0, description="Height of the stands behind the boards.")
    sky_bgr: Color = Field(default=(28, 28, 28), description="Roof or sky above the stands.")
    near_crowd: bool = Field(default=False, description="Spectators in front of the camera.")
    crowd_density: float = Field(default=0.85, ge=0, le=1, description="Share of the seats that are taken.")
    stand_light: float = Field(default=0.6, gt=0, le=1.2, description="Brightness of the stands.")
    team_bgr: tuple[Color, Color] = Field(
        default=((40, 40, 190), (235, 235, 235)), description="Shirts of the two teams."
    )
    shadow_count: int = Field(
        default=4, ge=0, le=6, description="Shadows of each player: 1 in the sun, 4 under floodlights."
    )
    shadow_strength: float = Field(default=0.2, ge=0, le=0.9, description="How dark each shadow is.")
    shadow_length: float = Field(
        default=1.1, ge=0, le=6, description="Length of a shadow as a share of the body height."
    )
    shadow_rad: float = Field(default=0.6, description="Direction of the first shadow on the field.")
    defocus_px: float = Field(
        default=0.5, ge=0, le=12, description="Standard deviation of the blur beyond the pixel's own."
    )
    motion_px: float = Field(default=0.0, ge=0, le=500, description="Length of the motion blur.")
    motion_rad: float = Field(default=0.0, description="Direction of the motion blur in the picture.")
    sharpening: float = Field(default=0.0, ge=0, le=2, description="Strength of the camera's edge enhancement.")
    noise: float = Field(default=1.2, ge=0, le=40, description="Standard deviation of the noise, grey levels.")
    jpeg_quality: int = Field(default=90, ge=10, le=100, description="Quality of the JPEG that is written.")
    scorebug: bool = Field(default=False, description="Score and time in an upper corner.")
    graphics: Graphics = Field(default=Graphics(), description="What else is laid over the picture.")

    def clean(self) -> RenderConfig:
        """The scene without anything random on the picture: fresh paint, even turf and light, no blur, no noise."""
        return self.model_copy(
            update={
                "wear": 0.0,
                "stripe_contrast": 0.0,
                "texture": 0.0,
                "patchiness": 0.0,
                "shade": 0.0,
                "vignette": 0.0,
                "haze": 0.0,
                "defocus_px": 0.0,
                "motion_px": 0.0,
                "sharpening": 0.0,
                "noise": 0.0,
                "jpeg_quality": 100,
                "scorebug": False,
                "graphics": Graphics(),
                "line_gaps": 0.0,
                "exposure": 1.0,
                "cast_bgr": (1.0, 1.0, 1.0),
                "light_pools": 0.0,
                "veil": 0.0,
                "precipitation": 0.0,
            }
        )


class Delivery(BaseModel):
    """What happens to the picture between camera and file."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    interlace_px: float = Field(
        default=0.0, ge=-60, le=60, description="How far the camera pans between the two fields; 0: progressive."
    )
    size: tuple[int, int] | None = Field(
        default=None, description="Size to which the finished picture is brought; null: as rendered."
    )
    bars_px: tuple[int, int, int, int] = Field(
        default=(0, 0, 0, 0), description="Bars at the left, top, right and bottom, pixels."
    )
    bar_bgr: Color = Field(default=(0, 0, 0), description="Colour of the bars.")
    blurred_bars: bool = Field(default=False, description="The picture itself out of focus instead of plain bars.")
    chroma_step: int = Field(default=1, ge=1, le=16, description="Columns that share one sample of colour.")
    block_quality: int | None = Field(
        default=None, ge=5, le=100, description="JPEG quality of the compression before the file's; null: none."
    )


@dataclass(frozen=True, slots=True)
class Player:
    """Someone standing or running on the field.

    Attributes
    ----------
    position_m : (2,) array
        Where the feet are.
    height_m : float
        Body height.
    team : int
        0 or 1; 2 for the referee.
    pose : (4,) array
        Swing of the legs and of both arms in radians, and the lean of the body.
    width : float
        How much of the shoulders is seen, 0.6 (from the side) to 1.
    look_seed : int or None
        Seed of skin, hair and boots, of someone who is seen in several frames.
    """

    position_m: Array
    height_m: float
    team: int
    pose: Array
    width: float
    look_seed: int | None = None


@dataclass(frozen=True, slots=True)
class ExtraPaint:
    """Paint of one colour and width that is no marking of the field."""

    elements: tuple[Circle | Line | Mark, ...]
    width_m: float
    bgr: Color
    opacity: float = 0.85


@dataclass(frozen=True, slots=True)
class Scene:
    """A frame to be rendered: the view, the ground, what stands on it and how it looks.

    Attributes
    ----------
    kind : str
        What is shown, in one word, e.g. ``"crowd"``; empty where the profile says all.
    extras : tuple of ExtraPaint
        Paint that belongs to other sports or to none, under the field's own.
    decals : tuple of Decal
        Pictures on the ground, under all paint.
    widths_m : dict
        Markings that are not as wide as the others, metres.
    painted : FieldTemplate or None
        The field's own markings where painters put them; None where they lie as the template has them.
    field_painted : bool
        Whether the field's own markings are there at all.
    alteration : str
        What is done to the finished picture so that no camera can have taken it; empty for nothing.
    """

    camera: Camera
    template: FieldTemplate
    surface: Surface
    config: RenderConfig
    players: tuple[Player, ...] = ()
    ball_m: Array | None = None
    center_mark_painted: bool = True
    delivery: Delivery = field(default_factory=Delivery)
    kind: str = ""
    extras: tuple[ExtraPaint, ...] = ()
    decals: tuple[Decal, ...] = ()
    widths_m: dict[str, float] = field(default_factory=dict)
    painted: FieldTemplate | None = None
    field_painted: bool = True
    alteration: Alteration = ""


def sample_player(position_m: Array, team: int, rng: np.random.Generator) -> Player:
    """A player of random build and pose at a field position (2,)."""
    stride = rng.normal(0.0, 0.35)
    pose = np.array(
        [stride, -0.8 * stride + rng.normal(0, 0.3), 0.8 * stride + rng.normal(0, 0.3), rng.normal(0, 0.08)]
    )
    return Player(
        np.asarray(position_m, dtype=np.float64),
        float(rng.uniform(1.72, 1.95)),
        team,
        pose,
        float(rng.uniform(0.65, 1.0)),
    )
