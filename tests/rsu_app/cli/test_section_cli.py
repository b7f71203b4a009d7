import builtins
import json
import re
import sys
from math import sin

import pytest
from typer.testing import CliRunner

from roadgrip.errors import SectionError
from roadgrip.protocol import HEADER_BYTES
from roadgrip.section_file import section_from_json
from roadgrip.sections import packaged_names, read_section
from rsu_app.cli.section import section_app
from rsu_app.cli.section_plot import section_panels
from rsu_app.cli.section_report import curvature_sketch, curves_of, plan_sketch
from tests.roadgrip.roads import circle_section
from tests.rsu_app.road_import.surveys import arc_points, csv_of, wkt_of


def _run(*words):
    return CliRunner().invoke(section_app, [str(word) for word in words], env={"COLUMNS": "160"})


@pytest.fixture
def survey_file(tmp_path):
    path = tmp_path / "Valley bend_2.csv"
    path.write_text(csv_of(arc_points()), encoding="utf-8")
    return path


def test_the_papers_roads_come_along():
    assert packaged_names() == ("long-turn", "s-turn", "sharp-turn")
    listed = json.loads(_run("list", "--json").stdout)
    assert [s["section_id"] for s in listed] == list(packaged_names())
    assert "s-turn" in _run("list").stdout


def test_import_writes_a_section_that_can_be_read_and_tells_the_fit(survey_file, tmp_path):
    out = tmp_path / "bend.json"
    result = _run("import", survey_file, "--speed-limit", 60, "-o", out)
    assert result.exit_code == 0, result.output
    section = read_section(str(out))
    assert section.section_id == "valley-bend-2"
    assert section.version in result.stdout
    assert "rms" in result.stdout
    assert "advice will count on none" in result.stdout


def test_import_for_a_machine(survey_file, tmp_path):
    out = tmp_path / "bend.json"
    result = _run(
        "import", survey_file, "--speed-limit", 60, "--id", "b", "--name", "The bend", "--direction", "against",
        "--from", 20, "--to", 120, "--smoothing-m", 8, "--bank-cap", 0.07, "-o", out, "--json",
    )  # fmt: skip
    told = json.loads(result.stdout)
    assert (told["section_id"], told["name"], told["direction"]) == ("b", "The bend", "against")
    assert told["length_m"] == pytest.approx(100.0, abs=1.0)
    assert told["fit"]["smoothing_m"] == 8.0
    assert told["bank_cap_ratio"] == 0.07
    assert told["version"] == section_from_json(out.read_text(encoding="utf-8")).version


def test_import_takes_a_format_and_a_reference(tmp_path):
    source = tmp_path / "line.txt"
    source.write_text(wkt_of(arc_points()), encoding="utf-8")
    out = tmp_path / "line.json"
    result = _run("import", source, "--format", "wkt", "--crs", "EPSG:25833", "--speed-limit", 60, "-o", out)
    assert result.exit_code == 0, result.output
    assert len(read_section(str(out)).anchors) >= 2


def test_import_never_replaces_a_map_unasked(survey_file, tmp_path):
    out = tmp_path / "bend.json"
    out.write_text("precious", encoding="utf-8")
    result = _run("import", survey_file, "--speed-limit", 60, "-o", out)
    assert isinstance(result.exception, SectionError)
    assert out.read_text(encoding="utf-8") == "precious"
    assert _run("import", survey_file, "--speed-limit", 60, "-o", out, "--force").exit_code == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["Valley bend_2.csv", "bend.json"]


def test_a_failed_import_leaves_nothing_behind(survey_file, tmp_path):
    result = _run("import", survey_file, "-o", tmp_path / "bend.json")
    assert isinstance(result.exception, SectionError)
    assert "--speed-limit" in str(result.exception)
    assert [p.name for p in tmp_path.iterdir()] == ["Valley bend_2.csv"]


