"""All settings in one schema: defaults, a TOML file over them, and the resolved result."""

import difflib
import tomllib
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError, ValidationInfo, field_validator
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict

from vwnav.errors import ConfigError
from vwnav.estimation.config import EkfConfig
from vwnav.files.whole import write_whole
from vwnav.guidance.limits import LimitsConfig
from vwnav.mission.config import FlightConfig
from vwnav.recording.disk.budget import RecordingConfig
from vwnav.safety.safety_config import EstimateLimits, SafetyConfig
from vwnav.seams import PipelineConfig
from vwnav.settings.ranges import check_written, in_short
from vwnav.types import FEATURE_NAMES
from vwnav.vision.config import FeaturesConfig, LocalizerConfig, OdometryConfig


class Config(BaseSettings):
    """Every setting; each table of the TOML file is one of these fields."""

    model_config = SettingsConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    features: FeaturesConfig = FeaturesConfig()
    pipeline: PipelineConfig = PipelineConfig()
    localizer: LocalizerConfig = LocalizerConfig()
    odometry: OdometryConfig = OdometryConfig()
    ekf: EkfConfig = EkfConfig()
    flight: FlightConfig = FlightConfig()
    limits: LimitsConfig = LimitsConfig()
    safety: SafetyConfig = SafetyConfig()
    estimate: EstimateLimits = EstimateLimits()
    recording: RecordingConfig = RecordingConfig()

    @field_validator("*", mode="before")
    @classmethod
    def _as_written(cls, table: Any, info: ValidationInfo) -> Any:
        """Numbers are held against their ranges before pydantic takes `true` for 1, "4" for 4."""
        if isinstance(table, dict):
            check_written(type(cls.model_fields[str(info.field_name)].default), table)
        return table

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Only what is handed in: a stray environment variable must not change a flight."""
        return (init_settings,)


def load_config(path: Path | None) -> Config:
    """Defaults, overridden by the file where one is given.

    Raises:
        ConfigError: unreadable, not TOML, an unknown key or a value that does not fit.
    """
    if path is None:
        return Config()
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ConfigError(f"cannot read the settings {path}: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(f"the settings {path} are not TOML: {error}") from error
    try:
        return Config(**content)
    except ValidationError as error:
        raise ConfigError(f"settings {path}: {explain(error)}") from error


def with_features(config: Config, name: str | None, model: Path | None) -> Config:
    """The settings with what the command line says of the features, where it says anything.

    Raises:
        ConfigError: there are no features of that name.
    """
    chosen = config.features
    if name is not None:
        known = [each for each in FEATURE_NAMES if each == name]
        if not known:
            raise ConfigError(f"no features {name!r}: choose one of {', '.join(FEATURE_NAMES)}")
        chosen = replace(chosen, name=known[0])
    if model is not None:
        chosen = replace(chosen, model=str(model))
    return config.model_copy(update={"features": chosen})


def with_camera(
    config: Config, mount_sigma_rad: float, focal_sigma_ratio: float, time_offset_sigma_s: float
) -> Config:
    """The settings with how well mount, lens and dates are known, as the camera's file says."""
    ekf = replace(
        config.ekf,
        mount_sigma_rad=mount_sigma_rad,
        # By eye a camera is turned by more than it is tilted.
        mount_turn_sigma_rad=max(config.ekf.mount_turn_sigma_rad, 2.0 * mount_sigma_rad),
        focal_sigma_ratio=focal_sigma_ratio,
        time_offset_sigma_s=time_offset_sigma_s,
    )
    return config.model_copy(update={"ekf": ekf})


def save_config(config: Config, path: Path) -> None:
    """Write every setting as TOML that `load_config` reads, whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    settings = tomli_w.dumps(config.model_dump())
    write_whole(path, f"# Every setting of this run; usable as --config.\n\n{settings}")


def explain(error: ValidationError) -> str:
    """The first fault: table, key, value and what was expected; of an unknown key a near one."""
    fault = error.errors()[0]
    where = [str(part) for part in fault["loc"]]
    if fault["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
        near = _near(where)
        hint = f", did you mean {near[0]!r}?" if near else ""
        return f"there is no setting {'.'.join(where)!r}{hint}"
    if fault["type"] == "dataclass_type":
        return (
            f"{where[0]} = {in_short(fault['input'])}: expected a table of settings, [{where[0]}]"
        )
    if fault["type"] == "value_error":
        return f"{'.'.join(where)}.{fault['ctx']['error']}"
    return f"{'.'.join(where)} = {in_short(fault['input'])}: {fault['msg'].lower()}"


def _near(where: list[str]) -> list[str]:
    """The setting that is spelt most like one that there is not: of its table, else of another."""
    near = difflib.get_close_matches(where[-1], _known_names(where[:-1]), n=1)
    if near:
        return near
    elsewhere = {
        name: f"{table}.{name}" for table in Config.model_fields for name in _known_names([table])
    }
    return [elsewhere[name] for name in difflib.get_close_matches(where[-1], elsewhere, n=1)]


def _known_names(table: list[str]) -> list[str]:
    if not table:
        return list(Config.model_fields)
    field = Config.model_fields.get(table[0])
    default = field.default if field else None
    return [f.name for f in fields(default)] if is_dataclass(default) else []
