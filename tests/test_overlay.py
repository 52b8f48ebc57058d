"""Pictures of calibrations: in the right places, for every state that a calibration can be in, at every size."""

from dataclasses import fields, replace

import numpy as np
import pytest

from circlecal import overlay
from circlecal.field import load_field
from circlecal.field.view import FieldView
from circlecal.geometry.camera import Camera, PlaneCamera, image_center
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS, ProjectionModel, theta_of
from circlecal.geometry.conics import circle_conic, polar, transform_conic
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.homography import turn_homography
from circlecal.geometry.projective import apply_homography, lift, normalise_line, transform_lines
from circlecal.geometry.surface import Surface
from circlecal.observations import CirclePoints, LinePoints, MarkingKey, MarkPoint, Observations
from circlecal.overlay.canvas import Canvas, clip_segments, text_size, wrap
from circlecal.overlay.frame_overlay import legend_of
from circlecal.overlay.palette import CIRCLE, TEMPLATE
from circlecal.overlay.quality import SCALE, rate_sigma
from circlecal.overlay.radar import radar_half
from circlecal.overlay.template_lines import (
    count_sigma_from_seen,
    draw_template,
    marking_sigmas,
    sigma_over_picture,
)
from circlecal.results import (
    Attempt,
    CameraFit,
    Check,
    CircleCandidate,
    Correspondences,
    Cues,
    EdgePoints,
    EllipseFit,
    EllipseFits,
    FrameCalibration,
    HomographyFit,
    LineCorrespondence,
    LineCue,
    MarkCue,
    MarkingMask,
    PointCorrespondence,
    RayPoints,
    Segment,
    Verdict,
)

SOCCER = load_field("soccer")
NAMES = [
    "01-mask",
    "02-edges",
    "03-rays",
    "04-ellipse",
    "05-cues",
    "06-correspondences",
    "07-homography",
    "08-camera",
    "09-verdict",
]
STAGES = ("mask", "edges", "rays", "ellipses", "cues", "correspondences", "homography", "camera", "observations")
CALIBRATED = Verdict("calibrated", None, None, None, (Check("circle_residual_px", 0.4, 2.0, True),))
REFUSED = Verdict(
    "refused", "too_uncertain", "the field is uncertain by 50 px", "verdict", (Check("sigma_px", 50.0, 20.0, False),)
)


def _camera(width=1280, height=720):
    angles = np.array([np.arctan2(-8.0, 55.0), np.arctan2(np.hypot(8.0, 55.0), 16.0), 0.02])
    return Camera(
        width,
        height,
        np.full(2, 1.7 * width),
        image_center(width, height),
        angles,
        np.array([8.0, 55.0, -16.0]),
        np.array([0.02, 0.0]),
    )


def _image(camera):
    rng = np.random.default_rng(0)
    noise = rng.integers(-6, 7, (camera.height, camera.width, 1))
    return np.clip(np.array([60, 120, 70]) + noise, 0, 255).astype(np.uint8)


def _fit(edge, H, rng):
    conic = transform_conic(H, circle_conic((0, 0), {"outer": 9.15, "center": 9.09, "inner": 9.03}[edge]))
    ellipse = ellipse_from_conic(conic)
    t = np.linspace(-3.0, 3.0, 200)
    points = ellipse.points(t) + rng.normal(0, 0.3, (200, 1)) * ellipse.normals(t)
    inliers = np.arange(200) % 17 > 0
    points[~inliers] += 9.0
    return EllipseFit(edge, conic, np.eye(6), ellipse, "direct", points, np.full(200, 0.3), inliers, 0.31, 340.0, 1000)


def _line_cue(name, start, end):
    points = start + np.linspace(0, 1, 60)[:, None] * (end - start)
    line = normalise_line(np.cross(lift(start), lift(end)))
    return LineCue(name, line, points, np.full(60, 0.2), Segment(start, end, 0.8), 0.2)


