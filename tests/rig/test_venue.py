"""The venue file: what is written comes back, damage is told in one line, and single frames get a prior from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml

import circlecal
from circlecal.cli.options import choose_config
from circlecal.config import load_config
from circlecal.errors import InputError
from circlecal.field import load_field
from circlecal.geometry.camera_parameters import KAPPA_1, theta_of
from circlecal.rig.tripod import COMMON, PLACE, PaintersShare, Venue
from circlecal.rig.venue import (
    choose_field,
    describe_changes,
    prior_of_tripod,
    read_venue,
    read_venue_file,
    venue_settings,
    write_venue,
)
from tests.tracking.scripted import tripod

SOCCER = load_field("soccer")


@pytest.fixture
def file(tmp_path):
    write_venue(tmp_path / "venue.yaml", Venue("soccer", (tripod(),)), SOCCER, "0" * 12)
    return tmp_path / "venue.yaml"


def test_what_is_written_comes_back(file):
    (found,), wanted = read_venue(file, SOCCER).tripods, tripod()
    np.testing.assert_allclose(found.mean, wanted.mean, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.covariance, wanted.covariance, rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose([found.head_low, found.head_high], [wanted.head_low, wanted.head_high], rtol=1e-12)
    assert (found.name, found.size, found.surface, found.used) == (
        wanted.name, wanted.size, wanted.surface, wanted.used
    )  # fmt: skip


def test_the_bend_of_a_lens_comes_back_and_files_of_earlier_versions_have_none(tmp_path):
    bent = with_painters()
    bend = PLACE["kappa_1_by_focal"]
    bent.mean[bend] = 0.04
    write_venue(tmp_path / "venue.yaml", Venue("soccer", (bent,)), SOCCER)
    (found,) = read_venue(tmp_path / "venue.yaml", SOCCER).tripods
    heads = found.head_low + np.array([[-0.5, 0.0, 0.0], [0.8, 0.0, 0.0]])
    lenses = found.model.thetas(heads, found.mean)[:, KAPPA_1]
    np.testing.assert_allclose(lenses, bent.model.thetas(heads, bent.mean)[:, KAPPA_1])
    # single frames are told of the lens that the tripod has at their zoom
    prior = prior_of_tripod(found)
    np.testing.assert_allclose(prior.at(heads[:, 0])[0][:, prior.parameters.index("kappa_1")], lenses)
    content = yaml.safe_load((tmp_path / "venue.yaml").read_text())
    (camera,) = content["tripods"]
    assert bend == len(COMMON) - 1
    del camera["parameters"]["kappa_1_by_focal"], camera["correlation"][-1], camera["painters"]["covariance"][-1]
    camera["painters"]["by_errors"] = {name: v[:-1] for name, v in camera["painters"]["by_errors"].items()}
    (tmp_path / "earlier.yaml").write_text(yaml.safe_dump(content))
    (earlier,) = read_venue(tmp_path / "earlier.yaml", SOCCER).tripods
    straight = bent.mean.copy()
    straight[bend] = 0.0
    np.testing.assert_allclose(earlier.mean, straight, atol=1e-12)
    np.testing.assert_allclose(earlier.whole_covariance[:bend, :bend], bent.whole_covariance[:bend, :bend], atol=1e-15)
    assert not earlier.whole_covariance[bend].any()


def with_painters():
    """A rink's camera whose position and length follow a line that lies beside its place."""
    follows = np.zeros(len(COMMON))
    follows[[PLACE["axis_x"], PLACE["length"]]] = 0.02, 0.05
    return replace(tripod(), painters=PaintersShare(tripod().covariance / 4.0, {"blue_line_left x": follows}))


@pytest.fixture
def painted_file(tmp_path):
    write_venue(tmp_path / "venue.yaml", Venue("soccer", (with_painters(),)), SOCCER)
    return tmp_path / "venue.yaml"


def test_what_painters_leave_open_comes_back(painted_file):
    (found,), wanted = read_venue(painted_file, SOCCER).tripods, with_painters()
    np.testing.assert_allclose(found.whole_covariance, wanted.whole_covariance, rtol=1e-9, atol=1e-18)
    assert list(found.painters.by_errors) == ["blue_line_left x"]
    # a prior for single frames has it, too
    without = replace(found, painters=replace(found.painters, by_errors={}))
    x = prior_of_tripod(found).parameters.index("x")
    more = prior_of_tripod(found).covariance - prior_of_tripod(without).covariance
    assert more[x, x] == pytest.approx(0.02**2)


