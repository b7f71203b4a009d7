"""What `make audit` finds in locks, and that it never takes silence for a clean bill."""

import json

import pytest

from deploy.audit import NOT_ASKED, answer_in, disagreements, installed_problems, lock_problems, main, pins_of

HASH = "--hash=sha256:" + "0" * 64
LOCK = f"""# Made by `make lock`
some-name==1.2 \\
    {HASH} \\
    {HASH}
    # via roadgrip
other[extra]==3 ; python_version < '4' \\
    {HASH}
"""


def test_pins_are_read_with_their_hashes():
    assert [(pin.name, pin.version, pin.hashes_count) for pin in pins_of(LOCK)] == [
        ("some-name", "1.2", 2),
        ("other", "3", 1),
    ]
    assert lock_problems("a.txt", LOCK) == []


@pytest.mark.parametrize(
    ("lock", "problem"),
    [
        (f"--find-links https://somewhere\n{LOCK}", "an address"),
        (f"-i somewhere\n{LOCK}", "an address"),
        (f"thing @ file://somewhere/thing.whl \\\n    {HASH}\n", "an address"),
        (f"thing>=1 \\\n    {HASH}\n", "thing is not pinned"),
        ("thing==1\n", "thing has no SHA-256"),
        ("", "nothing is locked"),
    ],
)
def test_what_a_lock_must_not_hold_is_found(lock, problem):
    assert any(problem in found for found in lock_problems("a.txt", lock))


def test_roles_are_locked_to_the_same_versions():
    assert disagreements({"rsu": LOCK, "dev": LOCK}) == []
    assert disagreements({"rsu": LOCK, "dev": LOCK.replace("==1.2", "==1.3")}) == [
        "some-name is locked to 1.2, 1.3, not the same for every role"
    ]


def test_another_version_than_the_locked_one_is_found():
    assert installed_problems(f"pytest==0.0.1 \\\n    {HASH}\nnot-installed-here==1 \\\n    {HASH}\n")[0].startswith(
        "pytest "
    )
    assert installed_problems(f"not-installed-here==1 \\\n    {HASH}\n") == []


def test_a_package_that_was_skipped_was_not_looked_up():
    packages = [
        {"name": "a", "version": "1", "vulns": []},
        {"name": "b", "version": "2", "vulns": [{"id": "CVE-1"}]},
        {"name": "c", "skip_reason": "not found"},
    ]
    answer = answer_in(json.dumps({"dependencies": packages}))
    assert (answer.asked_count, answer.unknown_count, answer.vulnerable) == (2, 1, ("b 2: CVE-1",))
    assert answer_in("no json").problem


def test_without_the_database_the_audit_does_not_succeed(monkeypatch, capsys):
    monkeypatch.setattr("deploy.audit.installed_problems", lambda lock: [])
    assert main([]) == NOT_ASKED
    assert "NOT AUDITED for known vulnerabilities" in capsys.readouterr().err
