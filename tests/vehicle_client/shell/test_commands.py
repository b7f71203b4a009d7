"""The command `roadgrip-vehicle`, alone and against a real unit."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import pytest
from typer.testing import CliRunner

from deploy.demo.unit import UnitProcess, migrate, write_config
from roadgrip.errors import ConfigurationError
from roadgrip.features import NEWEST_TABLE
from roadgrip.section_file import section_to_json
from roadgrip.sections import read_section
from vehicle_client.__main__ import main
from vehicle_client.cli import app_of
from vehicle_client.shell.can.description import path_of_signals, read_can_mapping

APP = app_of()
SPEEDUP = "200"


def run(*arguments: str | Path) -> tuple[int, str]:
    result = CliRunner().invoke(APP, [str(a) for a in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout


@pytest.mark.parametrize("command", [[], ["fleet"], ["replay"], ["drive"], ["inspect"], ["survey"]])
def test_help_teaches(command: list[str]):
    code, out = run(*command, "--help")
    assert code == 0
    assert "Usage" in out


def test_the_version_is_said():
    code, out = run("--version")
    assert code == 0
    assert out.startswith("roadgrip ")


@pytest.mark.parametrize(
    ("arguments", "needle"),
    [
        (["drive", "--section", "no-such-road"], "long-turn"),
        (["fleet", "--rsu", "carrier-pigeon"], "udp://HOST:PORT"),
        (["fleet", "--friction-change", "soon"], "0.25@0.5"),
        (["fleet", "--credential", "no-such.pem"], "no-such.pem"),
        (["fleet", "--authority", "no-such.pem"], "no-such.pem"),
        (["replay", "no-such.csv", "--dry-run"], "no-such.csv"),
        (["fleet", "--section", "rsu:long-turn", "--rsu", "udp://127.0.0.1:9"], "did not answer; is it running there?"),
    ],
)
def test_what_cannot_be_is_one_line_and_exit_code_2(
    arguments: list[str], needle: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(sys, "argv", ["roadgrip-vehicle", *arguments])
    with pytest.raises(SystemExit) as leaving:
        main()
    assert leaving.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("roadgrip-vehicle: ")
    assert needle in line


@pytest.mark.sim
def test_a_drive_is_drawn_kept_and_replayed(tmp_path: Path):
    pytest.importorskip("matplotlib")
    picture, recording = tmp_path / "drive.png", tmp_path / "drive.csv.gz"
    code, out = run(
        "drive", "-s", "s-turn", "--sensors", "automotive", "--json", "--plot", picture, "--trace", recording
    )
    assert code == 0
    driven = json.loads(out)
    assert driven["outcome"] == "completed"
    assert driven["sideslip_error_rad"] < driven["peak_sideslip_rad"]
    assert picture.read_bytes().startswith(b"\x89PNG")
    code, out = run("replay", recording, "-s", "s-turn", "--dry-run", "--json")
    assert code == 0
    # A fix is kept in the row nearest to it, so the match may move by a fraction of a sample.
    replayed = json.loads(out)["passage"]
    assert list(replayed["values"]) == [f.name for f in NEWEST_TABLE.kinematic]
    assert replayed["values"] == pytest.approx(driven["passage"]["values"], rel=0.05, abs=0.02)


@pytest.mark.sim
def test_a_drive_for_a_person_is_a_table():
    code, out = run("drive", "-s", "sharp-turn")
    assert code == 0
    assert "friction of the road" in out


@pytest.mark.sim
def test_a_part_of_a_recording_without_the_section_is_no_passage(tmp_path: Path):
    recording = tmp_path / "drive.csv"
    run("drive", "-s", "s-turn", "--json", "--trace", recording)
    code, out = run("replay", recording, "-s", "s-turn", "--dry-run", "--json", "--to", "12")
    assert code == 1
    assert json.loads(out)["passage"]["refusal"]["reason"] in {"passage_aborted", "wrong_road"}
    code, out = run("replay", recording, "-s", "s-turn", "--dry-run", "--to", "12")
    assert code == 1
    assert "no passage" in out


@pytest.fixture(scope="module")
def unit(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    folder = tmp_path_factory.mktemp("unit")
    files, http_port, udp_port = write_config(
        folder, section="s-turn", speedup_ratio=float(SPEEDUP), bundle=None, usual_ports=False
    )
    migrate(files)
    process = UnitProcess(files, section_id="s-turn", http_port=http_port)
    try:
        process.wait_until_ready()
        yield {"http": process.url, "udp": f"udp://127.0.0.1:{udp_port}"}
    finally:
        process.stop()


@pytest.mark.system
@pytest.mark.sim
@pytest.mark.parametrize(("carrier", "seed"), [("udp", "4"), ("http", "5")])
def test_a_fleet_reports_to_a_real_unit(unit: dict[str, str], carrier: str, seed: str, tmp_path: Path):
    code, out = run(
        *["fleet", "--rsu", unit[carrier], "--section", "rsu:s-turn", "--vehicles", "8", "--base-friction", "0.6"],
        *["--arrivals-per-hour", "400", "--speedup", SPEEDUP, "--loss", "0.05", "--doubled", "0.1", "--json"],
        *["--spool", str(tmp_path / "spool"), "--seed", seed],
    )
    report = json.loads(out)
    assert code == 0
    assert report["vehicles_count"] == 8
    assert report["accepted_count"] == report["drives"]["completed"] > 0
    assert report["counted_count"] == report["accepted_count"]
    assert report["budget_peak_count"] <= 12
    assert report["air"]["lost_count"] > 0
    assert list((tmp_path / "spool").iterdir()) == []


@pytest.mark.system
@pytest.mark.sim
def test_a_recording_is_acknowledged_by_a_real_unit(unit: dict[str, str], tmp_path: Path):
    recording = tmp_path / "drive.csv"
    run("drive", "-s", "s-turn", "--seed", "9", "--json", "--trace", recording)
    code, out = run("replay", recording, "-s", "s-turn", "--rsu", unit["udp"], "--json")
    assert code == 0
    exchange = json.loads(out)["exchange"]
    assert (exchange["ending"], exchange["counted"]) == ("accepted", True)
    code, out = run("replay", recording, "-s", "s-turn", "--rsu", unit["http"])
    # The same numbers under another passage id: somebody replays what he heard.
    assert code == 1
    assert "replayed" in out


@pytest.mark.system
def test_a_section_that_a_unit_does_not_serve_is_said_with_those_it_does(
    unit: dict[str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(sys, "argv", ["roadgrip-vehicle", "drive", "-s", "rsu:sharp-turn", "--rsu", unit["udp"]])
    with pytest.raises(SystemExit):
        main()
    assert "no map of 'sharp-turn': unknown_section: 'sharp-turn' is none of s-turn" in capsys.readouterr().err


@pytest.mark.parametrize(("absent", "code", "needle"), [("typer", 2, "roadgrip[vehicle]"), ("", 0, "roadgrip 0")])
def test_without_its_libraries_the_command_says_what_to_install(absent, code, needle):
    program = (
        f"import sys; sys.modules.update(dict.fromkeys({absent.split()})); "
        "import vehicle_client.__main__ as door; door.main()"
    )
    done = subprocess.run([sys.executable, "-c", program, "--version"], capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert needle in done.stdout + done.stderr
    assert "Traceback" not in done.stderr


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "drive.blf"
    code, _ = run("drive", "-s", "s-turn", "--base-friction", "0.6", "--json", "--trace", path)
    assert code == 0
    return path


@pytest.mark.sim
def test_a_can_log_is_inspected_and_summarised(log: Path):
    code, out = run("inspect", log, "--signals", "example", "--json")
    assert code == 0
    verdicts = {channel: finding["verdict"] for channel, finding in json.loads(out)["channels"].items()}
    assert verdicts["yaw_rate_radps"] == verdicts["steer_rad"] == verdicts["wheel_rear_left_mps"] == "ok"
    assert "off" not in verdicts.values()
    code, out = run("replay", log, "--signals", "example", "-s", "s-turn", "--dry-run", "--json")
    assert code == 0
    assert json.loads(out)["passage"]["match"]["method"] == "gnss"


@pytest.mark.sim
def test_a_mapping_that_is_wrong_is_found_out(log: Path, tmp_path: Path):
    example = Path(str(files("vehicle_client.shell.can") / "example"))
    for name in ("roadgrip-example.dbc", "vehicle.toml"):
        (tmp_path / name).write_bytes((example / name).read_bytes())
    text = (example / "signals.toml").read_text(encoding="utf-8").replace('unit = "km/h"', 'unit = "m/s"')
    (tmp_path / "signals.toml").write_text(text, encoding="utf-8")
    code, out = run("inspect", log, "--signals", tmp_path / "signals.toml")
    assert code == 1
    wheels = "wheel_front_left, wheel_front_right, wheel_rear_left, wheel_rear_right"
    assert f'{wheels} (off): wheel speeds look like km/h: unit = "km/h"' in out.splitlines()


@pytest.mark.sim
def test_another_vehicle_makes_another_summary(log: Path, tmp_path: Path):
    longer = tmp_path / "lorry.toml"
    longer.write_text(
        'name = "lorry"\n[geometry]\nwheelbase_m = 4.5\ntrack_m = 2.0\nfront_axle_m = 2.0\n', encoding="utf-8"
    )
    vehicles: tuple[tuple[str | Path, ...], ...] = ((), ("--vehicle", longer))
    summaries = [
        json.loads(run("replay", log, "--signals", "example", "-s", "s-turn", "--dry-run", "--json", *more)[1])
        for more in vehicles
    ]
    assert summaries[0]["passage"]["values"] != summaries[1]["passage"]["values"]


@pytest.mark.sim
def test_a_survey_writes_over_nothing_unless_it_is_told_to(log: Path, tmp_path: Path):
    asked: list[str | Path] = ["survey", log, "--signals", "example", "-o", tmp_path / "road.json", "--id", "road"]
    asked += ["--speed-limit", "80", "--from-m", "60", "--to-m", "400"]
    assert run(*asked)[0] == 0
    with pytest.raises(ConfigurationError, match="--force"):
        run(*asked)
    assert run(*asked, "--force", "--json")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "needle"),
    [
        (["replay", "drive.blf", "--dry-run"], "--signals signals.toml"),
        (["live", "--play", "drive.blf"], "--signals signals.toml"),
        (["inspect", "drive.csv", "--signals", "example"], "drive.csv is not such"),
        (["inspect", "no-such.blf", "--signals", "example"], "no-such.blf"),
        (["inspect", "drive.blf", "--signals", "no-such.toml"], "no-such.toml"),
        (["replay", "drive.csv", "--vehicle", "no-such.toml"], "no-such.toml"),
    ],
)
def test_what_a_recording_lacks_is_said(arguments: list[str], needle: str):
    with pytest.raises(ConfigurationError, match=needle):
        run(*arguments)


@pytest.mark.system
@pytest.mark.sim
@pytest.mark.parametrize("carrier", ["udp", "http"])
def test_a_unit_with_a_newer_map_sends_it_and_gets_a_summary_of_that(
    unit: dict[str, str], carrier: str, tmp_path: Path
):
    recording, outdated = tmp_path / "drive.blf", tmp_path / "outdated.json"
    run("drive", "-s", "s-turn", "--seed", {"udp": "21", "http": "22"}[carrier], "--json", "--trace", recording)
    road = read_section("s-turn")
    outdated.write_text(section_to_json(replace(road, speed_limit_mps=road.speed_limit_mps - 5.0)), encoding="utf-8")
    code, out = run("replay", recording, "--signals", "example", "-s", outdated, "--rsu", unit[carrier], "--json")
    replayed = json.loads(out)
    assert code == 0
    assert replayed["remapped"]
    assert replayed["map_version"] == road.version
    assert replayed["exchange"]["ending"] == "accepted"


def test_a_pattern_of_a_mapping_is_written_and_can_be_read(tmp_path: Path):
    code, out = run("signals", tmp_path / "mycar")
    assert code == 0
    assert "signals.toml" in out
    assert read_can_mapping(tmp_path / "mycar" / "signals.toml").mapping.vehicle == "vehicle.toml"
    with pytest.raises(ConfigurationError, match="--force"):
        run("signals", tmp_path / "mycar")
    assert run("signals", tmp_path / "mycar", "--force")[0] == 0


def test_a_draft_is_made_of_a_dbc_and_can_be_read(tmp_path: Path):
    dbc = tmp_path / "mycar.dbc"
    dbc.write_bytes((Path(str(files("vehicle_client.shell.can"))) / "example" / "roadgrip-example.dbc").read_bytes())
    code, out = run("signals", tmp_path / "mycar", "--dbc", dbc)
    assert code == 0
    assert "nothing in" not in out
    example, draft = (
        {source.table: source.signal for source in read_can_mapping(path).mapping.sources}
        for path in (path_of_signals("example"), tmp_path / "mycar" / "signals.toml")
    )
    assert set(draft.items()) <= set(example.items())
    assert set(example) - set(draft) <= {"stability"}


def test_a_draft_needs_a_dbc_that_is_one(tmp_path: Path):
    with pytest.raises(ConfigurationError, match=r"--dbc: cannot read .*no\.dbc"):
        run("signals", tmp_path / "mycar", "--dbc", tmp_path / "no.dbc")
    assert not (tmp_path / "mycar").exists()


LOADED_BY_LIVE = """
import sys
from vehicle_client.__main__ import main
sys.argv = ["roadgrip-vehicle", "live", "--help"]
try:
    main()
except SystemExit:
    pass
heavy = ("vehicle_client.cli_fleet", "vehicle_client.cli_drive", "vehicle_client.cli_recording", "numba", "scipy")
sys.exit(", ".join(set(heavy) & set(sys.modules)) or 0)
"""


@pytest.mark.system
def test_the_live_command_loads_no_other():
    done = subprocess.run([sys.executable, "-c", LOADED_BY_LIVE], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
