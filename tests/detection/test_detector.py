import itertools

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from circlecal.detection import Detection, DetectorConfig, candidates, circle, detect, one_pass
from circlecal.detection.arcs import GAPLESS_SHARE
from circlecal.detection.field_region import find_field_region
from circlecal.detection.one_pass import FLAT_WIDTH_PX, FLATTEST, PictureSearch, first_pass, flat_pass, second_pass
from circlecal.detection.picture import Picture
from circlecal.geometry.conics import sampson_distance
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.projective import Array, lift
from circlecal.refusals import Confidence
from circlecal.results import Interpretation

from .conftest import GRASS, HALFWAY_AND_CIRCLE, PENALTY_AREA, RADIUS_M, Scene, level, paint_scene, ring

CONFIG = DetectorConfig()


def run(image: np.ndarray, config: DetectorConfig = CONFIG, seed: int = 7) -> Detection:
    return detect(image, config, np.random.default_rng(seed))


def points_of_first_pass(image: np.ndarray, config: DetectorConfig) -> Array:
    """Ridge points (N, 2) of the first pass, px of the full picture."""
    region = find_field_region(image, config.field_region)
    picture = Picture(image, np.ascontiguousarray(image[:, :, 1]))
    found = PictureSearch(picture).run_pass(region, config, first_pass(config, 1.0), np.random.default_rng(7))
    return found.scaling.full(found.ridges.points)


def circle_error(found: Detection, scene: Scene) -> float:
    """Mean distance of the true circle's visible points from the conic, px."""
    assert found.circle is not None, found.refusal
    return float(np.abs(sampson_distance(found.circle.conic, scene.circle_points())).mean())


def halfway_error(found: Detection, scene: Scene) -> float:
    """Mean distance of the ends of the found line from the true halfway line, px."""
    assert found.halfway is not None
    truth = scene.camera.project(np.array([[0.0, -9.0], [0.0, 9.0]]))
    line = np.cross(*lift(truth))
    line /= np.hypot(line[0], line[1])
    return float(np.abs(lift(np.stack([found.halfway.start, found.halfway.end])) @ line).mean())


def test_circle_and_halfway_line(main_view: Scene) -> None:
    found = run(main_view.image)
    assert found.refusal is None
    assert circle_error(found, main_view) < 0.2
    assert halfway_error(found, main_view) < 0.3
    assert found.circle is not None
    assert found.circle.whole_share > 0.9
    assert np.abs(sampson_distance(main_view.conic, found.circle.points)).mean() < 0.3


def test_same_generator_same_answer(main_view: Scene) -> None:
    first, second = run(main_view.image), run(main_view.image)
    assert first.circle is not None
    assert second.circle is not None
    np.testing.assert_array_equal(first.circle.conic, second.circle.conic)
    np.testing.assert_array_equal(first.sketch.draw(), second.sketch.draw())


@pytest.mark.parametrize("width", [398, 1280, 2500])
def test_reduced_and_enlarged_search_have_no_half_pixel_shift(width: int) -> None:
    scene = paint_scene(width=width, height=round(width * 9 / 16), focal_px=1600.0, noise=1.0)
    found = run(scene.image)
    assert circle_error(found, scene) < 0.25
    offset = sampson_distance(found.circle.conic, scene.circle_points()) if found.circle else np.ones(1)
    assert abs(offset.mean()) < 0.15


def test_ridge_points_of_a_reduced_picture_are_in_pixels_of_the_full_one() -> None:
    scene = paint_scene(width=1920, height=1080, noise=1.0)
    points = points_of_first_pass(scene.image, CONFIG)
    distance = sampson_distance(scene.conic, points)
    near = np.abs(distance) < 3.0
    assert np.count_nonzero(near) > 500
    upper = points[:, 1] < np.median(points[near, 1])
    for side in (near & upper, near & ~upper):  # a shift of half a pixel has opposite signs on both sides
        assert abs(np.median(distance[side])) < 0.2