def test_a_size_that_a_person_has_fixed_is_not_left_open_by_painters(painted_file):
    text = painted_file.read_text()
    known = read_venue_file(painted_file).tripods[0].parameters["pitch_length_m"]
    written = f"pitch_length_m: {{mean: {known.mean}, sd: {known.sd}}}"
    assert written in text and known.sd > 0.0
    painted_file.write_text(text.replace(written, "pitch_length_m: {mean: 105.0, sd: 0.0}"))
    (found,) = read_venue(painted_file, SOCCER).tripods
    assert found.whole_covariance[PLACE["length"], PLACE["length"]] == 0.0
    x = PLACE["axis_x"], PLACE["axis_x"]
    assert found.whole_covariance[x] == pytest.approx(tripod().covariance[x] / 4.0 + 0.02**2)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda painters: painters["covariance"].pop(), "covariance needs 21 rows"),
        (lambda painters: painters["by_errors"]["blue_line_left x"].pop(), "by_errors.blue_line_left x needs 21"),
        (lambda painters: painters["covariance"][0].__setitem__(0, -1.0), "covariance is that of no distribution"),
    ],
)
def test_damage_in_what_painters_leave_open_is_told(painted_file, change, told):
    content = yaml.safe_load(painted_file.read_text())
    change(content["tripods"][0]["painters"])
    painted_file.write_text(yaml.safe_dump(content))
    with pytest.raises(InputError, match=rf"tripods\.0\.painters: {told}"):
        read_venue(painted_file, SOCCER)


def test_a_digest_that_looks_like_a_number_stays_text(tmp_path):
    for digest in ("123e45678901", "000000000000", "12e345678901"):
        write_venue(
            tmp_path / "venue.yaml", Venue("soccer", (replace(tripod(), used=("1e5", "0.400")),)), SOCCER, digest
        )
        found = read_venue_file(tmp_path / "venue.yaml")
        assert found.config_digest == digest and found.tripods[0].frames == ["1e5", "0.400"]


def test_lengths_are_absolute(file):
    assert "pitch_length_m: {mean: 103.5" in file.read_text()
    longer = load_field("soccer", {"length": 104.0})
    assert read_venue(file, longer).tripods[0].growth_m[0] == pytest.approx(-0.5)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("venue_version: 1", "venue_version: 7"), "venue_version is 7; this version reads 1"),
        (("venue_version: 1", "version: 1"), "is no venue: venue_version is missing"),
        (("field: soccer", "field: futsal"), "field: is futsal, not soccer"),
        (
            ("field: soccer", "field: nosuch"),
            "field as a file, if it is your own; known: australian-",
        ),
        (
            ("pitch_length_m: {mean: 103.5", "pitch_length_m: {mean: -103.5"),
            "tripods.0.parameters.pitch_length_m: is -103.5",
        ),
        (("pitch_length_m: {mean: 103.5", "pitch_length_m: {mean: 10.0"), "and soccer has 72 to 144 m; correct it"),
        (("pitch_width_m: {mean: 6", "pitch_width_m: {mean: 2"), "tripods.0.parameters.pitch_width_m: is 2"),
        (("lever_m:", "arm_m:"), "tripods.0: parameters.arm_m is unknown"),
        (("name: camera-1", "name: camera 1"), "tripods.0.name: String should match"),
        (("field: soccer", "field: soccer\nsport: ball"), "sport: is unknown"),
        (("head_roll_rad: {mean: 0.0", "head_roll_rad: {mean: .nan"), "tripods.0.parameters.head_roll_rad.mean"),
        (("head_roll_rad: {mean: 0.0", "head_roll_rad: {mean: 1.0e+300"), "tripods.0.parameters.head_roll_rad.mean"),
        (("axis_z_m: {mean: -15.0", "axis_z_m: {mean: 15.0"), "parameters.axis_z_m is below the ground"),
        (("shape: roof", "shape: dome"), "tripods.0.surface.shape"),
        (("tripods:", "tripods: ["), "cannot be read"),
    ],
)
def test_damage_is_told_in_one_line(file, change, told):
    text = file.read_text()
    assert change[0] in text
    file.write_text(text.replace(*change))
    with pytest.raises(InputError) as error:
        read_venue(file, SOCCER)
    assert told in str(error.value) and str(file) in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    "content", ["position_m: [1.0, 80.0, -20.0]\n", '{"schema_version": 1, "camera": null}\n', "position: 3\n"]
)
def test_the_file_of_one_camera_is_told_to_be_for_another_option(tmp_path, content):
    path = tmp_path / "camera-1.yaml"
    path.write_text(content)
    with pytest.raises(InputError, match="is no venue") as error:
        read_venue(path, SOCCER)
    assert ("--camera-prior takes" in str(error.value)) == ("position:" not in content)


