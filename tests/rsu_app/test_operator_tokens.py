import os

import pytest

from roadgrip.errors import ConfigurationError
from rsu_app.operator_tokens import TokenScope, digest_of, new_token, read_tokens, scopes_of, tokens_from_text
from rsu_app.secret_files import FileWatch


def test_a_new_token_opens_what_its_line_says():
    token, line = new_token([TokenScope.HEALTH, TokenScope.METRICS], note="the control room")
    assert line.startswith("metrics,health ")
    assert scopes_of(token, tokens_from_text(line)) == frozenset({TokenScope.METRICS, TokenScope.HEALTH})


def test_the_line_does_not_hold_the_token():
    token, line = new_token([TokenScope.METRICS])
    assert token not in line
    assert digest_of(token).hex() in line


def test_no_token_is_made_twice():
    assert len({new_token([TokenScope.METRICS])[0] for _ in range(100)}) == 100


def test_a_strange_token_opens_nothing():
    _, line = new_token([TokenScope.METRICS])
    assert scopes_of("rg_strange", tokens_from_text(line)) is None
    assert scopes_of("", tokens_from_text("")) is None


def test_a_token_on_two_lines_opens_what_both_say():
    token, line = new_token([TokenScope.METRICS])
    other = line.replace("metrics", "detections")
    assert scopes_of(token, tokens_from_text(f"{line}\n{other}\n")) == frozenset(
        {TokenScope.METRICS, TokenScope.DETECTIONS}
    )


def test_remarks_and_empty_lines_say_nothing():
    assert tokens_from_text("\n# metrics\n   \n  # health\n") == ()


@pytest.mark.parametrize(
    "line",
    [
        "metrics",
        "metrics 1234",
        "everything " + "a" * 64,
        "metrics,secret " + "a" * 64,
        "a" * 64,
        "metrics " + "A" * 64,
        "metrics " + "a" * 65,
        ", " + "a" * 64,
    ],
)
def test_a_line_that_is_none_is_named_by_its_number_and_not_repeated(line):
    with pytest.raises(ConfigurationError, match="line 2 is not") as caught:
        tokens_from_text(f"# first\n{line}\n")
    assert "aaa" not in str(caught.value).lower()


def test_the_file_has_a_budget():
    with pytest.raises(ConfigurationError, match="more than 100"):
        tokens_from_text(("metrics " + "a" * 64 + "\n") * 101)


@pytest.mark.parametrize("note", ["two\nlines", "x" * 101])
def test_a_note_is_a_line(note):
    with pytest.raises(ConfigurationError, match="note"):
        new_token([TokenScope.METRICS], note=note)


def test_a_token_without_a_scope_is_none():
    with pytest.raises(ConfigurationError, match="metrics, health, detections"):
        new_token([])


@pytest.fixture
def tokens_file(tmp_path):
    path = tmp_path / "tokens"
    path.write_text(new_token([TokenScope.METRICS])[1], encoding="utf-8")
    path.chmod(0o600)
    return path


@pytest.mark.parametrize("mode", [0o400, 0o600, 0o640, 0o440])
def test_a_file_of_owner_and_group_is_read(tokens_file, mode):
    tokens_file.chmod(mode)
    assert len(read_tokens(tokens_file)) == 1


@pytest.mark.parametrize("mode", [0o644, 0o660, 0o604, 0o602, 0o620])
def test_a_file_that_others_may_touch_is_refused(tokens_file, mode):
    tokens_file.chmod(mode)
    with pytest.raises(ConfigurationError, match=f"operators.tokens_file: others may .*mode {mode:04o}.*chmod 640"):
        read_tokens(tokens_file)


def test_a_file_that_is_not_there_or_no_text_is_refused(tokens_file, tmp_path):
    with pytest.raises(ConfigurationError, match="cannot read"):
        read_tokens(tmp_path / "nothing")
    tokens_file.write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigurationError, match="no text"):
        read_tokens(tokens_file)


def test_a_watch_sees_each_change_once(tokens_file):
    watch = FileWatch(tokens_file)
    assert not watch.changed()
    os.utime(tokens_file, ns=(1, 1))
    assert [watch.changed(), watch.changed()] == [True, False]
    tokens_file.unlink()
    assert [watch.changed(), watch.changed()] == [True, False]