@pytest.mark.parametrize("pan_deg", [9.5, -11.0])
def test_partly_visible_circle(pan_deg: float) -> None:
    scene = paint_scene(pan_deg=pan_deg, focal_px=2400.0)
    visible = len(scene.circle_points(360)) / 360
    assert 0.45 < visible < 0.85
    found = run(scene.image)
    assert circle_error(found, scene) < 0.4
    assert found.circle is not None
    assert abs(found.circle.whole_share - visible) < 0.12
    assert halfway_error(found, scene) < 0.5


def test_circle_without_a_halfway_line_is_accepted_without_one() -> None:
    scene = paint_scene(markings=HALFWAY_AND_CIRCLE[:1])
    found = run(scene.image)
    assert circle_error(found, scene) < 0.2
    assert found.halfway is None


def test_of_several_circles_the_one_with_a_line_through_its_middle_is_taken() -> None:
    def worn(x: Array, y: Array) -> tuple[Array, NDArray[np.bool_]]:
        return np.hypot(x, y) - RADIUS_M, np.cos(9 * np.arctan2(y, x)) < 0.8

    scene = paint_scene(markings=(worn, HALFWAY_AND_CIRCLE[1], ring(16.0, 6.0)), focal_px=1600.0)
    found = run(scene.image)
    assert circle_error(found, scene) < 0.3
    assert found.halfway is not None
    assert found.confidence is Confidence.ACCEPTED


@pytest.mark.parametrize("surface", [(50, 90, 120), (170, 130, 60)])
def test_other_surfaces(surface: tuple[int, int, int]) -> None:
    scene = paint_scene(surface=surface)
    assert circle_error(run(scene.image), scene) < 0.3


def test_dark_markings_need_their_polarity() -> None:
    scene = paint_scene(surface=(215, 225, 220), contrast=-90.0)
    assert run(scene.image).circle is None
    for marking in ("dark", "any"):
        config = DetectorConfig.model_validate({"marking": marking})
        assert circle_error(run(scene.image, config), scene) < 0.3


def test_players_hide_parts_of_the_circle(main_view: Scene) -> None:
    image = main_view.image.copy()
    points = main_view.circle_points(16)
    for x, y in points[::2].astype(int):
        cv2.rectangle(image, (x - 6, y - 30), (x + 6, y + 5), (40, 30, 200), -1)
    found = run(image)
    assert circle_error(found, main_view) < 0.4
    hidden = found.sketch.draw()[points[::2, 1].astype(int) - 8, points[::2, 0].astype(int)]
    assert not (hidden == 7).any()


def test_mask_follows_the_paint(main_view: Scene) -> None:
    found = run(main_view.image)
    on = np.rint(main_view.circle_points(300)).astype(int)
    assert np.mean(found.sketch.draw()[on[:, 1], on[:, 0]] == 7) > 0.9
    rows, columns = np.nonzero(found.sketch.draw() == 7)
    away = np.abs(sampson_distance(main_view.conic, np.stack([columns, rows], axis=-1)))
    assert away.max() < 6.0
    line = np.rint(main_view.camera.project(np.stack([np.zeros(40), np.linspace(-7, 7, 40)], axis=-1))).astype(int)
    assert np.mean(found.sketch.draw()[line[:, 1], line[:, 0]] == 18) > 0.9
    assert set(np.unique(found.sketch.draw())) <= {0, 7, 17, 18}


def test_field_region_is_a_hull_of_the_field(main_view: Scene) -> None:
    hull = run(main_view.image).region.hull
    assert hull.dtype == np.uint8
    assert set(np.unique(hull)) <= {0, 255}
    on = np.rint(main_view.circle_points(100)).astype(int)
    assert run(main_view.image).region.hull_at(960, 540)[on[:, 1], on[:, 0]].all()


