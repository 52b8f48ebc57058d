"""Which of several fields a picture shows: by the colour of the ground, then by what is painted."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.config import Config, find_template, load_config, suit_config
from circlecal.errors import ConfigError
from circlecal.field import load_field
from circlecal.field.loading import field_folder
from circlecal.observations import MarkingKey
from circlecal.pipeline import calibrate_unknown_field, field_choice, field_of, likely_sport, run
from circlecal.pipeline.field_choice import LEAST_EVIDENCE, SETTLED_MARKINGS, Answer, choose_answer
from circlecal.pipeline.leagues import may_be_league
from circlecal.pipeline.other_circles import OTHER_CIRCLES
from circlecal.pipeline.setting import Scene, Setting
from circlecal.records.json_text import result_line
from circlecal.records.record import ResultRecord
from circlecal.records.writing import result_record
from circlecal.results import Attempt, CameraFit, FieldCandidate, FrameCalibration, MarkingMask, Verdict
from circlecal.stages.mask import tell_grounds
from circlecal.synthetic.sampling import render_frame

AUTO = load_config(None, {"field.template": "auto", "field.among": ["soccer", "robocup", "futsal"]})
SIZE = (640, 360)


def answer(template, evidence=None, explained=1.0):
    """An answer under a template, refused where there is no evidence."""
    field = load_field(template)
    status, code = ("refused", "no_circle_found") if evidence is None else ("calibrated", None)
    attempt = Attempt(verdict=Verdict(status, code, None, None))
    found = FrameCalibration("x", *SIZE, template, field.default_circle, attempt, 0, "", template=field)
    return Answer(found, FieldCandidate(template, field.sport, status, code, evidence, 0.7, explained))


@pytest.mark.parametrize(
    ("bgr", "grounds"),
    [
        ((60, 130, 70), ("grass",)),
        ((228, 225, 220), ("ice", "floor")),
        ((110, 160, 200), ("floor",)),
        ((160, 150, 90), ("floor",)),
        ((110, 110, 110), ("grass", "floor", "ice")),
    ],
)
def test_the_colour_of_the_ground_says_what_may_be_seen(bgr, grounds):
    assert tell_grounds(np.full((*SIZE[::-1], 3), bgr, np.uint8)) == grounds


def test_the_field_that_explains_most_is_taken_and_all_are_named():
    found = choose_answer([answer("soccer", 0.4), answer("robocup"), answer("futsal", 1.0)])
    assert (found.status, found.field_name) == ("calibrated", "futsal")
    assert [candidate.template for candidate in found.fields] == ["futsal", "soccer", "robocup"]


def test_two_sports_that_explain_it_alike_are_refused_with_both():
    found = choose_answer([answer("soccer"), answer("futsal", 1.0), answer("handball", 0.9)])
    assert (found.status, found.verdict.code) == ("refused", "field_open")
    assert {"futsal", "handball"} <= {candidate.template for candidate in found.fields}


@pytest.mark.parametrize(("usual", "other", "taken"), [(0.774, 1.015, 1), (1.123, 0.95, 0), (1.0, 1.0, 0)])
def test_of_one_sport_the_sizes_that_explain_most_are_taken(usual, other, taken):
    """A rendered NBA court weighs 1.015, that of another league laid over it 0.774."""
    names = "basketball", "basketball-nba"
    found = choose_answer([answer("soccer"), answer(names[0], usual), answer(names[1], other)])
    assert (found.status, found.field_name) == ("calibrated", names[taken])
    assert found.fields[1].template == names[1 - taken]


def test_a_smaller_pitch_is_told_by_its_own_areas_and_not_by_its_border(monkeypatch):
    """Circle, halfway line, border and mark are those of a pitch of soccer at another scale."""
    shared = ("centre_circle", "halfway_line", "side_line_top", "side_line_left", "centre_mark")
    among = load_config(None, {"field.template": "auto", "field.among": ["soccer", "soccer-9"]})
    grass, taken = np.full((*SIZE[::-1], 3), (60, 130, 70), np.uint8), {}
    for carried in (shared, (*shared, "big_rect_left_main")):
        camera = CameraFit.__new__(CameraFit)
        object.__setattr__(camera, "residuals_px", {MarkingKey(name): 0.3 for name in carried})

        def weigh(scene, config, found, camera=camera):
            smaller = answer("soccer-9", 1.5)
            with_camera = replace(smaller.found, attempt=replace(smaller.found.attempt, camera=camera))
            return replace(smaller, found=with_camera) if found.field_name == "soccer-9" else answer("soccer", 1.4)

        monkeypatch.setattr(field_choice, "run", lambda image, config, **_: answer(config.field.template).found)
        monkeypatch.setattr(field_choice, "_weigh", weigh)
        taken[carried[-1]] = calibrate_unknown_field(grass, among, frame_id="x").field_name
    assert taken == {"centre_mark": "soccer", "big_rect_left_main": "soccer-9"}
    assert {"soccer-7", "soccer-9"} < set(Config().field.among)


def test_a_court_on_what_looks_like_ice_must_explain_more_of_the_paint(monkeypatch):
    """Half a court was laid into the middle of a rink whose circle is a blurred logo."""

    def calibrate(image, config, **_):
        return answer(config.field.template, None if config.field.template == "soccer" else 0.55).found

    def weigh(image, config, found):
        return answer(found.field_name, None if found.field_name == "soccer" else 0.55, 0.36)

    monkeypatch.setattr(field_choice, "run", calibrate)
    monkeypatch.setattr(field_choice, "_weigh", weigh)
    among = load_config(None, {"field.template": "auto", "field.among": ["soccer", "basketball"]})
    status = {}
    for ground, bgr in (("ice", (228, 225, 220)), ("wood", (110, 160, 200))):
        picture = np.full((*SIZE[::-1], 3), bgr, np.uint8)
        status[ground] = calibrate_unknown_field(picture, among, frame_id="x").status
    assert status == {"ice": "refused", "wood": "calibrated"}


@pytest.mark.parametrize(
    ("evidence", "paint", "halls"),
    [(0.43, (20.0, -60.0, -70.0), 0), (0.2, (20.0, -60.0, -70.0), 1), (0.43, (60.0,) * 3, 1)],
)
def test_no_hall_is_tried_where_a_rink_is_seen_that_does_not_calibrate(monkeypatch, evidence, paint, halls):
    tried = []

    def calibrate(image, config, **_):
        tried.append(config.field.template)
        return answer(config.field.template).found

    def weigh(image, config, found):
        seen = answer(found.field_name)
        laid = evidence if found.field_name == "ice-hockey-nhl" else None
        return replace(seen, candidate=replace(seen.candidate, evidence=laid, explained_share=0.38))

    monkeypatch.setattr(field_choice, "run", calibrate)
    monkeypatch.setattr(field_choice, "_weigh", weigh)
    monkeypatch.setattr(likely_sport, "tell_paints", lambda *_: (np.array(paint),))
    among = ["soccer", "ice-hockey-nhl", "basketball"]
    config = load_config(None, {"field.template": "auto", "field.among": among})
    ice = np.full((*SIZE[::-1], 3), (228, 225, 220), np.uint8)
    assert calibrate_unknown_field(ice, config, frame_id="x").status == "refused"
    # the first template thoroughly again where no other field is seen
    assert tried == [*among[: 2 + halls], *(["soccer"] if evidence < LEAST_EVIDENCE else [])]


def test_what_leaves_more_paint_unexplained_gives_way():
    found = choose_answer([answer("soccer"), answer("basketball", 0.6, 0.9), answer("handball", 0.7, 0.3)])
    assert (found.status, found.field_name) == ("calibrated", "basketball")


@pytest.mark.parametrize(
    ("evidence", "explained", "taken"), [(0.18, 0.75, True), (0.18, 0.6, False), (0.1, 0.75, False)]
)
def test_little_paint_is_believed_of_a_field_that_explains_most_of_it(evidence, explained, taken):
    """A far half court behind its players, as where its field is named."""
    found = choose_answer([answer("soccer"), answer("basketball-nba", evidence, explained)])
    assert (found.field_name == "basketball-nba") is taken


def test_what_is_not_painted_is_believed_on_its_own_ground_only():
    answers = [answer("soccer", -0.2), answer("futsal", 0.1, 0.5)]
    assert choose_answer(answers).status == "calibrated"
    found = choose_answer([replace(answers[0], is_at_home=False), answers[1]])
    assert (found.status, found.verdict.code, found.field_name) == ("refused", "field_open", "soccer")
    refused = choose_answer([replace(answer("soccer"), is_at_home=False), answers[1]])
    assert (refused.verdict.code, refused.field_name) == ("no_circle_found", "soccer")


def test_a_soccer_frame_is_answered_as_if_soccer_had_been_named():
    picture = render_frame("easy", np.random.default_rng(3), 960, 540).image
    found, named = calibrate_unknown_field(picture, AUTO, frame_id="x"), run(picture, Config(), frame_id="x")
    assert found.status == named.status == "calibrated"
    assert np.array_equal(found.attempt.camera.theta, named.attempt.camera.theta)
    assert [candidate.template for candidate in found.fields] == ["soccer"]


def test_a_hall_is_told_and_the_record_says_what_was_tried():
    picture = render_frame("wood", np.random.default_rng(1), 960, 540).image
    found = calibrate_unknown_field(picture, AUTO, frame_id="x")
    assert (found.status, found.field_name) == ("calibrated", "futsal")
    record = ResultRecord.model_validate_json(result_line(result_record(found, found.template)))
    assert record.field.template == "futsal"
    # a soccer field 61 m wide explains what is painted as well: a hall's floor tells which it is
    assert [field.template for field in record.fields] == ["futsal", "soccer"]
    assert record.fields[0].evidence > max(0.3, 0.95 * (record.fields[1].evidence or 0.0))


def test_a_template_brings_its_options_under_those_that_were_set():
    given = load_config(None, {"field.template": "auto", "camera.roll_sd_deg": 3.5})
    suited = suit_config(given, "futsal")
    assert suited.camera.roll_sd_deg == 3.5
    assert suited == load_config("futsal", {"camera.roll_sd_deg": 3.5})


def own_hall(folder, name="hall"):
    """A file of one's own with the lines of futsal."""
    own = folder / "hall.yaml"
    own.write_text((field_folder() / "futsal.yaml").read_text().replace("name: futsal", f"name: {name}", 1))
    return str(own)


