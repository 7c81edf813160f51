"""Sections of which a named preset gives the fields that are not set."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Self

from pydantic import ModelWrapValidatorHandler, model_validator

from mecp_env.core.settings import Settings


class PresetSettings(Settings):
    """A section with a field `preset`: what is not set beside it has the value of the preset, else the default.

    Such a value counts as not set, so that another preset replaces it, and `EnvConfig.to_dict` leaves it out.
    """

    PRESETS: ClassVar[Mapping[str, Mapping[str, Any]]] = {}

    @model_validator(mode="wrap")
    @classmethod
    def _filled(cls, given: Any, build: ModelWrapValidatorHandler[Self]) -> Self:
        if not isinstance(given, Mapping):
            return build(given)
        given = cls.completed(given)
        name = given.get("preset", cls.model_fields["preset"].default)
        preset = cls.PRESETS.get(name, {}) if isinstance(name, str) else {}
        preset = {"preset": name, **preset}
        section = build({**preset, **given})
        section.model_fields_set.difference_update(preset.keys() - given.keys())
        return section

    @classmethod
    def completed(cls, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """`given`, with a preset that it stands for without naming it."""
        return given