def test_other_straight_markings_are_reported_and_masked() -> None:
    extra = (level(14.0, -12.0, 12.0),)
    scene = paint_scene(markings=(*HALFWAY_AND_CIRCLE, *extra), focal_px=1500.0)
    found = run(scene.image)
    truth = scene.camera.project(np.array([[-11.0, 14.0], [11.0, 14.0]]))
    line = np.cross(*lift(truth))
    line /= np.hypot(line[0], line[1])
    distances = [np.abs(lift(np.stack([s.start, s.end])) @ line).max() for s in found.lines]
    assert min(distances) < 1.5
    middle = np.rint(scene.camera.project(np.array([[5.0, 14.0]]))[0]).astype(int)
    assert found.sketch.draw()[middle[1], middle[0]] == 17
    lengths = [np.hypot(*(s.end - s.start)) for s in found.lines]
    assert lengths == sorted(lengths, reverse=True)


@pytest.mark.parametrize("noise", [2.0, 12.0])
@pytest.mark.parametrize("marking", ["light", "any"])
def test_plain_grass_is_refused(noise: float, marking: str) -> None:
    scene = paint_scene(markings=(), noise=noise)
    found = run(scene.image, DetectorConfig.model_validate({"marking": marking}))
    assert found.circle is None
    assert found.halfway is None
    assert found.refusal in {"no_circle_found", "circle_support_too_low", "circle_off_marking", "arc_too_short"}
    assert not (found.sketch.draw() == 7).any()


def test_a_crowd_is_refused() -> None:
    random = np.random.default_rng(11)
    coarse = random.integers(0, 255, (108, 192, 3)).astype(np.uint8)
    found = run(cv2.resize(coarse, (960, 540), interpolation=cv2.INTER_CUBIC))
    assert found.circle is None


def test_black_picture_has_no_field() -> None:
    found = run(np.zeros((224, 398, 3), np.uint8))
    assert found.refusal == "no_field"
    assert not found.region.hull.any()


