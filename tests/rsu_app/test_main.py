import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

import rsu_app.__main__ as door
import rsu_app.cli.main as program
from tests.bundles import make_bundle


@pytest.fixture
def config(tmp_path: Path) -> Path:
    make_bundle(tmp_path / "bundle")
    path = tmp_path / "rsu.toml"
    path.write_text('[database]\npath = "rsu.sqlite3"\n[model]\nbundle_path = "bundle"\n', encoding="utf-8")
    return path


def said(*arguments: str, code: int = 0) -> str:
    result = CliRunner().invoke(program.app, arguments, terminal_width=200)
    assert result.exit_code == code, result.output
    return result.output


def refused(monkeypatch, capsys, *arguments: str) -> str:
    """Run the program as a shell would; return its one line of complaint."""
    monkeypatch.setattr("sys.argv", ["roadgrip-rsu", *arguments])
    with pytest.raises(SystemExit) as left:
        door.main()
    assert left.value.code == 2
    complaint: str = capsys.readouterr().err
    assert complaint.count("\n") == 1
    return complaint


def test_the_version_is_one_line():
    assert re.fullmatch(r"roadgrip \d+\.\d+\.\d+\S*\n", said("--version"))


@pytest.mark.parametrize("command", ["serve", "db", "config", "section", "ledger", "export"])
def test_help_names_every_command(command):
    assert command in said("--help")


def test_a_new_database_is_made_and_found_sound(config):
    assert "schema" in said("db", "upgrade", "--config", str(config))
    assert json.loads(said("db", "check", "--json", "--config", str(config)))["ok"] is True


def test_a_database_that_is_not_there_is_not_made_by_checking(config):
    assert "does not exist" in said("db", "check", "--config", str(config), code=1)
    assert not (config.parent / "rsu.sqlite3").exists()


def test_a_file_that_is_no_database_fails_the_check(config):
    (config.parent / "rsu.sqlite3").write_bytes(b"this is no database, and long enough not to be taken for one" * 20)
    assert json.loads(said("db", "check", "--json", "--config", str(config), code=1))["ok"] is False


def test_a_database_with_a_spoilt_page_fails_the_check(config):
    said("db", "upgrade", "--config", str(config))
    path = config.parent / "rsu.sqlite3"
    content = bytearray(path.read_bytes())
    content[4096 * 3 : 4096 * 4] = bytes(4096)
    path.write_bytes(content)
    told = json.loads(said("db", "check", "--json", "--config", str(config), code=1))
    assert told["problems"]
    assert bytes(content) == path.read_bytes()


def test_settings_are_shown_as_they_hold(config, monkeypatch):
    monkeypatch.setenv("ROADGRIP_HTTP__PORT", "9009")
    shown = json.loads(said("config", "show", "--json", "--config", str(config)))
    assert (shown["http"]["port"], shown["udp"]["port"]) == (9009, 4740)
    assert "9009" in said("config", "show", "--config", str(config))


def test_settings_that_hold_are_explained(config):
    explained = said("config", "check", "--config", str(config))
    assert "section long-turn" in explained
    assert "bundle" in explained


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ('[[sections]]\nfile = "no-such-turn"\n', "no-such-turn"),
        ('[[sections]]\nfile = "missing.json"\n', r"missing\.json"),
        ('[model]\nbundle_path = "missing"\n', "missing"),
        ('[signing]\ncredential_file = "missing.pem"\n', r"missing\.pem"),
        ('[signing]\nauthorities_folder = "missing"\n', "authorities_folder"),
        ('[database]\npath = "."\n', r"database\.path: .* is a folder; name a file"),
        ("[http]\nport = -1\n", r"http\.port"),
        ("not toml", "TOML"),
    ],
)
def test_settings_that_do_not_hold_are_one_line_and_exit_code_2(tmp_path, monkeypatch, capsys, text, named):
    path = tmp_path / "bad.toml"
    path.write_text(text, encoding="utf-8")
    assert re.search(named, refused(monkeypatch, capsys, "config", "check", "--config", str(path)))


def test_the_folder_of_a_database_that_cannot_be_made_is_named(tmp_path, monkeypatch, capsys):
    (tmp_path / "file").write_text("", encoding="utf-8")
    path = tmp_path / "bad.toml"
    path.write_text('[database]\npath = "file/rsu.sqlite3"\n', encoding="utf-8")
    assert "rsu.sqlite3" in refused(monkeypatch, capsys, "db", "upgrade", "--config", str(path))


def test_a_spoilt_bundle_is_named_with_its_folder(config, monkeypatch, capsys):
    with (config.parent / "bundle" / "model.onnx").open("ab") as model:
        model.write(b"?")
    complaint = refused(monkeypatch, capsys, "config", "check", "--config", str(config))
    assert f"{config.parent / 'bundle'}: bundle file model.onnx differs" in complaint


def test_settings_are_shown_in_words_of_their_table(config):
    shown = said("config", "show", "--config", str(config))
    assert "16.6667" in shown
    assert "None" not in shown


@pytest.mark.parametrize(("absent", "code", "needle"), [("typer", 2, "roadgrip[rsu]"), ("", 0, "roadgrip 0")])
def test_without_its_libraries_the_command_says_what_to_install(absent, code, needle):
    program = f"import sys; sys.modules.update(dict.fromkeys({absent.split()})); import rsu_app.__main__ as m; m.main()"
    done = subprocess.run([sys.executable, "-c", program, "--version"], capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert needle in done.stdout + done.stderr
    assert "Traceback" not in done.stderr
