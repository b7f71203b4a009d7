"""The one frozen record of settings: a TOML file, overruled by environment variables `ROADGRIP_SECTION__NAME`.

Every default is safe: the unit listens on this machine only, needs no root and writes below the working directory.
Relative paths in a configuration file are relative to that file's folder.
`deploy/README.md` holds the table that `settings_table` makes; a test keeps the two alike.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, Field, ValidationError
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict

from roadgrip.errors import ConfigurationError
from rsu_app.http_settings import HttpSettings, OperatorSettings
from rsu_app.setting_groups import (
    AdvisorySettings,
    ChangeDetectionSettings,
    ClockSettings,
    ControlSettings,
    DatabaseSettings,
    ExportSettings,
    FrameSettings,
    IngestSettings,
    LogSettings,
    ModelSettings,
    ProbingSettings,
    SectionSettings,
    SigningSettings,
    UdpSettings,
    UpdateSettings,
    WindowSettings,
)

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

ENV_PREFIX = "ROADGRIP_"
ENV_DELIMITER = "__"
_URL = re.compile(r"[a-z]+://")
CONFIG_VARIABLE = "ROADGRIP_CONFIG"
"""Names the file of settings; no setting itself."""


class Settings(BaseSettings):
    """Everything an operator may choose."""

    model_config = SettingsConfigDict(
        frozen=True,
        extra="forbid",
        env_prefix=ENV_PREFIX,
        env_nested_delimiter=ENV_DELIMITER,
        env_ignore_empty=True,
        allow_inf_nan=False,
    )

    sections: tuple[SectionSettings, ...] = Field(
        default=(SectionSettings(file="long-turn"),), min_length=1, description="The sections this unit serves."
    )
    database: DatabaseSettings = DatabaseSettings()
    export: ExportSettings = ExportSettings()
    model: ModelSettings = ModelSettings()
    window: WindowSettings = WindowSettings()
    change_detection: ChangeDetectionSettings = ChangeDetectionSettings()
    advisory: AdvisorySettings = AdvisorySettings()
    probing: ProbingSettings = ProbingSettings()
    http: HttpSettings = HttpSettings()
    operators: OperatorSettings = OperatorSettings()
    udp: UdpSettings = UdpSettings()
    frames: FrameSettings = FrameSettings()
    ingest: IngestSettings = IngestSettings()
    signing: SigningSettings = SigningSettings()
    updates: UpdateSettings = UpdateSettings()
    control: ControlSettings = ControlSettings()
    clock: ClockSettings = ClockSettings()
    log: LogSettings = LogSettings()

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],  # noqa: ARG003 - the library calls with these five
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,  # noqa: ARG003 - same
        file_secret_settings: PydanticBaseSettingsSource,  # noqa: ARG003 - same
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Return the sources, strongest first: the environment overrules what the file says (it comes as `init`)."""
        return env_settings, init_settings


def passages_kept_s(settings: Settings) -> float:
    """Return how long passages are kept: nothing longer than the unit needs it, unless they are for an export."""
    kept_s = settings.database.retention_s
    return max(kept_s, settings.export.retention_s) if settings.export.enabled else kept_s


def load_settings(config_file: Path | None) -> Settings:
    """Return the settings of a TOML file, overruled by the environment, on top of the defaults.

    Args:
        config_file: None takes the defaults and the environment.

    Raises:
        ConfigurationError: The file cannot be read, or something in it or in the environment cannot be; the message
            names every offending setting.
    """
    content: dict[str, Any] = {}
    if config_file is not None:
        try:
            content = tomllib.loads(config_file.read_text(encoding="utf-8"))
        except OSError as error:
            raise ConfigurationError(f"cannot read {config_file}: {error.strerror}") from error
        except (ValueError, RecursionError) as error:  # no text, no TOML, a number of 5,000 digits, a thousand brackets
            raise ConfigurationError(f"{config_file} is not TOML: {error}") from error
        _anchor_paths(content, config_file.resolve().parent)
        _anchored_source(content, config_file.resolve().parent)
    _refuse_unknown_variables()
    try:
        return Settings(**content)
    except ValidationError as error:
        problems = "; ".join(f"{'.'.join(map(str, e['loc'])) or 'settings'}: {_complaint(e)}" for e in error.errors())
        where = "environment" if config_file is None else f"{config_file} and environment"
        raise ConfigurationError(f"{where}: {problems}") from error
    except ValueError as error:  # `sections` is the only setting that the environment holds as JSON
        raise ConfigurationError(
            f'{ENV_PREFIX}SECTIONS is not JSON; write it like this: [{{"file": "s-turn"}}]'
        ) from error


