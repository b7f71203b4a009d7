"""The commands, from keys to ledger, as an operator gives them."""

from __future__ import annotations

import json
import shutil

import pytest
import typer
from typer.testing import CliRunner

from roadgrip.errors import RoadgripError
from roadgrip.ledger import Action
from tests.training.promotion.laboratories import bundle_folder, bundle_id
from training.cli_keys import keys_app
from training.cli_ledger import ledger_app
from training.cli_promote import promote, refresh, repository_app, sign
from training.laboratory import Laboratory
from training.promotion.decision import PromotionError
from training.promotion.keys import KeysError
from training.promotion.repository import RepositoryFolderError
from training.retraining.registry import BUNDLE_WORD, MODEL_NAME, aliases
from training.tracking import ModelRegister, local_address, local_tracker

app = typer.Typer()
for command in (promote, sign, refresh):
    app.command()(command)
for group in (keys_app, repository_app, ledger_app):
    app.add_typer(group)


class Operator:
    """Gives commands in a laboratory of his own."""

    def __init__(self, folder):
        self.folder = folder
        self.lab = Laboratory(folder / "lab")
        self.keys = folder / "keys"

    def result(self, *words):
        return CliRunner().invoke(app, [str(word) for word in words], env={"ROADGRIP_LAB": str(self.lab.folder)})

    def says(self, *words, exit_code=0):
        result = self.result(*words)
        if isinstance(result.exception, RoadgripError):
            raise result.exception
        assert result.exit_code == exit_code, result.output
        return result.stdout

    def says_json(self, *words):
        return json.loads(self.says(*words, "--json"))

    def promote(self, number, ring, *words):
        model = bundle_folder(self.folder, number)
        return self.says_json("promote", "--ring", ring, "--model", model, "--keys", self.keys, *words)

    def holder(self, name):
        """Put a key into a folder of its own, as one does who carries it to the safe."""
        folder = self.folder / f"holder-{name}"
        folder.mkdir()
        (self.keys / f"{name}.pem").rename(folder / f"{name}.pem")
        return folder


@pytest.fixture
def operator(tmp_path):
    operator = Operator(tmp_path)
    operator.says("keys", "init", "--keys", operator.keys)
    shutil.copy(operator.lab.repository_folder / "trusted-root.json", tmp_path / "trusted-root.json")
    return operator


def test_a_new_repository_says_what_goes_offline_and_what_stays(tmp_path):
    said = Operator(tmp_path).says("keys", "init", "--keys", tmp_path / "keys")
    lines = said.splitlines()
    assert [line for line in lines if "goes offline" in line and ("root-" in line or "targets-" in line)] == lines[:3]
    assert [line for line in lines if "stays" in line and ("snapshot-" in line or "timestamp-" in line)] == lines[3:5]
    assert "trusted-root.json" in lines[-1]


def test_the_first_bundle_goes_through_the_rings_and_units_get_it(operator):
    assert operator.promote(1, "canary")["release"]["gate"] == "none"
    assert operator.promote(1, "all", "--reason", "a week in the valley")["published"]
    said = operator.says("repository", "verify", "--trusted-root", operator.folder / "trusted-root.json")
    assert said.splitlines() == [
        f"ring canary: bundle {bundle_id(1)}, release 1, gate none",
        f"ring all: bundle {bundle_id(1)}, release 2, gate none",
        "everything is as it was signed",
    ]


def test_a_second_bundle_needs_the_gate_or_a_reason(operator):
    operator.promote(1, "canary")
    operator.promote(1, "all")
    with pytest.raises(PromotionError, match="--override REASON"):
        operator.promote(2, "canary")
    release = operator.promote(2, "canary", "--override", "ice on the road", "--by", "kari")["release"]
    assert (release["gate"], release["reason"], release["released_by"]) == ("overridden", "ice on the road", "kari")
    entry = operator.lab.ledger()[-1]
    assert (entry.actor, entry.evidence["override"], entry.entry_hash) == (
        "kari",
        "ice on the road",
        release["ledger_hash"],
    )