def test_a_size_must_be_one_of_the_field(tmp_path):
    """Also where the rules name no range, and where all fields are of one size."""
    path = tmp_path / "venue.yaml"
    for name, is_one in (("basketball-nba", False), ("soccer-any", True), ("futsal", False)):
        write_venue(path, Venue(name, (tripod(),)), SOCCER)
        if is_one:
            assert read_venue(path, load_field(name)).tripods
        else:
            with pytest.raises(InputError, match=r"tripods\.0\.parameters\.pitch_length_m: is 103\.5, and " + name):
                read_venue(path, load_field(name))


def test_a_file_may_be_without_its_correlation(file):
    """Which is deleted with a value that a person has changed."""
    head, rest = file.read_text().split("  correlation:\n", 1)
    file.write_text(head + rest[rest.index("  painters:") :])
    (found,) = read_venue(file, SOCCER).tripods
    np.testing.assert_allclose(found.covariance, np.diag(np.diag(tripod().covariance)), rtol=1e-9, atol=1e-18)


def test_what_lies_beside_what_was_known_is_described():
    known = tripod()
    sd = np.sqrt(np.diag(known.covariance))
    away = np.zeros(len(COMMON))
    away[[PLACE["axis_y"], PLACE["length"], PLACE["lever"]]] = 3.5, -12.0, 2.9
    found = replace(known, mean=known.mean + away * sd)
    assert describe_changes(known, found) == "pitch_length_m by 12.0, axis_y_m by 3.5"
    assert describe_changes(known, known) == ""


def test_a_correlation_must_be_one(file):
    text = file.read_text()
    head, rest = text.split("  correlation:\n", 1)
    rows = rest.splitlines(keepends=True)
    file.write_text(f"{head}  correlation:\n  - [1.0]\n  - [1.0, -1.0]\n{''.join(rows[2:])}")
    with pytest.raises(InputError, match="negative eigenvalue"):
        read_venue(file, SOCCER)


@pytest.mark.parametrize(
    ("settings", "named", "chosen"),
    [
        ([], None, "ice-hockey-nhl"),
        ([], "auto", "ice-hockey-nhl"),
        (["field.template=auto"], None, "ice-hockey-nhl"),
        ([], "futsal", "futsal"),
        (["field.template=futsal"], None, None),
    ],
)
def test_a_venue_names_the_field_where_the_user_does_not(tmp_path, settings, named, chosen):
    path, rink = tmp_path / "venue.yaml", load_field("ice-hockey-nhl")
    write_venue(path, Venue(rink.name, (tripod(),)), rink)
    assert choose_field(path, load_config(None, settings).field, named) == chosen
    if not settings and named != "futsal":
        config = choose_config(None, None, named, venue=path, tells_field=True)
        assert config.field.template == "ice-hockey-nhl"
        assert config.camera.position_m is not None


def test_a_venue_of_a_field_of_ones_own_asks_for_its_file(tmp_path):
    write_venue(tmp_path / "venue.yaml", Venue("mine", (tripod(),)), SOCCER)
    with pytest.raises(InputError, match="field: is mine, not soccer; give its --field"):
        choose_config(None, None, "auto", venue=tmp_path / "venue.yaml", tells_field=True)


def test_an_empty_venue_is_no_prior(tmp_path):
    write_venue(tmp_path / "venue.yaml", Venue("soccer"), SOCCER)
    assert read_venue(tmp_path / "venue.yaml", SOCCER).tripods == ()
    with pytest.raises(InputError, match="tripods: is empty"):
        venue_settings(tmp_path / "venue.yaml", SOCCER)


@pytest.mark.parametrize("pan", [-0.5, 0.0, 0.6])
def test_the_prior_of_single_frames_allows_the_cameras_of_the_tripod(pan):
    """Wherever the head points: position, roll and lens lie within three of the prior's standard deviations."""
    camera = tripod()
    view = camera.view(np.array([camera.log_focal + 0.3, pan, 1.33]), np.zeros((3, 3)))
    theta = theta_of(view.camera, camera.model.projection, view.surface.crown_m)
    prior = prior_of_tripod(camera)
    mean, covariance, _ = prior.at(theta[None, 0])
    sizes = [name in ("length", "breadth", "width") for name in prior.parameters]
    off = (theta[prior.indices] - mean[0]) / np.sqrt(np.diag(covariance[0]))
    assert np.abs(off[~np.array(sizes)]).max() < 3.0
    place = [prior.parameters.index(name) for name in ("x", "y", "z")]
    assert np.sqrt(np.diag(covariance[0]))[place].max() < 1.0