def test_a_section_that_does_not_fit_the_air_is_refused_before_it_is_written(tmp_path):
    source = tmp_path / "long.csv"
    rows = [f"{240500 + 10 * n},{6845000 + 20.0 * sin(n / 2.0):.2f},{sin(n / 5.0):.2f}" for n in range(700)]
    source.write_text("\n".join(["east_utm33,north_utm33,height", *rows]), encoding="utf-8")
    result = _run("import", source, "--speed-limit", 60, "-o", tmp_path / "long.json")
    assert isinstance(result.exception, SectionError)
    assert "--from and --to" in str(result.exception)
    assert [p.name for p in tmp_path.iterdir()] == ["long.csv"]
    part = _run("import", source, "--speed-limit", 60, "--to", 900, "-o", tmp_path / "part.json")
    assert part.exit_code == 0, part.output


@pytest.mark.parametrize("place", ["nowhere", "nowhere.json", "."])
def test_a_place_without_a_section_is_said(place):
    with pytest.raises(SectionError, match=r"nowhere|packaged|cannot read \.: Is a directory"):
        read_section(place)


def test_a_source_that_is_not_there_is_said(tmp_path):
    result = _run("import", tmp_path / "no.csv", "-o", tmp_path / "x.json")
    assert isinstance(result.exception, SectionError)
    assert re.fullmatch(r"cannot read .*no\.csv: No such file or directory", str(result.exception))


def test_show_tells_people_and_machines_the_same():
    people = _run("show", "sharp-turn").stdout
    machine = json.loads(_run("show", "sharp-turn", "--json").stdout)
    assert machine["tightest_radius_m"] == pytest.approx(20.0, rel=0.03)
    assert machine["version"] in people
    # People are told what flies, headers included; a machine gets the message alone.
    assert machine["map_message_frames_count"] == 1
    assert f"{machine['map_message_bytes'] + HEADER_BYTES} bytes in 1 frame" in people
    assert machine["curves"][0]["direction"] == "right"
    assert "right" in people


@pytest.mark.parametrize("ending", ["png", "svg"])
def test_show_draws_a_figure(tmp_path, ending):
    out = tmp_path / f"s.{ending}"
    result = _run("show", "s-turn", "--plot", out)
    assert result.exit_code == 0, result.output
    assert out.read_bytes()[:4] == (b"\x89PNG" if ending == "png" else b"<?xm")
    assert len(out.read_bytes()) > 10_000


def test_a_plot_needs_a_known_ending(tmp_path):
    assert "ends in" in str(_run("show", "s-turn", "--plot", tmp_path / "s.docx").exception)


def test_without_matplotlib_one_is_told_how_to_get_it(tmp_path, monkeypatch):
    real = builtins.__import__

    def without(name, *rest, **more):
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    for name in [m for m in sys.modules if m.startswith("matplotlib")]:
        monkeypatch.delitem(sys.modules, name)
    result = _run("show", "s-turn", "--plot", tmp_path / "s.png")
    assert isinstance(result.exception, SectionError)
    assert "pip install matplotlib" in str(result.exception)


def test_the_panels_cover_the_whole_section():
    section = read_section("long-turn")
    panels = section_panels(section)
    assert len(panels) == 4
    assert all(len(line.values) == len(section.profile.station_m) for panel in panels for line in panel.lines)


def test_curves_are_told_apart_by_side_and_measured():
    left, right = curves_of(read_section("s-turn"))
    assert (left.direction, right.direction) == ("left", "right")
    assert left.tightest_radius_m == pytest.approx(55.0, rel=0.03)
    assert left.start_m + left.length_m < right.start_m + 1.0
    (circle,) = curves_of(circle_section(100.0, turn_rad=2.0))
    assert circle.mean_radius_m == pytest.approx(100.0, rel=0.01)
    assert circle.turn_rad == pytest.approx(2.0, abs=0.01)


def test_a_straight_has_no_curves_and_can_still_be_shown():
    straight = circle_section(nodes_m=[[0, 0, 0], [20, 0, 0], [40, 0, 0], [60, 0, 0]])
    assert curves_of(straight) == ()
    assert plan_sketch(straight).startswith("S")
    assert "█" not in curvature_sketch(straight)


def test_the_sketch_fits_its_frame_and_has_both_ends():
    for name in packaged_names():
        rows = plan_sketch(read_section(name), columns=40, rows=12).split("\n")
        assert len(rows) <= 12
        assert max(map(len, rows)) <= 40
        assert "".join(rows).count("S") == "".join(rows).count("E") == 1