def test_a_step_back_takes_the_bundle_from_the_repository(operator):
    for number in (1, 2):
        operator.promote(number, "all", "--override", "a test")
    shutil.rmtree(operator.folder / "bundle-1")
    words = ("--ring", "all", "--model", bundle_id(1), "--keys", operator.keys)
    with pytest.raises(PromotionError, match="said nothing of it"):
        operator.says("promote", *words)
    assert operator.says_json("promote", *words, "--override", "false warnings")["published"]


def test_the_aliases_follow_the_rings(operator):
    tracker = local_tracker(operator.lab.folder, experiment="a test")
    run = tracker.begin("a bundle", parameters={})
    register = ModelRegister(address=local_address(operator.lab.folder))
    for number in (1, 2):
        register.add(MODEL_NAME, run_id=run.run_id, words={BUNDLE_WORD: bundle_id(number)}, description="")
    assert operator.promote(1, "canary")["aliases"] == ["canary"]
    assert operator.promote(1, "all")["aliases"] == ["champion"]
    assert operator.promote(2, "canary", "--override", "a test")["aliases"] == ["canary"]
    assert operator.promote(3, "canary", "--override", "from a folder")["aliases"] == []
    assert aliases(operator.lab) == {"canary": 2, "champion": 1}


def test_a_model_that_is_nowhere_is_told_without_making_a_register(operator):
    with pytest.raises(RoadgripError, match="no bundle 'challenger'"):
        operator.says("promote", "--ring", "canary", "--keys", operator.keys)
    assert not (operator.lab.folder / "mlflow.db").exists()


def test_signatures_of_two_holders_and_an_offline_copy(tmp_path):
    operator = Operator(tmp_path)
    operator.says("keys", "init", "--keys", operator.keys, "--targets-keys", 2, "--targets-threshold", 2)
    first, second = operator.holder("targets-1"), operator.holder("targets-2")
    assert operator.promote(1, "canary", "--keys", first)["missing"]
    assert "ring canary" in operator.says("sign")
    stick = tmp_path / "stick"
    shutil.copytree(operator.lab.repository_folder, stick)
    said = operator.says("sign", "--repository", stick, "--keys", second)
    assert f"signed: bundle {bundle_id(1)}: new" in said
    assert "not published yet" in said
    shutil.rmtree(operator.lab.repository_folder)
    shutil.copytree(stick, operator.lab.repository_folder)
    assert operator.says_json("refresh", "--keys", operator.keys)["published"]
    assert operator.says_json("repository", "show")["releases"]["canary"]["bundle_id"] == bundle_id(1)
    assert operator.says("sign").strip() == "no change waits for signatures"


def test_a_change_is_withdrawn_with_a_reason(operator):
    offline = operator.holder("targets-1")
    operator.promote(1, "canary")
    assert operator.says("sign", "--withdraw", "the wrong one").startswith("withdrawn: release 1")
    assert (operator.lab.ledger()[-1].action, operator.lab.ledger()[-1].reason) == (Action.REFUSED, "the wrong one")
    assert operator.promote(1, "canary", "--keys", offline)["published"]


def test_a_tampered_repository_is_told_with_exit_code_one(operator):
    operator.promote(1, "canary")
    (model,) = operator.lab.repository_folder.glob("targets/bundles/*/*.model.onnx")
    model.write_bytes(b"another")
    said = operator.says("repository", "verify", "--trusted-root", operator.folder / "trusted-root.json", exit_code=1)
    assert "model.onnx" in said
    assert "ring canary: nothing" in said


def test_keys_with_a_password_need_it_each_time(tmp_path):
    operator = Operator(tmp_path)
    (tmp_path / "password").write_text("snow\n")
    (tmp_path / "wrong").write_text("ice\n")
    operator.says("keys", "init", "--keys", operator.keys, "--password-file", tmp_path / "password")
    with pytest.raises(KeysError, match="give --password-file"):
        operator.says("refresh", "--keys", operator.keys)
    with pytest.raises(KeysError, match="the password is wrong"):
        operator.promote(1, "canary", "--password-file", tmp_path / "wrong")
    assert operator.promote(1, "canary", "--password-file", tmp_path / "password")["published"]