def test_a_field_of_ones_own_is_tried_like_the_others(tmp_path):
    """Its name stands in the result, and was then looked for among the templates of the package."""
    own = own_hall(tmp_path)
    config = load_config(None, {"field.template": "auto", "field.among": ["soccer", own]})
    picture = render_frame("wood", np.random.default_rng(1), 960, 540).image
    found = calibrate_unknown_field(picture, config, frame_id="x")
    assert (found.status, found.field_name) == ("calibrated", "hall")
    assert [candidate.template for candidate in found.fields] == ["hall", "soccer"]
    assert found.fields[0].evidence > 0.3
    assert find_template(config, "hall") == own and suit_config(config, "hall").field.template == own


@pytest.mark.parametrize(("name", "told"), [(None, "no such file"), ("soccer", "both named 'soccer'; rename one")])
def test_a_field_among_others_that_cannot_be_told_is_refused_by_its_option(tmp_path, name, told):
    own = str(tmp_path / "hall.yaml") if name is None else own_hall(tmp_path, name)
    config = load_config(None, {"field.template": "auto", "field.among": ["soccer", own]})
    with pytest.raises(ConfigError, match=f"^field.among: .*hall.yaml.*{told}"):
        field_of(config)


def test_circle_and_sizes_belong_to_a_field_that_is_named():
    for key, value in (("circle", "centre_circle"), ("sizes", {"length": 100})):
        with pytest.raises(ConfigError, match="auto goes with neither"):
            field_of(load_config(None, {"field.template": "auto", f"field.{key}": value}))
    assert field_of(AUTO)[0].name == "soccer"


