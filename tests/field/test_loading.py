"""What a template of a user's has of its sport without saying so."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from circlecal.config import load_config
from circlecal.errors import ConfigError
from circlecal.field import field_folder, field_names, load_field
from circlecal.field.loading import FACTS_OF_SPORT, find_relative

SEVERAL_TEMPLATES = {"soccer", "basketball", "ice hockey", "robot soccer"}
"""Sports of which the package has more than one template."""


def _content(name: str) -> dict:
    return yaml.safe_load((field_folder() / f"{name}.yaml").read_text(encoding="utf-8"))


def _facts(template) -> tuple:
    return tuple(getattr(template, key) for key in FACTS_OF_SPORT)


def _write(folder: Path, content: dict, **changes) -> Path:
    file = folder / "mine.yaml"
    told = {key: value for key, value in content.items() if key not in FACTS_OF_SPORT}
    file.write_text(yaml.safe_dump({**told, "name": "mine", **changes}, sort_keys=False), encoding="utf-8")
    return file


@pytest.mark.parametrize("name", field_names())
def test_names_of_markings_tell_the_sport(tmp_path, name):
    assert _facts(load_field(_write(tmp_path, _content(name)))) == _facts(load_field(name))


@pytest.mark.parametrize("name", [n for n in field_names() if load_field(n).sport in SEVERAL_TEMPLATES])
def test_a_field_of_another_size_has_the_sport_of_its_kind(tmp_path, name, monkeypatch):
    others = [other for other in field_names() if other != name]
    monkeypatch.setattr("circlecal.field.loading.field_names", lambda: others)
    assert _facts(load_field(_write(tmp_path, _content(name)))) == _facts(load_field(name))


def test_what_the_file_says_is_kept(tmp_path):
    rink = _content("ice-hockey")
    assert load_field(_write(tmp_path, rink, polarity="light", config=None)).config is None
    assert load_field(_write(tmp_path, rink, polarity="light")).polarity == "light"
    assert load_field(_write(tmp_path, rink, polarity="light")).ground == "ice"
    assert load_field(_write(tmp_path, rink, sport="futsal")).config == "futsal"


def test_a_sport_that_nobody_knows_has_no_relative(tmp_path):
    own = _content("wrestling")
    own["circles"] = [{**circle, "name": f"own_{circle['name']}"} for circle in own["circles"]]
    own["default_circle"] = f"own_{own['default_circle']}"
    template = load_field(_write(tmp_path, own))
    assert find_relative(template) is None
    assert _facts(template) == (None, "any", None, "light", True)
    assert _facts(load_field(_write(tmp_path, _content("soccer"), sport="tag"))) == ("tag", "any", None, "light", True)


def test_the_configuration_of_the_relative_is_taken(tmp_path):
    file = _write(tmp_path, _content("ice-hockey-nhl"))
    config = load_config(None, {"field.template": str(file)})
    assert config == load_config("ice-hockey", {"field.template": str(file)})
    assert config.mask.detector.marking == "dark"


@pytest.mark.parametrize("sport", ["footbal", "hockey", "Soccer"])
def test_a_sport_that_is_misspelt_names_the_known_ones(sport, tmp_path):
    with pytest.raises(ConfigError, match=rf"sport: '{sport}' is unknown; known: Australian football, basketball, "):
        load_field(_write(tmp_path, _content("soccer"), sport=sport))
    for other in ("American football", "kabaddi"):
        assert load_field(_write(tmp_path, _content("soccer"), sport=other)).sport == other