def test_a_key_is_rotated_and_listed(operator):
    old = {key["key_id"] for key in operator.says_json("keys", "show")["keys"] if key["role"] == "timestamp"}
    said = operator.says_json("keys", "rotate", "timestamp", "--revoke", "all", "--keys", operator.keys)
    (new,) = said["keys"]
    listed = operator.says_json("keys", "show", "--keys", operator.keys)
    of_role = {key["key_id"]: key["valid"] for key in listed["keys"] if key["role"] == "timestamp"}
    assert of_role == {new["key_id"]: True, **dict.fromkeys(old, False)}
    assert listed["root_version"] == 2


def test_a_role_that_does_not_exist_is_refused_by_name(operator):
    result = operator.result("keys", "rotate", "mirrors", "--keys", operator.keys)
    assert result.exit_code == 2
    assert "mirrors" in result.output


def test_shorter_periods_are_kept_by_every_command_after(operator):
    operator.says("keys", "renew", "--timestamp-days", 3, "--keys", operator.keys)
    operator.promote(1, "canary")
    periods = {role["role"]: role["period_days"] for role in operator.says_json("repository", "show")["roles"]}
    assert periods == {"root": 365, "targets": 365, "snapshot": 45, "timestamp": 3}


def test_what_is_shown_names_rings_bundles_dates_and_thresholds(operator):
    operator.promote(1, "canary")
    said = operator.says("repository", "show")
    for word in ("canary", bundle_id(1), "1 of 2", "good", "timestamp"):
        assert word in said


def test_old_bundles_are_pruned(operator):
    for number in (1, 2, 3):
        operator.promote(number, "canary", "--override", "a test")
    assert operator.says_json("repository", "prune", "--keep", 1, "--keys", operator.keys)["removed"] == [bundle_id(1)]
    assert operator.says_json("repository", "prune", "--keep", 1, "--keys", operator.keys)["removed"] == []


def test_the_ledger_is_shown_newest_last_and_limited(operator):
    operator.promote(1, "canary")
    lines = [json.loads(line) for line in operator.says("ledger", "show", "--json").splitlines()]
    assert [line["action"] for line in lines] == ["keys_changed", "promoted"]
    assert [json.loads(operator.says("ledger", "show", "--json", "--limit", 1))] == lines[-1:]
    assert lines[-1]["entry_hash"] in operator.says("ledger", "show")


def test_a_ledger_that_holds_together_says_its_head(operator):
    operator.promote(1, "canary")
    head = operator.lab.ledger()[-1].entry_hash
    assert head in operator.says("ledger", "verify", "--head", head)


@pytest.mark.parametrize("how", ["changed", "cut", "beginning", "unreadable", "unknown head"])
def test_a_ledger_that_was_mended_is_told_with_exit_code_one(operator, how):
    operator.promote(1, "canary")
    operator.promote(1, "all")
    lines = operator.lab.ledger_path.read_text().splitlines(keepends=True)
    words = ["--head", "f" * 64] if how == "unknown head" else []
    mended = {
        "changed": [line.replace('"canary"', '"valley"') for line in lines],
        "cut": lines[:-1],
        "beginning": lines[1:],
        "unreadable": [*lines[:1], "{\n", *lines[1:]],
        "unknown head": lines,
    }[how]
    operator.lab.ledger_path.write_text("".join(mended))
    said = operator.says("ledger", "verify", *words, exit_code=1)
    assert {
        "changed": "entry 2 was changed",
        "cut": "which is not in the ledger",
        "beginning": "begins with entry 2",
        "unreadable": "line 2",
        "unknown head": "told elsewhere is missing",
    }[how] in said


def test_without_a_repository_the_way_to_one_is_told(tmp_path):
    with pytest.raises(RepositoryFolderError, match="keys init"):
        Operator(tmp_path).says("repository", "show")
