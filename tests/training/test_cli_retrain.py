"""The commands that retrain, look at the register, and open mlflow's pages."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import httpx
import pytest
import typer
from typer.testing import CliRunner

from rsu_app.adapters.inference import load_bundle
from tests.training.many_roads import runs_of_many_roads
from tests.training.retraining.retrained_lab import measured_set, simulated_set
from training.cli_retrain import models_app, retrain, ui
from training.data.data_shelf import HoldOutError, add_data_set
from training.laboratory import Laboratory
from training.retraining.registry import RegisterError
from training.tracking import ModelRegister, local_address

pytestmark = [pytest.mark.xdist_group("tracking"), pytest.mark.timeout(180)]

app = typer.Typer()
app.command()(retrain)
app.command()(ui)
app.add_typer(models_app)
QUICK = ("--trees", 5, "--depth", 3, "--tables", 1)


def invoke(*words: object) -> str:
    result = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_a_retrained_bundle_is_told_listed_shown_and_named(lab, tmp_path):
    simulated_set(lab, "roads", count=500)
    measured_set(lab, "trailer", count=60)
    out = tmp_path / "bundle"
    told = invoke("retrain", "--data", "roads", "--data", "trailer", "--lab", lab.folder, "--out", out, *QUICK)
    bundle_id = load_bundle(out).manifest.bundle_id
    assert bundle_id in told
    assert "version 1 of roadgrip-global, called challenger" in told
    assert "own roads, as if never seen" in told
    assert str(lab.folder / "mlflow.db") in told.replace("\n", "")

    (listed,) = json.loads(invoke("models", "list", "--lab", lab.folder, "--json"))
    assert (listed["version"], listed["bundle_id"], listed["aliases"]) == (1, bundle_id, ["challenger"])
    assert bundle_id in invoke("models", "list", "--lab", lab.folder)
    assert "champion is version 1" in invoke("models", "alias", "champion", 1, "--lab", lab.folder)
    card = invoke("models", "show", "champion", "--lab", lab.folder)
    assert "version 1, called challenger and champion" in card
    assert f"`{bundle_id}`" in card
    shown = json.loads(invoke("models", "show", "--lab", lab.folder, "--json"))
    assert load_bundle(Path(shown["folder"])).manifest.bundle_id == bundle_id


def test_the_result_for_machines_is_one_document(lab):
    simulated_set(lab, "roads", count=500)
    words = ("retrain", "--data", "roads", "--lab", lab.folder, "--experiment", "spring", "--json", *QUICK)
    told = json.loads(invoke(*words))
    assert (told["version"], told["alias"]) == (1, "challenger")
    assert told["metrics"]["mape_ratio.unseen_roads.v1"] > 0.0
    assert [entry.subject for entry in lab.ledger()] == [told["bundle_id"]]
    assert lab.ledger()[0].evidence["experiment"] == "spring"


def test_a_hold_out_never_teaches(lab):
    add_data_set(
        lab,
        runs_of_many_roads(300),
        name="judge",
        kind="simulated",
        role="unseen_roads",
        origin="made up",
        licence="any",
        label_kind="simulated friction",
    )
    with pytest.raises(HoldOutError, match="it judges, and never teaches"):
        invoke("retrain", "--data", "judge", "--lab", lab.folder, *QUICK)


def test_an_empty_register_says_how_to_fill_it(lab):
    assert "roadgrip-train retrain" in invoke("models", "list", "--lab", lab.folder)
    with pytest.raises(RegisterError, match="no model 'challenger'"):
        invoke("models", "show", "--lab", lab.folder)


def test_records_on_a_server_are_named_and_not_served_again():
    told = invoke("ui", "--tracking", "http://roads:secret@records.example:5000")
    assert told == "the records are on a server: http://records.example:5000\n"


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def asked(address: str, server: subprocess.Popen[bytes], *, within_s: float = 120.0) -> bytes:
    """Return what a server says once it answers."""
    until_s = time.monotonic() + within_s
    while time.monotonic() < until_s:
        try:
            return httpx.get(address, timeout=5.0, trust_env=False).content
        except httpx.TransportError:
            try:
                server.wait(0.3)
            except subprocess.TimeoutExpired:
                continue
            raise AssertionError(f"the server ended with code {server.returncode}") from None
    raise AssertionError(f"{address} did not answer")


def is_free(port: int) -> bool:
    with socket.socket() as one:
        one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            one.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


@pytest.mark.long
@pytest.mark.system
@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_mlflows_pages_answer_until_they_are_ended(lab: Laboratory, ending: signal.Signals) -> None:
    assert ModelRegister(address=local_address(lab.folder)).versions("none") == []
    port = free_port()
    script = "import typer; from training.cli_retrain import ui; typer.run(ui)"
    with subprocess.Popen(
        [sys.executable, "-c", script, "--lab", str(lab.folder), "--port", str(port)],
        cwd=lab.folder,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])},
        stderr=subprocess.PIPE,
    ) as server:
        try:
            assert b"OK" in asked(f"http://127.0.0.1:{port}/health", server)
            assert b"<title>MLflow</title>" in asked(f"http://127.0.0.1:{port}/", server)
        finally:
            server.send_signal(ending)
            _, said = server.communicate(timeout=60.0)
    assert server.returncode == 0, said
    assert f"http://127.0.0.1:{port}" in said.decode()
    assert is_free(port)
    assert {path.name for path in lab.folder.iterdir()} <= {"mlflow.db", "mlflow.db-wal", "mlflow.db-shm"}