def turned_by_half(camera):
    """The camera on the other side of the field, which shows the same picture of the field turned by 180 degrees."""
    mean, half = camera.mean.copy(), np.array([0.0, np.pi, 0.0])
    mean[[PLACE["axis_x"], PLACE["axis_y"], PLACE["lean_x"], PLACE["lean_y"]]] *= -1.0
    return replace(camera, mean=mean, head_low=camera.head_low + half, head_high=camera.head_high + half)


@pytest.mark.parametrize("turn", [0.0, -2.0 * np.pi])
def test_a_camera_beyond_the_far_touchline_tells_single_frames_as_much_as_one_before_the_near_one(tmp_path, turn):
    near, far = tripod(), turned_by_half(tripod())
    shift = np.array([0.0, turn, 0.0])
    written = replace(far, head_low=far.head_low + shift, head_high=far.head_high + shift)
    write_venue(tmp_path / "venue.yaml", Venue("soccer", (written,)), SOCCER)
    (found,) = read_venue(tmp_path / "venue.yaml", SOCCER).tripods
    np.testing.assert_allclose([found.head_low, found.head_high], [far.head_low, far.head_high], atol=1e-12)
    wanted, told = prior_of_tripod(near), prior_of_tripod(found)
    sign = np.where([name in ("x", "y") for name in wanted.parameters], -1.0, 1.0)
    np.testing.assert_allclose(told.mean[: len(sign)], sign * wanted.mean[: len(sign)], atol=1e-9)
    np.testing.assert_allclose(told.deviation_sd, wanted.deviation_sd, atol=1e-9)


@pytest.mark.parametrize("name", ["length", "breadth", "crown", "kappa_1", "width"])
def test_what_is_fixed_is_known_to_single_frames(name):
    camera = tripod()
    mean, covariance = camera.mean.copy(), camera.covariance.copy()
    mean[PLACE[name]] = 0.25
    for place in (PLACE[name], PLACE.get(f"{name}_by_zoom", PLACE[name])):
        covariance[place], covariance[:, place] = 0.0, 0.0
    prior = prior_of_tripod(replace(camera, mean=mean, covariance=covariance))
    k = prior.parameters.index(name)
    assert prior.mean[k] == pytest.approx(mean[PLACE[name]])
    assert 0.0 < prior.covariance[k, k] < 1e-10


def test_a_camera_that_stands_at_a_known_place_and_turns_about_it_gives_settings(tmp_path):
    camera = tripod()
    mean, covariance = camera.mean.copy(), camera.covariance.copy()
    places = [PLACE[name] for name in ("axis_x", "axis_y", "axis_z", "lever", "lever_by_zoom")]
    mean[places[3:]] = 0.0
    covariance[places], covariance[:, places] = 0.0, 0.0
    known = replace(camera, mean=mean, covariance=covariance)
    write_venue(tmp_path / "venue.yaml", Venue("soccer", (known,)), SOCCER)
    config = load_config(None, venue_settings(tmp_path / "venue.yaml", SOCCER))
    np.testing.assert_allclose(config.camera.position_m, mean[places[:3]])
    assert max(config.camera.position_sd_m) < 1e-5


def test_the_configuration_takes_it(file):
    config = load_config(None, venue_settings(file, SOCCER))
    assert config.camera.shared is not None and config.correspondences.camera_side == "main"
    growth = config.camera.shared.mean[config.camera.shared.parameters.index("length")]
    assert growth == pytest.approx(tripod().mean[PLACE["length"]])
    assert config.camera.position_m[1] == pytest.approx(62.0, abs=0.7)


def test_python_takes_a_venue_and_a_prior_as_the_commands_do(file, tmp_path):
    prior = tmp_path / "camera-1.yaml"
    prior.write_text("position_m: [1.0, 80.0, -20.0]\nposition_sd_m: [1.0, 2.0, 3.0]\n")
    settings = {"camera.roll_sd_deg": 2.0, "seed": 3}
    options = [f"{key}={value}" for key, value in settings.items()]
    for path, given in ((file, {"venue": file}), (prior, {"camera_prior": prior})):
        found = circlecal.load_cameras(path, "broadcast", set=settings)
        assert found == choose_config("broadcast", options, **given)
        assert found != choose_config("broadcast", options)
    assert circlecal.load_cameras(prior, field="futsal") == choose_config(None, None, "futsal", camera_prior=prior)
    with pytest.raises(InputError, match=r"none\.yaml"):
        circlecal.load_cameras(tmp_path / "none.yaml")