@pytest.mark.parametrize("pan_deg", [24.0, 30.0, 34.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_penalty_arc_is_refused(pan_deg: float, seed: int) -> None:
    scene = paint_scene(markings=PENALTY_AREA, pan_deg=pan_deg, seed=seed)
    assert run(scene.image, seed=seed).circle is None


def test_a_part_of_a_circle_without_a_line_is_an_arc() -> None:
    scene = paint_scene(markings=(ring(0.0, RADIUS_M), *PENALTY_AREA, level(-34.0)), pan_deg=15.0)
    found = run(scene.image)
    assert found.halfway is None
    assert found.circle is None
    assert found.arcs[0].least_share > GAPLESS_SHARE
    assert np.abs(sampson_distance(found.arcs[0].conic, scene.circle_points())).mean() < 0.5
    for one, other in itertools.combinations(found.arcs, 2):
        assert np.median(np.abs(sampson_distance(one.conic, other.points))) > 3.0


def test_an_arc_that_ends_inside_the_picture_has_a_gap() -> None:
    found = run(paint_scene(markings=PENALTY_AREA, pan_deg=30.0).image)
    assert all(arc.least_share < GAPLESS_SHARE for arc in found.arcs)


def test_reasons_name_the_gate(main_view: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(circle, "TENTATIVE_WHOLE_SHARE", 1.0)
    gates = {"acceptance": {"share": 1.0, "share_with_line": 1.0}, "thorough": False}
    found = run(main_view.image, DetectorConfig.model_validate(gates))
    assert found.circle is None
    assert found.refusal == "circle_support_too_low"
    assert found.candidates
    assert np.abs(sampson_distance(found.candidates[0].conic, main_view.circle_points())).mean() < 0.5


def worn(scene: Scene, share: float, seed: int = 0) -> np.ndarray:
    """The picture with patches of bare grass over this share of the circle, in short pieces all around it."""
    image = scene.image.copy()
    points = scene.circle_points(120)
    order = np.random.default_rng(seed).permutation(len(points))[: int(share * len(points))]
    for x, y in np.rint(points[order]).astype(int):
        cv2.circle(image, (int(x), int(y)), 6, GRASS, -1)
    return image


def test_a_worn_circle_with_its_line_is_tentative(main_view: Scene) -> None:
    found = run(worn(main_view, 0.4))
    assert circle_error(found, main_view) < 1.0
    assert found.halfway is not None
    assert found.confidence is Confidence.TENTATIVE
    assert run(main_view.image).confidence is Confidence.ACCEPTED


def test_a_worn_circle_without_a_line_is_refused() -> None:
    scene = paint_scene(markings=HALFWAY_AND_CIRCLE[:1])
    assert run(worn(scene, 0.4)).circle is None


def test_a_second_pass_finds_what_is_too_faint_for_the_first(main_view: Scene) -> None:
    blind = {"ridges": {"threshold": 50.0}}
    quick = DetectorConfig.model_validate({**blind, "thorough": False})
    assert run(main_view.image, quick).confidence is not Confidence.ACCEPTED
    found = run(main_view.image, DetectorConfig.model_validate(blind))
    assert found.confidence is Confidence.ACCEPTED
    assert circle_error(found, main_view) < 0.3


def test_the_first_pass_takes_a_smaller_picture_and_both_find_the_same(main_view: Scene) -> None:
    options = [{"detection_width_px": width, "enlarged_width_px": 480, "thorough": False} for width in (480, 960)]
    configs = [DetectorConfig.model_validate(option) for option in options]
    points = [points_of_first_pass(main_view.image, config) for config in configs]
    assert len(points[0]) < len(points[1])
    assert np.ptp(points[0][:, 0]) > 0.8 * main_view.image.shape[1]
    assert max(circle_error(run(main_view.image, config), main_view) for config in configs) < 0.3


def test_wrong_pictures_are_value_errors() -> None:
    for image in (np.zeros((10, 10), np.uint8), np.zeros((10, 10, 3), np.float32)):
        with pytest.raises(ValueError, match="image_bgr"):
            run(image)


def test_every_option_has_a_description_and_rejects_nonsense() -> None:
    def models(model: type) -> list[type]:
        nested = [f.annotation for f in model.model_fields.values() if hasattr(f.annotation, "model_fields")]
        return [model, *(m for n in nested for m in models(n))]

    for model in models(DetectorConfig):
        assert all(f.description for f in model.model_fields.values()), model
    for wrong in ({"detection_width_px": 0}, {"unknown": 1}, {"ridges": {"threshold": float("nan")}}):
        with pytest.raises(ValidationError):
            DetectorConfig.model_validate(wrong)


def test_a_field_that_fills_less_of_the_picture_than_the_stands() -> None:
    scene = paint_scene(width=1280, height=400, focal_px=1600.0, noise=1.0)
    stands = np.full((640, 1280, 3), (70, 70, 95), np.uint8)
    stands += np.random.default_rng(1).integers(0, 12, stands.shape, np.uint8)
    found = run(np.concatenate([stands, scene.image]))
    assert found.circle is not None, found.refusal
    middle = np.abs(sampson_distance(found.circle.conic, scene.circle_points() + np.array([0.0, 640.0]))).mean()
    assert middle < 0.3
    assert found.region.hull_at(1280, 1040)[700:].mean() > 200
    assert found.region.hull_at(1280, 1040)[:600].mean() < 20


def test_the_last_pass_has_more_pixels_and_flatter_ellipses() -> None:
    last = flat_pass(CONFIG, 1.0)
    assert last.width_px == FLAT_WIDTH_PX > CONFIG.detection_width_px
    assert last.ellipses.axis_ratio == (FLATTEST, CONFIG.hypotheses.axis_ratio[1])
    assert last.ridges == second_pass(CONFIG, 1.0).ridges


def test_bare_surfaces_are_left_alone_by_the_last_passes() -> None:
    bare = run(paint_scene(markings=(), noise=2.0).image)
    assert bare.refusal == "no_circle_found"
    assert len(bare.passes) == 2
    arc = run(paint_scene(markings=PENALTY_AREA, pan_deg=24.0, noise=2.0).image)
    assert arc.circle is None
    assert len(arc.passes) == 3


def test_a_bare_surface_beside_that_of_a_circle_is_searched_quickly() -> None:
    scene = paint_scene(width=1280, height=400, focal_px=1600.0, noise=1.0)
    beside = np.full((320, 1280, 3), (70, 70, 95), np.uint8)
    beside += np.random.default_rng(1).integers(0, 12, beside.shape, np.uint8)
    worn_circle = np.concatenate([worn(scene, 0.4), beside])
    found = run(worn_circle)
    assert found.confidence is Confidence.TENTATIVE
    assert len({id(result.region) for result in found.passes}) == 2
    assert [result.region is found.region for result in found.passes] == [False, True, True]


def test_a_surface_beside_a_larger_one_is_searched_slowly_where_something_like_a_circle_was_seen() -> None:
    """A circle of which little is left may be there; the larger one is searched slowly in any case."""

    def regions_searched(beside: np.ndarray, *ruled_out: Interpretation) -> list[bool]:
        ground = np.full((480, 1280, 3), (70, 70, 95), np.uint8)
        ground += np.random.default_rng(1).integers(0, 12, ground.shape, np.uint8)
        image = np.concatenate([beside, ground])
        found = detect(image, CONFIG, np.random.default_rng(7), ruled_out=ruled_out)
        largest = found.passes[0].region
        assert found.circle is None
        return [result.region is largest for result in found.passes]

    view = {"width": 1280, "height": 400, "focal_px": 1600.0, "noise": 1.0}
    bare = paint_scene(markings=(), **view)
    assert regions_searched(bare.image) == [True, False, True]
    assert regions_searched(bare.image, Interpretation(bare.conic, None)) == [True, False, True, False]
    arc = paint_scene(markings=(ring(0.0, RADIUS_M, 2.2),), **view).image
    assert regions_searched(arc)[:4] == [True, False, True, False]


def test_a_line_in_another_paint_than_the_circle_is_not_its_halfway_line() -> None:
    """A ring that an analyst draws may have the line of another marking through its middle."""
    ring_only, line_only = (paint_scene(markings=HALFWAY_AND_CIRCLE[k : k + 1], noise=0.0).image for k in (0, 1))
    covered = (ring_only.astype(np.float64) - GRASS).mean(axis=-1, keepdims=True) / 90.0
    noise = np.random.default_rng(0).normal(0, 2, ring_only.shape)
    image = (line_only + covered * np.array([-50.0, 110.0, -60.0]) + noise).clip(0, 255).astype(np.uint8)
    found = run(image)
    assert found.circle is not None
    assert found.halfway is None
    assert run(image, DetectorConfig(one_paint=False)).halfway is not None


@pytest.mark.parametrize("hidden_rows", [0, 30])
def test_a_halfway_line_may_lie_under_another_sports_line(main_view: Scene, hidden_rows: int) -> None:
    """In that one's colour, where a line in the circle's paint is not seen; also where only short
    pieces of it are seen.
    """
    ring_only, line_only = (paint_scene(markings=HALFWAY_AND_CIRCLE[k : k + 1], noise=0.0).image for k in (0, 1))
    covered = (line_only.astype(np.float64) - GRASS).mean(axis=-1, keepdims=True) / 90.0
    covered[np.arange(len(covered)) % 60 >= 60 - hidden_rows] = 0.0
    noise = np.random.default_rng(0).normal(0, 2, ring_only.shape)
    image = (ring_only + covered * np.array([150.0, 20.0, 10.0]) + noise).clip(0, 255).astype(np.uint8)
    assert run(image).halfway is None
    assert halfway_error(run(image, DetectorConfig(shared_halfway=True)), main_view) < 0.5


def test_a_drawn_line_through_the_middle_is_no_halfway_line(main_view: Scene) -> None:
    middle = main_view.camera.project(np.zeros((1, 2)))[0]
    image = main_view.image.copy()
    hidden = main_view.camera.project(np.array([[0.0, -8.5], [0.0, 8.5]]))[:, 1]  # by somebody who stands there
    image[slice(*np.sort(np.rint(hidden)).astype(int)), int(middle[0]) - 15 : int(middle[0]) + 15] = GRASS
    start, end = (tuple(int(v) for v in np.rint(middle + step)) for step in ((-400.0, -60.0), (400.0, 60.0)))
    cv2.line(image, start, end, (40, 220, 60), 3, cv2.LINE_AA)
    found = run(image)
    assert circle_error(found, main_view) < 0.3
    assert halfway_error(found, main_view) < 0.3  # by what is seen of it on both sides of the circle
    assert halfway_error(run(image, DetectorConfig(one_paint=False)), main_view) > 5.0


def test_what_each_surface_shows_of_either_polarity_is_kept_apart() -> None:
    image = np.full((540, 960, 3), 120, np.uint8)
    cv2.ellipse(image, (300, 330), (150, 60), 0, 0, 360, (250, 250, 250), 5, cv2.LINE_AA)
    cv2.ellipse(image, (700, 330), (150, 60), 0, 0, 360, (20, 20, 20), 5, cv2.LINE_AA)
    image = np.clip(image + np.random.default_rng(0).normal(0, 2, image.shape), 0, 255).astype(np.uint8)
    found = run(image, CONFIG.model_copy(update={"marking": "any"}))
    middles = {}
    for sign, x in ((1.0, 300), (-1.0, 700)):
        conics = [candidate.conic for seen in found.sightings if seen.sign == sign for candidate in seen.candidates]
        middles[sign] = min(abs(ellipse_from_conic(conic).center[0] - x) for conic in conics)
    assert max(middles.values()) < 3.0
    assert found.sightings[0].sign == found.polarity


def test_a_further_interpretation_shares_what_was_found_and_measured(main_view: Scene, monkeypatch) -> None:
    calls = []
    first = run(main_view.image)
    for module, name in ((one_pass, "find_ridges"), (one_pass, "search_ellipses"), (candidates, "measure_circle")):
        usual = getattr(module, name)
        monkeypatch.setattr(
            module, name, lambda *a, usual=usual, name=name, **k: (calls.append(name), usual(*a, **k))[1]
        )
    assert first.circle is not None
    wrong = (Interpretation(first.circle.conic, None),)
    second = detect(main_view.image, CONFIG, np.random.default_rng(7), ruled_out=wrong, earlier=first)
    assert "find_ridges" in calls  # the passes that were not needed before
    calls.clear()
    third = detect(main_view.image, CONFIG, np.random.default_rng(7), ruled_out=wrong, earlier=second)
    assert calls == []
    assert third.refusal == second.refusal
    assert [c.score for c in third.candidates] == [c.score for c in second.candidates]


def test_across_a_ring_of_another_colour_than_white_a_line_in_any_paint_is_none() -> None:
    """An analyst's blue ring with a yellow line through it on bare grass."""
    ring_only, line_only = (paint_scene(markings=HALFWAY_AND_CIRCLE[k : k + 1], noise=0.0).image for k in (0, 1))
    ring, line = (
        (image.astype(np.float64) - GRASS).mean(axis=-1, keepdims=True) / 90.0 for image in (ring_only, line_only)
    )
    bare = paint_scene(markings=(), noise=2.0).image
    image = bare + ring * np.array([170.0, 90.0, 14.0]) + line * np.array([40.0, 110.0, 140.0])
    found = run(image.clip(0, 255).astype(np.uint8), DetectorConfig(shared_halfway=True))
    assert found.circle is not None
    assert found.halfway is None