def _correspondences(H):
    conic = transform_conic(H, circle_conic((0, 0), 9.09))
    directions = {"right": 0, "bottom_right": 45, "bottom": 90, "bottom_left": 135}
    directions |= {"left": 180, "top_left": 225, "top": 270, "top_right": 315}
    points, tangents = [], []
    for label, degrees in directions.items():
        outward = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
        seen = apply_homography(H, 9.09 * outward)
        points.append(PointCorrespondence(label, 9.09 * outward, seen, 0.3))
        tangents.append(LineCorrespondence(label, np.append(outward, -9.09), normalise_line(polar(conic, lift(seen)))))
    center = lift(apply_homography(H, np.zeros(2)))
    vanishing = normalise_line(transform_lines(H, np.array([0.0, 0.0, 1.0])))
    return Correspondences(1, conic, 9.09, center, "centre_mark", vanishing, tuple(points), tuple(tangents))


def _calibration(camera=None, verdict=CALIBRATED):
    """Everything that a calibration can hold, made from a camera."""
    camera = camera or _camera()
    rng = np.random.default_rng(1)
    size, H = (camera.height, camera.width), camera.homography
    fits = EllipseFits(*(_fit(edge, H, rng) for edge in ("outer", "inner", "center")))
    outer, inner, center = (f.points_px for f in (fits.outer, fits.inner, fits.center))
    top, bottom, left = (apply_homography(H, np.array(p)) for p in ((0.0, -12.0), (0.0, 12.0), (-20.0, -34.0)))
    halfway = _line_cue("halfway_line", top, bottom)
    unnamed = _line_cue(None, left, apply_homography(H, np.array([20.0, -34.0])))
    classes = np.zeros(size, np.uint8)
    classes[size[0] // 2 : size[0] // 2 + 4] = np.arange(size[1]) % 20
    region = np.zeros(size, bool)
    region[size[0] // 4 :] = True
    sigma = np.linspace(0.1, 0.4, 200)
    mark = MarkCue("centre_mark", apply_homography(H, np.zeros(2)), 0.5, 12.0)
    theta = theta_of(camera, ProjectionModel(camera.width, camera.height, Surface("roof")))
    theta[-1] = 2.0  # the field is 2 m broader than its template
    everywhere = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    everywhere[:7, :7] = np.diag([1e-4, 1e-6, 1e-6, 1e-6, 0.01, 0.01, 0.01])
    fit = CameraFit(
        camera=camera,
        surface=Surface("roof", crown_m=0.05),
        parameters=PARAMETERS,
        covariance=everywhere,
        H_covariance=np.eye(8) * 1e-9,
        imaged_center_px=apply_homography(H, np.zeros(2)),
        imaged_center_covariance=np.eye(2),
        noise_scale=1.2,
        data_share=0.8,
        max_sigma_px=3.2,
        max_sigma_m=0.2,
        residuals_px={MarkingKey("centre_circle", "center"): 0.4, MarkingKey("halfway_line"): 0.2},
        theta=theta,
        rejected=(MarkingKey("centre_mark"),),
        named_lines=("side_line_top",),
    )
    plane = HomographyFit(H, turn_homography(H, np.zeros(2)), np.array([0.1, 0.2]), 300.0, 1e-9)
    seen = Observations(
        camera.width,
        camera.height,
        (CirclePoints("centre_circle", "center", center, sigma),),
        (LinePoints("halfway_line", halfway.points_px, halfway.sigma_px), LinePoints(None, unnamed.points_px, sigma)),
        (MarkPoint("centre_mark", mark.point_px, 0.5),),
    )
    return FrameCalibration(
        id="frame",
        width=camera.width,
        height=camera.height,
        field_name="soccer",
        circle_name="centre_circle",
        attempt=Attempt(
            mask=MarkingMask(
                classes,
                "detector",
                fits.center.conic,
                Segment(top, bottom, 0.9),
                (unnamed.segment,),
                region,
                tuple(
                    CircleCandidate(conic, 0.4, (Check("painted_share", 0.31, 0.74, False),))
                    for conic in (fits.outer.conic, np.diag([1.0, -1.0, 1.0]), np.full((3, 3), np.nan))
                ),
            ),
            edges=EdgePoints(outer, fits.outer.ellipse.normals(sigma), 100 * sigma, sigma, 2.0, 1.1, (20.0, 50.0)),
            rays=RayPoints(mark.point_px, outer, sigma, inner, sigma, center, sigma, 720, 30, outer[::7] + 15),
            ellipses=fits,
            cues=Cues(halfway, mark, (unnamed,)),
            correspondences=_correspondences(H),
            homography=plane,
            camera=fit,
            observations=seen,
            verdict=verdict,
        ),
        seed=0,
        config_digest="0",
        timings_ms={"mask": 12.0, "camera": 80.0},
    )


def _with(calibration, **changes):
    """The calibration with other results of stages."""
    return replace(calibration, attempt=replace(calibration.attempt, **changes))


def _check(picture):
    assert picture.dtype == np.uint8
    assert picture.ndim == 3
    assert picture.shape[2] == 3
    assert picture.flags["C_CONTIGUOUS"]


def _draw_all(image, calibration, template=SOCCER):
    drawn = overlay.draw_overlay(image, calibration, template)
    assert drawn.shape == image.shape
    radar = overlay.draw_radar(image, calibration, template, px_per_m=3.0)
    pictures = overlay.stage_pictures(image, calibration, template)
    assert list(pictures) == [name for name in NAMES if name in pictures]
    assert "09-verdict" in pictures
    for picture in [drawn, *pictures.values(), *([radar] if radar is not None else [])]:
        _check(picture)
    return drawn, radar, pictures


@pytest.fixture(scope="module")
def complete():
    calibration = _calibration()
    return _image(_camera()), calibration


def test_pictures_leave_the_frame_alone_and_show_something(complete):
    image, calibration = complete
    before = image.copy()
    drawn, radar, pictures = _draw_all(image, calibration)
    np.testing.assert_array_equal(image, before)
    assert (drawn != image).any(axis=2).mean() > 0.005
    assert radar is not None
    _check(overlay.contact_sheet(pictures, "frame: calibrated"))


@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("verdict", [CALIBRATED, REFUSED])
def test_any_part_may_be_missing(complete, stage, verdict):
    image, calibration = complete
    drawn, radar, _ = _draw_all(image, _with(calibration, verdict=verdict, **{stage: None}))
    assert (radar is None) == (verdict is REFUSED)
    assert (drawn != image).any()


@pytest.mark.parametrize("reached", range(len(STAGES) + 1))
def test_a_frame_may_be_refused_anywhere(complete, reached):
    image, calibration = complete
    verdict = Verdict("refused", "no_circle", "no circle was found", STAGES[min(reached, len(STAGES) - 1)])
    missing = dict.fromkeys(STAGES[reached:])
    _, radar, pictures = _draw_all(image, _with(calibration, verdict=verdict, **missing))
    assert radar is None
    assert len(pictures) == min(reached, 8) + 1, "a stage that was not reached has no picture"


def test_parts_within_the_parts_may_be_missing(complete):
    image, c = complete
    empty, none = np.zeros((0, 2)), np.zeros(0)
    variants = [
        _with(c, mask=MarkingMask(c.attempt.mask.classes, "file")),
        _with(c, mask=replace(c.attempt.mask, conic=None), ellipses=None, camera=None, homography=None, cues=None),
        _with(c, edges=EdgePoints(empty, empty, none, none, 0.0, 0.0, (0.0, 0.0))),
        _with(c, rays=RayPoints(np.zeros(2), empty, none, empty, none, empty, none, 0, 0, empty)),
        _with(c, ellipses=EllipseFits(None, None, None)),
        _with(c, ellipses=EllipseFits(replace(c.attempt.ellipses.outer, inliers=np.zeros(200, bool)), None, None)),
        _with(c, cues=Cues(None, None, ())),
        _with(c, cues=Cues(None, replace(c.attempt.cues.mark, point_px=np.array([3.0, 3.0])))),
        _with(c, correspondences=replace(c.attempt.correspondences, points=(), tangents=())),
        _with(c, correspondences=replace(c.attempt.correspondences, vanishing_line=np.array([0.0, 0.0, 1.0]))),
        _with(
            c,
            homography=replace(
                c.attempt.homography, residuals_px=none, H_image_field=-c.attempt.homography.H_image_field
            ),
        ),
        _with(
            c,
            camera=replace(
                c.attempt.camera, covariance=np.eye(3), theta=np.zeros(3), parameters=("?",), residuals_px={}
            ),
        ),
        _with(
            c, camera=replace(c.attempt.camera, max_sigma_px=np.inf, max_sigma_m=np.nan, rejected=(), named_lines=())
        ),
        replace(_with(c, verdict=Verdict("refused", None, None, None)), timings_ms={}),
        replace(c, circle_name="penalty_arc_left"),
        _with(
            c, edges=replace(c.attempt.edges, sigma_px=np.where(np.arange(200) % 3, np.nan, c.attempt.edges.sigma_px))
        ),
        _with(c, rays=replace(c.attempt.rays, center_px=np.full(2, np.nan)), ellipses=None),
        _with(c, homography=replace(c.attempt.homography, H_image_field=np.full((3, 3), np.nan)), camera=None),
        _with(
            c, camera=replace(c.attempt.camera, camera=replace(c.attempt.camera.camera, position_m=np.full(3, np.nan)))
        ),
        _with(c, correspondences=replace(c.attempt.correspondences, imaged_center=np.array([1.0, 1.0, 0.0]))),
        replace(_with(c, verdict=replace(REFUSED, reason="größer als erlaubt " * 20)), id="Fußball ⚽ 12"),
    ]
    for variant in variants:
        _draw_all(image, variant)


def test_every_optional_field_of_a_calibration_is_tried():
    words = {"verdict", "circle_name", "no_correspondences"}
    assert {f.name for f in fields(Attempt) if f.default is None} - words == set(STAGES)


def test_words_for_sigma_follow_the_width():
    assert [rate_sigma(sigma, 1920) for sigma in (1.9, 2.0, 7.6, 15.0)] == ["excellent", "good", "usable", "poor"]
    assert rate_sigma(1.0, 640) == "good"  # 3 px at 1920
    assert [rate_sigma(sigma, 640) for sigma in (None, float("nan"), float("inf"))] == ["unknown"] * 3
    for limit, word in (("2", "excellent"), ("5", "good"), ("15", "usable")):
        assert f"{word} below {limit} px" in SCALE


def test_the_legend_names_what_is_drawn_and_nothing_else(complete):
    _, calibration = complete
    full = [words for words, _ in legend_of(calibration, SOCCER)]
    assert full == ["circle", "other markings", "points that were used", "derived points (labelled)", "tangents"]
    without = _with(calibration, correspondences=None)
    assert [words for words, _ in legend_of(without, SOCCER)] == full[:3]
    refused = legend_of(_with(calibration, verdict=REFUSED), SOCCER)
    assert refused[0][0] == "estimate that was refused (dashed)"
    nothing = replace(calibration, attempt=Attempt(verdict=REFUSED))
    assert legend_of(nothing, SOCCER) == []
    turned = replace(_camera(), angles_rad=_camera().angles_rad + np.array([0.75, 0.0, 0.0]))
    goal = _with(calibration, camera=replace(calibration.attempt.camera, camera=turned))
    assert legend_of(goal, SOCCER)[0][0] == "markings"


def test_debug_pictures_explain_no_colour_that_they_do_not_show(complete, monkeypatch):
    image, calibration = complete
    told = {}

    def header(canvas, title, facts=(), legend=()):
        told[title] = dict(legend)
        return canvas.picture

    monkeypatch.setattr(Canvas, "header", header)
    attempt = calibration.attempt
    overlay.stage_pictures(image, calibration, SOCCER)
    assert {"circle", "other classes", "rough circle", "candidates (dashed)"} <= told["1 mask"].keys()
    assert {"centre mark", "halfway line"} <= told["5 cues"].keys()
    assert "lines seen without a name" in told["8 camera"]
    bare = replace(attempt.mask, drawn=0 * attempt.mask.classes, conic=None, halfway=None, candidates=())
    recognised = replace(attempt.camera, names_by_line={1: "side_line_top"})
    overlay.stage_pictures(
        image, _with(calibration, mask=bare, cues=replace(attempt.cues, mark=None), camera=recognised), SOCCER
    )
    assert told["1 mask"].keys() == {"other lines"}
    assert told["5 cues"].keys() == {"halfway line", "further lines"}
    assert "lines seen without a name" not in told["8 camera"]


def test_sigma_that_counts_from_what_was_seen_leaves_the_length_of_the_field_out(complete):
    view = complete[1].view
    x, length = INDEX["x"], INDEX["length"]
    covariance = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    covariance[np.ix_([x, length], [x, length])] = [[1.0, 2.0], [2.0, 4.0]]  # the camera moves as half the length does
    unsure = replace(view, covariance=covariance)
    from_seen = count_sigma_from_seen(unsure, (0.5, 0.0))
    assert np.nanmin(sigma_over_picture(unsure, SOCCER)) > 5.0
    assert np.nanmax(sigma_over_picture(from_seen, SOCCER)) < 1e-6
    assert sigma_over_picture(count_sigma_from_seen(replace(view, covariance=None), (0.5, 0.0)), SOCCER) is None


def test_the_grid_of_sigmas_lies_on_the_middles_of_its_cells():
    # an uncertain focal length moves what is seen away from the middle of the picture, as far as it is away
    camera = replace(_camera(960, 540), principal_point_px=image_center(960, 540), kappa=np.zeros(2))
    covariance = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    covariance[INDEX["log_focal"], INDEX["log_focal"]] = 0.01**2
    grid = sigma_over_picture(FieldView(camera, covariance=covariance), SOCCER)
    x, y = np.meshgrid(np.arange(4.5, 960, 10), np.arange(4.5, 540, 10))
    away = 0.01 * np.hypot(x - 479.5, y - 269.5)
    known = np.isfinite(grid)
    assert known.sum() > 500
    np.testing.assert_allclose(grid[known], away[known], rtol=1e-6)


@pytest.mark.parametrize("size", [(398, 224), (640, 360), (2560, 1440), (360, 640), (900, 200), (64, 48), (1, 1)])
def test_every_size_of_picture(size):
    camera = _camera(*size)
    calibration = _calibration(camera)
    drawn, _, pictures = _draw_all(_image(camera), calibration)
    assert drawn.shape == (size[1], size[0], 3)
    if min(size) >= 200:
        readable = overlay.draw_readable_overlay(_image(camera), calibration, SOCCER)
        zoom = max(1, -(-1280 // size[0]))
        assert readable.shape[1] == zoom * size[0] >= 1280
        strip = readable[zoom * size[1] :]
        for _, colour in legend_of(calibration, SOCCER):  # the strip below explains every colour
            assert (strip == colour).all(axis=2).sum() > 50
        assert all(picture.shape[1] >= 640 for picture in pictures.values())
        assert all(picture.shape[0] < 2.5 * picture.shape[1] for picture in pictures.values())


@pytest.mark.parametrize("name", ["futsal", "ice-hockey", "basketball", "robocup"])
def test_every_field(complete, name):
    image, calibration = complete
    _draw_all(image, replace(calibration, field_name=name), load_field(name))


def test_a_camera_beside_a_goal_sees_part_of_the_field_behind_it():
    camera = replace(_camera(), angles_rad=np.array([np.pi / 2, 1.4, 0.0]), position_m=np.array([-30.0, 5.0, -4.0]))
    calibration = _with(_calibration(), camera=replace(_calibration().attempt.camera, camera=camera))
    _draw_all(_image(camera), calibration)
    pixels = calibration.view.project([[-50.0, 0.0], [20.0, 0.0]])
    assert np.isnan(pixels[0]).all()
    assert np.isfinite(pixels[1]).all()


def test_a_picture_of_another_size_is_refused(complete):
    image, calibration = complete
    for wrong in (image[:-1], image[..., 0], image.astype(np.float64)):
        with pytest.raises(ValueError, match="expected a uint8 picture"):
            overlay.draw_overlay(wrong, calibration, SOCCER)
        with pytest.raises(ValueError, match="expected a uint8 picture"):
            overlay.stage_pictures(wrong, calibration, SOCCER)
        with pytest.raises(ValueError, match="expected a uint8 picture"):
            overlay.draw_radar(wrong, calibration, SOCCER)
    with pytest.raises(ValueError, match="px_per_m"):
        overlay.draw_radar(image, calibration, SOCCER, px_per_m=0.0)


def _color_at(picture, points, color, tolerance=70):
    x, y = np.round(points).astype(int).T
    return (np.abs(picture[y, x].astype(int) - color).max(axis=1) < tolerance).mean()


def test_template_is_drawn_where_the_camera_projects_it(complete):
    image, calibration = complete
    bare = _with(calibration, ellipses=None, correspondences=None, cues=None)
    drawn = overlay.draw_overlay(image, bare, SOCCER)
    t = np.linspace(0, 2 * np.pi, 100)
    circle = 9.09 * np.stack([np.cos(t), np.sin(t)], axis=-1)
    depth = 0.05 * np.abs(circle[:, 1]) / 9.15
    pixels = calibration.attempt.camera.camera.project(np.column_stack([circle, depth]))
    assert _color_at(drawn, pixels, CIRCLE) > 0.9
    halfway = np.column_stack([np.zeros(40), np.linspace(-8.5, -4.5, 40)])
    seen = calibration.attempt.camera.camera.project(np.column_stack([halfway, 0.05 * np.abs(halfway[:, 1]) / 9.15]))
    assert _color_at(drawn, seen, TEMPLATE) > 0.9
    assert _color_at(drawn, pixels + np.array([0, 6]), CIRCLE) < 0.1


def test_fitted_breadth_moves_the_touchline_and_not_the_penalty_area(complete):
    _, calibration = complete
    grown = calibration.view.markings(SOCCER)
    plain = FieldView(PlaneCamera(1280, 720, calibration.attempt.camera.H_image_field)).markings(SOCCER)
    moved = {name: float(np.abs(grown[name] - plain[name]).max()) for name in plain}
    assert moved["side_line_top"] == pytest.approx(1.0, abs=0.01)
    assert moved["halfway_line"] == pytest.approx(1.0, abs=0.01)
    assert moved["big_rect_left_top"] == moved["centre_circle"] == moved["penalty_mark_left"] == 0.0


def test_view_falls_back_to_the_closed_form(complete):
    _, calibration = complete
    assert _with(calibration, camera=None, homography=None).view is None
    view = _with(calibration, camera=None).view
    H = calibration.attempt.homography.H_image_field
    points = np.array([[0.0, 0.0], [5.0, 3.0], [0.0, 80.0]])
    pixels = view.project(points)
    np.testing.assert_allclose(pixels[:2], apply_homography(H, points[:2]))
    assert np.isnan(pixels[2]).all()  # behind the camera
    np.testing.assert_allclose(PlaneCamera(1280, 720, -3.0 * H).project(points)[:2], pixels[:2])


def test_radar_shows_the_field_from_above(monkeypatch):
    camera = _camera()
    calibration = _calibration(camera)
    image = _image(camera)
    red = np.round(camera.project([[6.0, 4.0, 0.05 * 4.0 / 9.15]])[0]).astype(int)
    image[red[1] - 6 : red[1] + 7, red[0] - 6 : red[0] + 7] = (0, 0, 255)
    radar = overlay.draw_radar(image, calibration, SOCCER, px_per_m=10.0)
    assert radar.shape == (740, 1110, 3)
    found = np.argwhere((radar.astype(int) - (0, 0, 255) == 0).all(axis=2)).mean(axis=0)
    np.testing.assert_allclose(found, (370 + 40, 555 + 60), atol=2.0)
    monkeypatch.setattr("circlecal.overlay.radar._LARGEST_PX", 600)
    assert overlay.draw_radar(image, calibration, SOCCER, px_per_m=1e9).shape == (400, 600, 3)


def test_the_view_from_above_has_room_for_a_longer_pitch():
    view = FieldView(_camera())
    usual = radar_half(SOCCER)
    for growth_m, more_m in (((2.0, 2.0), (0.0, 0.0)), ((13.0, -4.0), (4.5, 0.0))):
        np.testing.assert_allclose(radar_half(SOCCER, replace(view, growth_m=np.array(growth_m))), usual + more_m)


def test_verdict_is_told_apart_without_colours(complete):
    image, calibration = complete
    accepted = overlay.draw_overlay(image, calibration, SOCCER)
    refused = overlay.draw_overlay(image, _with(calibration, verdict=REFUSED), SOCCER)
    assert (accepted[:40, :200].max(axis=2) > 240).any()
    assert not np.array_equal(accepted[:40, :200], refused[:40, :200])


def test_contact_sheet_of_any_number_of_pictures():
    rng = np.random.default_rng(2)
    for count in (0, 1, 2, 4, 9):
        pictures = {f"{k:02d}": rng.integers(0, 255, (90 + 50 * k, 160, 3), dtype=np.uint8) for k in range(count)}
        sheet = overlay.contact_sheet(pictures, "a title that is long enough to be broken into several lines " * 4)
        _check(sheet)
        assert sheet.shape[1] == 3 * 800 + 4 * 12


def test_segments_are_clipped_to_the_box():
    starts = np.array([[-5.0, 5.0], [2.0, 2.0], [-5.0, -5.0], [np.nan, 0.0], [5.0, -5.0], [3.0, 3.0], [-2.0, 5.0]])
    ends = np.array([[15.0, 5.0], [4.0, 8.0], [-1.0, -9.0], [1.0, 1.0], [5.0, 15.0], [3.0, 3.0], [-2.0, 9.0]])
    clipped = clip_segments(starts, ends, np.zeros(2), np.full(2, 10.0))
    expected = [[[0, 5], [10, 5]], [[2, 2], [4, 8]], [[5, 0], [5, 10]], [[3, 3], [3, 3]]]
    np.testing.assert_allclose(clipped, expected)
    far = clip_segments(np.array([[-1e12, -1e12]]), np.array([[1e12, 1e12]]), np.zeros(2), np.full(2, 10.0))
    np.testing.assert_allclose(far, [[[0, 0], [10, 10]]], atol=1e-2)


def test_drawing_is_sub_pixel():
    canvas = Canvas(np.zeros((20, 40, 3), np.uint8))
    canvas.polyline([[-10.0, 7.5], [60.0, 7.5]], (255, 255, 255), 1.0)
    assert abs(int(canvas.picture[7, 20, 0]) - int(canvas.picture[8, 20, 0])) < 40
    assert canvas.picture[7, 20, 0] > 60
    enlarged = Canvas.of(np.zeros((20, 40, 3), np.uint8), zoom=4)
    np.testing.assert_allclose(enlarged.place([0.0, 0.0]), (1.5, 1.5))


def test_labels_keep_apart_and_inside():
    canvas = Canvas(np.zeros((300, 400, 3), np.uint8))
    for k in range(12):
        canvas.label(f"label {k}", (200.0 + k, 150.0), (255, 255, 255))
    canvas.label("outside", (900.0, 150.0), (255, 255, 255))
    canvas.label("nowhere", (np.nan, 150.0), (255, 255, 255))
    boxes = np.array(canvas.taken)
    assert 6 <= len(boxes) <= 12
    for k, box in enumerate(boxes):
        others = np.delete(boxes, k, axis=0)
        apart = (
            (box[0] >= others[:, 2]) | (box[2] <= others[:, 0]) | (box[1] >= others[:, 3]) | (box[3] <= others[:, 1])
        )
        assert apart.all()
    assert (boxes[:, :2] >= 0).all()
    assert (boxes[:, 2:] <= (400, 300)).all()


def test_text_is_wrapped_to_the_width():
    lines = wrap("the field around the circle is uncertain by more than is allowed", 12.0, 150.0)
    assert len(lines) > 2
    assert all(text_size(line, 12.0)[0] <= 150 for line in lines)
    assert wrap("", 12.0, 100.0) == [""]
    assert wrap("größe\nzwei", 12.0, 900.0) == ["gr??e zwei"]


def test_a_marking_that_nothing_tells_is_dashed():
    """A touchline of a pitch whose width is open; what lies in the middle of the pitch is certain."""
    covariance = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    covariance[INDEX["breadth"], INDEX["breadth"]] = 10.0**2
    view = FieldView(_camera(), covariance=covariance)
    far = SOCCER.width_m / 2.0
    here, there = (replace(view, growth_m=np.array([0.0, g])).markings(SOCCER)["side_line_top"] for g in (0.0, 0.01))
    moved = np.hypot(*(view.project(there) - view.project(here)).T)[view.shows(view.project(here))]
    sigmas = marking_sigmas(view, SOCCER)
    assert sigmas["side_line_top"] == pytest.approx(10.0 * moved.max() / 0.01, rel=0.02)
    assert sigmas["centre_circle"] < 1e-6
    drawn = {}
    for most_px in (np.inf, 32.0, 1e4):
        canvas = Canvas.of(np.zeros((720, 1280, 3), np.uint8))
        draw_template(canvas, view, SOCCER, "centre_circle", most_sigma_px=most_px)
        drawn[most_px] = canvas.picture
    assert np.array_equal(drawn[np.inf], drawn[1e4])
    changed = view.to_field(np.argwhere((drawn[np.inf] != drawn[32.0]).any(axis=-1))[:, ::-1].astype(float))
    assert len(changed) > 100 and (np.abs(np.abs(changed[:, 1]) - far) < 1.0).all()
    assert marking_sigmas(FieldView(_camera()), SOCCER) == {}