def _complaint(error: ErrorDetails) -> str:
    if error["type"] == "extra_forbidden":
        return "there is no such setting; `roadgrip-rsu config show` lists all"
    return error["msg"].removeprefix("Value error, ")


def is_packaged_name(file: str) -> bool:
    """Return whether a section is named rather than given as a path."""
    return not file.endswith(".json") and os.sep not in file


@dataclass(frozen=True, slots=True)
class SettingRow:
    """One setting as the documentation shows it."""

    name: str
    variable: str
    default: str
    description: str


def settings_rows() -> tuple[SettingRow, ...]:
    """Return every setting in the order of the record."""
    return tuple(_rows(Settings, ()))


def settings_table() -> str:
    """Return the table of all settings as Markdown, as `deploy/README.md` holds it."""
    lines = ["| setting | environment | default | meaning |", "|---|---|---|---|"]
    lines += [f"| `{r.name}` | `{r.variable}` | {r.default} | {r.description} |" for r in settings_rows()]
    return "\n".join(lines) + "\n"


def _rows(model: type[BaseModel], above: tuple[str, ...]) -> Iterator[SettingRow]:
    for name, field in model.model_fields.items():
        path = (*above, name)
        annotation = field.annotation
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            yield from _rows(annotation, path)
            continue
        variable = ENV_PREFIX + ENV_DELIMITER.join(path).upper()
        if name == "sections":
            yield SettingRow(
                "sections",
                variable,
                '`[{file = "long-turn"}]`',
                (field.description or "") + " In the environment: JSON.",
            )
            yield from (
                SettingRow(f"sections[].{row.name}", "", row.default, row.description)
                for row in _rows(SectionSettings, ())
            )
            continue
        yield SettingRow(".".join(path), variable, _shown(field.get_default()), field.description or "")


def shown_value(value: object) -> str:
    """Return a setting's value as a person reads it: `none` for nothing, six digits of a fraction."""
    if value is None or value == "":
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _shown(default: object) -> str:
    if default is None or default == "":
        return "none"
    return f"`{shown_value(default)}`" if isinstance(default, bool | float | str | int | Path) else "must be given"


def _anchor_paths(content: dict[str, Any], folder: Path) -> None:
    for group, name in (
        ("database", "path"),
        ("model", "bundle_path"),
        ("signing", "credential_file"),
        ("signing", "authorities_folder"),
        ("signing", "revocations_file"),
        ("http", "tls_certificate_file"),
        ("http", "tls_key_file"),
        ("http", "client_authorities_file"),
        ("operators", "tokens_file"),
        ("updates", "folder"),
        ("updates", "trusted_root"),
        ("control", "socket_path"),
    ):
        table = content.get(group)
        if isinstance(table, dict) and isinstance(table.get(name), str):
            table[name] = str(folder / table[name])
    sections = content.get("sections")
    for section in sections if isinstance(sections, list) else ():
        if isinstance(section, dict) and isinstance(section.get("file"), str) and not is_packaged_name(section["file"]):
            section["file"] = str(folder / section["file"])


def _anchored_source(content: dict[str, Any], folder: Path) -> None:
    """Take a repository that is named as a relative folder relative to the configuration file, too."""
    updates = content.get("updates")
    source = updates.get("source") if isinstance(updates, dict) else None
    if isinstance(updates, dict) and isinstance(source, str) and source and not _URL.match(source):
        updates["source"] = str(folder / source)


def _refuse_unknown_variables() -> None:
    """Raise for a misspelt variable; pydantic-settings would pass over it in silence."""
    known = {row.variable for row in settings_rows()} | {CONFIG_VARIABLE}
    unknown = sorted(name for name in os.environ if name.startswith(ENV_PREFIX) and name.upper() not in known)
    if unknown:
        raise ConfigurationError(
            f"unknown environment variables: {', '.join(unknown)}; a setting's group and name are joined by two "
            f"underscores, as in {ENV_PREFIX}HTTP{ENV_DELIMITER}PORT"
        )
