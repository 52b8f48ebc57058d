"""Configuration: files, overrides, errors that name the key, and the commented YAML."""

import json
from pathlib import Path

import pytest
import yaml
from pydantic import BaseModel

from circlecal.config import (
    Config,
    absolute_files,
    config_digest,
    config_folder,
    config_names,
    effective_yaml,
    json_schema,
    load_config,
)
from circlecal.errors import ConfigError


def problem(file: Path | str | None = None, *overrides: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load_config(file, overrides)
    text = str(caught.value)
    assert "\n" not in text
    return text


def written(folder: Path, text: str) -> Path:
    path = folder / "mine.yaml"
    path.write_text(text)
    return path


def models(model: type[BaseModel]) -> list[type[BaseModel]]:
    nested = [f.annotation for f in model.model_fields.values()]
    return [model, *(m for n in nested if isinstance(n, type) and issubclass(n, BaseModel) for m in models(n))]


def test_nothing_given_is_the_defaults():
    assert load_config() == Config()


def test_a_file_needs_only_what_differs(tmp_path):
    config = load_config(written(tmp_path, "seed: 7\nfield: {circle: centre_circle, sizes: {length: 100}}\nedges:\n"))
    assert config.seed == 7
    assert config.field.sizes == {"length": 100.0}
    assert config.edges == Config().edges


def test_an_empty_file_is_the_defaults(tmp_path):
    assert load_config(written(tmp_path, "# nothing\n")) == Config()


def test_overrides_win_over_the_file_and_later_ones_over_earlier(tmp_path):
    file = written(tmp_path, "seed: 7\noutput: {radar: true}\n")
    config = load_config(file, ["seed=8", "seed=9", "field.sizes.length=1e2", "edges.thresholds=[5, 20]"])
    assert (config.seed, config.output.radar, config.field.sizes) == (9, True, {"length": 100.0})
    assert config.edges.thresholds == (5.0, 20.0)


def test_a_file_lies_over_the_options_of_the_sport_and_under_the_overrides(tmp_path):
    rink = load_config("ice-hockey")
    radar = written(tmp_path, "output: {radar: true}\n")
    named = load_config(radar, {"field.template": "ice-hockey"})
    assert named == load_config("ice-hockey", {"output.radar": True})
    assert config_digest(named) == config_digest(rink)
    inside = written(tmp_path, "field: {template: ice-hockey}\ncamera: {k1_sd: 0.02}\n")
    assert load_config(inside) == load_config("ice-hockey", {"camera.k1_sd": 0.02})
    assert load_config(inside, ["camera.k1_sd=0.03"]) == load_config("ice-hockey", {"camera.k1_sd": 0.03})
    sized = written(tmp_path, "field: {template: ice-hockey, any_circle: false, sizes: {length: 58}}\n")
    assert load_config(sized) == load_config("ice-hockey", {"field.any_circle": False, "field.sizes.length": 58})
    for file in (radar, "tribune", None):
        assert load_config(file, {"field.template": "auto"}).mask == Config().mask


@pytest.mark.parametrize("name", ["soccer", "ice-hockey", "robocup"])
def test_a_file_of_every_option_leaves_nothing_to_the_sport(tmp_path, name):
    whole = load_config(None, {"field.template": name})
    again = load_config(written(tmp_path, effective_yaml(whole)))
    assert config_digest(again) == config_digest(whole)
    plain = written(tmp_path, effective_yaml(Config()))
    assert load_config(plain, {"field.template": name}) == load_config("default", {"field.template": name})
    assert load_config(plain, {"field.template": name}).camera == Config().camera


def test_a_loaded_configuration_takes_the_options_of_another_sport_only():
    radar = load_config(None, {"output.radar": True})
    assert load_config(radar, {"field.template": "futsal"}) == load_config("futsal", {"output.radar": True})
    plain = load_config("default", {"field.template": "futsal"})
    assert load_config(plain, {"seed": 1}) == plain.model_copy(update={"seed": 1})


def test_overrides_are_left_as_they_were_given():
    camera, sizes = {"roll_sd_deg": 1}, {"length": 100}
    load_config(None, {"camera": camera, "camera.focal_sd": 0.5, "field": {"sizes": sizes}, "field.sizes.width": 60})
    assert (camera, sizes) == ({"roll_sd_deg": 1}, {"length": 100})


def test_shipped_configurations_load_by_name():
    assert {"default", "broadcast", "low-camera", "futsal", "ice-hockey", "robocup"} <= set(config_names())
    for name in config_names():
        load_config(name)


def test_a_template_file_lies_relative_to_the_configuration_that_names_it(tmp_path):
    config = load_config(written(tmp_path, "field: {template: rink.yaml}\n"))
    assert config.field.template == str(tmp_path / "rink.yaml")


def test_template_files_among_others_lie_there_too_and_their_content_counts(tmp_path):
    config = load_config(written(tmp_path, "field: {template: auto, among: [soccer, rink.yaml]}\n"))
    assert config.field.among == ("soccer", str(tmp_path / "rink.yaml"))
    before = config_digest(config)
    (tmp_path / "rink.yaml").write_text("name: rink\n")
    assert config_digest(config) != before
    here = load_config(None, {"field.template": "auto", "field.among": ["soccer", "rink.yaml"]})
    assert absolute_files(here).field.among == ("soccer", str(Path.cwd() / "rink.yaml"))


@pytest.mark.parametrize(
    ("override", "parts"),
    [
        ("edges.smothing_px=1", ["unknown key edges.smothing_px", "did you mean edges.smoothing_px?"]),
        ("jpeg_quality=3", ["unknown key jpeg_quality", "output.jpeg_quality"]),
        ("fild.template=x", ["unknown key fild", "did you mean field?"]),
        ("edges.zzz=1", ["unknown key edges.zzz", "known in edges: dilate_px"]),
        (
            "mask.detector.ridges.treshold=1",
            ["unknown key mask.detector.ridges.treshold", "mask.detector.ridges.threshold"],
        ),
        ("seed=x", ["seed: should be a valid integer", '"x"']),
        ("seed=true", ["seed: should be a valid integer", "true"]),
        ("seed=", ["seed", "null"]),
        ("seed.x=3", ["seed", "a mapping"]),
        ("seed=-1", ["seed", "greater than or equal to 0", "-1"]),
        ("field.circle=no", ["field.circle", "string", "false"]),
        ("field.sizes.length=.nan", ["field.sizes.length", "finite", "NaN"]),
        ("edges.smoothing_px=.inf", ["edges.smoothing_px", "finite"]),
        ("edges.thresholds=[20, 5]", ["edges", "low one must be below"]),
        ("output=3", ["output", "not 3"]),
        ("output={a: 1, a: 2}", ["key 'a' is given twice"]),
        ("seed={", ["--set seed={"]),
        ("seed", ["section.key=value"]),
        ("=3", ["section.key=value"]),
    ],
)
def test_a_wrong_override_is_one_line_that_names_it(override, parts):
    text = problem(None, override)
    assert text.startswith(f"--set {override}")
    for part in parts:
        assert part in text


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        ("seed: 1\nseed: 2\n", ["line 2", "'seed' is given twice"]),
        ("seed: .nan\n", ["seed"]),
        ("camera: {crown_m: .inf}\n", ["camera.crown_m", "finite"]),
        ("edges: {smoothing_px: thick}\n", ["edges.smoothing_px", "valid number", '"thick"']),
        ("seed: 1:30\n", ["seed", "valid integer", '"1:30"']),
        ("edges: {smoothing: 1}\n", ["unknown key edges.smoothing", "edges.smoothing_px"]),
        ("edges: [1, 2]\n", ["edges: should be a mapping, not a list"]),
        ("field: {among: []}\n", ["field.among: should have at least 1 item, not 0"]),
        ("camera: {position_m: [1, 2]}\n", ["camera.position_m.2: is missing"]),
        ("field: {among: soccer}\n", ["field.among: should be a list", '"soccer"']),
        ("edges:\n\tsmoothing_px: 1\n", ["line 2", "a tab begins the line; indent with blanks"]),
        ("- 1\n", ["mapping", "a list"]),
        ("just text\n", ["mapping"]),
        ("seed: [1\n", ["line"]),
        ("? [a, b]\n: 1\n", ["a key must be a name"]),
        ("seed: !!python/object/apply:os.system [ls]\n", ["could not determine a constructor"]),
        ("seed: 1\n\0", ["is not YAML"]),
    ],
)
def test_a_wrong_file_is_one_line_that_names_it(tmp_path, content, parts):
    file = written(tmp_path, content)
    text = problem(file)
    assert text.startswith(str(file))
    for part in parts:
        assert part in text