@pytest.mark.parametrize(
    ("first", "tried"),
    [
        (answer("basketball", 1.0), ["basketball", "basketball-nba"]),
        (answer("basketball", 1.0, 0.8), ["basketball", "basketball-nba", "futsal"]),
        (answer("basketball"), ["basketball", "basketball-nba", "futsal"]),
    ],
    ids=["all is explained", "paint is left", "refused"],
)
def test_no_other_sport_is_tried_where_one_explains_all_that_is_painted(monkeypatch, first, tried):
    """But other leagues of the sport are, which lie where the first one does."""
    camera = CameraFit.__new__(CameraFit)
    object.__setattr__(camera, "residuals_px", {MarkingKey(str(k)): 0.0 for k in range(SETTLED_MARKINGS)})
    object.__setattr__(camera, "max_sigma_px", 1.0)
    object.__setattr__(camera, "field_size", None)
    asked = []

    def calibrate(image, config, *, is_brief, **_):
        asked.append((config.field.template, is_brief))
        return answer(config.field.template).found

    attempt = replace(first.found.attempt, camera=camera)
    answers = {"basketball": replace(first, found=replace(first.found, attempt=attempt))}
    monkeypatch.setattr(field_choice, "run", calibrate)
    monkeypatch.setattr(field_choice, "_weigh", lambda *given: answers.get(given[2].field_name, answer("soccer")))
    among = ["soccer", "basketball", "basketball-nba", "futsal"]
    config = load_config(None, {"field.template": "auto", "field.among": among})
    calibrate_unknown_field(np.full((*SIZE[::-1], 3), (110, 160, 200), np.uint8), config, frame_id="x")
    is_seen = first.weight > 0.0
    brief = {"basketball": False, "basketball-nba": True, "futsal": is_seen}
    # the first template by its circle alone on ground of another colour, thoroughly where nothing else is seen
    again = [] if is_seen else [("soccer", False)]
    assert asked == [("soccer", True), *((name, brief[name]) for name in tried), *again]


