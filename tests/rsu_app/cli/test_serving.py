"""The lean way to `serve`, and what it leaves to the whole command line."""

from __future__ import annotations

from pathlib import Path

import pytest

from roadgrip.errors import ConfigurationError
from rsu_app.cli.serving import config_of_plain_serve, one_line_complaints
from rsu_app.settings import CONFIG_VARIABLE


@pytest.mark.parametrize(
    ("arguments", "environment", "files"),
    [
        (["serve"], {}, []),
        (["serve"], {CONFIG_VARIABLE: ""}, []),
        (["serve"], {CONFIG_VARIABLE: "/etc/a.toml"}, ["/etc/a.toml"]),
        (["serve", "--config", "b.toml"], {CONFIG_VARIABLE: "/etc/a.toml"}, ["b.toml"]),
        (["serve", "-c", "b.toml"], {}, ["b.toml"]),
        (["serve", "--config=b.toml"], {}, ["b.toml"]),
    ],
)
def test_a_plain_serve_names_its_settings(arguments: list[str], environment: dict[str, str], files: list[str]) -> None:
    assert config_of_plain_serve(arguments, environment) == [Path(file) for file in files]


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["status"],
        ["--version"],
        ["serve", "--help"],
        ["serve", "-c"],
        ["serve", "-c", "--help"],
        ["serve", "--config="],
        ["serve", "--config", ""],
        ["serve", "b.toml"],
        ["serve", "-c", "a.toml", "-c", "b.toml"],
    ],
)
def test_all_else_is_for_the_whole_command_line(arguments: list[str]) -> None:
    assert config_of_plain_serve(arguments, {}) is None


def test_a_broken_promise_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left, one_line_complaints():
        raise ConfigurationError("no such thing")
    assert left.value.code == 2
    assert capsys.readouterr().err == "roadgrip-rsu: no such thing\n"
