import json

import pytest
from typer.testing import CliRunner

import rsu_app.cli.main as program
from rsu_app.operator_tokens import TokenScope, scopes_of, tokens_from_text


def called(*arguments: str):
    return CliRunner().invoke(program.app, ["token", "new", *arguments])


def test_the_token_goes_to_standard_output_and_its_line_beside_it():
    done = called("--scope", "metrics", "--scope", "health", "--note", "control room")
    line = done.stderr.splitlines()[-1]
    assert line.endswith(" control room")
    assert scopes_of(done.stdout.strip(), tokens_from_text(line)) == frozenset({TokenScope.METRICS, TokenScope.HEALTH})


def test_a_machine_gets_both_as_json():
    told = json.loads(called("--scope", "detections", "--json").stdout)
    assert scopes_of(told["token"], tokens_from_text(told["line"])) == frozenset({TokenScope.DETECTIONS})


@pytest.mark.parametrize("arguments", [(), ("--scope", "everything")])
def test_a_token_that_opens_nothing_we_know_is_not_made(arguments):
    done = called(*arguments)
    assert done.exit_code == 2
    assert "rg_" not in done.output