@pytest.mark.parametrize(
    ("profile", "seed", "among", "tried"),
    [
        ("rink", 0, ["soccer", "ice-hockey-nhl", "ice-hockey"], ["ice-hockey-nhl"]),
        ("rink", 0, ["soccer", "ice-hockey", "ice-hockey-nhl"], ["ice-hockey-nhl", "ice-hockey"]),
        ("court", 4, ["soccer", "basketball-nba", "basketball"], ["basketball-nba"]),
        ("court", 4, ["soccer", "basketball", "basketball-nba"], ["basketball-nba", "basketball"]),
    ],
)
def test_a_league_is_left_out_only_where_it_explains_clearly_less(profile, seed, among, tried):
    config = load_config(None, {"field.template": "auto", "field.among": among})
    picture = render_frame(profile, np.random.default_rng(seed), 1280, 720).image
    found = calibrate_unknown_field(picture, config, frame_id="x")
    assert found.status == "calibrated"
    assert [field.template for field in found.fields if field.template != "soccer"] == tried


@pytest.mark.parametrize(("field", "size"), [("futsal", {}), ("soccer", {"width": 61.0})])
def test_a_pitch_of_unusual_size_is_believed_where_no_other_field_explains_as_much(field, size):
    """With its circle, its halfway line and its touchlines a futsal court is a pitch 61 m wide, seen from farther."""
    config = load_config(None, {"field.template": "auto", "field.among": ["soccer", "futsal"]})
    picture = render_frame("easy", np.random.default_rng(3), 960, 540, load_field(field, size)).image
    found = calibrate_unknown_field(picture, config, frame_id="x")
    assert (found.status, found.field_name) == ("calibrated", field)
    if field == "soccer":
        assert not found.attempt.camera.field_size.is_usual


def test_every_field_may_be_seen_beside_one_that_was_laid_nowhere():
    scene = Scene(np.zeros((*SIZE[::-1], 3), np.uint8), np.zeros(SIZE[::-1], np.uint8), None, None, None)
    field, refused = load_field("basketball"), answer("basketball-nba").found
    assert may_be_league(scene, AUTO, [], field) and may_be_league(scene, AUTO, [refused], field)


@pytest.mark.parametrize(("field", "expected"), [("basketball", False), ("ice-hockey-nhl", False), ("futsal", True)])
def test_other_circles_are_looked_for_where_no_field_is_laid_over_the_picture(field, expected):
    config = load_config(None, {"field.template": field})
    template, circle = field_of(config)
    setting = Setting(config, template, circle, *SIZE, np.random.default_rng(0))
    mask = MarkingMask(None, "detector", None, None, ())
    refused = Attempt(mask=mask, verdict=Verdict("refused", "line_beyond_field", None, "verdict"))
    assert OTHER_CIRCLES.when(setting, refused) is expected