def test_further_problems_are_counted(tmp_path):
    assert "(and 1 more)" in problem(written(tmp_path, "seed: x\noutput: {radar: 3}\n"))


def test_missing_and_unreadable_files(tmp_path):
    assert "no such file" in problem(tmp_path / "none.yaml")
    assert "broadcast" in problem("no-such-name")
    folder = tmp_path / "folder.yaml"
    folder.mkdir()
    assert "cannot be read" in problem(folder)
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00")
    assert "UTF-8" in problem(binary)


def test_effective_yaml_loads_back_to_the_same_configuration(tmp_path):
    config = load_config(None, ["seed=3", "edges.thresholds=[5, 20]", "field.sizes={length: 99.5}", "field.circle=c"])
    again = load_config(written(tmp_path, effective_yaml(config)))
    assert again == config
    assert config_digest(again) == config_digest(config)


def test_every_option_has_a_description_that_stands_in_the_yaml():
    text = effective_yaml(Config())
    flat = " ".join(line.strip().removeprefix("# ") for line in text.splitlines())
    for model in models(Config):
        assert model.model_config["extra"] == "forbid", model
        assert model.model_config["frozen"], model
        for name, field in model.model_fields.items():
            assert field.description, f"{model.__name__}.{name}"
            assert field.description in flat, f"{model.__name__}.{name}"


def test_default_yaml_is_the_effective_default():
    committed = (config_folder() / "default.yaml").read_text()
    assert committed == effective_yaml(Config()), "regenerate with: circlecal config > configs/default.yaml"


def test_bounds_and_choices_stand_in_the_yaml():
    text = effective_yaml(Config())
    assert "(>= 1, <= 100)" in text
    assert "(one of light, dark, any)" in text


def test_schema_describes_every_section():
    schema = json.loads(json.dumps(json_schema(), allow_nan=False))
    assert set(schema["properties"]) == set(Config.model_fields)
    assert schema["additionalProperties"] is False


def test_digest_changes_with_what_changes_answers_only(tmp_path):
    digest = config_digest(Config())
    assert len(digest) == 12
    assert config_digest(load_config(None, ["output.radar=true"])) == digest
    assert config_digest(load_config(None, ["seed=1"])) != digest
    template = tmp_path / "t.yaml"
    template.write_text("a: 1\n")
    config = load_config(None, [f"field.template={template}"])
    before = config_digest(config)
    template.write_text("a: 2\n")
    assert config_digest(config) != before


def test_uses_differ_from_the_default_and_are_short():
    for name in set(config_names()) - {"default"}:
        text = (config_folder() / f"{name}.yaml").read_text()
        assert text.startswith("#"), f"{name} says what it is for"
        assert len(text.splitlines()) < 40
        assert load_config(name) != Config(), name
        assert isinstance(yaml.safe_load(text), dict)
