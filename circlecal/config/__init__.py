"""The configuration: every option of every stage, from YAML files and ``--set`` overrides, checked and described.

``sections`` (the options) -> ``loading`` (from files and overrides) -> ``suiting`` (for the field and the pixels of a
frame); ``writing`` (as YAML, schema and digest) needs the sections alone.
"""

from circlecal.config.loading import NamedOption, load_config
from circlecal.config.sections import (
    AUTO,
    MODEL_KEYS,
    TEMPLATE_KEYS,
    TOLD_APART,
    Config,
    FieldConfig,
    LearningConfig,
    OutputConfig,
)
from circlecal.config.suiting import aspect_of, check_among, find_template, load_told_field, suit_config, suit_pixels
from circlecal.config.writing import absolute_files, config_digest, effective_yaml, json_schema
from circlecal.yaml_text import config_folder, config_names

__all__ = [
    "AUTO",
    "MODEL_KEYS",
    "TEMPLATE_KEYS",
    "TOLD_APART",
    "Config",
    "FieldConfig",
    "LearningConfig",
    "NamedOption",
    "OutputConfig",
    "absolute_files",
    "aspect_of",
    "check_among",
    "config_digest",
    "config_folder",
    "config_names",
    "effective_yaml",
    "find_template",
    "json_schema",
    "load_config",
    "load_told_field",
    "suit_config",
    "suit_pixels",
]
