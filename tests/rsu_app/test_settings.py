from pathlib import Path

import pytest
from pydantic import ValidationError

from roadgrip.errors import ConfigurationError
from rsu_app.domain.change import ChangePolicy
from rsu_app.domain.probing import ProbingPolicy
from rsu_app.settings import Settings, load_settings, passages_kept_s, settings_rows, settings_table


def written(folder: Path, text: str) -> Path:
    path = folder / "rsu.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_defaults_listen_on_this_machine_only():
    settings = load_settings(None)
    assert (settings.http.host, settings.udp.host, settings.udp.broadcast_host) == ("127.0.0.1", "127.0.0.1", "")


def test_settings_cannot_be_changed_after_loading():
    with pytest.raises(ValidationError):
        load_settings(None).http.port = 1


def test_the_file_overrules_the_defaults(tmp_path):
    assert load_settings(written(tmp_path, "[http]\nport = 9001\n")).http.port == 9001


def test_the_environment_overrules_the_file(tmp_path, monkeypatch):
    monkeypatch.setenv("ROADGRIP_HTTP__PORT", "9002")
    settings = load_settings(written(tmp_path, '[http]\nport = 9001\nhost = "192.0.2.1"\n'))
    assert (settings.http.port, settings.http.host) == (9002, "192.0.2.1")


def test_sections_come_from_the_environment_as_json(monkeypatch):
    monkeypatch.setenv("ROADGRIP_SECTIONS", '[{"file": "s-turn", "winter_speed_mps": 11.1}]')
    (section,) = load_settings(None).sections
    assert (section.file, section.winter_speed_mps) == ("s-turn", 11.1)


def test_paths_in_a_file_are_relative_to_it(tmp_path):
    settings = load_settings(
        written(tmp_path, '[database]\npath = "rsu.sqlite3"\n[[sections]]\nfile = "maps/a.json"\n')
    )
    assert settings.database.path == tmp_path / "rsu.sqlite3"
    assert settings.sections[0].file == str(tmp_path / "maps/a.json")


def test_a_packaged_section_keeps_its_name(tmp_path):
    assert load_settings(written(tmp_path, '[[sections]]\nfile = "s-turn"\n')).sections[0].file == "s-turn"


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[http]\nprot = 1\n", "http.prot: there is no such setting"),
        ("[http]\nport = 70000\n", "http.port"),
        ('[http]\nhost = "my host"\n', "http.host"),
        ("[clock]\nspeedup_ratio = nan\n", "clock.speedup_ratio"),
        ("[clock]\nspeedup_ratio = inf\n", "clock.speedup_ratio"),
        ('[udp]\nsignatures = "sometimes"\n', "udp.signatures"),
        ("[signing]\nreplay_window_s = 0\n", "signing.replay_window_s"),
        ("[change_detection]\nkept_count = 9\n", "change_detection.kept_count"),
        ("[change_detection]\nslack_ratio = 0.3\n", "change_detection: slack_ratio must lie below"),
        ("[change_detection]\nrise_threshold_ratio = 0.1\n", "change_detection: rise_threshold_ratio must not"),
        ("[change_detection]\nreference_from_count = 31\n", "change_detection: reference_from_count must not"),
        ("[export]\nenabled = true\n", "export: enabled needs unit_name"),
        ('[export]\nenabled = true\nunit_name = " "\n', "export: enabled needs unit_name"),
        ("[export]\nsize_limit_bytes = 1000000\n", "export.size_limit_bytes"),
        ("[probing]\nnamed_frac = 1.0\n", "probing.named_frac"),
        ("[probing]\ndriven_frac = 0.0\n", "probing.driven_frac"),
        ("[probing]\nlikely_count = 201\n", "probing.likely_count"),
        ("[probing]\nheard_after_s = inf\n", "probing.heard_after_s"),
        ("sections = []\n", "sections"),
        ("[http\n", "not TOML"),
        ("http = 3\n", "http"),
    ],
)
def test_what_cannot_be_is_refused_by_name(tmp_path, text, named):
    with pytest.raises(ConfigurationError, match=named):
        load_settings(written(tmp_path, text))


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ConfigurationError, match=r"nowhere\.toml"):
        load_settings(tmp_path / "nowhere.toml")


@pytest.mark.parametrize("variable", ["ROADGRIP_HTTP__PROT", "ROADGRIP_HTTP_PORT", "ROADGRIP_PORT"])
def test_a_misspelt_variable_is_refused_with_the_right_spelling_shown(monkeypatch, variable):
    monkeypatch.setenv(variable, "1")
    with pytest.raises(ConfigurationError, match=f"{variable};.*ROADGRIP_HTTP__PORT"):
        load_settings(None)


def test_the_variable_that_names_the_file_is_no_setting(monkeypatch):
    monkeypatch.setenv("ROADGRIP_CONFIG", "rsu.toml")
    assert load_settings(None).http.port == 8080


def test_a_variable_that_is_not_json_is_refused(monkeypatch):
    monkeypatch.setenv("ROADGRIP_SECTIONS", "s-turn")
    with pytest.raises(ConfigurationError, match=r"ROADGRIP_SECTIONS is not JSON; .*\[\{\"file\": \"s-turn\"\}\]"):
        load_settings(None)


def test_every_setting_is_described():
    assert [row.name for row in settings_rows() if not row.description.endswith(".")] == []


def test_the_operators_page_holds_the_table_of_settings(project_root):
    assert settings_table() in (project_root / "deploy/README.md").read_text(encoding="utf-8")


def test_the_settings_of_change_detection_are_what_the_detector_assumes():
    fields = Settings().change_detection.model_dump()
    assert fields.pop("enabled") is False
    assert ChangePolicy(**fields) == ChangePolicy()


@pytest.mark.parametrize(
    ("text", "kept_days"),
    [
        ("", 7),
        ("[export]\nretention_s = 864000\n", 7),
        ('[export]\nenabled = true\nunit_name = "bend"\n', 90),
        ('[export]\nenabled = true\nunit_name = "bend"\nretention_s = 86400\n', 7),
    ],
)
def test_passages_are_kept_longer_only_for_an_export(tmp_path, text, kept_days):
    assert passages_kept_s(load_settings(written(tmp_path, text))) == 86_400.0 * kept_days


def test_the_settings_of_probing_are_what_the_advice_assumes():
    assert ProbingPolicy(**Settings().probing.model_dump()) == ProbingPolicy()


@pytest.mark.parametrize("name", ["evidence_count", "knowing_count", "likely_count", "sure_count"])
def test_no_vehicle_is_not_enough_to_change_advice(tmp_path, name):
    with pytest.raises(ConfigurationError, match=f"probing.{name}"):
        load_settings(written(tmp_path, f"[probing]\n{name} = 0\n"))


def test_the_example_configuration_is_the_defaults_spelt_out(project_root):
    example = load_settings(project_root / "deploy/rsu.example.toml")
    plain = Settings()
    differing = {
        name for name in Settings.model_fields if name != "database" and getattr(example, name) != getattr(plain, name)
    }
    assert differing == set()
