"""Filled circles: the rim of a disc or of a logo is an edge, and no band."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.config import config_folder, load_config
from circlecal.field import load_field
from circlecal.geometry.conics import circle_conic
from circlecal.pipeline import calibrate_image, discs, field_of, placed_field
from circlecal.pipeline.setting import Setting, frame_generator
from circlecal.results import Attempt, MarkingMask, Verdict
from circlecal.synthetic.decals import Decal, disc, round_logo
from circlecal.synthetic.renderer import render
from circlecal.synthetic.sampling import sample_scene

BLUE, RED = np.array([170.0, 60.0, 40.0]), np.array([40.0, 40.0, 180.0])


@pytest.fixture(scope="module")
def fields(tmp_path_factory):
    """Futsal with a filled centre circle, as files of a user's own."""
    source = (config_folder() / "fields" / "futsal.yaml").read_text()
    folder = tmp_path_factory.mktemp("fields")
    for fill in ("disc", "logo"):
        filled = source.replace("name: centre_circle,", f"name: centre_circle, fill: {fill},")
        (folder / f"{fill}.yaml").write_text(filled)
    return folder


def draw(kind: str, number: int):
    """A hall whose centre circle is filled; of a disc there is no line."""
    rng = np.random.default_rng([31, number])
    scene = sample_scene("wood", rng, 960, 540, load_field("futsal"))
    radius = scene.template.radius(scene.template.circle_by_name["centre_circle"], "outer")
    texture = {
        "disc": lambda: disc(BLUE),
        "two colours": lambda: disc(BLUE, RED),
        "logo": lambda: round_logo(np.random.default_rng(number)),
    }[kind]()
    size = 2 * radius * (256 / 248 if kind == "logo" else 1.0)
    hidden = {} if kind == "logo" else {"centre_circle": 1e-4}
    decals = (Decal(texture, (0.0, 0.0), (size, size), 0.95),)
    scene = replace(scene, extras=(), decals=decals, widths_m=hidden)
    return render(scene, rng).image, scene


@pytest.mark.parametrize(("kind", "number"), [("disc", 4), ("two colours", 4), ("logo", 4)])
def test_a_rim_calibrates_where_no_band_is(kind, number, fields):
    image, scene = draw(kind, number)
    template = fields / f"{'logo' if kind == 'logo' else 'disc'}.yaml"

    def calibrate(rims: str):
        config = load_config("futsal", [f"field.template={template}", f"mask.detector.rims={rims}"])
        return calibrate_image(image, config, frame_id=kind)

    assert calibrate("false").status == "refused"
    found = calibrate("null")
    assert found.status == "calibrated"
    points = np.array([[0.0, 0.0], [3.0, 0.0], [-3.0, 0.0], [0.0, 3.0], [0.0, -3.0]])
    there = scene.camera.project(scene.surface.lift(points))
    shown = ((there >= 0) & (there <= (959, 539))).all(axis=1)
    off = np.linalg.norm(found.view.project(points) - there, axis=1)[shown]
    assert off.max() < 3.0 * found.attempt.camera.max_sigma_px
    assert off.max() < 4.0


def test_a_logo_holds_other_rims_which_are_looked_for_too(monkeypatch):
    """Each look leaves out what was taken for the circle before, until one finds none."""
    conics = [circle_conic((100.0, 100.0), radius) for radius in (30.0, 50.0)]
    masks = [MarkingMask(np.zeros((200, 200), np.uint8), "detector", conic) for conic in (*conics, None)]
    looks = []

    def look(_, __, ruled_out):
        looks.append([interpretation.conic for interpretation in ruled_out])
        return Attempt(mask=masks[len(ruled_out)])

    monkeypatch.setattr(discs, "measure", look)
    found = discs._find_rims(None, None, Attempt(mask=masks[0]))
    assert [len(left_out) for left_out in looks] == [1, 2]
    assert looks[-1][0] is conics[0]
    np.testing.assert_array_equal(found, conics)


def test_the_field_is_laid_about_rims_of_logos_alone(monkeypatch):
    asked = []
    monkeypatch.setattr(placed_field, "look_for_paint", lambda *_: asked.append("paint"))
    gray, rims = np.zeros((200, 200), np.uint8), [circle_conic((100.0, 100.0), 30.0)]
    refused = Attempt(mask=MarkingMask(gray, "detector"), verdict=Verdict("refused", "no_circle_found", None, "mask"))
    for name, seen, count in (("ice-hockey-nhl", rims, 1), ("ice-hockey-nhl", [], 0), ("futsal", rims, 0)):
        config = load_config(None, [f"field.template={name}"])
        setting = Setting(config, *field_of(config), 200, 200, frame_generator(0))
        assert placed_field.place_about_rims(setting, None, refused, seen) is None
        assert len(asked) == count
        asked.clear()
